"""A body of coloured parts, finished as a mesh."""

from __future__ import annotations

import colorsys
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from manifold3d import Manifold

Array = NDArray[np.float64]
Rgb = tuple[int, int, int]

DARK: Rgb = (32, 33, 36)
GREY: Rgb = (120, 122, 126)
SILVER: Rgb = (190, 192, 196)
WHITE: Rgb = (236, 234, 228)
GLASS: Rgb = (38, 52, 66)
RED: Rgb = (178, 32, 30)
AMBER: Rgb = (226, 150, 40)
# What cutting lays bare where the cutter has no colour of its own.
_BARE = GREY
FEWEST_FACES, MOST_FACES = 2000, 20000


class Paint:
    """Remembers which part has which colour, through all unions and cuts."""

    def __init__(self) -> None:
        self._colors: dict[int, Rgb] = {}

    def __call__(self, solid: Manifold, color: Rgb) -> Manifold:
        """The solid as a part of a colour. Cutting with it leaves its colour on the cut."""
        part = solid.as_original()
        self._colors[part.original_id()] = color
        return part

    def mesh(self, body: Manifold) -> tuple[Array, NDArray[np.int64], NDArray[np.uint8]]:
        """Vertices (V, 3), faces (F, 3) and their colours (F, 3) of a finished body.

        Slivers that cuts leave are removed, and large flat faces divided until there are some
        thousands of faces.

        Raises:
            ToolkitError: a body that is empty or cannot be held within the number of faces.
        """
        low, high = np.split(np.array(body.bounding_box()), 2)
        diagonal = float(np.linalg.norm(high - low))
        tolerance = 1e-5
        solid = body.simplify(tolerance * diagonal)
        while solid.num_tri() > MOST_FACES and tolerance < 2e-3:
            tolerance *= 2
            solid = body.simplify(tolerance * diagonal)
        length = 0.25
        while solid.num_tri() < FEWEST_FACES and length > 0.01:
            solid = solid.refine_to_length(length * diagonal)
            length *= 0.8
        if not FEWEST_FACES <= solid.num_tri() <= MOST_FACES:
            raise ToolkitError("a procedural body has too many faces", value=solid.num_tri())
        mesh = solid.to_mesh64()
        faces = np.asarray(mesh.tri_verts, dtype=np.int64)
        colors = np.empty((len(faces), 3), dtype=np.uint8)
        starts = np.asarray(mesh.run_index, dtype=np.int64) // 3
        for k, original in enumerate(mesh.run_original_id):
            colors[starts[k] : starts[k + 1]] = self._colors.get(int(original), _BARE)
        return np.asarray(mesh.vert_properties[:, :3], dtype=np.float64), faces, colors


def hsv(hue: float, saturation: float, value: float) -> Rgb:
    """RGB bytes of a hue, saturation and value in [0, 1]."""
    r, g, b = colorsys.hsv_to_rgb(hue % 1, saturation, value)
    return round(255 * r), round(255 * g), round(255 * b)


def vivid(rng: np.random.Generator) -> Rgb:
    """A saturated colour, as of packaging and toys."""
    return hsv(rng.uniform(), rng.uniform(0.55, 0.9), rng.uniform(0.5, 0.95))


def muted(rng: np.random.Generator) -> Rgb:
    """A soft colour, as of glazed crockery."""
    return hsv(rng.uniform(), rng.uniform(0.05, 0.5), rng.uniform(0.35, 0.95))


def metal(rng: np.random.Generator) -> Rgb:
    """The grey of a metal."""
    return hsv(rng.uniform(0.55, 0.65), rng.uniform(0, 0.06), rng.uniform(0.55, 0.85))


def one_of(rng: np.random.Generator, *colors: Rgb) -> Rgb:
    """One of some colours."""
    return colors[int(rng.integers(len(colors)))]
