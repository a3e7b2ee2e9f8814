"""Options of the camera-pose step."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from pathlib import Path

from std_toolkit.errors import ToolkitError


class Refinement(enum.StrEnum):
    """What of the intrinsics is adjusted together with the poses."""

    NONE = "none"
    FOCAL = "focal"
    INTRINSICS = "intrinsics"
    DISTORTION = "distortion"


class Mapper(enum.StrEnum):
    """How the keyframes are put together."""

    INCREMENTAL = "incremental"
    GLOBAL = "global"


@dataclass(frozen=True, kw_only=True)
class PoseOptions:
    """How camera poses are recovered.

    Attributes:
        keyframe_motion: median image motion that makes a new keyframe, as a share of the width.
        max_keyframe_gap: a keyframe at least every this many frames.
        max_features: SIFT features per image.
        fine_keyframes: detect features of keyframes at twice the resolution: four times the time,
            twice the features; for scenes of little texture.
        overlap: neighbours in time that every keyframe is matched with.
        loops: keyframes elsewhere in time that look alike, matched with every keyframe.
        mapper: incremental or global mapping of the keyframes.
        refine: which intrinsics are adjusted with the poses: "none" trusts the given ones,
            "focal" adjusts fx and fy, "intrinsics" also cx and cy, "distortion" also k1 k2 p1 p2.
        min_angle_deg: the final adjustment uses points that are seen under at least this angle
            (less on a short sweep and where an image has too few): the things the camera goes
            round, not the far background, where people walk.
        min_points: fewest points that register a frame.
        scale: "auto" (all sources that the scene has), "none" (unit unknown), or one source.
        board: description of a fiducial board (JSON); default: `board.json` of the scene, if any.
        min_registered: gate: share of keyframes, and of all frames, with a pose.
        max_reprojection_px: gate: mean reprojection error.
        max_position_sigma: gate: median standard deviation of a camera position, as a share of
            the median distance to what the camera sees.
        max_disagreement: gate: largest relative difference of two scale sources.
        seed: of every random choice.
        threads: 1 makes results byte-identical from run to run; None uses all cores.
    """

    keyframe_motion: float = 0.05
    max_keyframe_gap: int = 30
    max_features: int = 8192
    fine_keyframes: bool = False
    overlap: int = 6
    loops: int = 4
    mapper: Mapper = Mapper.INCREMENTAL
    refine: Refinement = Refinement.NONE
    min_angle_deg: float = 18.0
    min_points: int = 20
    scale: str = "auto"
    board: Path | None = None
    min_registered: float = 0.95
    max_reprojection_px: float = 1.0
    max_position_sigma: float = 0.01
    max_disagreement: float = 0.005
    seed: int = 0
    threads: int | None = None

    def __post_init__(self) -> None:
        # A plain string that names no member would otherwise be taken for the default.
        for name, kind in (("mapper", Mapper), ("refine", Refinement)):
            try:
                object.__setattr__(self, name, kind(getattr(self, name)))
            except ValueError as error:
                raise ToolkitError(
                    "unknown choice",
                    field=name,
                    value=getattr(self, name),
                    hint=f"one of {', '.join(kind)}",
                ) from error
        for name in ("keyframe_motion", "max_reprojection_px", "max_position_sigma"):
            if not getattr(self, name) > 0:
                raise ToolkitError("must be positive", field=name, value=getattr(self, name))
        for name, least in (
            ("max_keyframe_gap", 1),
            ("max_features", 100),
            ("overlap", 1),
            ("loops", 0),
            ("min_points", 6),
        ):
            if getattr(self, name) < least:
                raise ToolkitError(
                    f"must be at least {least}", field=name, value=getattr(self, name)
                )
        if not 0 <= self.min_registered <= 1:
            raise ToolkitError(
                "must be between 0 and 1", field="min_registered", value=self.min_registered
            )
        if self.threads is not None and self.threads < 1:
            raise ToolkitError("must be at least 1", field="threads", value=self.threads)
