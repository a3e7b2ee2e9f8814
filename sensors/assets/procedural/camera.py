"""Cameras: body, lens, viewfinder, flash and controls; lens towards -z."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sensors.assets.procedural import solids

if TYPE_CHECKING:
    from manifold3d import Manifold

PLANS = ("reflex", "rangefinder", "compact", "bridge", "instant", "twin_lens")
LENS: solids.Rgb = (24, 26, 44)
COAT: solids.Rgb = (64, 44, 110)


def camera(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    """A still camera about 12 units wide."""
    plan = PLANS[int(rng.integers(len(PLANS)))]
    return {
        "reflex": _reflex,
        "rangefinder": _rangefinder,
        "compact": _compact,
        "bridge": _reflex,
        "instant": _instant,
        "twin_lens": _twin_lens,
    }[plan](rng, paint)


def _reflex(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    w, h, d = float(rng.uniform(12, 14)), float(rng.uniform(7.4, 8.6)), float(rng.uniform(3.6, 4.6))
    color = solids.one_of(rng, solids.DARK, solids.DARK, (70, 72, 76), solids.hsv(0.05, 0.5, 0.35))
    made = paint(solids.rounded_box((w, h, d), 0.9), color)
    # Grip on the user's right hand: to the left seen from the front.
    grip = solids.rounded_box((0.24 * w, 0.94 * h, d + 2.4), 1.1).translate(
        [0.36 * w, -0.02 * h, -1.1]
    )
    made += paint(grip, solids.DARK)
    hump_w = float(rng.uniform(0.3, 0.38)) * w
    outline = solids.polygon(
        [(-hump_w / 2, -1), (-0.34 * hump_w, 2.2), (0.34 * hump_w, 2.2), (hump_w / 2, -1)]
    )
    prism = solids.along_z(solids.rounded(outline, 0.35), -0.5 * d - 0.7, 0.5 * d + 0.3)
    made += paint(prism.translate([-0.04 * w, h / 2 - 0.1, 0]), color)
    shoe = solids.box((-1.0, h / 2 + 2.05, 0.2 * d - 0.9), (1.0, h / 2 + 2.3, 0.2 * d + 0.9))
    made += paint(shoe.translate([-0.04 * w, 0, 0]), solids.SILVER)
    made += _lens(
        rng, paint, (-0.04 * w, -0.06 * h, -d / 2), 0.42 * h, float(rng.uniform(3.0, 7.0))
    )
    made += _dial(paint, (-0.36 * w, h / 2, 0), 1.05, 0.8)
    made += _dial(paint, (0.3 * w, h / 2, 0.4), 0.85, 0.6)
    button = solids.ellipsoid((1.0, 0.7, 1.0), 20).translate([0.37 * w, 0.45 * h, -d / 2 - 1.4])
    made += paint(button, solids.SILVER)
    screen = solids.rounded_box((0.5 * w, 0.58 * h, 0.3), 0.1, 12)
    made += paint(screen.translate([-0.08 * w, -0.08 * h, d / 2]), solids.GLASS)
    eye = solids.rounded_box((2.2, 1.5, 1.0), 0.3, 12).translate(
        [-0.04 * w, h / 2 + 0.9, d / 2 + 0.5]
    )
    made += paint(eye, solids.DARK)
    for y in (-0.25, 0.0, 0.25):
        knob = solids.rod(
            (0.3 * w, y * h, d / 2 - 0.2), (0.3 * w, y * h, d / 2 + 0.22), 0.45, None, 20
        )
        made += paint(knob, solids.GREY)
    return made


def _rangefinder(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    w, h, d = (
        float(rng.uniform(11.5, 13.5)),
        float(rng.uniform(6.4, 7.4)),
        float(rng.uniform(2.8, 3.4)),
    )
    leather = solids.one_of(
        rng,
        solids.DARK,
        solids.hsv(0.05, 0.6, 0.3),
        solids.hsv(0.0, 0.6, 0.35),
        solids.hsv(0.4, 0.4, 0.25),
    )
    ends = solids.rectangle((-w / 2, -d / 2), (w / 2, d / 2))
    slab = solids.rounded(ends, 0.48 * d, 40)
    made = paint(solids.along_y(slab, -h / 2, 0.24 * h), leather)
    made += paint(solids.along_y(slab.offset(0.06), 0.22 * h, h / 2), solids.SILVER)
    made += paint(solids.along_y(slab.offset(0.06), -h / 2 - 0.25, -0.42 * h), solids.SILVER)
    made += _lens(
        rng, paint, (-0.02 * w, -0.1 * h, -d / 2), 0.36 * h, float(rng.uniform(1.8, 3.2)),
        barrel=solids.one_of(rng, solids.SILVER, solids.DARK),
    )  # fmt: skip
    for x, size in ((-0.33 * w, 1.7), (0.08 * w, 0.9), (0.3 * w, 1.1)):
        frame = solids.box((x - size / 2, 0.29 * h, -d / 2 - 0.22), (x + size / 2, 0.43 * h, 0))
        pane = solids.box(
            (x - size / 2 + 0.15, 0.31 * h, -d), (x + size / 2 - 0.15, 0.41 * h, -d / 2 - 0.1)
        )
        made = made + paint(frame, solids.DARK) - paint(pane, solids.GLASS)
    made += _dial(paint, (0.18 * w, h / 2, 0), 0.85, 0.6)
    made += _dial(paint, (0.36 * w, h / 2, 0), 0.7, 0.9)
    made += _dial(paint, (-0.38 * w, h / 2, 0), 0.9, 0.5)
    shoe = solids.box((-1.0, h / 2 - 0.1, -0.8), (1.0, h / 2 + 0.3, 0.9))
    made += paint(shoe.translate([-0.06 * w, 0, 0]), solids.DARK)
    lever = solids.box((0.3 * w, h / 2 + 0.55, 0.0), (0.48 * w, h / 2 + 0.75, 0.6))
    return made + paint(lever, solids.SILVER)


def _compact(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    w, h, d = (
        float(rng.uniform(9.0, 10.5)),
        float(rng.uniform(5.4, 6.4)),
        float(rng.uniform(2.2, 2.8)),
    )
    color = solids.one_of(rng, solids.SILVER, solids.vivid(rng), solids.vivid(rng), solids.DARK)
    made = paint(solids.rounded_box((w, h, d), float(rng.uniform(0.5, 1.0))), color)
    made += _lens(
        rng, paint, (-0.08 * w, -0.06 * h, -d / 2), 0.37 * h, float(rng.uniform(1.2, 2.6)),
        barrel=solids.one_of(rng, solids.SILVER, solids.GREY),
    )  # fmt: skip
    flash = solids.rounded_box((1.7, 0.8, 0.3), 0.12, 12).translate([-0.33 * w, 0.32 * h, -d / 2])
    made += paint(flash, solids.WHITE)
    lamp = solids.rod((0.2 * w, 0.34 * h, 0), (0.2 * w, 0.34 * h, -d / 2 - 0.12), 0.25, None, 16)
    made += paint(lamp, solids.RED)
    ridge = solids.rounded_box((0.5, 0.72 * h, 0.7), 0.24, 14).translate(
        [0.38 * w, -0.03 * h, -d / 2]
    )
    made += paint(ridge, solids.GREY)
    made += _dial(paint, (0.28 * w, h / 2 - 0.05, 0), 0.7, 0.45)
    rocker = solids.rounded_box((1.2, 0.4, 0.7), 0.15, 12).translate([0.08 * w, h / 2, 0])
    made += paint(rocker, solids.GREY)
    screen = solids.rounded_box((0.62 * w, 0.72 * h, 0.2), 0.08, 12)
    return made + paint(screen.translate([-0.1 * w, 0, d / 2]), solids.GLASS)


def _instant(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    w, h, d = (
        float(rng.uniform(10.5, 12.0)),
        float(rng.uniform(9.0, 10.5)),
        float(rng.uniform(5.5, 7.0)),
    )
    color, accent = (
        solids.one_of(rng, solids.WHITE, solids.vivid(rng), solids.DARK),
        solids.vivid(rng),
    )
    side = solids.polygon(
        [
            (-d, -h / 2),
            (-d, -0.26 * h),
            (-0.54 * d, -0.07 * h),
            (-0.5 * d, h / 2),
            (0.3 * d, h / 2),
            (0.45 * d, -h / 2),
        ]
    )
    made = paint(solids.along_x(solids.rounded(side, 0.5), w), color)
    made += _lens(
        rng,
        paint,
        (0.0, 0.19 * h, -0.52 * d),
        0.22 * h,
        float(rng.uniform(0.9, 1.6)),
        barrel=solids.DARK,
    )
    flash = solids.rounded_box((2.6, 1.7, 0.7), 0.2, 14).translate([-0.31 * w, 0.36 * h, -0.5 * d])
    made += paint(flash, (250, 248, 236))
    finder = solids.rounded_box((1.5, 1.3, 0.7), 0.2, 14).translate([0.31 * w, 0.37 * h, -0.5 * d])
    made += paint(finder, solids.GLASS)
    button = solids.rod(
        (0.34 * w, 0.06 * h, -0.4 * d), (0.34 * w, 0.08 * h, -0.6 * d), 0.6, None, 24
    )
    made += paint(button, solids.RED)
    slot = solids.box((-0.42 * w, -0.4 * h, -d - 0.5), (0.42 * w, -0.36 * h, -d + 0.5))
    made -= paint(slot, solids.DARK)
    stripe = solids.box((-0.06 * w, -0.36 * h, -d - 0.06), (0.06 * w, -0.22 * h, -0.9 * d))
    return made + paint(stripe, accent)


def _twin_lens(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    w, h, d = (
        float(rng.uniform(7.2, 8.2)),
        float(rng.uniform(10.0, 11.5)),
        float(rng.uniform(6.4, 7.4)),
    )
    leather = solids.one_of(rng, solids.DARK, solids.hsv(0.05, 0.5, 0.3))
    made = paint(solids.rounded_box((w, h, d), 0.5), leather)
    plate = solids.rounded_box((0.8 * w, 0.92 * h, 0.9), 0.25, 14).translate([0, 0, -d / 2 - 0.2])
    made += paint(plate, solids.GREY)
    for y, length in ((0.24 * h, 1.6), (-0.22 * h, 2.0)):
        made += _lens(rng, paint, (0, y, -d / 2 - 0.5), 0.21 * h, length, barrel=solids.SILVER)
    hood = solids.rounded_box((0.82 * w, 2.6, 0.8 * d), 0.2, 12).translate(
        [0, h / 2 + 1.1, 0.04 * d]
    )
    well = solids.box((-0.36 * w, h / 2 + 0.2, -0.31 * d), (0.36 * w, h / 2 + 3, 0.39 * d))
    made = made + paint(hood, leather) - paint(well, solids.GLASS)
    for side, y in ((1, 0.1), (1, -0.25), (-1, 0.15)):
        start, end = (side * (w / 2 - 0.1), y * h, 0.0), (side * (w / 2 + 0.8), y * h, 0.0)
        made += paint(solids.rod(start, end, 0.9, None, 28), solids.SILVER)
    crank = solids.box((w / 2 + 0.7, -0.3 * h, -0.25), (w / 2 + 1.0, -0.02 * h, 0.25))
    return made + paint(crank, solids.SILVER)


def _lens(
    rng: np.random.Generator,
    paint: solids.Paint,
    at: tuple[float, float, float],
    radius: float,
    length: float,
    barrel: solids.Rgb = solids.DARK,
) -> Manifold:
    """A lens with its mount at `at`, facing -z: rings, bevel and a curved front glass."""
    r, n = radius, length
    keys = [(1.06 * r, -0.3), (1.06 * r, 0.16 * n), (0.94 * r, 0.2 * n), (0.94 * r, 0.5 * n)]
    keys += [(0.99 * r, 0.53 * n), (0.99 * r, 0.8 * n), (0.9 * r, 0.84 * n), (0.9 * r, n)]
    body = solids.lathe(keys, 64, edge=0.08, corner=12)
    ribs = solids.outline_of_turn([(1.02 * r, 0.57 * n), (1.02 * r, 0.76 * n)])
    cone = solids.lathe([(0.6 * r, n - 0.22 * r), (0.84 * r, n + 0.02)], 64)
    eye = solids.ellipsoid((1.24 * r, 1.24 * r, 0.5 * r), 40).rotate([90, 0, 0])
    made = paint(body, barrel) + paint(
        solids.turned(ribs, 64), solids.one_of(rng, solids.DARK, solids.GREY)
    )
    accent = solids.outline_of_turn([(0.965 * r, 0.44 * n), (0.965 * r, 0.48 * n)])
    made += paint(
        solids.turned(accent, 64), solids.one_of(rng, solids.RED, solids.SILVER, solids.WHITE)
    )
    made -= paint(cone, solids.DARK)
    made += paint(eye.translate([0, n - 0.3 * r, 0]), solids.one_of(rng, LENS, COAT))
    return made.rotate([-90, 0, 0]).translate(list(at))


def _dial(
    paint: solids.Paint, at: tuple[float, float, float], radius: float, height: float
) -> Manifold:
    x, y, z = at
    knob = solids.lathe([(radius, -0.3), (radius, height)], 36, edge=0.12, corner=12)
    return paint(knob.translate([x, y, z]), solids.SILVER if radius > 0.8 else solids.GREY)
