"""Cars: a body lofted from its side view, windows, wheels, lights; front towards -z."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sensors.assets.procedural import solids
from std_toolkit.arrays import Array

if TYPE_CHECKING:
    from manifold3d import CrossSection, Manifold

PLANS = ("sedan", "hatchback", "suv", "pickup", "van", "coupe")


@dataclass(frozen=True)
class _Shape:
    """Side view of a car of length 1 before scaling: u from the nose, heights in metres.

    Attributes:
        roof_h, hood_h, tail_h: heights above the body's lower edge.
        hood_u, roof_u, roof_end_u, tail_u: ends of hood, roof and rear window.
    """

    length: float
    width: float
    roof_h: float
    hood_h: float
    tail_h: float
    hood_u: float
    roof_u: float
    roof_end_u: float
    tail_u: float
    wheel: float
    pillars: tuple[float, ...]


# Bounds of the fields of `_Shape` in their order, and its pillars.
_BOUNDS: dict[str, tuple[tuple[tuple[float, float], ...], tuple[float, ...]]] = {
    "sedan": ((
        (4.3, 4.8), (1.7, 1.85), (1.12, 1.2), (0.64, 0.7), (0.68, 0.75), (0.26, 0.3),
        (0.4, 0.44), (0.66, 0.7), (0.81, 0.86), (0.3, 0.34),
    ), (0.55,)),
    "hatchback": ((
        (3.6, 4.1), (1.65, 1.78), (1.15, 1.28), (0.66, 0.74), (0.74, 0.8), (0.22, 0.27),
        (0.37, 0.42), (0.82, 0.88), (0.95, 0.985), (0.29, 0.33),
    ), (0.6,)),
    "suv": ((
        (4.2, 4.7), (1.85, 1.98), (1.35, 1.5), (0.86, 0.95), (0.9, 0.98), (0.24, 0.28),
        (0.34, 0.38), (0.9, 0.94), (0.965, 0.985), (0.38, 0.43),
    ), (0.52, 0.74)),
    "pickup": ((
        (5.0, 5.4), (1.85, 1.98), (1.35, 1.45), (0.86, 0.94), (0.84, 0.9), (0.25, 0.28),
        (0.34, 0.37), (0.52, 0.56), (0.56, 0.6), (0.38, 0.44),
    ), (0.44,)),
    "van": ((
        (4.5, 5.1), (1.8, 1.95), (1.65, 1.9), (0.8, 0.95), (1.0, 1.1), (0.1, 0.14),
        (0.25, 0.3), (0.94, 0.965), (0.985, 0.995), (0.31, 0.35),
    ), (0.38, 0.6, 0.8)),
    "coupe": ((
        (4.1, 4.5), (1.8, 1.95), (1.0, 1.08), (0.63, 0.68), (0.68, 0.73), (0.34, 0.4),
        (0.5, 0.54), (0.62, 0.66), (0.9, 0.96), (0.3, 0.33),
    ), ()),
}  # fmt: skip


def car(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    """A car in metres, wheels on the ground at y = 0."""
    plan = PLANS[int(rng.integers(len(PLANS)))]
    bounds, pillars = _BOUNDS[plan]
    fields: tuple[Any, ...] = (*(float(rng.uniform(*pair)) for pair in bounds), pillars)
    s = _Shape(*fields)
    lift = 0.55 * s.wheel + float(rng.uniform(0.0, 0.05))
    color = solids.one_of(
        rng,
        solids.vivid(rng),
        solids.vivid(rng),
        solids.WHITE,
        solids.SILVER,
        solids.hsv(0.6, 0.25, 0.4),
    )
    side = _side(s)
    belt = max(s.hood_h, s.tail_h if plan != "pickup" else 0.0) + 0.03
    hull = _warped(solids.along_x(side, s.width), s, belt)
    shell = paint(hull, color) - paint(_window_cut(s, side, belt), solids.DARK)
    if plan == "pickup":
        rear = s.tail_u * s.length + 0.08
        bed = solids.box(
            (-0.42 * s.width, 0.45 * s.tail_h, rear), (0.42 * s.width, 2.0, 0.965 * s.length)
        )
        shell -= paint(bed, solids.DARK)
    # The glass is a slightly smaller copy of the body, visible through the window openings.
    middle = np.array([0.0, 0.5 * s.hood_h, 0.5 * s.length])
    inner = hull.translate((-middle).tolist()).scale([0.965, 0.975, 0.985])
    glass = inner.translate(middle.tolist())
    if plan == "pickup":
        glass = glass ^ solids.box((-2, 0.4 * s.tail_h, 0), (2, 3, s.tail_u * s.length))
    made = shell + paint(glass, solids.GLASS)
    made += _lower_trim(s, paint)
    made = _with_wheels(rng, made, s, paint)
    made += _lights(s, plan, paint, hull)
    if plan in ("suv", "van") and rng.uniform() < 0.6:
        for x in (-0.33 * s.width, 0.33 * s.width):
            z0, z1 = (s.roof_u + 0.06) * s.length, (s.roof_end_u - 0.06) * s.length
            made += paint(
                solids.rounded_box((0.05, 0.08, z1 - z0), 0.02, 12).translate(
                    [x, s.roof_h + 0.0, (z0 + z1) / 2]
                ),
                solids.DARK,
            )
    if plan == "coupe" and rng.uniform() < 0.6:
        made += _spoiler(s, paint, color)
    return made.translate([0, lift, 0])


def _side(s: _Shape) -> CrossSection:
    top = [
        (0.0, 0.12),
        (0.0, 0.62 * s.hood_h),
        (0.02, 0.86 * s.hood_h),
        (0.5 * s.hood_u, 0.96 * s.hood_h),
        (s.hood_u, s.hood_h + 0.02),
        (s.roof_u, s.roof_h - 0.03),
        (0.5 * (s.roof_u + s.roof_end_u), s.roof_h),
        (s.roof_end_u, s.roof_h - 0.04),
        (s.tail_u, s.tail_h + 0.03),
        (0.985, s.tail_h),
        (1.0, 0.85 * s.tail_h),
        (1.0, 0.14),
        (0.97, 0.0),
        (0.03, 0.0),
    ]
    points = np.array(top) * [s.length, 1.0]
    section = solids.rounded(solids.polygon(points), 0.07, 24)
    # Concave corners, such as the one at the windscreen, are rounded too.
    return section.offset(0.06).offset(-0.06)


def _warped(solid: Manifold, s: _Shape, belt: float) -> Manifold:
    """Taper the body towards nose, tail and roof, and arch the roof and hood."""

    def warp(p: Array) -> Array:
        q = np.array(p)
        u = 2 * q[:, 2] / s.length - 1
        half = s.width / 2
        above = np.clip((q[:, 1] - belt) / (s.roof_h - belt), 0, 1.2)
        below = np.clip(1 - q[:, 1] / (0.45 * s.hood_h), 0, 1)
        plan = 1 - 0.13 * np.abs(u) ** 5 - 0.04 * u**2
        x = q[:, 0] / half
        q[:, 0] *= plan * (1 - 0.2 * above**1.2) * (1 - 0.06 * below**2)
        q[:, 1] -= (0.05 + 0.04 * above) * np.abs(x) ** 3 * np.clip(q[:, 1] / belt, 0, 1) ** 2
        # The nose and the tail are rounded in the plan view, too.
        q[:, 2] -= np.sign(u) * 0.16 * np.abs(x) ** 3 * np.abs(u) ** 8
        return q

    return solid.refine_to_length(0.13).warp_batch(warp)


def _window_cut(s: _Shape, side: CrossSection, belt: float) -> Manifold:
    room = side ^ solids.rectangle((-1.0, belt), (s.length + 1, 3.0))
    frame = room.offset(-0.09) ^ solids.rectangle((-1.0, belt + 0.03), (s.length + 1, 3.0))
    for u in s.pillars:
        frame -= solids.rectangle((u * s.length - 0.05, 0), (u * s.length + 0.05, 3.0))
    cut = solids.along_x(solids.rounded(frame, 0.03, 12), 4.0)
    low, high = belt + 0.05, s.roof_h - 0.13
    half = 0.5 * 0.74 * s.width
    front = solids.box(
        (-half, low, s.hood_u * s.length - 0.1), (half, high, s.roof_u * s.length + 0.05)
    )
    rear = solids.box(
        (-half, low, s.roof_end_u * s.length - 0.1), (half, high - 0.02, s.length + 0.1)
    )
    # The windscreen and rear window taper with the roof.
    return cut + front + rear


def _lower_trim(s: _Shape, paint: solids.Paint) -> Manifold:
    front = solids.rounded_box((0.5 * s.width, 0.22 * s.hood_h, 0.1), 0.03, 12)
    made = paint(front.translate([0, 0.42 * s.hood_h, 0.035]), solids.DARK)
    for z in (0.05, s.length - 0.05):
        bar = solids.rounded_box((0.84 * s.width, 0.16, 0.14), 0.05, 16).translate([0, 0.12, z])
        made += paint(bar, solids.DARK)
    return made


def _with_wheels(
    rng: np.random.Generator, body: Manifold, s: _Shape, paint: solids.Paint
) -> Manifold:
    radius, broad = s.wheel, float(rng.uniform(0.2, 0.26))
    axles = (float(rng.uniform(0.165, 0.19)), float(rng.uniform(0.79, 0.83)))
    height = 0.45 * radius
    wheel = _wheel(rng, paint, radius, broad)
    made = body
    for u in axles:
        z = u * s.length
        for side in (-1, 1):
            at = side * s.width / 2
            arch = solids.rod(
                (at - side * 0.32, height, z), (at + side * 0.2, height, z), 1.17 * radius, None, 48
            )
            made -= paint(arch, solids.DARK)
            turn = -90 if side > 0 else 90
            x = at - side * (broad / 2 + 0.04)
            made += wheel.rotate([0, 0, turn]).translate([x, height, z])
            axle = solids.rod((0, height, z), (x, height, z), 0.09, None, 16)
            made += paint(axle, solids.DARK)
    return made


def _wheel(rng: np.random.Generator, paint: solids.Paint, radius: float, broad: float) -> Manifold:
    half = broad / 2
    tyre = solids.lathe([(radius, -half), (radius, half)], 48, edge=0.05, corner=16)
    rim = 0.66 * radius
    made = paint(tyre, solids.DARK) - paint(
        solids.lathe([(rim, half - 0.06), (rim, half + 0.1)], 48), solids.SILVER
    )
    made += paint(solids.lathe([(0.2 * radius, 0), (0.14 * radius, half)], 24), solids.SILVER)
    spokes = int(rng.integers(5, 9))
    for k in range(spokes):
        angle = 2 * np.pi * k / spokes
        end = (0.97 * rim * np.cos(angle), half - 0.045, 0.97 * rim * np.sin(angle))
        made += paint(solids.rod((0, half - 0.035, 0), end, 0.035, None, 8), solids.SILVER)
    return made


def _lights(s: _Shape, plan: str, paint: solids.Paint, hull: Manifold) -> Manifold:
    lamp = solids.ellipsoid((0.34, 0.17, 0.9), 28)
    skin = hull.scale([1.012, 1.012, 1.0]).translate([0, 0, -0.012])
    tail = solids.rounded_box((0.2, 0.2 if plan not in ("van", "suv") else 0.42, 0.16), 0.05, 12)
    made = None
    for x in (-0.36 * s.width, 0.36 * s.width):
        front = lamp.translate([x, 0.74 * s.hood_h, 0.1]) ^ skin
        back = tail.translate([x * 1.06, 0.78 * s.tail_h, s.length - 0.1])
        for solid, color in ((front, (246, 244, 226)), (back, solids.RED)):
            part = paint(solid, color)
            made = part if made is None else made + part
        mirror = solids.ellipsoid((0.2, 0.14, 0.1), 16)
        at = s.hood_u * s.length + 0.28
        made += paint(
            mirror.translate([np.sign(x) * (0.46 * s.width + 0.09), s.hood_h + 0.1, at]),
            solids.DARK,
        )
        blink = solids.ellipsoid((0.16, 0.08, 0.9), 16).translate([x, 0.52 * s.hood_h, 0.1])
        made += paint(blink ^ skin, solids.AMBER)
    return made


def _spoiler(s: _Shape, paint: solids.Paint, color: solids.Rgb) -> Manifold:
    z = 0.95 * s.length
    wing = solids.rounded_box((0.8 * s.width, 0.04, 0.26), 0.018, 12).translate(
        [0, s.tail_h + 0.17, z]
    )
    made = paint(wing, color)
    for x in (-0.28 * s.width, 0.28 * s.width):
        made += paint(
            solids.box((x - 0.03, 0.8 * s.tail_h, z - 0.06), (x + 0.03, s.tail_h + 0.17, z + 0.06)),
            color,
        )
    return made
