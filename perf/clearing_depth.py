"""Fit the quick depth camera of table clearing to simulated frames, and compare the two.

    python perf/clearing_depth.py SETS [--frames 144] [--write]

SETS is a folder that `std-sim --layout dreds` wrote. Half of the frames are fitted to, the other
half compared with: shares of holes, of depth within 1 cm and of the background seen through
objects, by material class. `--write` saves the parameters in benchmark/tabletop/depth_model.json.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.data.frame import DepthFrame
from benchmark.data.splits import open_split
from benchmark.tabletop.depth_model import (
    BACKGROUND,
    EDGE,
    HOLE,
    KINDS,
    LEVELS,
    MATERIALS,
    OTHER,
    SHADOW,
    SURFACE,
    TABLE,
    WRONG,
    DepthModel,
    KindModel,
    degrade,
    patches,
    pixel_kinds,
    unmatched,
)
from std_toolkit.io.documents import write_document

NEAR_M = 0.01
BASELINE_M = 0.055
FEWEST = 150
# The table is nearer than this; walls and what is beyond them are no table.
FARTHEST_M = 1.0
TARGET = Path(__file__).parents[1] / "benchmark" / "tabletop" / "depth_model.json"
_SIGMAS = (0.5, 0.8, 1.2, 1.8, 2.5, 3.5, 5.0, 7.0)
_LAG = 3


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("sets", type=Path)
    parser.add_argument("--frames", type=int, default=144)
    parser.add_argument("--split", default="dreds-catknown-test")
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    source = open_split(args.split, args.sets)
    count = min(args.frames, len(source))
    chosen = [i * len(source) // count for i in range(count)]
    # Whole scenes on either side: frames of one scene show the same objects.
    scenes = sorted({source.keys()[i].scene for i in chosen})
    fitted_on = [i for i in chosen if scenes.index(source.keys()[i].scene) % 2 == 0]
    compared = [i for i in chosen if i not in set(fitted_on)]
    found: dict[str, list[Region]] = defaultdict(list)
    camera = source.load(chosen[0]).camera
    for i in fitted_on:
        for region in regions(source.load(i)):
            found[region.kind].append(region)
    size = f"{camera.width}x{camera.height}"
    model = DepthModel(
        source=f"perf/clearing_depth.py: {len(fitted_on)} frames {size} of {len(scenes[::2])} "
        "scenes of the procedural library, std-sim --sensor d415, quality draft, local matcher",
        focal_baseline=camera.fx * BASELINE_M,
        kinds={kind: fit(found[kind], camera.fx * BASELINE_M) for kind in KINDS},
    )
    for kind, m in model.kinds.items():
        print(
            f"{kind:12} n {m.instances:4} surface {m.shares[0]:.3f} other {m.shares[1]:.3f} "
            f"wrong {m.shares[2]:.3f} hole {m.shares[3]:.3f} concentration {m.concentration:6.2f} "
            f"patch {m.patch_px:.1f} px noise {m.noise_px:.3f} px bias {1e3 * m.bias_m:.2f} mm"
        )
    compare(model, source, compared)
    if args.write:
        write_document(TARGET, model)
        print(TARGET)


class Region:
    """Pixels of one kind in one frame: labels as an image, errors and depths."""

    def __init__(self, kind: str, labels: Any, error: Any, depth: Any) -> None:
        self.kind, self.labels, self.error, self.depth = kind, labels, error, depth
        self.shares = np.array([(labels == k).sum() for k in range(4)]) / (labels >= 0).sum()


def behind_of(frame: DepthFrame) -> Any:
    """Depth of the floor: a plane fitted to its visible part, without walls and edges of tables."""
    rays = frame.camera.rays()
    points = rays * frame.depth_true[..., None]
    near = (frame.depth_true > 0) & (frame.depth_true < FARTHEST_M)
    points = points[(frame.mask == BACKGROUND) & near][::20]
    kept = np.ones(len(points), bool)
    for _ in range(10):
        centre = points[kept].mean(axis=0)
        normal = np.linalg.svd(points[kept] - centre, full_matrices=False)[2][2]
        off = np.abs((points - centre) @ normal)
        kept = off <= max(0.003, 2 * float(np.median(off)))
    return ((centre @ normal) / (rays @ normal)).astype(np.float32)


def materials_of(frame: DepthFrame) -> dict[int, str]:
    return {i.mask_id: i.material.name.lower() for i in frame.instances}


def regions(frame: DepthFrame) -> list[Region]:
    true, raw = frame.depth_true, frame.depth_raw
    floor = behind_of(frame)
    kinds, other = pixel_kinds(
        true, frame.mask, floor, materials_of(frame), focal_baseline=frame.camera.fx * BASELINE_M
    )
    error = raw - true
    matched = ~unmatched(true, frame.camera.fx * BASELINE_M)
    found = []
    for kind in KINDS:
        here = (kinds == KINDS.index(kind)) & (true > 0) & (true < FARTHEST_M) & matched
        if kind in (EDGE, SHADOW):
            here &= other < FARTHEST_M
        elif kind == TABLE:
            here &= np.abs(floor - true) < NEAR_M
        ids = np.unique(frame.mask[here]) if kind in MATERIALS else [None]
        for number in ids:
            mine = here if number is None else here & (frame.mask == number)
            if mine.sum() < FEWEST:
                continue
            second = other if kind in (EDGE, SHADOW) else floor
            labels = np.full(true.shape, -1, np.int8)
            labels[mine] = WRONG
            apart = np.abs(second - true) > 2 * NEAR_M
            labels[mine & (np.abs(raw - second) < 1.5 * NEAR_M) & apart] = OTHER
            labels[mine & (np.abs(error) < NEAR_M)] = SURFACE
            labels[mine & (raw <= 0)] = HOLE
            found.append(Region(kind, labels, error, true))
    return found


def fit(found: list[Region], focal_baseline: float) -> KindModel:
    shares = np.array([r.shares for r in found])
    mean, variance = shares.mean(axis=0), shares.var(axis=0, ddof=1)
    used = mean > 0.02
    # Of a Dirichlet: variance = mean (1 - mean) / (concentration + 1), pooled over the labels.
    concentration = float(
        (mean * (1 - mean))[used].sum() / max(float(variance[used].sum()), 1e-6) - 1
    )
    surface = [r.error[r.labels == SURFACE] for r in found]
    z = [r.depth[r.labels == SURFACE] for r in found]
    # Slow waves of one object are no noise: deviations from its own median.
    disparity = np.concatenate(
        [
            (e - np.median(e)) * focal_baseline / d**2
            for e, d in zip(surface, z, strict=True)
            if len(e)
        ]
    )
    wrong = np.concatenate([r.error[r.labels == WRONG] for r in found])
    return KindModel(
        instances=len(found),
        shares=[round(float(x), 4) for x in mean / mean.sum()],
        concentration=round(max(concentration, 0.5), 3),
        patch_px=patch_of(found),
        bias_m=round(float(np.median(np.concatenate(surface))), 5),
        noise_px=round(float(1.4826 * np.median(np.abs(disparity))), 4),
        wrong_m=[round(float(x), 4) for x in np.quantile(wrong, LEVELS)]
        if len(wrong)
        else [0.0] * len(LEVELS),
    )


def agreement(labels: Any, member: Any) -> tuple[float, float]:
    """Number of pixel pairs a few columns apart that agree in being holes, and of all pairs."""
    a, b = labels[:, :-_LAG], labels[:, _LAG:]
    both = member[:, :-_LAG] & member[:, _LAG:]
    return float(((a == HOLE) == (b == HOLE))[both].sum()), float(both.sum())


def patch_of(found: list[Region]) -> float:
    """The patch size whose labels agree as often as the measured ones."""
    rng = np.random.default_rng(0)
    taken = found[:: max(1, len(found) // 60)]
    pairs = [agreement(r.labels, r.labels >= 0) for r in taken]
    measured = sum(p[0] for p in pairs) / max(sum(p[1] for p in pairs), 1)
    best = []
    for sigma in _SIGMAS:
        same = total = 0.0
        for r in taken:
            member = r.labels >= 0
            field = patches(member.shape, sigma, rng)
            limit = np.quantile(field[member], 1 - r.shares[HOLE])
            labels = np.where(field > limit, HOLE, SURFACE)
            got = agreement(labels, member)
            same, total = same + got[0], total + got[1]
        best.append((abs(same / max(total, 1) - measured), sigma))
    return min(best)[1]


def compare(model: DepthModel, source: Any, frames: list[int]) -> None:
    """Shares of both kinds of depth on frames that were not fitted to."""
    rng = np.random.default_rng(1)
    rows: dict[str, list[Any]] = defaultdict(list)
    for i in frames:
        frame = source.load(i)
        floor = behind_of(frame)
        made = degrade(
            frame.depth_true, frame.mask, floor, materials_of(frame), frame.camera,
            rng=rng, model=model,
        )  # fmt: skip
        for name in (*MATERIALS, TABLE):
            ids = [k for k, m in materials_of(frame).items() if m == name] or [-1]
            here = np.isin(frame.mask, [BACKGROUND] if name == TABLE else ids)
            here &= (frame.depth_true > 0) & (frame.depth_true < FARTHEST_M)
            if here.sum() < FEWEST:
                continue
            apart = np.abs(floor - frame.depth_true)[here] > 2 * NEAR_M
            for which, depth in (("simulator", frame.depth_raw), ("model", made)):
                d, t, f = depth[here], frame.depth_true[here], floor[here]
                right = np.abs(d - t) < NEAR_M
                through = (np.abs(d - f) < 1.5 * NEAR_M) & apart & ~right
                rows[f"{name:12} {which}"].append([(d <= 0).mean(), right.mean(), through.mean()])
    print(f"{'kind, on other scenes':32} frames  hole   right  through")
    for key, values in sorted(rows.items()):
        hole, right, through = np.mean(values, axis=0)
        print(f"{key:32} {len(values):6} {hole:.3f}  {right:.3f}  {through:.3f}")


if __name__ == "__main__":
    main()
