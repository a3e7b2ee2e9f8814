"""Cost of settling a scene: `python perf/settle.py [--scenes 10] [--shapes 2] [--cache D]`.

Per category: creating a shape, its convex parts (CoACD, once per shape), their number, and their
volume relative to the shape. Then scenes of eight objects, one of each category: building the
simulation, falling until all objects are at rest, attempts; the deepest overlap of the visual
meshes with each other and the floor, and the drift over half a second afterwards.

Seconds are processor time including child processes, because the machine may be busy.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from sensors.assets.asset_source import draw_diagonal
from sensors.assets.procedural.shape_library import CATEGORIES, make
from sensors.physics import PhysicalObject, convex_parts, drift, settle
from sensors.physics.rigid_bodies import World
from std_toolkit.errors import ToolkitError
from std_toolkit.labels.support import PlacedObject, find_penetrations


def seconds() -> float:
    """Processor time of this process and its finished children."""
    t = os.times()
    return t.user + t.system + t.children_user + t.children_system


def print_shapes(shapes: int, cache: Path) -> None:
    head = f"{'category':<10}{'faces':>7}{'make s':>8}{'parts':>7}"
    print(f"{head}{'CoACD s':>9}{'kept s':>8}{'room':>7}")
    for category in CATEGORIES:
        rows = []
        for seed in range(shapes):
            times = [seconds()]
            asset = make(category, seed)
            times.append(seconds())
            parts = convex_parts(asset, cache)
            times.append(seconds())
            convex_parts(asset, cache)
            times.append(seconds())
            room = sum(ConvexHull(p).volume for p in parts) / asset.mesh.volume
            rows.append([len(asset.faces), len(parts), room, *np.diff(times)])
        faces, count, room, make_s, coacd_s, kept_s = np.mean(rows, axis=0)
        print(
            f"{category:<10}{faces:>7.0f}{make_s:>8.2f}{count:>7.1f}{coacd_s:>9.2f}"
            f"{kept_s:>8.3f}{room:>7.2f}"
        )


def print_scenes(scenes: int, shapes: int, cache: Path) -> None:
    print(f"\n{'seed':>4}{'build s':>9}{'settle s':>10}{'sim s':>7}{'tries':>7}", end="")
    print(f"{'overlap mm':>12}{'floor mm':>10}{'drift mm':>10}")
    rows = []
    for seed in range(scenes):
        rng = np.random.default_rng(seed)
        objects = []
        for category in CATEGORIES:
            asset = make(category, int(rng.integers(shapes)))
            parts = convex_parts(asset, cache)
            objects.append(PhysicalObject(asset, draw_diagonal(rng, asset), parts))
        began = seconds()
        World(objects)
        built = seconds() - began
        began = seconds()
        try:
            settled = settle(objects, seed)
        except ToolkitError as error:
            print(f"{seed:>4}  {error}")
            continue
        spent = seconds() - began
        things = [
            PlacedObject(f"{k}", o.asset.scaled(o.diagonal_m), T)
            for k, (o, T) in enumerate(zip(objects, settled.poses, strict=True))
        ]
        deep = max([0.0, *(p.depth_m for p in find_penetrations(things, tolerance_m=1e-5))])
        low = min(float((t.T_frame_obj @ t.mesh.vertices)[:, 2].min()) for t in things)
        row = [
            built,
            spent,
            settled.simulated_s,
            settled.attempts,
            1000 * deep,
            -1000 * low,
            1000 * drift(objects, settled.poses),
        ]
        rows.append(row)
        print(_row(f"{seed:>4}", row))
    if rows:
        print(_row("mean", list(np.mean(rows, axis=0))))
        print(_row("most", list(np.max(rows, axis=0))))


def _row(title: str, row: list[float]) -> str:
    built, spent, simulated, attempts, deep, low, moved = row
    return (
        f"{title}{built:>9.2f}{spent:>10.2f}{simulated:>7.1f}{attempts:>7.1f}"
        f"{deep:>12.3f}{low:>10.3f}{moved:>10.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--shapes", type=int, default=2, help="of each category")
    parser.add_argument("--cache", type=Path, help="folder of convex parts; default: none is kept")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        cache = args.cache or Path(temporary)
        print_shapes(args.shapes, cache)
        print_scenes(args.scenes, args.shapes, cache)


if __name__ == "__main__":
    main()
