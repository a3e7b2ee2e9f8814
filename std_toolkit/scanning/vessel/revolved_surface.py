"""A photo with an outline, and a solid of revolution as an axis and a profile with its mesh."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera

Array = NDArray[np.float64]

SECTIONS = 128


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


@dataclass(frozen=True, eq=False)
class RevolvedSurface:
    """An axis and a profile with deviations.

    Attributes:
        T_world_axis: frame whose z axis is the axis; its origin is where the axis meets the table.
        heights: (K,) metres along the axis, from 0 to the rim.
        radii: (K,) of the outer wall, metres.
        deviation_m: (K,) standard deviation of the radii.
        seen: (K,) whether an outline touches the surface there; elsewhere it is interpolated.
        wall_m: thickness of the wall at the rim.
        wall_seen: whether photos show the rim's inner edge; otherwise the wall is a guess.
        outline_px: root mean square distance of the outline, without what is left out.
        outside: share of the outline that is left out.
        warnings: sentences on what is a guess or out of reach.
    """

    T_world_axis: SE3
    heights: Array
    radii: Array
    deviation_m: Array
    seen: NDArray[np.bool_]
    wall_m: float
    wall_seen: bool
    outline_px: float
    outside: float
    warnings: tuple[str, ...] = ()

    def mesh(self) -> tuple[Array, NDArray[np.int64]]:
        """Watertight triangles, hollow and open at the top: vertices (V, 3) in the world, metres;
        faces (F, 3).
        """
        outer = np.stack([self.radii, self.heights], axis=1)
        vertices, faces = _turned(np.vstack([[[0.0, 0.0]], outer, self._inner()]))
        return self.T_world_axis @ vertices, faces

    def _inner(self) -> Array:
        """(N, 2) inner wall, rim first, ending on the axis above the base."""
        wall, top = self.wall_m, float(self.heights[-1])
        slope = np.gradient(self.radii, self.heights)
        across = wall * np.sqrt(1 + np.minimum(slope**2, 4.0))
        inner = self.radii - across
        base = max(2 * wall, 0.003)
        # The cavity ends where it is too narrow, such as above the stem of a glass.
        closed = np.flatnonzero((inner < wall) & (self.heights < 0.95 * top))
        low = float(self.heights[closed[-1]]) if len(closed) else 0.0
        kept = (self.heights > low + base) & (inner > 0)
        points = np.stack([inner, self.heights], axis=1)[kept][::-1]
        if not len(points):
            return np.array([[0.0, top]])
        return np.vstack([points, [[0.0, points[-1, 1]]]])

    def doubts(self, *, known_wall: bool) -> tuple[str, ...]:
        """Sentences on what is a guess or out of reach."""
        sentences = []
        if self.outside > 0.02:
            sentences.append(
                f"{100 * self.outside:.0f} % of the outline is not of the surface of revolution: "
                "handles and spouts are not modelled"
            )
        if not (self.wall_seen or known_wall):
            sentences.append(
                f"no photo shows the inner edge of the rim: a wall of {1000 * self.wall_m:.1f} mm "
                "is a guess; photograph the rim from above, or measure the wall"
            )
        sentences.append("the thickness of the base is a guess")
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
