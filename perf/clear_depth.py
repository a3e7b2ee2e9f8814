"""What a camera measures where something transparent is, simulated and real: rows of `realism.py`.

The background is at least `GAP_M` behind the surface. 123 (ClearGrasp) and the D415's bottle set
the ranges of the materials; 080 and 130 only judge.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from perf.trial import CAMERA, SENSOR, VESSELS, render_view, vessels
from sensors.render.sim_renderer import DRAFT_INFRARED
from sensors.render.sim_scene import SimScene, TruthCaster
from std_toolkit.io.exr import read_exr_depth
from std_toolkit.io.images import read_depth, read_png

GAP_M = 0.015


@dataclass(frozen=True, kw_only=True)
class ClearShares:
    """What a camera measures where something transparent is.

    Attributes:
        pixels: counted: those with the background at least `GAP_M` behind the surface.
        missing: fraction without depth.
        background: fraction of the measured ones that show what lies behind: nearer to it than to
            the surface by 3 to 7, or within `GAP_M` of it.
        surface: fraction of the measured ones within 10 mm of the surface.
        median_mm: median error of the measured ones.
        brightness: mean of the infrared image over that of a ring around; NaN if unknown.
    """

    pixels: int
    missing: float
    background: float
    surface: float
    median_mm: float
    brightness: float = float("nan")


def clear_shares(
    depth: NDArray[np.floating],
    surface: NDArray[np.floating],
    background: NDArray[np.floating],
    mask: NDArray[np.bool_],
    *,
    infrared: NDArray[np.uint8] | None = None,
) -> ClearShares:
    """Compare a depth map with the two surfaces that a clear object offers.

    Args:
        depth: (h, w) measured, metres, 0 = none.
        surface: (h, w) true depth of the object.
        background: (h, w) true depth without the object.
        mask: (h, w) bool, the object.
        infrared: (h, w) image of the same camera.
    """
    gap = background - surface
    counted = mask & (surface > 0) & (gap > GAP_M)
    seen = counted & (depth > 0)
    z, near, far = depth[seen], surface[seen], background[seen]
    behind = (z - near > 0.7 * (far - near)) & (z - far < GAP_M)
    brightness = float("nan")
    if infrared is not None and mask.any():
        inside = mask.astype(np.uint8)
        ring = cv2.dilate(inside, np.ones((41, 41))) > cv2.dilate(inside, np.ones((11, 11)))
        brightness = float(infrared[mask].mean() / max(infrared[ring].mean(), 1))
    return ClearShares(
        pixels=int(counted.sum()),
        missing=1 - float(seen.sum() / max(counted.sum(), 1)),
        background=float(behind.mean()) if behind.size else 0.0,
        surface=float((abs(z - near) < 0.01).mean()) if behind.size else 0.0,
        median_mm=float(np.median(abs(z - near)) * 1000) if behind.size else float("nan"),
        brightness=brightness,
    )


# The bottle without its cap, in the left infrared image of the D415.
BOTTLE = ((205, 120), (232, 108), (255, 125), (318, 180), (335, 215), (295, 248), (262, 222))
GLASS_TRIALS: dict[str, tuple[str, dict[str, Any], tuple[str, ...], str]] = {
    "thin, lying bottles": (
        "glass_thin",
        {"floor": "fabric_cotton", "lying": True, "distance_m": 0.5, "elevation_deg": 80},
        ("bottle",) * 2,
        "D415, lying bottle (fitted)",
    ),
    "hazy plastic, mugs and bowls": (
        "glass_glossy",
        {"floor": "wood_ebony", "distance_m": 0.68, "elevation_deg": 50},
        ("mug", "bowl", "mug", "bowl", "mug", "mug"),
        "123, three boxes (fitted)",
    ),
    "thin, standing and lying bottles": (
        "glass_thin",
        {"floor": "fabric_cotton", "distance_m": 0.55, "elevation_deg": 35},
        ("bottle",) * 3,
        "080, four bottles",
    ),
    "clear glass, vessels": (
        "glass_clear",
        {"floor": "wood_pine", "distance_m": 0.68, "elevation_deg": 45},
        VESSELS * 2,
        "130, plastic and glass",
    ),
    "refractive glass, vessels": (
        "glass_refractive",
        {"floor": "wood_pine", "distance_m": 0.68, "elevation_deg": 45},
        VESSELS * 2,
        "130, plastic and glass",
    ),
}


def glass(renderer: Any, data: Path, seeds: int) -> pd.DataFrame:
    """What is measured where glass is, simulated and real."""
    rows = {}
    for name, (material, place, categories, _) in GLASS_TRIALS.items():
        found = []
        for seed in range(seeds):
            trial = vessels([("transparent", material, c) for c in categories], seed, **place)
            view = render_view(trial, SENSOR, CAMERA, renderer, options=DRAFT_INFRARED, seed=seed)
            floor = SimScene(trial.scene.objects[:1], trial.scene.environment)
            bare = TruthCaster(floor).maps(CAMERA, trial.T_world_ir).depth
            found.append(
                clear_shares(view.depth, view.exact, bare, view.mask > 0, infrared=view.left)
            )
        rows[f"simulated {name}"] = np.mean([astuple(f) for f in found], axis=0)
    if data.is_dir():
        rows["D415, lying bottle (fitted)"] = astuple(real_bottle(data / "d415_stereo_pair"))
        for number, label in (
            ("123", "123, three boxes (fitted)"),
            ("080", "080, four bottles"),
            ("130", "130, plastic and glass"),
        ):
            rows[label] = astuple(real_glass(data, number))
    columns = [f.name for f in fields(ClearShares)]
    return pd.DataFrame(rows, index=columns).T.astype({"pixels": int})


def real_glass(data: Path, number: str) -> ClearShares:
    """A capture of ClearGrasp; the background is the plane of its table."""
    stem = data / "cleargrasp_real" / "real-val" / f"000000{number}"
    depth, twin = (
        np.nan_to_num(read_exr_depth(Path(f"{stem}-{kind}-depth-img.exr")))
        for kind in ("transparent", "opaque")
    )
    mask = np.asarray(read_png(Path(f"{stem}-mask.png")), np.uint8)
    inside = (mask if mask.ndim == 2 else mask[..., 0]) > 0
    around = (cv2.dilate(inside.astype(np.uint8), np.ones((41, 41), np.uint8)) == 0) & (twin > 0)
    h, w = inside.shape
    y, x = np.nonzero(around)
    # A plane is linear in the inverse of the depth.
    a = np.stack([x / w, y / h, np.ones(len(x))], axis=1)
    rng = np.random.default_rng(0)
    best = np.zeros(len(x), bool)
    for _ in range(200):
        three = rng.integers(len(x), size=3)
        if np.linalg.matrix_rank(a[three]) < 3:
            continue
        plane = np.linalg.solve(a[three], 1 / twin[around][three])
        near = abs(1 / np.maximum(a @ plane, 1e-3) - twin[around]) < 0.01
        best = near if near.sum() > best.sum() else best
    plane = np.linalg.lstsq(a[best], 1 / twin[around][best], rcond=None)[0]
    rows, columns = np.mgrid[:h, :w]
    table = 1 / (columns / w * plane[0] + rows / h * plane[1] + plane[2])
    return clear_shares(depth, twin, table, inside)


def real_bottle(folder: Path) -> ClearShares:
    """The D415's bottle. Its surface is unknown: 45 mm, 3/4 of its width, above the cloth."""
    left = read_png(folder / "0000_ir_l.png")[..., 0].astype(np.uint8)
    depth = read_depth(folder / "0000_depth.png", scale=0.001)
    mask = np.zeros(left.shape, np.uint8)
    cv2.fillPoly(mask, [np.array(BOTTLE)], 1)
    wide, narrow = (cv2.dilate(mask, np.ones((k, k), np.uint8)) > 0 for k in (31, 9))
    ring = wide & ~narrow & (depth > 0.4)
    y, x = np.nonzero(ring)

    def terms(x: Any, y: Any) -> Any:
        u, v = x / 640, y / 360
        return np.stack([u, v, u * u, v * v, np.ones_like(u)], axis=-1)

    cloth = np.linalg.lstsq(terms(x, y), 1 / depth[ring], rcond=None)[0]
    rows, columns = np.mgrid[:360, :640]
    behind = 1 / (terms(columns, rows) @ cloth)
    shares = clear_shares(depth, behind - 0.045, behind, mask > 0, infrared=left)
    return replace(shares, median_mm=float("nan"), surface=float("nan"))
