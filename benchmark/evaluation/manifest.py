"""Manifests of runs: what decides a table, and the circumstances of the run."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import msgspec

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import begin_folder

MANIFEST = "run.json"

_PACKAGES = ("numpy", "opencv-python-headless", "pandas", "pyarrow", "scipy", "torch")

GRASP_MANIFEST = "grasp.json"

POSE_MANIFEST = "pose.json"

BOP_MANIFEST, BOP_FILE = "bop_run.json", "bop.json"


class _Frames(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What decides the table of a method on frames.

    Attributes:
        split: name of the split.
        frames: number of frames.
        frames_sha256: hash over the frames' names.
        method, preset, settings: the method and its options.
        weights_sha256: hash of the file of weights; empty where there is none.
        precision, compile, device: of the network; device is its kind, `cpu` or `cuda`.
    """

    split: str
    frames: int
    frames_sha256: str
    method: str
    preset: str
    settings: dict[str, str]
    weights_sha256: str
    precision: str
    compile: bool
    device: str


class Setup(_Frames, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What decides a run's numbers; a run goes on only with the same.

    Attributes:
        protocol: the scoring protocol.
        batch_size: frames that go through the method together.
        depth_from: folder whose depth took the place of the sensor's; empty for the sensor's own.
    """

    protocol: str
    batch_size: int
    depth_from: str


class Manifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A run's setup and its circumstances, which only tell a reader where it ran.

    Attributes:
        version_of_tool: of this package.
        label: what the method is called in tables.
        root: where the data lay.
        weights: the file of weights, as it was named.
        packages: versions of the libraries that compute.
        hardware: processor, cores and GPUs.
    """

    version_of_tool: str
    label: str
    setup: Setup
    root: str
    weights: str
    packages: dict[str, str]
    hardware: dict[str, str]


def begin(folder: Path, manifest: Any, name: str = MANIFEST, beside: Sequence[str] = ()) -> None:
    """Write the manifest of a new run, or see that the run that was begun there is the same.

    Args:
        folder: of the run.
        manifest: a structure with a field `setup`, such as `Manifest`.
        name: of its file.
        beside: files that may be there without a manifest, of older versions.

    Raises:
        ToolkitError: another run was begun there; the field that differs is named.
    """
    path = folder / name
    begun = begin_folder(path, manifest, hint="choose another --out", beside=beside)
    for field in manifest.setup.__struct_fields__:
        was, now = getattr(begun.setup, field), getattr(manifest.setup, field)
        if was != now:
            other = "--label or --out" if hasattr(manifest, "label") else "--out"
            raise ToolkitError(
                f"these results were begun with {was!r}",
                path=path,
                field=f"setup.{field}",
                value=now,
                hint=f"choose another {other}",
            )


def circumstances() -> dict[str, Any]:
    """The fields of a manifest that tell where a run runs."""
    return {
        "version_of_tool": __version__,
        "packages": package_versions(),
        "hardware": hardware(),
    }


def package_versions() -> dict[str, str]:
    """Versions of the libraries that compute, as far as they are installed."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def hardware() -> dict[str, str]:
    """Processor, usable cores, and the GPUs that torch sees if something has loaded torch."""
    found = {"processor": _processor(), "cores": str(len(os.sched_getaffinity(0)))}
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_available():
        names = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
        found["gpus"] = ", ".join(names)
    return found


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


class GraspSetup(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What decides a run's table; a run goes on only with the same. Rounds may be added.

    Attributes:
        seed: of all rounds.
        attempts: at most so many a round.
        camera: `quick` or `simulated`.
        depth_model_sha256: of the fitted figures behind the quick camera; empty for the other.
        gripper: name of the hand.
        planner, planner_preset, planner_settings, planner_weights_sha256: the planner and its
            options.
        depth, depth_preset, depth_settings, depth_weights_sha256: `raw`, `gt`, which have no
            preset, or a restorer and its options.
        precision, compile, device: of networks; device is its kind, `cpu` or `cuda`.
    """

    seed: int
    attempts: int
    camera: str
    depth_model_sha256: str
    gripper: str
    planner: str
    planner_preset: str
    planner_settings: dict[str, str]
    planner_weights_sha256: str
    depth: str
    depth_preset: str
    depth_settings: dict[str, str]
    depth_weights_sha256: str
    precision: str
    compile: bool
    device: str


class GraspManifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A run's setup and its circumstances, which only tell a reader where it ran.

    Attributes:
        version_of_tool: of this package.
        depth_label, planner_label: what depth and planner are called in tables.
        planner_weights, depth_weights: the files of weights, as they were named.
        packages: versions of the libraries that compute.
        hardware: processor, cores and GPUs.
    """

    version_of_tool: str
    depth_label: str
    planner_label: str
    setup: GraspSetup
    planner_weights: str
    depth_weights: str
    packages: dict[str, str]
    hardware: dict[str, str]


class PoseSetup(_Frames, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What decides a run's table; a run goes on only with the same. The fit is among the settings.

    Attributes:
        batch_size: frames that go through the method together.
        depth: what poses are fitted to: `raw`, `gt`, a restorer, or what a folder is called.
        depth_preset, depth_settings, depth_weights_sha256: of the restorer; empty for the others.
        depth_folder: that depth was read from; empty for the others.
        as_input: whether networks look at that depth, too, and not at raw depth.
    """

    batch_size: int
    depth: str
    depth_preset: str
    depth_settings: dict[str, str]
    depth_weights_sha256: str
    depth_folder: str
    as_input: bool


class PoseManifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A run's setup and its circumstances, which only tell a reader where it ran.

    Attributes:
        version_of_tool: of this package.
        label, depth_label, fit: what method, depth and fit are called in tables.
        root: where the data lay.
        weights, depth_weights: the files of weights, as they were named.
        packages: versions of the libraries that compute.
        hardware: processor, cores and GPUs.
    """

    version_of_tool: str
    label: str
    depth_label: str
    fit: str
    setup: PoseSetup
    root: str
    weights: str
    depth_weights: str
    packages: dict[str, str]
    hardware: dict[str, str]


class BopSetup(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What decides a run's table; a run goes on only with the same.

    Attributes:
        data, split: names of the folder of the data set, and of that of its scenes.
        results, results_sha256: name of the result file, and its hash.
        targets, targets_sha256: number of objects in images to be found, and hash over them.
        renderer: that draws the models for VSD.
    """

    data: str
    split: str
    results: str
    results_sha256: str
    targets: int
    targets_sha256: str
    renderer: str


class BopManifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A run's setup and its circumstances, which only tell a reader where it ran.

    Attributes:
        version_of_tool: of this package.
        root: where the data lay.
        packages: versions of the libraries that compute.
        hardware: processor, cores and GPUs.
    """

    version_of_tool: str
    setup: BopSetup
    root: str
    packages: dict[str, str]
    hardware: dict[str, str]
