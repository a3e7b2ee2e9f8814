"""Objects outside the seven categories."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from sensors.assets.procedural import solids

if TYPE_CHECKING:
    from manifold3d import Manifold


def distractor(rng: np.random.Generator, paint: solids.Paint) -> tuple[Manifold, bool]:
    """A body in arbitrary units, and whether it is symmetric under rotations about y."""
    makers = (*_TURNED, *_OTHERS)
    chosen = int(rng.integers(len(makers)))
    return makers[chosen](rng, paint), chosen < len(_TURNED)


def _ball(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    a = np.linspace(-np.pi / 2, np.pi / 2, 49)[1:-1]
    ball = solids.lathe(np.stack([4 * np.cos(a), 4 * np.sin(a)], 1))
    band = solids.outline_of_turn([(4.03, -0.6), (4.03, 0.6)]) - solids.outline_of_turn(
        [(3.6, -1), (3.6, 1)]
    )
    return paint(ball, solids.vivid(rng)) + paint(solids.turned(band), solids.WHITE)


def _apple(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    a = np.linspace(-0.92 * np.pi / 2, 0.86 * np.pi / 2, 44)
    lean = float(rng.uniform(0.04, 0.12))
    r = 3.6 * np.cos(a) * (1 + lean * np.sin(a)) + 0.35 * np.abs(np.sin(a))
    fruit = solids.lathe(np.stack([np.maximum(r, 0.15), 3.3 * np.sin(a)], 1))
    dimple = solids.lathe([(0.1, 2.2), (1.1, 3.5)])
    stem = solids.lathe([(0.14, 1.6), (0.14, 3.9)])
    made = paint(fruit, solids.hsv(rng.uniform(-0.02, 0.3), 0.75, 0.75))
    return made - paint(dimple, solids.hsv(0.2, 0.6, 0.4)) + paint(stem, solids.hsv(0.07, 0.6, 0.3))


def _hoop(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    from manifold3d import CrossSection

    section = CrossSection.circle(float(rng.uniform(0.9, 1.5)), 40).translate((4.0, 0.0))
    return paint(solids.turned(section), solids.vivid(rng))


def _candle(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    h = float(rng.uniform(5, 10))
    made = paint(solids.lathe([(2.6, 0), (2.6, h)], edge=0.3), solids.muted(rng))
    made -= paint(solids.lathe([(0.3, h - 0.5), (2.0, h + 0.1)]), solids.WHITE)
    return made + paint(solids.lathe([(0.13, h - 1), (0.1, h + 0.9)], 16), solids.DARK)


def _spool(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    h = float(rng.uniform(4, 7))
    made = paint(solids.lathe([(2.2, -0.3), (2.2, h + 0.3)]), solids.vivid(rng))
    for low in (-0.6, h):
        disc = solids.lathe([(3.4, low), (3.4, low + 0.6)], edge=0.15)
        made += paint(disc, solids.hsv(0.09, 0.4, 0.75))
    return made - paint(solids.lathe([(0.7, -1), (0.7, h + 1)], 32), solids.DARK)


def _vase(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    r = float(rng.uniform(2.6, 3.6))
    keys = [(0.6 * r, 0), (r, 3.0), (0.9 * r, 5.5), (0.42 * r, 8.0), (0.62 * r, 10.0)]
    profile = solids.smooth_profile(keys, samples=36)
    outer, inner = solids.outline_of_turn(profile), solids.outline_of_turn(profile - [0.3, -0.5])
    return paint(solids.turned(solids.rounded(outer - inner, 0.1, 12)), solids.muted(rng))


def _carton(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    w, h, d = map(float, rng.uniform((5, 7, 2), (9, 12, 5)))
    made = paint(solids.rounded_box((w, h, d), 0.15, 12), solids.vivid(rng))
    front = d / 2 + 0.02
    print_ = solids.box((-0.3 * w, -0.2 * h, -front), (0.3 * w, 0.25 * h, front))
    return made + paint(print_, solids.one_of(rng, solids.WHITE, solids.vivid(rng)))


def _book(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    w, h, d = map(float, rng.uniform((9, 12, 1.6), (12, 16, 3.2)))
    pages = solids.box((-w / 2 + 0.3, -h / 2 + 0.3, -d / 2), (w / 2 - 0.3, h / 2 - 0.3, d / 2))
    inside = solids.box((-w / 2 + 0.35, -h, -d / 2), (w, h, d / 2))
    cover = solids.rounded_box((w, h, d + 0.5), 0.2, 12) - inside
    return paint(pages, solids.WHITE) + paint(cover, solids.vivid(rng))


def _brick(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    nx, nz = int(rng.integers(2, 5)), int(rng.integers(1, 3))
    made = solids.box((0, 0, 0), (nx * 2, 2.4, nz * 2))
    made -= solids.box((0.3, -1, 0.3), (nx * 2 - 0.3, 2.1, nz * 2 - 0.3))
    for i in range(nx):
        for k in range(nz):
            x, z = 2 * i + 1, 2 * k + 1
            made += solids.rod((x, 2.3, z), (x, 2.85, z), 0.62, None, 32)
    return paint(made, solids.vivid(rng))


def _remote(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    length = float(rng.uniform(13, 17))
    made = paint(
        solids.rounded_box((4.2, 1.8, length), 0.8),
        solids.one_of(rng, solids.DARK, solids.GREY, solids.WHITE),
    )
    for i in range(3):
        for k in range(int(length / 2) - 1):
            x, z = 1.2 * (i - 1), -length / 2 + 2 + 1.5 * k
            color = solids.one_of(rng, solids.WHITE, solids.GREY, solids.vivid(rng))
            made += paint(solids.rod((x, 0.5, z), (x, 1.12, z), 0.4, None, 16), color)
    return made


def _banana(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    bend = float(rng.uniform(0.8, 1.15))
    a = np.linspace(-bend, bend, 40)
    path = np.stack([8 * np.sin(a), 8 - 8 * np.cos(a), np.zeros(40)], 1)
    thick = np.maximum(1.55 * (1 - np.abs(a / bend / 1.03) ** 3.2), 0.32)
    return paint(
        solids.tube(path, thick, 0.94 * thick, 28), solids.hsv(rng.uniform(0.13, 0.17), 0.75, 0.9)
    )


def _wrench(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    from manifold3d import CrossSection

    length, gap = float(rng.uniform(9, 13)), float(rng.uniform(0.8, 1.1))
    eye, hexagon = CrossSection.circle(1.9, 48), CrossSection.circle(1.1, 6)
    shaft = solids.polygon([(-0.7, 0), (0.7, 0), (0.9, length), (-0.9, length)])
    head = CrossSection.circle(2.1, 48).translate((0.0, length + 1.2))
    low, high = length + 0.8, length + 4
    jaw = solids.polygon([(-gap, low), (gap, low), (gap, high), (-gap, high)])
    flat = solids.rounded((shaft + head + eye) - jaw - hexagon, 0.15, 12)
    made = paint(solids.along_z(flat, -0.4, 0.4), solids.metal(rng))
    return made + paint(solids.along_z(eye - hexagon, -0.55, 0.55), solids.metal(rng))


def _gear(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    from manifold3d import CrossSection

    teeth = int(rng.integers(10, 20))
    wheel = CrossSection.circle(4.0, 96)
    tooth = solids.polygon([(-0.55, 3.8), (0.55, 3.8), (0.3, 4.9), (-0.3, 4.9)])
    for k in range(teeth):
        wheel += tooth.rotate(360 * k / teeth)
    wheel -= CrossSection.circle(1.0, 40)
    for k in range(5):
        wheel -= CrossSection.circle(0.75, 32).translate((0.0, 2.4)).rotate(72 * k)
    return paint(solids.along_y(wheel, -0.7, 0.7), solids.metal(rng))


def _die(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    from manifold3d import Manifold

    made = paint(
        solids.rounded_box((6, 6, 6), float(rng.uniform(0.4, 1))),
        solids.one_of(rng, solids.WHITE, solids.vivid(rng)),
    )
    pit = Manifold.sphere(0.62, 20)
    # Opposite sides add up to seven.
    grid = ((-1, -1), (1, 1), (-1, 1), (1, -1), (-1, 0), (1, 0))
    spots = {1: [(0, 0)], 2: grid[:2], 3: [(0, 0), *grid[:2]]}
    spots |= {4: grid[:4], 5: [(0, 0), *grid[:4]], 6: grid}
    for number in range(1, 7):
        axis, sign = (number - 1, -1) if number < 4 else (6 - number, 1)
        for a, b in spots[number]:
            at = np.zeros(3)
            at[[(axis + 1) % 3, (axis + 2) % 3]] = 1.5 * a, 1.5 * b
            at[axis] = 3.15 * sign
            made -= paint(pit.translate(at.tolist()), solids.DARK)
    return made


def _tape(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    """A roll of tape in its dispenser."""
    side = solids.polygon([(-5, 0), (4.5, 0), (5.2, 2.6), (2.5, 2.6), (0.5, 4.5), (-4.2, 4.2)])
    made = paint(solids.along_x(solids.rounded(side, 0.4), 3.2), solids.vivid(rng))
    made -= paint(solids.rod((-0.9, 4.0, -1.6), (0.9, 4.0, -1.6), 3.0, None, 48), solids.DARK)
    roll = solids.rod((-0.8, 3.8, -1.6), (0.8, 3.8, -1.6), float(rng.uniform(2.2, 2.8)), None, 48)
    axle = solids.rod((-1.7, 3.4, -1.6), (1.7, 3.4, -1.6), 0.7, None, 24)
    return made + paint(roll, solids.hsv(0.12, 0.3, 0.85)) + paint(axle, solids.SILVER)


_Maker = Callable[[np.random.Generator, solids.Paint], "Manifold"]
_TURNED: tuple[_Maker, ...] = (_ball, _apple, _hoop, _candle, _spool, _vase)
_OTHERS: tuple[_Maker, ...] = (
    _carton,
    _book,
    _brick,
    _remote,
    _banana,
    _wrench,
    _gear,
    _die,
    _tape,
)
