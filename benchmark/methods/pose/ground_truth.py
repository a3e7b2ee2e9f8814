"""Poses from true masks and true NOCS coordinates.

The remaining error is that of the depth. The result is an upper bound of what a restorer can
achieve for poses; with true depth it is exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmark.methods.pose.fitting import FitSettings, FittedPose, fit_pose
from benchmark.methods.protocol import Estimated, PoseView
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.pose.pose_frames import PosePrediction
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.depth_maps import unproject_depth
from std_toolkit.plugins import configured

_FEWEST_POINTS = 4


@dataclass(frozen=True, kw_only=True)
class GroundTruthConfig(FitSettings):
    """Settings.

    Attributes:
        box: sides of the box: `true`, where they are known, or `seen`: from the coordinates that
            can be seen, as methods have to do it.
    """

    box: Literal["true", "seen"] = "true"


class GroundTruthNOCS:
    """True masks and coordinates, poses fitted to the depth asked for: what depth alone decides."""

    settings_type = GroundTruthConfig

    input_size: tuple[int, int] | None = None
    needs_truth = True

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(GroundTruthConfig(), options.settings)
        self._fit = self.config.fit_options

    def estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        """See `PoseEstimator`.

        Raises:
            ToolkitError: a view without ground truth.
        """
        return [self._estimate(view) for view in views]

    def _estimate(self, view: PoseView) -> Estimated:
        truth = view.truth
        if truth is None:
            raise ToolkitError("needs the true coordinates of the frame")
        points = unproject_depth(view.depth, view.camera)
        found: list[tuple[int, FittedPose]] = []
        masks = []
        for instance in truth.instances:
            mask = truth.mask == instance.mask_id
            chosen = mask & (view.depth > 0) & np.isfinite(view.depth)
            if instance.class_id == 0 or chosen.sum() < _FEWEST_POINTS:
                continue
            coordinates = truth.nocs[chosen].astype(np.float64) - 0.5
            try:
                pose = fit_pose(coordinates, points[chosen], self._fit)
            except ToolkitError:
                continue  # no pose explains the depth: not found
            sides = truth.sides.get(instance.mask_id)
            if self.config.box == "true" and sides is not None:
                pose = pose.with_sides(sides)
            found.append((instance.class_id, pose))
            masks.append(mask)
        prediction = PosePrediction(
            [class_id for class_id, _ in found],  # type: ignore[arg-type]
            [pose.RT for _, pose in found],  # type: ignore[arg-type]
            [pose.size for _, pose in found],  # type: ignore[arg-type]
            [1.0] * len(found),  # type: ignore[arg-type]
        )
        return Estimated(prediction, np.array(masks) if masks else None)
