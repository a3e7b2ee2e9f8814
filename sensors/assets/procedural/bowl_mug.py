"""Bowls and mugs. Bowls are hollow bodies of revolution with a foot or a flat bottom."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sensors.assets.procedural import solids
from std_toolkit.arrays import Array

if TYPE_CHECKING:
    from manifold3d import Manifold


MUG_PLANS = ("straight", "tapered", "barrel", "waisted", "cup", "flared")

HANDLES = ("c", "ear", "square", "d")

BOWL_PLANS = ("round", "conical", "straight", "wide_rim", "deep", "rolled")


def mug(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    """A mug of radius about 4."""
    plan = MUG_PLANS[int(rng.integers(len(MUG_PLANS)))]
    r, h = 4.0, float(rng.uniform(8.0, 10.5))
    bend = float(rng.uniform(0.06, 0.14))
    keys = {
        "straight": [(0.97 * r, 0), (r, 0.05 * h), (r, h)],
        "tapered": [((0.82 - bend) * r, 0), ((0.85 - bend) * r, 0.05 * h), (r, h)],
        "barrel": [((0.94 - bend) * r, 0), (r, 0.5 * h), ((0.95 - bend) * r, h)],
        "waisted": [(0.97 * r, 0), (r, 0.06 * h), ((0.97 - bend) * r, 0.5 * h), (r, h)],
        "cup": [(0.5 * r, 0), (0.78 * r, 0.14 * h), (0.98 * r, 0.5 * h), (1.04 * r, h)],
        "flared": [(0.72 * r, 0), (0.76 * r, 0.3 * h), (0.86 * r, 0.7 * h), (1.06 * r, h)],
    }[plan]
    if plan == "cup":
        h *= 0.78
        keys = [(a, 0.78 * b) for a, b in keys]
    profile = solids.smooth_profile(keys, samples=26)
    wall = float(rng.uniform(0.3, 0.45))
    section = solids.vessel(profile, wall, base=float(rng.uniform(0.45, 0.8)))
    glaze = solids.muted(rng)
    cup = paint(solids.turned(section), glaze)
    handle = paint(
        _handle(rng, profile, h, wall),
        glaze if rng.uniform() < 0.6 else solids.one_of(rng, solids.vivid(rng)),
    )
    # The ends of the handle are sunk into the wall; parts that reach the inside are cut away.
    room = solids.outline_of_turn(
        np.concatenate([profile, [(profile[-1, 0], 2 * h)]]) - [0.5 * wall, 0]
    )
    made = cup + (handle - solids.turned(room))
    band = rng.uniform()
    if band < 0.45:
        at = float(rng.uniform(0.15, 0.7)) * h
        low, high = at, min(at + float(rng.uniform(0.08, 0.3)) * h, 0.93 * h)
        ring = profile[(profile[:, 1] > low) & (profile[:, 1] < high)]
        if len(ring) >= 2:
            inner = solids.outline_of_turn(ring - np.array([0.2 * wall, 0]))
            strip = solids.outline_of_turn(ring + np.array([0.03, 0])) - inner
            made += paint(
                solids.turned(strip), solids.one_of(rng, solids.vivid(rng), solids.WHITE), "print"
            )
    if plan in ("cup", "barrel") and rng.uniform() < 0.8:
        foot = 0.8 * float(profile[0, 0])
        ring_section = solids.rectangle((-foot, -0.35), (foot, 0.2)) - solids.rectangle(
            (-foot + 0.5, -1), (foot - 0.5, -0.02)
        )
        made += paint(solids.turned(solids.rounded(ring_section, 0.1)), glaze)
    return made


def _handle(rng: np.random.Generator, profile: Array, h: float, wall: float) -> Manifold:
    kind = HANDLES[int(rng.integers(len(HANDLES)))]
    low = h * float(rng.uniform(0.14, 0.26))
    high = h * float(rng.uniform(0.76, 0.9))
    at_low, at_high = (float(np.interp(y, profile[:, 1], profile[:, 0])) for y in (low, high))
    out = float(rng.uniform(2.0, 2.8))
    middle = (low + high) / 2
    half = (high - low) / 2
    if kind == "square":
        keys = [(0, high), (0.7 * out, high), (out, high - 0.28 * half)]
        keys += [(out, low + 0.28 * half), (0.7 * out, low), (0, low)]
        smooth = 0.8
    elif kind == "ear":
        keys = [(0, high), (0.75 * out, high + 0.06 * h), (1.05 * out, middle + 0.5 * half)]
        keys += [(0.75 * out, middle - 0.25 * half), (0.3 * out, low + 0.1 * half), (0, low)]
        smooth = 1.6
    elif kind == "d":
        keys = [(0, high), (0.8 * out, high - 0.1 * half), (out, middle + 0.35 * half)]
        keys += [(out, middle - 0.35 * half), (0.8 * out, low + 0.1 * half), (0, low)]
        smooth = 1.2
    else:
        turn = np.linspace(np.pi / 2, -np.pi / 2, 9)
        keys = [(out * np.cos(a), middle + half * np.sin(a)) for a in turn]
        smooth = 1.0
    line = _smoothed(np.array(keys, dtype=np.float64), smooth)
    share = np.linspace(1, 0, len(line))
    line[:, 0] += at_low + (at_high - at_low) * share
    # Both ends extend into the wall.
    sunk = 0.9 * wall
    line[0, 0] -= sunk
    line[-1, 0] -= sunk
    path = np.column_stack([line, np.zeros(len(line))])
    thick = float(rng.uniform(0.32, 0.5))
    return solids.tube(path, thick * float(rng.uniform(1.1, 1.8)), thick)


def _smoothed(keys: Array, width: float) -> Array:
    """40 points along a line of key points, corners rounded over about `width`."""
    from scipy.ndimage import gaussian_filter1d

    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(keys, axis=0), axis=1))])
    fine = np.linspace(0, length[-1], 200)
    line = np.stack([np.interp(fine, length, keys[:, i]) for i in range(2)], 1)
    ends = line[[0, -1]].copy()
    line = gaussian_filter1d(line, 0.35 * width / length[-1] * 200, axis=0, mode="nearest")
    line[[0, -1]] = ends
    return line[np.linspace(0, 199, 40).round().astype(int)]


def bowl(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    """A bowl with a rim radius of about 8."""
    plan = BOWL_PLANS[int(rng.integers(len(BOWL_PLANS)))]
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
    profile = solids.smooth_profile(np.stack([radius, h * u], 1), samples=30)
    wall = float(rng.uniform(0.28, 0.5))
    section = solids.vessel(profile, wall, base=1.25 * wall)
    made = paint(solids.turned(section), solids.muted(rng))
    if rng.uniform() < 0.7 and plan != "straight":
        foot = float(rng.uniform(0.4, 0.9))
        for_ring = bottom * float(rng.uniform(0.92, 1.0))
        ring = solids.rectangle((-for_ring, -foot), (for_ring, 0.3 * wall)) - solids.rectangle(
            (-for_ring + 1.3 * wall, -foot - 1), (for_ring - 1.3 * wall, -0.02)
        )
        made += paint(
            solids.turned(solids.rounded(ring, 0.2 * wall)),
            solids.one_of(rng, solids.WHITE, solids.muted(rng)),
        )
    if plan == "rolled" or rng.uniform() < 0.3:
        edge = float(rng.uniform(0.6, 1.0)) * wall
        at = float(profile[-1, 0])
        roll = solids.rounded(
            solids.rectangle((at - wall, h - 1.2 * edge), (at + 0.8 * edge, h + 0.2 * edge)),
            0.45 * edge,
        )
        lip = roll + roll.mirror([1, 0])
        made += paint(solids.turned(lip), solids.one_of(rng, solids.vivid(rng), solids.WHITE))
    return made
