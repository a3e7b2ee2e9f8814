"""What a run of clearing was: all that decides its table, and the circumstances it ran in."""

from __future__ import annotations

from pathlib import Path

import msgspec

from benchmark.running.manifest import hardware, package_versions
from std_toolkit import __version__

GRASP_MANIFEST = "grasp.json"


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


def grasp_manifest(
    setup: GraspSetup,
    *,
    depth_label: str,
    planner_label: str,
    planner_weights: Path | None,
    depth_weights: Path | None,
) -> GraspManifest:
    """A manifest with this machine's circumstances."""
    return GraspManifest(
        version_of_tool=__version__,
        depth_label=depth_label,
        planner_label=planner_label,
        setup=setup,
        planner_weights=str(planner_weights or ""),
        depth_weights=str(depth_weights or ""),
        packages=package_versions(),
        hardware=hardware(),
    )
