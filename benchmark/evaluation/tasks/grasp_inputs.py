"""Depth and planner of a process that clears tables."""

from dataclasses import replace

from benchmark.data.frame import DepthFrame
from benchmark.data.splits import FrameKey
from benchmark.evaluation.depth_choice import DepthChoice, DepthProvider
from benchmark.methods.protocol import GraspView
from benchmark.methods.registry import MethodOptions, make_planner
from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import PANDA, Gripper
from benchmark.metrics.grasp.suction import SuctionCup
from benchmark.tabletop import round, sense
from benchmark.tabletop.saved_views import check_saved_depth
from std_toolkit.errors import ToolkitError

# Uses the true object poses: the upper bound.
ORACLE = "oracle"

# Planner of suction grasps, and the values of `gripper_kind` of planners.
FLAT_PATCHES, JAW, SUCTION = "flat-patches", "jaw", "suction"

# Tables have the file names of data sets without names of their own.
TABLE_SPLIT = "table"


class Methods:
    """Depth and planner of a process.

    Args:
        depth: depth that grasps are planned on, with the options of its restorer.
        planner, options: a registered planner and its options, or `oracle`.
        gripper: that executes the grasps.

    Raises:
        ToolkitError: a method cannot be made, the planner is for another kind of gripper, or the
            folder of saved depth does not exist.
    """

    def __init__(
        self,
        depth: DepthChoice,
        planner: str,
        options: MethodOptions,
        gripper: Gripper | SuctionCup = PANDA,
    ) -> None:
        self.depths = DepthProvider(depth, TABLE_SPLIT)
        if planner == FLAT_PATCHES and isinstance(gripper, SuctionCup):
            settings = {"cup_radius": str(gripper.radius), **options.settings}
            options = replace(options, settings=settings)
        self.planner = None if planner == ORACLE else make_planner(planner, options)
        kind = SUCTION if isinstance(gripper, SuctionCup) else JAW
        if (planned := getattr(self.planner, "gripper_kind", JAW)) != kind:
            raise ToolkitError(
                f"the planner is for a {planned}, the gripper is a {kind}",
                field="--planner",
                value=planner,
                hint="antipodal is for a jaw, flat-patches for suction",
            )

    @property
    def looks_at_color(self) -> bool:
        """Whether colour is used: by any restorer, or by a planner with `needs_color`."""
        return self.depths.restorer is not None or bool(getattr(self.planner, "needs_color", False))

    def given(self, frame: DepthFrame) -> round.GivenDepth:
        """Return the depth to plan on at camera size; restored depth uses `at_full_size`.

        Raises:
            ToolkitError: the restorer fails, or there is no saved depth of this view.
        """
        if (answers := self.depths.answers) is not None:
            path = answers.path(FrameKey(frame.scene, frame.name))
            check_saved_depth(path, answers.folder, frame)
        answer = self.depths.depths({0: frame})[0]
        if isinstance(answer, str):
            raise ToolkitError(f"there is no depth to plan on: {answer}")
        return round.GivenDepth(frame.color, answer, frame.camera)

    def plan(self, view: GraspView, state: round.State) -> Grasps:
        """Return the planner's grasps of a view, in the camera frame."""
        if self.planner is not None:
            return self.planner.plan(view)
        from benchmark.tabletop.oracle import plan_from_surfaces, surfaces_of

        surfaces = surfaces_of([o.body for o in state.objects], state.poses)
        return plan_from_surfaces(surfaces).transformed(sense.camera_pose().inverse())
