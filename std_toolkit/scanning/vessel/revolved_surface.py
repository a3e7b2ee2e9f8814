"""A photo with an outline, and a solid of revolution as an axis and a profile with its mesh."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

SECTIONS = 128

# A wall that no photo shows is taken as this.
_GUESSED_WALL_M = 0.0025


@dataclass(frozen=True, kw_only=True)
class StemSettings(Settings):
    """What is a stem, and which foot is below it."""

    stem: float = limit(0.4, source="wine glasses: a stem is 0.1 to 0.2 of foot and bowl")
    """a stem is narrower than this part of both what is below and above it"""
    ends: float = limit(2.0, source=NOT_RECORDED)
    """it ends where the bowl is this many times as wide as its narrowest place"""
    worse_px: float = limit(0.03, unit="px", source="one rendered wine glass")
    """a thinner foot may leave the outlines this much further away in the mean"""


@dataclass(frozen=True, eq=False)
class OutlineView:
    """One photo of the object.

    Attributes:
        camera: intrinsics without distortion.
        T_world_cam: pose; the world is z up, in metres, with the table at z = 0.
        mask: (H, W) bool pixels that show the object.
        image: (H, W, 3) uint8 RGB, for the rim; or None.
    """

    camera: Camera
    T_world_cam: SE3
    mask: NDArray[np.bool_]
    image: NDArray[np.uint8] | None = None


def stem_end(heights: Array, radii: Array) -> float:
    """Height at which the stem of a profile widens to the bowl, metres; 0 without a stem."""
    limits = StemSettings.current()
    below = np.maximum.accumulate(radii)
    above = np.maximum.accumulate(radii[::-1])[::-1]
    stem = radii < limits.stem * np.minimum(below, above)
    if not stem.any():
        return 0.0
    narrowest = float(radii[stem].min())
    return float(heights[stem & (radii < limits.ends * narrowest)].max())


@dataclass(frozen=True, kw_only=True)
class Inside:
    """What is known of the inside of a vessel.

    Attributes:
        wall_m: thickness of the wall.
        wall: where it is from.
        floor_m: height of the floor above the table, as the user stated it; None for a guess.
    """

    wall_m: float = _GUESSED_WALL_M
    wall: Literal["stated by the user", "seen at the rim", "guessed"] = "guessed"
    floor_m: float | None = None


@dataclass(frozen=True, eq=False)
class RevolvedSurface:
    """An axis and a profile with deviations.

    Attributes:
        T_world_axis: frame whose z axis is the axis; its origin is where the axis meets the table.
        heights: (K,) metres along the axis, from 0 to the rim.
        radii: (K,) of the outer wall, metres.
        deviation_m: (K,) standard deviation of the radii.
        seen: (K,) whether an outline touches the surface there; elsewhere it is interpolated.
        outline_px: root mean square distance of the outline, without what is left out.
        outside: share of the outline that is left out.
        inside: wall and floor.
    """

    T_world_axis: SE3
    heights: Array
    radii: Array
    deviation_m: Array
    seen: NDArray[np.bool_]
    outline_px: float
    outside: float
    inside: Inside = Inside()

    @property
    def height(self) -> float:
        """Of the rim above the table, metres."""
        return float(self.heights[-1])

    @property
    def floor_m(self) -> float:
        """Height of the floor of the inside above the table, stated or guessed; metres."""
        if self.inside.floor_m is not None:
            return self.inside.floor_m
        wall, inner = self.inside.wall_m, self.inner_radii()
        # The hollow ends where it is too narrow, and above a stem.
        closed = np.flatnonzero((inner < wall) & (self.heights < 0.95 * self.height))
        low = float(self.heights[closed[-1]]) if len(closed) else 0.0
        return min(max(low, self.stem_end_m) + max(2 * wall, 0.003), self.height)

    @property
    def stem_end_m(self) -> float:
        """Height at which a stem widens to the bowl, metres; 0 without a stem."""
        return stem_end(self.heights, self.radii)

    def inner_radii(self) -> Array:
        """(K,) radii of the outer wall moved inwards by the thickness of the wall, metres."""
        slope = np.gradient(self.radii, self.heights)
        return np.asarray(self.radii - self.inside.wall_m * np.sqrt(1 + np.minimum(slope**2, 4.0)))

    def mesh(self) -> tuple[Array, NDArray[np.int64]]:
        """Watertight triangles, hollow and open at the top: vertices (V, 3) in the world, metres;
        faces (F, 3).
        """
        outer = np.stack([self.radii, self.heights], axis=1)
        vertices, faces = _turned(np.vstack([[[0.0, 0.0]], outer, self._inner()]))
        return self.T_world_axis @ vertices, faces

    def _inner(self) -> Array:
        """(N, 2) inner wall, rim first, ending on the axis at the floor."""
        floor, inner = self.floor_m, self.inner_radii()
        at_floor = float(np.interp(floor, self.heights, inner))
        kept = (self.heights > floor) & (inner > 0)
        if not kept.any() or at_floor <= 0:
            return np.array([[0.0, self.height]])
        points = np.stack([inner, self.heights], axis=1)[kept][::-1]
        return np.vstack([points, [[at_floor, floor], [0.0, floor]]])

    @property
    def facts(self) -> dict[str, str]:
        """What is known of the inside, and from where."""
        stated = "guessed" if self.inside.floor_m is None else "stated by the user"
        floor = self.floor_m
        return {
            "wall": f"{1000 * self.inside.wall_m:.1f} mm, {self.inside.wall}",
            "base": f"{1000 * floor:.1f} mm, {stated}",
            "inside depth": f"{1000 * (self.height - floor):.1f} mm, {stated}",
        }

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences on what is a guess or out of reach."""
        sentences = []
        if self.outside > 0.02:
            sentences.append(
                f"{100 * self.outside:.0f} % of the outline is not of the surface of revolution: "
                "handles and spouts are not modelled"
            )
        if self.inside.wall == "guessed":
            sentences.append(
                "no photo shows the inner edge of the rim: a wall of "
                f"{1000 * self.inside.wall_m:.1f} mm is a guess; photograph the rim from above, or "
                "measure the wall and give --wall-mm"
            )
        if self.inside.floor_m is None:
            sentences.append(
                f"the thickness of the base is a guess, {1000 * self.floor_m:.0f} mm: measure it, "
                "or the depth of the inside from the rim, and give --base-mm or --inside-depth-mm"
            )
        if not self.seen.all():
            hidden = 1000 * float((~self.seen).mean() * self.heights[-1])
            sentences.append(f"no outline touches {hidden:.0f} mm of the profile: interpolated")
        return tuple(sentences)


def _turned(profile: Array) -> tuple[Array, NDArray[np.int64]]:
    """A closed surface from (radius, height) points that begin and end on the axis."""
    keep = np.concatenate([[True], np.linalg.norm(np.diff(profile, axis=0), axis=1) > 1e-7])
    profile = profile[keep]
    angle = np.linspace(0, 2 * np.pi, SECTIONS, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inner = profile[1:-1]
    body = np.concatenate(
        [
            np.column_stack([r * ring, np.full(SECTIONS, h)])
            for r, h in np.maximum(inner, [1e-6, -np.inf])
        ]
    )
    vertices = np.vstack([[0, 0, profile[0, 1]], body, [0, 0, profile[-1, 1]]])
    here = np.arange(SECTIONS)
    following = (here + 1) % SECTIONS
    faces = [np.stack([np.zeros(SECTIONS, int), following + 1, here + 1], axis=1)]
    for k in range(len(inner) - 1):
        a, b = 1 + k * SECTIONS, 1 + (k + 1) * SECTIONS
        faces.append(np.stack([a + here, a + following, b + following], axis=1))
        faces.append(np.stack([a + here, b + following, b + here], axis=1))
    last, end = 1 + (len(inner) - 1) * SECTIONS, len(vertices) - 1
    faces.append(np.stack([last + here, last + following, np.full(SECTIONS, end)], axis=1))
    return vertices, np.concatenate(faces).astype(np.int64)
