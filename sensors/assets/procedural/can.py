"""Cans: drink cans with necked ends, food tins with beads, flat tins, spray cans."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sensors.assets.procedural.painted import WHITE, Paint, metal, one_of, vivid
from sensors.assets.procedural.solids import outline_of_turn, rounded, turned

if TYPE_CHECKING:
    from manifold3d import Manifold

PLANS = ("drink", "sleek", "food", "flat", "spray")


def can(rng: np.random.Generator, paint: Paint) -> Manifold:
    """A closed can of a radius of about 3.3. Its tab is left out: it turns without a change."""
    plan = PLANS[int(rng.integers(len(PLANS)))]
    r = 3.3
    if plan in ("drink", "sleek"):
        return _drink(rng, paint, r if plan == "drink" else 0.88 * r, plan)
    if plan == "spray":
        return _spray(rng, paint, 0.9 * r)
    height = r * float(rng.uniform(2.2, 3.0) if plan == "food" else rng.uniform(0.85, 1.3))
    return _tin(rng, paint, r, height)


def _drink(rng: np.random.Generator, paint: Paint, r: float, plan: str) -> Manifold:
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
    printed = paint(turned(outline_of_turn(side)), vivid(rng))
    rim = [(neck - 0.1, h - 0.7), (neck, h - 0.4), (neck + 0.14, h - 0.15), (neck + 0.02, h)]
    lid = turned(rounded(outline_of_turn(rim), 0.06))
    dish = turned(outline_of_turn([(neck - 0.45, h - 0.5), (neck - 0.22, h + 0.1)]))
    # The bottom is domed inwards.
    dome = turned(
        outline_of_turn([(0.66 * r, -0.1), (0.6 * r, 0.18), (0.4 * r, 0.5), (0.15 * r, 0.66)])
    )
    color = metal(rng)
    base = turned(outline_of_turn([(0.73 * r, -0.02), (0.79 * r, 0.12), (0.93 * r, 0.6)]))
    made = printed + paint(base, color) + paint(lid, color)
    return made - paint(dish, color) - paint(dome, color)


def _tin(rng: np.random.Generator, paint: Paint, r: float, h: float) -> Manifold:
    color = metal(rng)
    heights = np.linspace(0.3, h - 0.3, 70)
    radius = np.full(70, r)
    beads = int(rng.integers(0, 4)) if h > 5 else 0
    if beads:
        inside = np.clip((heights - 0.28 * h) / (0.44 * h), 0, 1)
        radius -= 0.09 * np.sin(np.pi * inside * (2 * beads + 1)) ** 2
    body = turned(outline_of_turn(np.stack([radius, heights], 1)))
    labelled = rng.uniform() < 0.75
    made = paint(body, vivid(rng) if labelled else color)
    edge = float(rng.uniform(0.1, 0.2))
    for low in (0.0, h - 0.42):
        ring = [(r + edge, low), (r + edge, low + 0.42)]
        made = made + paint(turned(rounded(outline_of_turn(ring), 0.12)), color)
    depth = float(rng.uniform(0.2, 0.4))
    for low in (-0.1, h - depth):
        dish = outline_of_turn([(0.92 * r, low), (0.94 * r, low + depth + 0.1)])
        made = made - paint(turned(dish), color)
    for level in (depth - 0.1, h - depth):
        # Rings pressed into the ends.
        ring = outline_of_turn([(0.62 * r, level - 0.12), (0.58 * r, level + 0.12)])
        made = made + paint(turned(ring), color)
    return made


def _spray(rng: np.random.Generator, paint: Paint, r: float) -> Manifold:
    h = float(rng.uniform(12.5, 15.5))
    color = metal(rng)
    body = turned(outline_of_turn([(0.93 * r, 0.0), (r, 0.15), (r, h - 1.5), (0.96 * r, h - 1.35)]))
    rim = turned(rounded(outline_of_turn([(1.04 * r, h - 1.75), (1.04 * r, h - 1.4)]), 0.1))
    dome = turned(
        outline_of_turn(
            [(0.96 * r, h - 1.5), (0.9 * r, h - 1.0), (0.7 * r, h - 0.4), (0.45 * r, h)]
        )
    )
    cap = turned(
        rounded(outline_of_turn([(0.42 * r, h - 0.3), (0.36 * r, h + rng.uniform(1.4, 2.4))]), 0.2)
    )
    made = paint(body, vivid(rng)) + paint(rim, color) + paint(dome, color)
    return made + paint(cap, one_of(rng, WHITE, vivid(rng)))
