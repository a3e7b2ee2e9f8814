"""Whether rendered ground truth still belongs to the labels and camera poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from std_toolkit.geometry.se3 import rotation_angle
from std_toolkit.scene.scene import Scene

if TYPE_CHECKING:
    from std_toolkit.rendering.ground_truth import FrameTruth

# Far below what a label is good to, far above what a decimal number loses.
_SAME_M, _SAME_RAD = 1e-6, 1e-6


def truth_is_current(scene: Scene, truth: FrameTruth) -> bool:
    """Whether a frame was rendered with the poses, camera and meshes that it has now."""
    # Imported here: the rendering package builds on this one.
    from std_toolkit.rendering.inputs import frame_inputs
    from std_toolkit.rendering.placements import frame_placements

    now = frame_placements(scene, truth.frame)
    then = {row.object: row.pose for row in truth.objects}
    if set(now) != set(then) or truth.inputs != frame_inputs(scene, truth.frame):
        return False
    return all(
        np.abs(now[i].t - then[i].t).max() <= _SAME_M
        and rotation_angle(now[i].R.T @ then[i].R) <= _SAME_RAD
        for i in now
    )
