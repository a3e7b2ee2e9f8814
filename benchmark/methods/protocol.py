"""Protocols of depth restorers, pose estimators and grasp planners."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

if TYPE_CHECKING:
    from benchmark.data.frame import Instance
    from benchmark.data.infrared import InfraredPair
    from benchmark.metrics.grasp.grasp import Grasps
    from benchmark.metrics.pose.pose_frames import PosePrediction


@dataclass(frozen=True)
class View:
    """What a restorer may see of a frame; colour and depth have the camera's size.

    Attributes:
        color: (h, w, 3) uint8 RGB.
        depth: (h, w) float32 metres, 0 where the sensor measured nothing.
        camera: intrinsics at this size (fx and fy differ where the aspect is squeezed).
        mask: (h, w) bool pixels that a method with `needs_mask` may doubt, such as those of
            transparent objects; None otherwise.
        infrared: the infrared pair at its own size, for a method with `needs_infrared`.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    camera: Camera
    mask: NDArray[np.bool_] | None = None
    infrared: InfraredPair | None = None


@dataclass(frozen=True)
class Restored:
    """What a restorer makes of a view.

    Attributes:
        depth: (h, w) float32 metres at the size of the view. What is not finite or not positive
            counts as no answer.
        confidence: (h, w) float32 in [0, 1], trust in the sensor's depth, of methods that have it.
        spread: (h, w) float32 metres, the expected error (standard deviation) of `depth`, of
            methods that have it.
        clear: (h, w) float32 in [0, 1], probability of glass or metal, of methods that look for it.
    """

    depth: NDArray[np.float32]
    confidence: NDArray[np.float32] | None = None
    spread: NDArray[np.float32] | None = None
    clear: NDArray[np.float32] | None = None


class Restorer(Protocol):
    """A method that makes depth whole.

    Attributes:
        input_size: (width, height) that it works at, or None for any: it is then given the size
            of the ground truth (of the protocol, where that has one).
        needs_mask: whether the view must contain the mask of pixels to doubt.

    A class with `needs_infrared = True` gets the infrared pair, too.
    """

    input_size: tuple[int, int] | None
    needs_mask: bool

    def restore(self, views: Sequence[View]) -> list[Restored]:
        """Restore a batch; the answers in the order of the views, each of its view's size."""
        ...


@dataclass(frozen=True, eq=False)
class PoseAnswer:
    """Ground truth of a view, for methods that use a part of it.

    Attributes:
        mask: (h, w) uint8 `Instance.mask_id` of each pixel, `BACKGROUND` (255) elsewhere.
        instances: the objects of `mask`.
        nocs: (h, w, 3) float32 normalised coordinates x y z in [0, 1], 0 in the background.
        sides: (3,) sides of an object's box, of length 1 together, by mask id; objects whose box
            nobody knows are missing.
    """

    mask: NDArray[np.uint8]
    instances: tuple[Instance, ...]
    nocs: NDArray[np.float32]
    sides: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PoseView:
    """What a method may see of a frame; all maps have the camera's size.

    Attributes:
        color: (h, w, 3) uint8 RGB.
        sensor: (h, w) float32 metres, 0 where there is nothing: the depth that networks look at.
            It is the sensor's raw depth, unless the user asks for another.
        depth: (h, w) float32 metres, 0 where there is nothing: the depth that poses are fitted to.
            It is raw, restored or true, as the user asks (`--depth`).
        camera: intrinsics at this size (fx and fy differ where the aspect is squeezed).
        truth: what is there; given to methods with `needs_truth` alone.

    Raises:
        ToolkitError: maps of another size than the camera's.
    """

    color: NDArray[np.uint8]
    sensor: NDArray[np.float32]
    depth: NDArray[np.float32]
    camera: Camera
    truth: PoseAnswer | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        for name, shape in (("color", (*size, 3)), ("sensor", size), ("depth", size)):
            if getattr(self, name).shape != shape:
                value = getattr(self, name).shape
                raise ToolkitError(f"must have the shape {shape}", field=name, value=value)


@dataclass(frozen=True, eq=False)
class Estimated:
    """What a method found in a view.

    Attributes:
        prediction: classes, poses, sizes and scores of N objects, in the camera's frame. What the
            method finds and cannot fit a pose to is left out.
        masks: (N, h, w) bool pixels of each object at the size of the view, for pictures; None of
            methods that have none. A list of masks is converted to an array.

    Raises:
        ToolkitError: another number of masks than of objects.
    """

    prediction: PosePrediction
    masks: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        n = len(self.prediction.class_ids)
        if self.masks is not None and not isinstance(self.masks, np.ndarray):
            masks = list(self.masks)
            if len({np.shape(mask) for mask in masks}) > 1:
                raise ToolkitError("must be of one size", field="masks")
            object.__setattr__(self, "masks", np.array(masks, dtype=bool) if masks else None)
        if self.masks is not None and (self.masks.ndim != 3 or len(self.masks) != n):
            raise ToolkitError(f"must be ({n}, h, w)", field="masks", value=self.masks.shape)


class PoseEstimator(Protocol):
    """A method that finds objects, their poses and their sizes.

    It takes the settings of `benchmark.methods.pose.fitting.FitSettings`: how poses are fitted to
    what it found is the user's choice.

    Attributes:
        input_size: (width, height) that it works at, or None for any: it is then given the size
            of the ground truth.
        needs_truth: whether the view must contain ground truth (`PoseView.truth`).
    """

    input_size: tuple[int, int] | None
    needs_truth: bool

    def estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        """What is in each of a batch of views, in their order."""
        ...


@dataclass(frozen=True)
class GraspView:
    """What a planner may see; the maps have the camera's size.

    Attributes:
        color: (h, w, 3) uint8 RGB.
        depth: (h, w) float32 metres, z-depth, 0 nothing known: measured, restored or true.
        camera: intrinsics at this size.
        mask: (h, w) bool pixels that belong to objects; None where nobody knows: a planner may
            then look at everything above the table.
        T_cam_table: (4, 4) pose of the table, whose plane is z = 0 and whose z points up; None
            where it is unknown.

    Raises:
        ToolkitError: maps of another size than the camera's, or a pose of another shape.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    camera: Camera
    mask: NDArray[np.bool_] | None = None
    T_cam_table: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        shapes = {"color": (*size, 3), "depth": size, "mask": size, "T_cam_table": (4, 4)}
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array is not None and array.shape != shape:
                raise ToolkitError(f"must have the shape {shape}", field=name, value=array.shape)


class GraspPlanner(Protocol):
    """A method that finds grasps.

    A planner for a suction cup has the attribute `gripper_kind = "suction"`; others are taken to be
    for a jaw. A suction grasp has the middle of the lip at its tip, and its approach is the cup's
    axis.
    """

    def plan(self, view: GraspView) -> Grasps:
        """Grasps of what is seen, in the camera's frame, best first; none where it finds none.

        The same view gives the same grasps.
        """
        ...
