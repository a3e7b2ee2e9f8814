"""Geometry of parallel-jaw grippers, as boxes in the frame of a grasp."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError, check_known

Floats = NDArray[np.float64]


class Boxes(NamedTuple):
    """Axis-aligned boxes in the frames of N grasps: B of them for each.

    Attributes:
        low, high: (N, B, 3) smallest and largest x (approach), y (closing), z (height), metres.
    """

    low: Floats
    high: Floats


@dataclass(frozen=True, kw_only=True)
class Gripper:
    """A parallel jaw with two fingers that are mirror images, and a palm.

    Lengths are in metres. "Along" is x, the direction of approach; fingers are listed from the
    tip backwards.

    Attributes:
        name: for people and files.
        max_width: largest opening between the fingers.
        finger_height: of the fingers' inner faces, along z.
        finger_sections: (length along x, thickness along y, height along z) of each section of a
            finger, from the tip backwards; inner faces are flush.
        palm: (length along x, width along y, height along z) of what lies behind the fingers. A
            width of 0 is that of the opened jaw with its fingers.
        base: where the palm begins along x where the fingers grow with the depth of a grasp, as
            those of GraspNet's model do: their first section then ends there. None for fingers
            of fixed length.

    Raises:
        ToolkitError: a length that is not positive.
    """

    name: str
    max_width: float
    finger_height: float
    finger_sections: tuple[tuple[float, float, float], ...]
    palm: tuple[float, float, float]
    base: float | None = None

    def __post_init__(self) -> None:
        lengths = [self.max_width, self.finger_height, self.palm[0], self.palm[2]]
        lengths += [x for section in self.finger_sections for x in section]
        if not all(x > 0 for x in lengths) or not self.finger_sections:
            raise ToolkitError("a gripper's lengths are positive", value=self.name)

    @property
    def finger_length(self) -> float:
        """From the palm to the tips; the longest where it depends on the grasp."""
        return sum(section[0] for section in self.finger_sections)

    def palm_front(self, depths: ArrayLike) -> Floats:
        """(N,) x at which the palm begins, of grasps of these depths (N,)."""
        tips = np.asarray(depths, dtype=np.float64)
        return tips - self.finger_length if self.base is None else np.full_like(tips, self.base)

    def boxes(self, widths: ArrayLike, depths: ArrayLike) -> Boxes:
        """What the open gripper fills: fingers, section by section, then the palm.

        Args:
            widths, depths: (N,) of the grasps.
        """
        half = np.asarray(widths, dtype=np.float64) / 2
        tips = np.asarray(depths, dtype=np.float64)
        front = self.palm_front(tips)
        low, high = [], []
        end = tips
        for length, thickness, height in self.finger_sections:
            start = front if self.base is not None else end - length
            for inner, outer in ((-half, -half - thickness), (half, half + thickness)):
                y = np.minimum(inner, outer), np.maximum(inner, outer)
                low.append(np.stack([start, y[0], np.full_like(tips, -height / 2)], axis=-1))
                high.append(np.stack([end, y[1], np.full_like(tips, height / 2)], axis=-1))
            end = start
        length, width, height = self.palm
        thickest = max(section[1] for section in self.finger_sections)
        across = np.full_like(tips, width / 2) if width else half + thickest
        z = np.full_like(tips, height / 2)
        low.append(np.stack([front - length, -across, -z], axis=-1))
        high.append(np.stack([front, across, z], axis=-1))
        return Boxes(np.stack(low, axis=1), np.stack(high, axis=1))

    def between(self, widths: ArrayLike, depths: ArrayLike) -> Boxes:
        """The space between the open fingers, one box (N, 1, 3) each; arguments as of `boxes`."""
        half = np.asarray(widths, dtype=np.float64) / 2
        tips = np.asarray(depths, dtype=np.float64)
        z = np.full_like(tips, self.finger_height / 2)
        low = np.stack([self.palm_front(tips), -half, -z], axis=-1)
        high = np.stack([tips, half, z], axis=-1)
        return Boxes(low[:, None], high[:, None])


# GraspNet's evaluation: plates of 1 cm, 2 cm high, from 2 cm behind the grasp to its depth. Its
# largest depth is 4 cm.
GRASPNET = Gripper(
    name="graspnet",
    max_width=0.1,
    finger_height=0.02,
    finger_sections=((0.06, 0.01, 0.02),),
    palm=(0.01, 0.0, 0.02),
    base=-0.02,
)

# The hand that GraspNet's published planner looks for in the measured cloud: fingers of 6 cm
# whatever the depth, and 5 cm of way behind the hand.
GRASPNET_SWEPT = Gripper(
    name="graspnet-swept",
    max_width=0.1,
    finger_height=0.02,
    finger_sections=((0.06, 0.01, 0.02),),
    palm=(0.06, 0.0, 0.02),
)

# The hand of the Franka Emika Panda, after the collision boxes of its maker's description: a
# fingertip of 18.5 x 15.2 x 17.5 mm before a thicker shank; tips 46 mm before the housing, which
# is 63 mm x 204 mm and 66 mm long.
PANDA = Gripper(
    name="panda",
    max_width=0.08,
    finger_height=0.0175,
    finger_sections=((0.0185, 0.0152, 0.0175), (0.0275, 0.0265, 0.022)),
    palm=(0.066, 0.204, 0.063),
)

GRIPPERS = {gripper.name: gripper for gripper in (PANDA, GRASPNET, GRASPNET_SWEPT)}


def get_gripper(name: str) -> Gripper:
    """A gripper by its name.

    Args:
        name: a key of `GRIPPERS`.

    Returns:
        The gripper.

    Raises:
        ToolkitError: no such gripper.

    >>> get_gripper("panda").max_width
    0.08
    """
    check_known(name, GRIPPERS, "no such gripper", field="gripper", told="known:")
    return GRIPPERS[name]
