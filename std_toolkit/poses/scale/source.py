"""The protocol of a scale source, and the registry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.jobs import JobOptions
from std_toolkit.plugins import Registry
from std_toolkit.poses.model import Observations, observations
from std_toolkit.scene import Frame, Scene
from std_toolkit.scene.model import ScaleEstimate


@dataclass(frozen=True)
class ScaleContext:
    """What a source may look at.

    Attributes:
        scene: frames, images, labels.
        model: pycolmap.Reconstruction of unknown unit.
        image_ids: frame id to COLMAP image id, registered frames only, rising.
        cameras: intrinsics by camera key, as adjusted with the model.
        board: description of a fiducial board, or None.
        jobs: where work over frames runs.
    """

    scene: Scene
    model: Any
    image_ids: dict[int, int]
    cameras: dict[str, Camera]
    board: Path | None = None
    jobs: JobOptions | None = None

    @cached_property
    def poses(self) -> dict[int, SE3]:
        """T_cam_world of every registered frame, by frame id, in units of the model."""
        from std_toolkit.poses.colmap import from_rigid3d

        return {
            frame: from_rigid3d(self.model.image(image).cam_from_world())
            for frame, image in self.image_ids.items()
        }

    def frames(self) -> list[Frame]:
        """The registered frames in recording order."""
        return [f for f in self.scene.frames if f.id in self.image_ids]

    def camera(self, frame: Frame) -> Camera:
        """Intrinsics that belong to the model."""
        return self.cameras[frame.camera]

    def observations(self, frame_id: int) -> Observations:
        """What a registered frame sees of the model."""
        return observations(self.model, self.image_ids[frame_id])


class ScaleSource(Protocol):
    """One way to metres.

    An implementation is a class without arguments, or a module-level object, registered in the
    entry-point group `std_toolkit.scale_sources`.
    """

    name: str

    def available(self, context: ScaleContext) -> bool:
        """Whether the scene has what this source needs; cheap."""
        ...

    def estimate(self, context: ScaleContext) -> ScaleEstimate:
        """Metres per unit of the model.

        Raises:
            ToolkitError: the evidence is too weak or contradicts itself.
        """
        ...


# Names to factories.
SOURCES: Registry[Callable[[], ScaleSource]] = Registry(
    "std_toolkit.scale_sources",
    {
        "depth": "std_toolkit.poses.scale.depth:DepthScale",
        "cad": "std_toolkit.poses.scale.cad:CadScale",
        "board": "std_toolkit.poses.scale.board:BoardScale",
    },
)


def summarise(
    name: str,
    ratios: NDArray[np.floating],
    *,
    weights: NDArray[np.floating] | None = None,
    groups: NDArray[np.integer] | None = None,
    note: str = "",
) -> ScaleEstimate:
    """Robust summary of single estimates of the scale.

    The factor is the (weighted) median. The spread is the interquartile range relative to it. The
    standard error is 1.2533 x 1.4826 x MAD / sqrt(n); with `groups` it is that of the medians per
    group, because estimates from one image share their errors.

    Args:
        ratios: (N,) positive single estimates.
        weights: (N,) for the median.
        groups: (N,) ids.
        note: what was measured.
    """
    r = np.asarray(ratios, dtype=np.float64)
    factor = float(np.median(r)) if weights is None else weighted_median(r, weights)
    q1, q3 = np.percentile(r, [25, 75])
    single = r
    if groups is not None:
        single = np.array([np.median(r[groups == g]) for g in np.unique(groups)])
    mad = float(np.median(np.abs(single - np.median(single))))
    error = 1.2533 * 1.4826 * mad / np.sqrt(len(single))
    return ScaleEstimate(
        source=name,
        factor=factor,
        spread=float(q3 - q1) / factor,
        standard_error=float(error) / factor,
        count=len(r),
        note=note,
    )


def weighted_median(values: NDArray[np.floating], weights: NDArray[np.floating]) -> float:
    """The value at which half of the weight lies on either side."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(np.asarray(weights, dtype=np.float64)[order])
    return float(np.asarray(values)[order][np.searchsorted(total, total[-1] / 2)])
