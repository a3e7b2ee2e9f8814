"""Bowls: turned, hollow, on a foot or a flat bottom."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sensors.assets.procedural.painted import WHITE, Paint, muted, one_of, vivid
from sensors.assets.procedural.solids import rectangle, rounded, smooth_profile, turned, vessel

if TYPE_CHECKING:
    from manifold3d import Manifold

PLANS = ("round", "conical", "straight", "wide_rim", "deep", "rolled")


def bowl(rng: np.random.Generator, paint: Paint) -> Manifold:
    """A bowl with a rim radius of about 8."""
    plan = PLANS[int(rng.integers(len(PLANS)))]
    r = 8.0
    h = r * float(
        {
            "round": rng.uniform(0.75, 0.95),
            "conical": rng.uniform(0.6, 0.9),
            "straight": rng.uniform(0.65, 0.9),
            "wide_rim": rng.uniform(0.5, 0.65),
            "deep": rng.uniform(1.0, 1.2),
            "rolled": rng.uniform(0.6, 0.85),
        }[plan]
    )
    bottom = r * float(rng.uniform(0.3, 0.45))
    u = np.linspace(0, 1, 14)
    if plan == "conical":
        radius = bottom + (r - bottom) * u ** rng.uniform(0.85, 1.1)
    elif plan == "straight":
        bottom = 0.72 * r
        radius = bottom + (r - bottom) * np.minimum(1, 2.2 * u) ** 0.5
    elif plan == "wide_rim":
        side = 0.72 * r
        radius = np.where(u < 0.8, bottom + (side - bottom) * (1 - (1 - u / 0.8) ** 2) ** 0.5, 0.0)
        radius[u >= 0.8] = np.linspace(side + 0.05 * r, r, int((u >= 0.8).sum()))
    else:
        round_ = (1 - (1 - u) ** 2) ** 0.5
        radius = bottom + (r - bottom) * round_ ** rng.uniform(0.9, 1.1)
    profile = smooth_profile(np.stack([radius, h * u], 1), samples=30)
    wall = float(rng.uniform(0.28, 0.5))
    section = vessel(profile, wall, base=1.25 * wall)
    outside = paint(turned(section), muted(rng))
    parts = [outside]
    if rng.uniform() < 0.7 and plan != "straight":
        foot = float(rng.uniform(0.4, 0.9))
        for_ring = bottom * float(rng.uniform(0.92, 1.0))
        ring = rectangle((-for_ring, -foot), (for_ring, 0.3 * wall)) - rectangle(
            (-for_ring + 1.3 * wall, -foot - 1), (for_ring - 1.3 * wall, -0.02)
        )
        parts.append(paint(turned(rounded(ring, 0.2 * wall)), one_of(rng, WHITE, muted(rng))))
    if plan == "rolled" or rng.uniform() < 0.3:
        edge = float(rng.uniform(0.6, 1.0)) * wall
        at = float(profile[-1, 0])
        roll = rounded(
            rectangle((at - wall, h - 1.2 * edge), (at + 0.8 * edge, h + 0.2 * edge)), 0.45 * edge
        )
        lip = roll + roll.mirror([1, 0])
        parts.append(paint(turned(lip), one_of(rng, vivid(rng), WHITE)))
    made = parts[0]
    for part in parts[1:]:
        made = made + part
    return made
