"""Accuracy, bias and speed of the stereo matchers, compared with the depth of a real D415.

    python perf/stereo.py [--data ../shared/data] [--repeats 5] [--device cuda]

Three tables. The first compares each matcher's depth of a real infrared pair with the camera's own,
after one factor on all depths. The second tells the sub-pixel error on a tilted plane of dots whose
disparity is known by formula: its mean, its spread, and the worst mean of a tenth of a pixel
(pixel locking). The third tells processor time and elapsed time at 640x360, and the ratio to
OpenCV's SGBM; only ratios compare between machines, and processor time is the one to trust on a
busy one.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "sensors" / "stereo"))

from dot_stereo import Rig, bias_by_fraction, plane
from real_pair import Pair, compare, load_pair

from sensors.stereo import StereoMatcher, make_matcher

REPOSITORY = Path(__file__).resolve().parent.parent
MATCHERS: dict[str, tuple[str, dict[str, object]]] = {
    "SGBM (OpenCV)": ("sgbm", {}),
    "local, census (default)": ("local", {}),
    "local, census, quadratic": ("local", {"subpixel": "quadratic"}),
    "local, census, sums of 7x7": ("local", {"aggregation_px": 7}),
    "local, ZNCC": ("local", {"cost": "zncc"}),
    "local, ZNCC, quadratic": ("local", {"cost": "zncc", "subpixel": "quadratic"}),
    "local, ZNCC, equiangular": ("local", {"cost": "zncc", "subpixel": "equiangular"}),
    "DREDS as released": ("dreds", {}),
}


def print_agreement(pair: Pair) -> None:
    print("\nagainst the depth of a real D415 (640x360, 0.37 to 0.47 m)")
    print(f"{'':<28}{'scale':>8}{'median mm':>11}{'<= 10 mm':>10}{'complete':>10}{'shared':>8}")
    for title, (name, options) in MATCHERS.items():
        found = compare(pair, make_matcher(name, **options).match(pair.left, pair.right))
        print(
            f"{title:<28}{found.scale:>8.4f}{found.median_mm:>11.2f}{found.within_10_mm:>10.1%}"
            f"{found.complete:>10.1%}{found.shared:>8.1%}"
        )
    print(f"{'the camera itself':<28}{'':>8}{'':>11}{'':>10}{(pair.depth > 0).mean():>10.1%}")


def print_bias() -> None:
    print("\nsub-pixel error in pixels, tilted plane at 0.5 m")
    rigs = {"dots 2.1 px": Rig(), "dots 1.6 px": Rig(dot_px=0.7), "noise 3": Rig(noise=3)}
    print(f"{'':<28}" + "".join(f"{title:^25}" for title in rigs))
    print(f"{'':<28}" + f"{'mean':>9}{'spread':>8}{'locked':>8}" * len(rigs))
    views = [rig.pair(plane((0.15, 0.1, 1), 0.5)) for rig in rigs.values()]
    for title, (name, options) in MATCHERS.items():
        line = f"{title:<28}"
        for left, right, exact in views:
            found = make_matcher(name, **options).match(left, right)
            inside = np.zeros(exact.shape, dtype=bool)
            inside[12:-12, 130:-12] = True
            inside &= found > 0
            error = (found - exact)[inside]
            locked = abs(bias_by_fraction(error, exact[inside])).max()
            line += f"{error.mean():>9.4f}{error.std():>8.3f}{locked:>8.3f}"
        print(line)


def seconds(run: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Least processor time and elapsed time of some runs, after one that compiles."""
    run()
    cpu, wall = [], []
    for _ in range(repeats):
        before = time.process_time(), time.perf_counter()
        run()
        cpu.append(time.process_time() - before[0])
        wall.append(time.perf_counter() - before[1])
    return min(cpu), min(wall)


def print_speed(pair: Pair, repeats: int, device: str | None) -> None:
    print("\ntime per frame of 640x360, 108 disparities (SGBM 112)")
    print(f"{'':<28}{'CPU ms':>8}{'ms':>8}{'to SGBM':>9}")
    rows = {title: make_matcher(name, **options) for title, (name, options) in MATCHERS.items()}
    if importlib.util.find_spec("torch"):
        import torch

        on = device or ("cuda" if torch.cuda.is_available() else "cpu")
        for title, options in (("census", {}), ("ZNCC", {"cost": "zncc"})):
            rows[f"torch on {on}, {title}"] = make_matcher(
                "local", backend="torch", device=on, **options
            )
    sgbm = None
    for title, matcher in rows.items():
        cpu, wall = seconds(lambda m=matcher: matched(m, pair), repeats)
        # A GPU's work is not the processor's.
        spent = wall if "cuda" in title else cpu
        sgbm = sgbm or spent
        print(f"{title:<28}{cpu * 1e3:>8.0f}{wall * 1e3:>8.0f}{spent / sgbm:>9.1f}")


def matched(matcher: StereoMatcher, pair: Pair) -> np.ndarray:
    return matcher.match(pair.left, pair.right)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=REPOSITORY.parent / "shared" / "data")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--device", help="of torch; the GPU if there is one")
    args = parser.parse_args()
    pair = load_pair(args.data)
    print_agreement(pair)
    print_bias()
    print_speed(pair, args.repeats, args.device)


if __name__ == "__main__":
    main()
