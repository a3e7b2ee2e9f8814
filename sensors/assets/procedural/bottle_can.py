"""Bottles and cans.

Cans: drink cans with necked ends, food tins with beads, flat tins, spray cans.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sensors.assets.procedural import solids
from std_toolkit.arrays import Array

if TYPE_CHECKING:
    from manifold3d import CrossSection, Manifold


BOTTLE_PLANS = ("bordeaux", "longneck", "soda", "sports", "milk", "lotion", "flask", "squeeze")

_GAP = 0.02

CAN_PLANS = ("drink", "sleek", "food", "flat", "spray")


def bottle(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    """A bottle about 20 units high, open at the neck or closed by a cap."""
    from manifold3d import JoinType

    plan = BOTTLE_PLANS[int(rng.integers(len(BOTTLE_PLANS)))]
    h = 20.0
    r, neck, shoulder, neck_base = _proportions(plan, rng)
    keys = _keys(plan, rng, h, r, neck, shoulder, neck_base)
    wall = float(rng.uniform(0.22, 0.34))
    profile = solids.smooth_profile(keys, samples=44)
    profile = np.concatenate([[(0.86 * r, 0.0)], profile[1:]])
    opening = neck - wall
    base = float(rng.uniform(0.4, 0.8))
    section = solids.vessel(profile, wall, base=base)
    # A ring below the mouth, which on real bottles holds a cap or a crown cork.
    lip, at = neck * rng.uniform(1.1, 1.22), h - rng.uniform(0.5, 0.9)
    for side in (-1, 1):
        ring = solids.rectangle((side * opening, at - 0.35), (side * lip, at + 0.1))
        section += solids.rounded(ring, 0.12)
    made = paint(solids.turned(section), _glass(plan, rng))
    if rng.uniform() < 0.6:
        cap = solids.turned(_cap(plan, rng, h, neck, lip))
        made += paint(cap, solids.one_of(rng, solids.WHITE, solids.vivid(rng)), "cap")
        # A gap, so that no face of the contents coincides with one of the glass.
        room = solids.outline_of_turn(profile[profile[:, 1] <= neck_base * h])
        room = room.offset(-wall - _GAP, JoinType.Round, 2.0, 32)
        room = room ^ solids.rectangle((-99, base + _GAP), (99, h))
        paint.cavity = solids.turned(solids.rounded(room, 0.3 * base))
    label = _label(profile, shoulder * h, rng)
    if label is not None:
        color = solids.one_of(rng, solids.WHITE, solids.vivid(rng))
        made += paint(solids.turned(label), color, "label")
    return made


def _proportions(plan: str, rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Radius of body and neck; end of the shoulder and start of the neck as fractions of height."""
    ranges = {
        "bordeaux": ((2.5, 2.9), (0.9, 1.1), (0.58, 0.64), (0.72, 0.76)),
        "longneck": ((2.3, 2.8), (0.95, 1.15), (0.46, 0.54), (0.72, 0.8)),
        "soda": ((2.8, 3.4), (1.0, 1.2), (0.55, 0.62), (0.88, 0.91)),
        "sports": ((2.9, 3.4), (1.7, 2.1), (0.76, 0.8), (0.86, 0.88)),
        "milk": ((3.2, 3.8), (1.8, 2.2), (0.52, 0.6), (0.8, 0.86)),
        "lotion": ((3.0, 3.8), (1.0, 1.3), (0.72, 0.78), (0.84, 0.87)),
        "flask": ((3.6, 4.4), (1.0, 1.3), (0.34, 0.42), (0.62, 0.7)),
        "squeeze": ((2.7, 3.2), (0.9, 1.1), (0.66, 0.74), (0.84, 0.87)),
    }[plan]
    r, neck, shoulder, base = (float(rng.uniform(*bounds)) for bounds in ranges)
    return r, neck, shoulder, base


def _keys(
    plan: str,
    rng: np.random.Generator,
    h: float,
    r: float,
    neck: float,
    shoulder: float,
    neck_base: float,
) -> list[tuple[float, float]]:
    low = [(0.97 * r, 0.0), (r, 0.045 * h)]
    top = [(neck, neck_base * h), (neck, h)]
    between = shoulder + 0.45 * (neck_base - shoulder)
    if plan == "bordeaux":
        waist = [(r, shoulder * h), (0.86 * r, (shoulder + 0.05) * h)]
    elif plan == "longneck":
        waist = [(r, shoulder * h), (0.62 * r + 0.2 * neck, between * h)]
    elif plan == "soda":
        narrow = float(rng.uniform(0.82, 0.9))
        waist = [
            (r, 0.12 * h),
            (narrow * r, 0.28 * h),
            (narrow * r, 0.33 * h),
            (r, 0.45 * h),
            (r, shoulder * h),
            (0.5 * (r + neck), (shoulder + 0.2) * h),
        ]
    elif plan == "sports":
        grip = float(rng.uniform(0.8, 0.88))
        waist = [
            (r, 0.4 * h),
            (grip * r, 0.5 * h),
            (grip * r, 0.58 * h),
            (r, 0.68 * h),
            (0.97 * r, shoulder * h),
        ]
    elif plan == "milk":
        waist = [(r, shoulder * h), (0.55 * r + 0.45 * neck, between * h)]
    elif plan == "lotion":
        waist = [(r, 0.6 * h), (0.985 * r, shoulder * h), (0.72 * r, (shoulder + 0.06) * h)]
    elif plan == "flask":
        low = [(0.75 * r, 0.0), (0.93 * r, 0.08 * h)]
        waist = [(r, 0.22 * h), (0.9 * r, shoulder * h), (0.45 * r + 0.3 * neck, between * h)]
    else:  # squeeze
        low = [(0.9 * r, 0.0), (0.97 * r, 0.045 * h)]
        waist = [(r, 0.35 * h), (0.92 * r, shoulder * h), (0.6 * r, (neck_base - 0.04) * h)]
    return [*low, *waist, *top]


def _cap(plan: str, rng: np.random.Generator, h: float, neck: float, lip: float) -> CrossSection:
    """Section of the closure: a screw cap, a crown, a sports cap or a tip."""
    radius = lip + 0.12
    if plan == "squeeze":
        tip = h + rng.uniform(1.8, 3.0)
        return solids.outline_of_turn(
            [(1.3 * radius, h - 1.2), (1.25 * radius, h + 0.2), (0.32 * neck, h + 0.8), (0.2, tip)]
        )
    if plan in ("lotion", "sports"):
        broad, tall = rng.uniform(1.2, 1.5) * radius, rng.uniform(0.9, 1.6)
        knob = solids.rounded(
            solids.rectangle((-0.45 * broad, h), (0.45 * broad, h + tall + 1.0)), 0.2
        )
        return solids.rounded(solids.rectangle((-broad, h - 1.5), (broad, h + tall)), 0.3) + knob
    if plan == "longneck":
        return solids.outline_of_turn(
            [(1.12 * radius, h - 0.45), (radius, h + 0.1), (0.8 * radius, h + 0.3)]
        )
    down, up = rng.uniform(0.9, 1.6), rng.uniform(0.2, 0.4)
    return solids.rounded(solids.rectangle((-radius, h - down), (radius, h + up)), 0.12)


def _label(profile: Array, top: float, rng: np.random.Generator) -> CrossSection | None:
    """Section of a paper ring around the body, or None for a bottle without a label."""
    if rng.uniform() < 0.35:
        return None
    low, high = 0.14 * 20 + rng.uniform(0, 0.8), top - rng.uniform(0.4, 1.5)
    if high - low < 2:
        return None
    inside = profile[(profile[:, 1] > low) & (profile[:, 1] < high)]
    if len(inside) < 3:
        return None
    outer = np.concatenate(
        [
            [(np.interp(low, profile[:, 1], profile[:, 0]), low)],
            inside,
            [(np.interp(high, profile[:, 1], profile[:, 0]), high)],
        ]
    )
    outer[:, 0] += 0.05
    # A ring, not a plug: the bottle stays hollow.
    return solids.outline_of_turn(outer) - solids.outline_of_turn(outer - [0.2, 0.0])


def _glass(plan: str, rng: np.random.Generator) -> solids.Rgb:
    if plan in ("bordeaux", "longneck"):
        return solids.hsv(rng.uniform(0.05, 0.4), rng.uniform(0.5, 0.8), rng.uniform(0.25, 0.5))
    if plan in ("lotion", "squeeze", "sports"):
        return solids.one_of(rng, solids.vivid(rng), solids.WHITE)
    return solids.one_of(
        rng, solids.hsv(rng.uniform(0.3, 0.6), 0.25, 0.75), (206, 216, 214), solids.vivid(rng)
    )


def can(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    """A closed can of radius about 3.3, without a tab so that it is rotationally symmetric."""
    plan = CAN_PLANS[int(rng.integers(len(CAN_PLANS)))]
    r = 3.3
    if plan in ("drink", "sleek"):
        return _drink(rng, paint, r if plan == "drink" else 0.88 * r, plan)
    if plan == "spray":
        return _spray(rng, paint, 0.9 * r)
    height = r * float(rng.uniform(2.2, 3.0) if plan == "food" else rng.uniform(0.85, 1.3))
    return _tin(rng, paint, r, height)


def _drink(rng: np.random.Generator, paint: solids.Paint, r: float, plan: str) -> Manifold:
    h = float(rng.uniform(11.2, 12.4) if plan == "drink" else rng.uniform(12.5, 14.0))
    neck = float(rng.uniform(0.76, 0.84)) * r
    taper = float(rng.uniform(1.1, 1.6))
    side = [
        (0.72 * r, 0.0),
        (0.78 * r, 0.12),
        (0.97 * r, 0.75),
        (r, 1.1),
        (r, h - taper - 0.35),
        (0.985 * r, h - taper),
        (neck + 0.05, h - 0.55),
        (neck, h - 0.4),
    ]
    printed = paint(solids.lathe(side), solids.vivid(rng))
    rim = [(neck - 0.1, h - 0.7), (neck, h - 0.4), (neck + 0.14, h - 0.15), (neck + 0.02, h)]
    lid = solids.lathe(rim, edge=0.06)
    dish = solids.lathe([(neck - 0.45, h - 0.5), (neck - 0.22, h + 0.1)])
    # The bottom is domed inwards.
    dome = solids.lathe([(0.66 * r, -0.1), (0.6 * r, 0.18), (0.4 * r, 0.5), (0.15 * r, 0.66)])
    color = solids.metal(rng)
    base = solids.lathe([(0.73 * r, -0.02), (0.79 * r, 0.12), (0.93 * r, 0.6)])
    made = printed + paint(base, color) + paint(lid, color)
    return made - paint(dish, color) - paint(dome, color)


def _tin(rng: np.random.Generator, paint: solids.Paint, r: float, h: float) -> Manifold:
    color = solids.metal(rng)
    heights = np.linspace(0.3, h - 0.3, 70)
    radius = np.full(70, r)
    beads = int(rng.integers(0, 4)) if h > 5 else 0
    if beads:
        inside = np.clip((heights - 0.28 * h) / (0.44 * h), 0, 1)
        radius -= 0.09 * np.sin(np.pi * inside * (2 * beads + 1)) ** 2
    body = solids.lathe(np.stack([radius, heights], 1))
    labelled = rng.uniform() < 0.75
    made = paint(body, solids.vivid(rng) if labelled else color)
    edge = float(rng.uniform(0.1, 0.2))
    for low in (0.0, h - 0.42):
        ring = [(r + edge, low), (r + edge, low + 0.42)]
        made += paint(solids.lathe(ring, edge=0.12), color)
    depth = float(rng.uniform(0.2, 0.4))
    for low in (-0.1, h - depth):
        dish = solids.outline_of_turn([(0.92 * r, low), (0.94 * r, low + depth + 0.1)])
        made -= paint(solids.turned(dish), color)
    for level in (depth - 0.1, h - depth):
        # Rings pressed into the ends.
        ring = solids.outline_of_turn([(0.62 * r, level - 0.12), (0.58 * r, level + 0.12)])
        made += paint(solids.turned(ring), color)
    return made


def _spray(rng: np.random.Generator, paint: solids.Paint, r: float) -> Manifold:
    h = float(rng.uniform(12.5, 15.5))
    color = solids.metal(rng)
    body = solids.lathe([(0.93 * r, 0.0), (r, 0.15), (r, h - 1.5), (0.96 * r, h - 1.35)])
    rim = solids.lathe([(1.04 * r, h - 1.75), (1.04 * r, h - 1.4)], edge=0.1)
    dome = solids.lathe(
        [(0.96 * r, h - 1.5), (0.9 * r, h - 1.0), (0.7 * r, h - 0.4), (0.45 * r, h)]
    )
    cap = solids.lathe([(0.42 * r, h - 0.3), (0.36 * r, h + rng.uniform(1.4, 2.4))], edge=0.2)
    made = paint(body, solids.vivid(rng)) + paint(rim, color) + paint(dome, color)
    return made + paint(cap, solids.one_of(rng, solids.WHITE, solids.vivid(rng)))
