"""Accuracy of the labels of a simulated annotator: `python perf/annotate_accuracy.py`.

    python perf/annotate_accuracy.py [--seeds 1 2 3 4] [--views 3 4 6 10] [--starts 2]

Each object of synthetic recordings is placed in the first frame, by clicks with a pixel of noise or
by hand 30 mm and 15 degrees off, refined once in so many images, and compared with the truth:
surface distance (MSSD) and rotation, symmetry aware. Camera poses are the true ones.

CPU seconds, of all threads, are reliable on a busy machine.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "annotator"))

from simulated_annotator import Attempt, SimulatedAnnotator, Start, scene_to_annotate

from sensors.synthetic import RecordingOptions, make_recording
from std_toolkit.jobs import JobOptions

FRAMES = 13
MATERIALS = ("diffuse", "transparent", "specular")
LIMITS = {True: (1.5, 0.7), False: (2.5, 1.0)}


def spread(count: int) -> tuple[int, ...]:
    """`count` of the frames, including the first and the last."""
    return tuple(int(i) for i in np.linspace(0, FRAMES - 1, count).round())


def runs(
    annotator: SimulatedAnnotator, views: Sequence[int], starts: int, seed: int
) -> Iterator[tuple[int, Attempt]]:
    for count in views:
        for k in range(starts):
            start: Start = "hand" if k % 2 else "clicks"
            for attempt in annotator.label(start=start, frames=spread(count), seed=100 * seed + k):
                yield count, attempt


def texture_rows(title: str, tried: list[tuple[int, Attempt]], *, depth: bool) -> None:
    print(f"\n{title}")
    head = f"{'views':>5} {'material':<12}{'n':>4}{'median':>8}{'p90':>7}{'worst':>8} mm"
    print(f"{head}{'median':>8}{'p90':>7}{'worst':>8} deg{'lost':>6}{'s':>7}{'CPU s':>7}")
    for count in sorted({v for v, _ in tried}):
        for material in MATERIALS:
            mine = [a for v, a in tried if v == count and a.material == material]
            if not mine:
                continue
            mm, deg = (np.array([getattr(a, f) for a in mine]) for f in ("mm", "deg"))
            limit_mm, limit_deg = LIMITS[depth and material == "diffuse"]
            misses = np.median(mm) > limit_mm or np.median(deg) > limit_deg
            print(
                f"{count:>5} {material:<12}{len(mine):>4}"
                f"{np.median(mm):>8.2f}{np.percentile(mm, 90):>7.2f}{mm.max():>8.2f}   "
                f"{np.median(deg):>8.2f}{np.percentile(deg, 90):>7.2f}{deg.max():>8.2f}    "
                f"{np.mean((mm > 5) | (deg > 3)):>6.0%}"
                f"{np.median([a.seconds for a in mine]):>7.1f}"
                f"{np.median([a.cpu_seconds for a in mine]):>7.1f}"
                + ("  misses its limit" if misses and count >= 3 else "")
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4])
    parser.add_argument("--views", type=int, nargs="+", default=[3, 4, 6, 10])
    parser.add_argument("--starts", type=int, default=2, help="per object; clicks and by hand")
    args = parser.parse_args()
    without: list[tuple[int, Attempt]] = []
    single: list[tuple[int, Attempt]] = []
    sensed: list[tuple[int, Attempt]] = []
    with tempfile.TemporaryDirectory() as temporary:
        for seed in args.seeds:
            folder = Path(temporary) / str(seed)
            recording = folder / "recording"
            options = RecordingOptions(frames=FRAMES, seed=seed)
            make_recording(recording, options, jobs=JobOptions(progress=False))
            blind = scene_to_annotate(recording, folder / "blind", depth=False)
            seeing = scene_to_annotate(recording, folder / "seeing", depth=True)
            without += runs(
                SimulatedAnnotator(recording, blind.root), args.views, args.starts, seed
            )
            annotator = SimulatedAnnotator(recording, seeing.root)
            sensed += runs(annotator, args.views[:2], args.starts, seed)
            single += runs(annotator, [1], args.starts, seed)
            print(f"recording {seed} done", file=sys.stderr, flush=True)
    texture_rows("without depth", without, depth=False)
    texture_rows("with sensor depth that reads 1.5 % long", sensed, depth=True)
    opaque = [(v, a) for v, a in single if a.material == "diffuse"]
    texture_rows("one frame with that depth: nothing tells how long it reads", opaque, depth=True)


if __name__ == "__main__":
    main()
