"""A suction cup: its sizes, where it seals, and what it holds.

The seal is that of Dex-Net 3.0 (Mahler et al., ICRA 2018): the cup is a ring of springs that is
pushed along its axis onto the surface, and it seals where no spring must change its length by more
than a tenth. The limits of force and torque are those of the same paper, with the radius and the
stiffness of SuctionNet-1Billion (Cao et al., RA-L 2021).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.metrics.grasp.gripper import Boxes
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.se3 import SE3

Floats = NDArray[np.float64]

# Points of the ring, about 4 mm apart on a cup of 1 cm.
_RING = 16

# Largest distance of lip and surface when the ring is pushed on, in heights of the cup.
_FARTHEST = 2.0


@dataclass(frozen=True, kw_only=True)
class SuctionCup:
    """A bellows cup at the end of a tube, which is fixed to a box.

    A grasp of it has the lip's middle at its tip and the axis, from the tube to the object, as
    its approach; the other two axes do not matter.

    Attributes:
        radius: of the lip, metres (SuctionNet-1Billion: 1 cm).
        height: of the cup, metres.
        pressure: below that around, Pa. 60 kPa is usual for ejectors.
        friction: of the lip on the object (Dex-Net 3.0).
        stiffness: N of the lip: its torque about an axis across is at most pi * radius * stiffness
            (SuctionNet-1Billion: 15.6).
        stretch: largest share by which a spring of the cup changes its length (Dex-Net 3.0).
        tube: (length, radius) of the tube, metres.
        body: (length along the axis, width) of the box behind, metres.

    Raises:
        ToolkitError: a number that is not positive, or a radius that no such cup has.
    """

    radius: float = 0.01
    height: float = 0.01
    pressure: float = 60e3
    friction: float = 0.5
    stiffness: float = 15.6
    stretch: float = 0.1
    tube: tuple[float, float] = (0.10, 0.006)
    body: tuple[float, float] = (0.06, 0.06)

    def __post_init__(self) -> None:
        if not 0.002 <= self.radius <= 0.05:
            raise ToolkitError(
                "a suction cup has a radius of 2 to 50 mm", field="cup_radius", value=self.radius
            )
        for name in ("height", "pressure", "friction", "stiffness", "stretch"):
            if not getattr(self, name) > 0:
                raise ToolkitError("must be positive", field=name, value=getattr(self, name))

    @property
    def name(self) -> str:
        """Name for people and files.

        >>> SuctionCup().name
        'suction-10mm'
        """
        return f"suction-{1000 * self.radius:g}mm"

    @property
    def max_width(self) -> float:
        """Diameter of the lip, metres."""
        return 2 * self.radius

    @property
    def suction(self) -> float:
        """Force of the vacuum, newtons.

        >>> round(SuctionCup().suction, 1)
        18.8
        """
        return math.pi * self.radius**2 * self.pressure

    def boxes(self, widths: ArrayLike, depths: ArrayLike) -> Boxes:  # noqa: ARG002 - a jaw's
        """Return the boxes around cup, tube and body of N grasps; see `Gripper.boxes`."""
        tips = np.asarray(depths, dtype=np.float64)
        tube, half = self.tube
        length, width = self.body
        parts = (
            (-self.height, 0.0, self.radius),
            (-self.height - tube, -self.height, half),
            (-self.height - tube - length, -self.height - tube, width / 2),
        )
        low = np.array([[start, -r, -r] for start, _, r in parts])
        high = np.array([[end, r, r] for _, end, r in parts])
        along = np.stack([tips, 0 * tips, 0 * tips], axis=-1)[:, None]
        return Boxes(along + low, along + high)

    def holds(self, force: ArrayLike, torque: ArrayLike) -> bool:
        """Return whether the cup can apply a force and a torque to an object.

        Args:
            force: (3,) newtons on the object, in the axes of the grasp.
            torque: (3,) newton metres about the middle of the lip.
        """
        f, m = np.asarray(force, dtype=np.float64), np.asarray(torque, dtype=np.float64)
        # The vacuum presses the lip on; a pull along the axis takes from that.
        pressed = self.suction + f[0]
        return bool(
            pressed > 0
            and np.hypot(f[1], f[2]) <= self.friction * pressed
            and abs(m[0]) <= self.radius * self.friction * pressed
            and np.hypot(m[1], m[2]) <= math.pi * self.radius * self.stiffness
        )


@dataclass(frozen=True)
class Seal:
    """What a cup finds where it is pushed on.

    Attributes:
        mesh: number of the mesh under all of the lip, in the order of the caster; -1 if the lip is
            beside it, or on several.
        stretch: largest share by which a spring changes its length; inf without a mesh.
    """

    mesh: int
    stretch: float

    def is_tight(self, cup: SuctionCup) -> bool:
        """Whether the cup seals."""
        return self.mesh >= 0 and self.stretch <= cup.stretch


def seal_at(surfaces: RayCaster, T: SE3, cup: SuctionCup) -> Seal:
    """Push a cup along its axis onto surfaces.

    Args:
        surfaces: meshes in one frame, such as the world.
        T: the cup in that frame: the middle of the lip, and the axis as its x.
        cup: the cup.

    Returns:
        What it finds; the mesh is -1 where the lip is not on one mesh all around.

    >>> surfaces = RayCaster(threads=1)
    >>> seal_at(surfaces, SE3(np.eye(3), np.zeros(3)), SuctionCup())
    Seal(mesh=-1, stretch=inf)
    """
    angles = 2 * np.pi * np.arange(_RING) / _RING
    back = _FARTHEST * cup.height
    across = cup.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    starts = T @ np.column_stack([np.full(_RING, -back), across])
    axis = np.broadcast_to(T.R[:, 0], starts.shape)
    hits = surfaces.cast(np.concatenate([starts, axis], axis=1))
    along = hits.distance.astype(np.float64) - back
    if not (np.abs(along) <= back).all() or (hits.mesh != hits.mesh[0]).any():
        return Seal(-1, math.inf)
    return Seal(int(hits.mesh[0]), ring_stretch(along, cup))


def ring_stretch(along: Floats, cup: SuctionCup) -> float:
    """Compute the largest share by which a spring of a cup changes its length.

    The springs join neighbours on the ring, every second point, and each point with the apex of the
    cup, which is `cup.height` behind the mean of the ring.

    Args:
        along: (n,) places of the surface along the axis, at n points around the ring, metres.
        cup: the cup.

    Returns:
        Change of length / length at rest.

    >>> ring_stretch(np.zeros(16), SuctionCup())
    0.0
    """
    found = 0.0
    for step in (1, 2):
        rest = 2 * cup.radius * math.sin(math.pi * step / len(along))
        length = np.hypot(rest, np.roll(along, -step) - along)
        found = max(found, float(np.abs(length / rest - 1).max()))
    cone = np.hypot(cup.radius, cup.height + along - along.mean())
    return max(found, float(np.abs(cone / math.hypot(cup.radius, cup.height) - 1).max()))
