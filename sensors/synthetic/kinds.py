"""Kinds of objects beyond the six of the default recording, with random proportions.

`SETTING` are for setting limits, `JUDGING` for judging them; they share no kind. Both have
cartons, prisms, vessels, flat dishes, mirrors without edges and objects with a handle.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import trimesh

from sensors.synthetic.shapes import TURN
from sensors.synthetic.solids import (
    about_x,
    circle,
    cuboid,
    handle,
    joined,
    moved,
    of_size,
    prism,
    rounded_rectangle,
    shell,
    shoulder,
    tube,
    turned,
    upright,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.geometry.symmetry import Symmetry
from std_toolkit.scene.model import Material

Generator = np.random.Generator

Look = Literal["bare", "printed", "glass", "steel"]
LOOKS: tuple[Look, ...] = get_args(Look)
MATERIAL_OF: dict[Look, Material] = {
    "bare": "diffuse",
    "printed": "diffuse",
    "glass": "transparent",
    "steel": "specular",
}


def _half_turns(*axes: str) -> Symmetry:
    turns = [so3_exp(np.pi * np.eye(3)["xyz".index(a)]) for a in axes]
    return Symmetry(discrete=tuple(tuple(SE3(R, np.zeros(3)).flat()) for R in turns))


def _prism_turns(sides: int) -> Symmetry:
    """Of an upright regular prism with a corner on the x axis."""
    turns = [so3_exp([0, 2 * np.pi * k / sides, 0]) for k in range(sides)]
    flip = so3_exp([np.pi, 0, 0])
    every = [R @ F for F in (np.eye(3), flip) for R in turns][1:]
    return Symmetry(discrete=tuple(tuple(SE3(R, np.zeros(3)).flat()) for R in every))


NONE = Symmetry()
BOX = _half_turns("x", "y", "z")
FLIP = Symmetry(discrete=_half_turns("x").discrete, continuous=TURN.continuous)
SPHERE = Symmetry(
    continuous=(((0.0, 1.0, 0.0), (0.0, 0.0, 0.0)), ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
)


@dataclass(frozen=True)
class Kind:
    """A kind of objects.

    Attributes:
        name: unique, a category name.
        looks: that it may have.
        largest_mm: range of its largest extent.
        make: a mesh of random proportions and any size.
        symmetry: of its shape without a print.
        lies: whether it may also lie on its side.
    """

    name: str
    looks: tuple[Look, ...]
    largest_mm: tuple[float, float]
    make: Callable[[Generator], trimesh.Trimesh]
    symmetry: Symmetry = NONE
    lies: bool = False

    def mesh(self, rng: Generator) -> trimesh.Trimesh:
        """A centred mesh of random proportions and size, metres, y up."""
        made = self.make(rng)
        return of_size(made, float(rng.uniform(*self.largest_mm)) / 1000)


def _carton(rng: Generator) -> trimesh.Trimesh:
    return cuboid(
        0.1 * rng.uniform(0.5, 0.9), 0.1 * rng.uniform(0.9, 1.6), 0.1 * rng.uniform(0.25, 0.48)
    )


def _can(rng: Generator) -> trimesh.Trimesh:
    r, h, e = 0.035, 0.035 * rng.uniform(1.6, 4.0), 0.002
    return turned([(0, 0), (r - e, 0), (r, e), (r, h - e), (r - e, h), (0, h)])


def _hexagon(rng: Generator) -> trimesh.Trimesh:
    corners = 0.05 * circle(6)
    return prism([(x, z) for x, z in corners], 0.05 * rng.uniform(0.5, 2.6))


def _wedge(rng: Generator) -> trimesh.Trimesh:
    w, h, top = 0.1, 0.1 * rng.uniform(0.35, 0.7), 0.1 * rng.uniform(0.1, 0.4)
    lying = prism([(0, 0), (w, 0), (top, h), (0, h)], 0.1 * rng.uniform(0.5, 1.1))
    return upright(lying)


def _mug(rng: Generator) -> trimesh.Trimesh:
    r, h, wall = 0.042, 0.042 * rng.uniform(1.7, 2.8), 0.004
    waist = r * rng.uniform(0.8, 1.0)
    cup = turned([(0, 0), (waist, 0), (r, h), (r - wall, h), (waist - wall, wall), (0, wall)])
    return joined(cup, handle(0.92 * r, 0.52 * h, r * rng.uniform(0.6, 0.9), 0.33 * h, 0.11 * r))


def _bottle(rng: Generator) -> trimesh.Trimesh:
    r, h = 0.035, 0.035 * rng.uniform(4.5, 7.0)
    neck, low, high = (
        r * rng.uniform(0.3, 0.5),
        h * rng.uniform(0.45, 0.6),
        h * rng.uniform(0.7, 0.8),
    )
    sides = shoulder((r, low), (neck, high))
    return turned([(0, 0), (0.93 * r, 0), (r, 0.02 * h), *sides, (neck, h), (0, h)])


def _tumbler(rng: Generator) -> trimesh.Trimesh:
    r, h, wall = 0.04, 0.04 * rng.uniform(1.8, 3.6), 0.003
    foot = r * rng.uniform(0.65, 0.98)
    return turned([(0, 0), (foot, 0), (r, h), (r - wall, h), (foot - wall, 0.012), (0, 0.012)])


def _bowl(rng: Generator) -> trimesh.Trimesh:
    return shell(0.07, 0.07 * rng.uniform(0.55, 0.95), rng.uniform(0.3, 0.5))


def _petri_dish(rng: Generator) -> trimesh.Trimesh:
    r, h, wall = 0.045, 0.045 * rng.uniform(0.3, 0.55), 0.002
    return turned([(0, 0), (r, 0), (r, h), (r - wall, h), (r - wall, wall), (0, wall)])


def _tray(rng: Generator) -> trimesh.Trimesh:
    w, h, wall = 0.09, 0.09 * rng.uniform(0.22, 0.45), 0.003
    slope = rng.uniform(0.82, 0.95)
    profile = [(0, 0), (slope * w, 0), (w, h), (w - wall, h), (slope * w - wall, wall), (0, wall)]
    return turned(profile, rounded_rectangle(rng.uniform(0.5, 0.85)))


def _ball(_: Generator) -> trimesh.Trimesh:
    angles = np.linspace(-np.pi / 2, np.pi / 2, 49)
    return turned([(0.035 * np.cos(a), 0.035 * np.sin(a)) for a in angles])


def _funnel(rng: Generator) -> trimesh.Trimesh:
    r, h, stem = 0.045, 0.045 * rng.uniform(1.8, 2.6), 0.045 * rng.uniform(0.15, 0.25)
    cone = rng.uniform(0.4, 0.55) * h
    return turned(
        [(0, 0), (stem, 0), (stem, cone), (r, h), (r - 0.003, h), (0.5 * stem, cone), (0, cone)]
    )


def _pan(rng: Generator) -> trimesh.Trimesh:
    r, h, wall = 0.06, 0.06 * rng.uniform(0.6, 1.2), 0.003
    pan = turned(
        [(0, 0), (0.93 * r, 0), (r, 0.1 * h), (r, h), (r - wall, h), (r - wall, wall), (0, wall)]
    )
    s = np.linspace(0, 1, 16)
    length = r * rng.uniform(1.1, 1.6)
    path = np.stack([r - 0.001 + length * s, 0.8 * h + 0.15 * h * s, 0 * s], axis=1)
    return joined(pan, tube(path, np.full(16, 0.007), flatness=1.6))


def _book(rng: Generator) -> trimesh.Trimesh:
    return cuboid(0.1 * rng.uniform(0.6, 0.85), 0.1 * rng.uniform(0.12, 0.25), 0.1)


def _stick_pack(rng: Generator) -> trimesh.Trimesh:
    return cuboid(0.05, 0.05 * rng.uniform(2.2, 3.4), 0.05 * rng.uniform(0.7, 0.95))


def _bracket(rng: Generator) -> trimesh.Trimesh:
    a, b, t = 0.1, 0.1 * rng.uniform(0.6, 1.1), 0.1 * rng.uniform(0.15, 0.35)
    lying = prism([(0, 0), (a, 0), (a, t), (t, t), (t, b), (0, b)], 0.1 * rng.uniform(0.3, 0.8))
    return upright(lying)


def _house(rng: Generator) -> trimesh.Trimesh:
    w, h, roof = 0.07, 0.07 * rng.uniform(0.8, 1.6), 0.07 * rng.uniform(0.3, 0.7)
    lying = prism([(0, 0), (w, 0), (w, h), (w / 2, h + roof), (0, h)], 0.07 * rng.uniform(0.6, 1.4))
    return upright(lying)


def _thermos(rng: Generator) -> trimesh.Trimesh:
    r, h = 0.037, 0.037 * rng.uniform(5.0, 7.0)
    lid, low = r * rng.uniform(0.68, 0.86), h * rng.uniform(0.7, 0.8)
    return turned(
        [
            (0, 0),
            (0.96 * r, 0),
            (r, 0.01),
            (r, low),
            (lid, low + 0.015),
            (lid, h - 0.004),
            (lid - 0.004, h),
            (0, h),
        ]
    )


def _pot(rng: Generator) -> trimesh.Trimesh:
    """A teapot: a round body with a lid, a spout and a handle."""
    r, h = 0.06, 0.06 * rng.uniform(1.3, 1.9)
    foot, rim = r * rng.uniform(0.55, 0.75), r * rng.uniform(0.45, 0.6)
    body = [
        (foot + (r - foot) * np.sin(a), 0.45 * h * (1 - np.cos(a)))
        for a in np.linspace(0, np.pi / 2, 9)
    ]
    body += [
        (rim + (r - rim) * np.cos(a), h * (0.45 + 0.4 * np.sin(a)))
        for a in np.linspace(0, np.pi / 2, 9)[1:]
    ]
    knob = [(0.25 * r, 0.91 * h), (0.16 * r, 0.93 * h), (0.2 * r, h), (0, h)]
    s = np.linspace(0, 1, 16)
    spout = np.stack([-0.8 * r - 0.9 * r * s, h * (0.28 + 0.5 * s**1.6), 0 * s], axis=1)
    return joined(
        turned([(0, 0), *body, *knob]),
        tube(spout, r * (0.22 - 0.12 * s)),
        handle(0.8 * r, 0.48 * h, 0.85 * r, 0.28 * h, 0.09 * r),
    )


def _wine_glass(rng: Generator) -> trimesh.Trimesh:
    r, stem = 0.038, 0.038 * rng.uniform(1.4, 2.4)
    foot, bowl = r * rng.uniform(0.75, 0.95), r * rng.uniform(2.0, 2.9)
    bottom = stem + 0.004
    outer = [
        (0.12 * r + 0.88 * r * np.sin(a), bottom + 0.55 * bowl * (1 - np.cos(a)))
        for a in np.linspace(0.1, np.pi / 2, 8)
    ] + [(0.82 * r, bottom + bowl)]
    inner = [(x - 0.0015, y + 0.002 * (y < bottom + 0.3 * bowl)) for x, y in reversed(outer)]
    inner = [(x, y) for x, y in inner if x > 0.12 * r]
    return turned(
        [
            (0, 0),
            (foot, 0),
            (foot, 0.0015),
            (0.1 * r, 0.006),
            (0.1 * r, stem),
            *outer,
            *inner,
            (0, bottom + 0.006),
        ]
    )


def _flask(rng: Generator) -> trimesh.Trimesh:
    r, h = 0.045, 0.045 * rng.uniform(2.2, 3.2)
    neck, low = r * rng.uniform(0.28, 0.42), h * rng.uniform(0.6, 0.72)
    wall = 0.002
    return turned(
        [
            (0, 0),
            (0.94 * r, 0),
            (r, 0.006),
            (neck, low),
            (neck, h - 0.003),
            (neck + 0.002, h),
            (neck - wall, h),
            (neck - wall, low),
            (r - wall - 0.002, 0.007),
            (0, wall),
        ]
    )


def _square_bottle(rng: Generator) -> trimesh.Trimesh:
    r, h = 0.035, 0.035 * rng.uniform(3.6, 5.5)
    neck, low = r * rng.uniform(0.35, 0.5), h * rng.uniform(0.65, 0.76)
    body = turned(
        [(0, 0), (0.96 * r, 0), (r, 0.004), *shoulder((r, low), (neck, 0.85 * h)), (0, 0.85 * h)],
        rounded_rectangle(rng.uniform(0.6, 0.9)),
    )
    narrow = 0.58 * neck
    return joined(
        body, moved(turned([(0, 0), (narrow, 0), (narrow, 0.17 * h), (0, 0.17 * h)]), y=0.83 * h)
    )


def _dish(rng: Generator) -> trimesh.Trimesh:
    return shell(0.08, 0.08 * rng.uniform(0.16, 0.32), rng.uniform(0.45, 0.7))


def _dome(rng: Generator) -> trimesh.Trimesh:
    """A paperweight: the upper part of a ball."""
    r, low = 0.04, rng.uniform(-0.6, -0.2)
    angles = np.linspace(low, np.pi / 2, 36)
    line = [(r * np.cos(a), r * np.sin(a)) for a in angles]
    return turned([(0, line[0][1]), *line])


def _banana(rng: Generator) -> trimesh.Trimesh:
    bend, thick = rng.uniform(0.9, 1.6), rng.uniform(0.13, 0.2)
    s = np.linspace(-1, 1, 40)
    path = np.stack([np.sin(bend * s), np.cos(bend * s), 0 * s], axis=1) * 0.1 / bend
    radii = thick * np.maximum(0.18, (1 - np.abs(s) ** 4) ** 0.5)
    bent = tube(path, 0.1 * radii, flatness=float(rng.uniform(0.85, 1.1)))
    return about_x(bent, np.pi / 2)


_OPAQUE: tuple[Look, ...] = ("bare", "printed")

SETTING: tuple[Kind, ...] = (
    Kind("carton", _OPAQUE, (70, 250), _carton, BOX, lies=True),
    Kind("can", (*_OPAQUE, "steel"), (50, 160), _can, FLIP, lies=True),
    Kind("hexagon", _OPAQUE, (60, 160), _hexagon, _prism_turns(6)),
    Kind("wedge", _OPAQUE, (60, 180), _wedge),
    Kind("mug", LOOKS, (90, 140), _mug),
    Kind("bottle", LOOKS, (120, 250), _bottle, TURN, lies=True),
    Kind("tumbler", ("glass", "steel"), (80, 160), _tumbler, TURN),
    Kind("bowl", LOOKS, (100, 180), _bowl, TURN),
    Kind("petri_dish", ("glass",), (60, 120), _petri_dish, TURN),
    Kind("tray", ("steel", "bare"), (110, 230), _tray, _half_turns("y")),
    Kind("ball", ("steel", "glass", "bare"), (40, 90), _ball, SPHERE),
    Kind("funnel", ("glass", "steel"), (80, 150), _funnel, TURN),
    Kind("pan", ("steel", "bare"), (130, 230), _pan),
)

JUDGING: tuple[Kind, ...] = (
    Kind("book", _OPAQUE, (120, 230), _book, BOX),
    Kind("stick_pack", _OPAQUE, (60, 220), _stick_pack, BOX, lies=True),
    Kind("bracket", ("bare", "steel"), (60, 160), _bracket),
    Kind("house", _OPAQUE, (60, 150), _house, _half_turns("y")),
    Kind("thermos", (*_OPAQUE, "steel"), (160, 250), _thermos, TURN, lies=True),
    Kind("pot", LOOKS, (130, 230), _pot),
    Kind("wine_glass", ("glass",), (120, 220), _wine_glass, TURN),
    Kind("flask", ("glass",), (80, 190), _flask, TURN),
    Kind(
        "square_bottle",
        ("glass", *_OPAQUE),
        (100, 220),
        _square_bottle,
        _half_turns("y"),
        lies=True,
    ),
    Kind("dish", ("glass", "steel", "bare"), (100, 200), _dish, TURN),
    Kind("dome", ("steel", "glass"), (50, 100), _dome, TURN),
    Kind("banana", (*_OPAQUE, "steel"), (110, 200), _banana, _half_turns("z")),
)

_BY_NAME = {kind.name: kind for kind in (*SETTING, *JUDGING)}


def kind_named(name: str) -> Kind:
    """The kind of that name.

    Raises:
        ToolkitError: there is none.
    """
    if name not in _BY_NAME:
        raise ToolkitError("no such kind", field="kind", value=name, hint=", ".join(_BY_NAME))
    return _BY_NAME[name]
