"""What a run of poses was: everything that decides its table, and the circumstances it ran in."""

from __future__ import annotations

from pathlib import Path

import msgspec

from benchmark.running.manifest import hardware, package_versions
from std_toolkit import __version__

POSE_MANIFEST = "pose.json"


class PoseSetup(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What decides a run's table; a run goes on only with the same.

    Attributes:
        split: name of the split.
        frames: number of frames.
        frames_sha256: hash over the frames' names.
        method, preset, settings: the pose method and its options; the fit is among the settings.
        weights_sha256: hash of the file of weights; empty where there is none.
        precision, compile, device: of networks; device is its kind, `cpu` or `cuda`.
        batch_size: frames that go through the method together.
        depth: what poses are fitted to: `raw`, `gt`, a restorer, or what a folder is called.
        depth_preset, depth_settings, depth_weights_sha256: of the restorer; empty for the others.
        depth_folder: that depth was read from; empty for the others.
        as_input: whether networks look at that depth, too, and not at raw depth.
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


def pose_manifest(
    setup: PoseSetup,
    *,
    label: str,
    depth_label: str,
    fit: str,
    root: Path,
    weights: Path | None,
    depth_weights: Path | None,
) -> PoseManifest:
    """A manifest with this machine's circumstances."""
    return PoseManifest(
        version_of_tool=__version__,
        label=label,
        depth_label=depth_label,
        fit=fit,
        setup=setup,
        root=str(root),
        weights=str(weights or ""),
        depth_weights=str(depth_weights or ""),
        packages=package_versions(),
        hardware=hardware(),
    )
