"""Plug-ins of `std-bench`; restorers run in `std-restore`, too."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmark import MethodOptions, Restored, View
from benchmark.data.splits import Split
from benchmark.data.toolkit_scenes import open_scenes
from benchmark.methods.protocol import Estimated, GraspView, PoseView
from benchmark.metrics import Missing
from benchmark.metrics.grasp import Grasps
from benchmark.metrics.pose import PosePrediction
from benchmark.metrics.pose.pose_protocol import PoseGate, PoseProtocol
from benchmark.metrics.protocols import Grid, Protocol, Subset
from std_toolkit.plugins import configured


@dataclass(frozen=True)
class MedianSettings:
    least: int = 1
    """fewest measured pixels of which a median is taken"""


class MedianDepth:
    """`std-bench --method median --set least=10`: holes become the median of what is measured."""

    input_size = None
    needs_mask = False

    def __init__(self, options: MethodOptions) -> None:
        self.settings = configured(MedianSettings(), options.settings)

    def restore(self, views: Sequence[View]) -> list[Restored]:
        return [Restored(self._filled(view.depth)) for view in views]

    def _filled(self, depth: np.ndarray) -> np.ndarray:
        measured = depth[depth > 0]
        enough = len(measured) >= self.settings.least
        return np.where(depth > 0, depth, np.median(measured) if enough else 0).astype(np.float32)


class FindsNothing:
    """`std-bench pose --method nothing`: the lower end of the table."""

    input_size = None
    needs_truth = False

    def __init__(self, options: MethodOptions) -> None:
        """It has no settings."""

    def estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        none = PosePrediction([], np.zeros((0, 4, 4)), np.zeros((0, 3)), [])
        return [Estimated(none) for _ in views]


class Highest:
    """`std-bench grasp --planner highest`: from above at the highest point over the table."""

    def __init__(self, options: MethodOptions) -> None:
        """It has no settings."""

    def plan(self, view: GraspView) -> Grasps:
        v, u = np.nonzero(view.depth)
        points = view.camera.unproject(np.stack([u, v], 1), view.depth[v, u])
        T_table_cam = np.linalg.inv(view.T_cam_table)
        height = points @ T_table_cam[2, :3] + T_table_cam[2, 3]
        if not len(height) or height.max() < 0.01:
            return Grasps.empty()
        down = -view.T_cam_table[:3, 2]
        across = np.cross(down, [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        R = np.stack([down, across, np.cross(down, across)], axis=1)
        return Grasps.make(R[None], points[height.argmax()][None], widths=0.08, depths=0.02)


SHELF = Split(
    name="shelf",
    about="scenes of this toolkit, recorded in our shelf",
    layout="ROOT/shelf/<scene>/scene.json",
    open=lambda root: open_scenes("shelf", root / "shelf"),
)

CLOSE = Protocol(
    name="close",
    about="native resolution, up to 60 cm away",
    grids=(Grid("native", None),),
    subsets=(Subset("all"),),
    missing=Missing.COUNTED,
    depth_range=(0.0, 0.6),
)

LOOSE = PoseProtocol(
    name="loose", about="as strict, with wider gates", gates=(PoseGate(20, 10), PoseGate(30, 20))
)
