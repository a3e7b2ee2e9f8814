"""Shipped or given weights against the best filling, frame by frame.

    python perf/weights.py TEST=SPLIT:ROOT ... [--weights DIR] [--limit 60]
    python perf/weights.py --recordings DIR ... [--weights DIR] [--limit 60]

For each test: RMSE in mm and share of pixels within 5 % on specular and transparent pixels,
protocol `strict`, of every filling and of the networks; and how often good depth is
spoiled: the share of pixels of opaque objects whose sensor depth is within 5 mm of the truth and
whose restored depth is more than 10 mm away, of the network's own map and of what `std-restore`
returns; the last also of the surroundings of the objects. Fewer than ten frames are listed one by
one. DIR holds METHOD-compact.safetensors; without it, shipped weights. Weights are chosen
elsewhere, by simulated validation scenes: this script only judges them.

Recordings of scenes without glass and metal need no truth: holes are cut into their own depth, and
the answer of `std-restore` is compared with what was measured there.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import pandas as pd

REPOSITORY = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(REPOSITORY))

from benchmark.data.frame import DepthFrame, Material, resize_nearest  # noqa: E402
from benchmark.data.splits import open_split  # noqa: E402
from benchmark.evaluation.probes import holes_elsewhere  # noqa: E402
from benchmark.methods.depth.full_size import restorer_view, to_full_size  # noqa: E402
from benchmark.methods.protocol import Restorer as MethodRestorer  # noqa: E402
from benchmark.methods.registry import MethodOptions, make_restorer  # noqa: E402
from benchmark.metrics.depth.holes import COLUMNS  # noqa: E402
from benchmark.metrics.protocols.protocol import get_protocol  # noqa: E402
from benchmark.metrics.protocols.score import score_frame  # noqa: E402
from benchmark.restoring.options import default_where  # noqa: E402
from benchmark.restoring.recordings import open_recordings  # noqa: E402
from benchmark.restoring.restorer import Restorer  # noqa: E402
from std_toolkit.importers.options import ImageOptions  # noqa: E402

FILLINGS = ("nearest", "telea", "navier-stokes", "joint-bilateral", "colorization", "planes")
NETWORKS = ("swindrnet", "nlspn", "dfnet", "compactdr")
GOOD_M, SPOILED_M = 0.005, 0.010


def spoiled(restored: np.ndarray, frame: DepthFrame, where: np.ndarray) -> tuple[int, int]:
    """Good pixels of `where` (H, W), and how many of them end far from the truth."""
    size = (restored.shape[1], restored.shape[0])
    sensor, true = resize_nearest(frame.depth_raw, size), resize_nearest(frame.depth_true, size)
    good = (
        resize_nearest(where, size) & (true > 0) & (sensor > 0) & (np.abs(sensor - true) <= GOOD_M)
    )
    return int(good.sum()), int((np.abs(restored - true)[good] > SPOILED_M).sum())


def rows_of(name: str, restorer: MethodRestorer, frame: DepthFrame) -> dict[str, object]:
    protocol = get_protocol("strict")
    (answer,) = restorer.restore([restorer_view(frame, restorer)])
    found = {"method": name, "frame": frame.key}
    for row in score_frame(answer.depth, frame, protocol):
        # The first size is that of the tables of `std-bench`; the own size of the frame follows.
        if row.subset == "specular+transparent" and "rmse" not in found:
            found |= {"rmse": 1000 * row.errors.rmse, "d105": 100 * row.errors.d105}
    opaque = frame.mask_of(Material.RAW, Material.DIFFUSE)
    found["good"], found["spoiled"] = spoiled(answer.depth, frame, opaque)
    if name in NETWORKS:
        color = resize_nearest(frame.color, frame.depth_raw.shape[::-1])
        whole = to_full_size(frame.depth_raw, answer, color)
        found["whole_good"], found["whole_spoiled"] = spoiled(whole.depth, frame, opaque)
        around = ~frame.mask_of(*Material)
        found["around_good"], found["around_spoiled"] = spoiled(whole.depth, frame, around)
    return found


def print_holes(
    source: Path, made: dict[str, MethodRestorer], limit: int, by_default: bool
) -> None:
    """Errors in holes cut into the depth of a recording."""
    with tempfile.TemporaryDirectory() as folder:
        (recording,) = open_recordings([source], ImageOptions(), Path(folder))
        count = min(limit, len(recording.frames))
        chosen = [recording.frames[i * len(recording.frames) // count] for i in range(count)]
        frames = [(f.name, *f.read(), f.camera) for f in chosen]
    rows = []
    for name, method in made.items():
        where = default_where(name) if by_default else "everywhere"
        restore = Restorer(method, MethodOptions(), where=where).restore_view
        found = holes_elsewhere(lambda *view, restore=restore: restore(*view).depth, frames)
        rows.append({"method": name, **{c.title: c.factor * found[c.name] for c in COLUMNS}})
    print(f"\n{source}: {int(found['frames'])} of {count} frames with depth to cut holes into")
    print(pd.DataFrame(rows).round(1).to_string(index=False))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("tests", nargs="*", metavar="TEST=SPLIT:ROOT")
    parser.add_argument("--recordings", nargs="+", type=Path, default=[])
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--limit", type=int, default=60)
    parser.add_argument("--by-default", action="store_true", help="SwinDRNet as std-restore has it")
    parser.add_argument("--methods", nargs="+", default=[*FILLINGS, *NETWORKS])
    args = parser.parse_args()
    made = {}
    for name in args.methods:
        own = args.weights and args.weights / f"{name}-compact.safetensors"
        if name in NETWORKS and own and not own.is_file():
            continue
        given = own if name in NETWORKS else None
        made[name] = make_restorer(name, MethodOptions(preset="compact", weights=given or None))
    for recording in args.recordings:
        print_holes(recording, made, args.limit, args.by_default)
    for test in args.tests:
        title, _, where = test.partition("=")
        split, _, root = where.partition(":")
        source = open_split(split, Path(root))
        count = min(args.limit, len(source))
        found: dict[str, list[dict[str, object]]] = defaultdict(list)
        for index in (i * len(source) // count for i in range(count)):
            frame = source.load(index)
            for name, restorer in made.items():
                found[name].append(rows_of(name, restorer, frame))
        table = pd.DataFrame([row for rows in found.values() for row in rows])
        print(f"\n{title}: {count} frames of {root}")
        mean = table.groupby("method", sort=False)[["rmse", "d105"]].mean()
        sums = table.groupby("method", sort=False)[
            [c for c in table.columns if c.endswith(("good", "spoiled"))]
        ].sum()
        mean["spoiled %"] = 100 * sums["spoiled"] / sums["good"].clip(lower=1)
        for part, title in (("whole", "std-restore"), ("around", "surroundings")):
            if f"{part}_good" in sums:
                shares = 100 * sums[f"{part}_spoiled"] / sums[f"{part}_good"].clip(lower=1)
                mean[f"spoiled, {title} %"] = shares.where(sums[f"{part}_good"] > 0)
        print(mean.round(2).to_string())
        if count < 10:
            print(table.pivot_table(index="method", columns="frame", values=["rmse", "d105"],
                                    sort=False).round(1).to_string())  # fmt: skip


if __name__ == "__main__":
    main()
