"""Scoring of poses against a loop of the same formulas: `python perf/bench_pose.py`.

10 000 predictions with exact overlap of boxes, in frames of the seven classes of the data sets,
some objects found twice. The loop takes one pair of boxes at a time in plain Python and NumPy: it
cuts the faces of one box by the planes of the other, and matches as the field's evaluations do. It
is timed on some of the frames. Processor time is reliable on a busy machine; the elapsed time of
one process is printed next to it.
"""

from __future__ import annotations

import argparse
import time
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from benchmark.metrics.pose import (
    PosePrediction,
    PoseTruth,
    average_precision,
    get_pose_protocol,
    score_poses,
)
from benchmark.metrics.pose.box_iou import cube_to_box

LIMIT_S = 10.0
CLASSES = 7
ROUND, HANDLE = (1, 2, 4), 6
FACES = [(axis, side) for axis in range(3) for side in (1.0, -1.0)]


def frames(predictions: int, seed: int) -> tuple[list[PoseTruth], list[PosePrediction]]:
    """Frames with five objects and six to eight predictions each."""
    rng = np.random.default_rng(seed)
    truths: list[PoseTruth] = []
    found: list[PosePrediction] = []
    made = 0
    while made < predictions:
        ids = rng.choice(np.arange(1, CLASSES + 1), 5, replace=False)
        RT = np.tile(np.eye(4), (5, 1, 1))
        RT[:, :3, :3] = rng.uniform(0.12, 0.3, (5, 1, 1)) * Rotation.random(5, rng).as_matrix()
        RT[:, :3, 3] = rng.uniform((-0.3, -0.2, 0.5), (0.3, 0.2, 0.9), (5, 3))
        sizes = rng.uniform(0.3, 1, (5, 3))
        sizes /= np.linalg.norm(sizes, axis=1, keepdims=True)
        truths.append(PoseTruth(ids, RT, sizes, rng.random(5) < 0.7))
        rows = np.append(np.arange(5), rng.integers(0, 5, rng.integers(1, 4)))
        rows = rows[: predictions - made]
        off = np.tile(np.eye(4), (len(rows), 1, 1))
        turns = rng.normal(0, np.deg2rad(7), (len(rows), 3))
        off[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
        off[:, :3, 3] = rng.normal(0, 0.05, (len(rows), 3))
        found.append(
            PosePrediction(
                ids[rows],
                RT[rows] @ off,
                sizes[rows] * rng.uniform(0.9, 1.1, (len(rows), 3)),
                rng.random(len(rows)),
            )
        )
        made += len(rows)
    return truths, found


def cut(polygon: list[np.ndarray], axis: int, side: float) -> list[np.ndarray]:
    """The part of a polygon on the inner side of one plane of the cube."""
    kept = []
    for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        dp, dq = 1 - side * p[axis], 1 - side * q[axis]
        if dp >= 0:
            kept.append(p)
        if (dp >= 0) != (dq >= 0):
            kept.append(p + dp / (dp - dq) * (q - p))
    return kept


def fans(polygon: list[np.ndarray]) -> list[tuple[float, float]]:
    """Twice the area seen along x, and the mean x, of the triangles of a polygon."""
    a = polygon[0] if polygon else None
    parts = []
    for b, c in pairwise(polygon[1:]):
        u, v = b - a, c - a
        parts.append((u[1] * v[2] - u[2] * v[1], (a[0] + b[0] + c[0]) / 3))
    return parts


def common(A: np.ndarray, B: np.ndarray) -> float:
    """Common volume of two boxes, as in `benchmark.metrics.pose.box_iou`."""
    inverse = np.linalg.inv(A[:3, :3])
    edges, centre = inverse @ B[:3, :3], inverse @ (B[:3, 3] - A[:3, 3])
    flux = 0.0
    for i, side in FACES:
        e, u, v = edges[:, i], edges[:, (i + 1) % 3], edges[:, (i + 2) % 3]
        polygon = [
            centre + side * (e + k * v) + j * u for j, k in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        for axis, sign in FACES[2:]:
            polygon = cut(polygon, axis, sign)
        below = cut(polygon, 0, 1.0)
        middle = cut(below, 0, -1.0)
        whole, under = (sum(area for area, _ in fans(p)) for p in (polygon, below))
        flux += (whole - 2 * under + sum(area * (1 + x) for area, x in fans(middle))) / 2
    return abs(flux) * abs(np.linalg.det(A[:3, :3]))


def overlap(a: np.ndarray, size_a: np.ndarray, b: np.ndarray, size_b: np.ndarray) -> float:
    A, B = cube_to_box(a, size_a), cube_to_box(b, size_b)
    volume = common(A, B)
    return volume / (8 * np.linalg.det(A[:3, :3]) + 8 * np.linalg.det(B[:3, :3]) - volume)


def compare(
    a: np.ndarray, size_a: np.ndarray, b: np.ndarray, size_b: np.ndarray, turning: bool
) -> tuple[float, float, float]:
    """Overlap, degrees and centimetres of one pair."""
    iou = 0.0
    for k in range(20 if turning else 1):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec((0, 2 * np.pi * k / 20, 0)).as_matrix()
        iou = max(iou, overlap(a @ turn, size_a, b, size_b))
    Ra, Rb = (RT[:3, :3] / np.cbrt(np.linalg.det(RT[:3, :3])) for RT in (a, b))
    cosine = Ra[:, 1] @ Rb[:, 1] if turning else (np.trace(Ra @ Rb.T) - 1) / 2
    degrees = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
    return iou, float(degrees), float(100 * np.linalg.norm(a[:3, 3] - b[:3, 3]))


def loop(truths: list[PoseTruth], found: list[PosePrediction]) -> np.ndarray:
    """(7, 8) average precisions by class, as `score_poses` gives them."""
    protocol = get_pose_protocol("strict")
    figures = np.zeros((CLASSES, len(protocol.columns)))
    for c in range(1, CLASSES + 1):
        hits: list[list[bool]] = []
        scores: list[float] = []
        objects = 0
        for true, pred in zip(truths, found, strict=True):
            t = np.flatnonzero(true.class_ids == c)
            p = np.flatnonzero(pred.class_ids == c)
            p = p[np.argsort(-pred.scores[p])]
            objects += len(t)
            turning = [c in ROUND or (c == HANDLE and not true.visible[j]) for j in t]
            pairs = {
                (i, j): compare(pred.RT[i], pred.sizes[i], true.RT[j], true.sizes[j], turn)
                for i in p
                for j, turn in zip(t, turning, strict=True)
            }
            taken: list[set[int]] = [set() for _ in protocol.columns]
            for i in p:
                row = []
                for column in range(len(protocol.columns)):
                    fits = {}
                    for j in set(t.tolist()) - taken[column]:
                        iou, degrees, cm = pairs[i, j]
                        if column < len(protocol.iou_thresholds):
                            if iou > protocol.iou_thresholds[column]:
                                fits[j] = -iou
                        else:
                            gate = protocol.gates[column - len(protocol.iou_thresholds)]
                            if degrees <= gate.degrees and cm <= gate.centimetres:
                                fits[j] = degrees + cm
                    if fits:
                        taken[column].add(min(fits, key=fits.__getitem__))
                    row.append(bool(fits))
                hits.append(row)
                scores.append(float(pred.scores[i]))
        for column in range(figures.shape[1]):
            marks = [row[column] for row in hits]
            figures[c - 1, column] = average_precision(scores, marks, objects)
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--predictions", type=int, default=10_000)
    parser.add_argument("--loop", type=int, default=300, help="predictions that the loop scores")
    arguments = parser.parse_args()
    truths, found = frames(arguments.predictions, 0)
    few = frames(arguments.loop, 1)
    score_poses(*few)
    print(f"{len(truths)} frames, {arguments.predictions} predictions; processor / elapsed seconds")
    for name in ("strict", "paper", "nocs2019"):
        cpu, wall = time.process_time(), time.perf_counter()
        score_poses(truths, found, get_pose_protocol(name))
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        limit = f"  limit {LIMIT_S:g}" if name == "strict" else ""
        print(f"{name:<10} {cpu:8.2f} {wall:8.2f}{limit}")
        if name == "strict":
            each = cpu / arguments.predictions
    cpu = time.process_time()
    figures = loop(*few)
    cpu = time.process_time() - cpu
    off = np.abs(figures - score_poses(*few).values).max()
    slow, fast = 1000 * cpu / arguments.loop, 1000 * each
    print(f"loop {slow:13.2f} ms a prediction, {fast:.2f} ms here: {slow / fast:.0f} times as long")
    print(f"           the figures of both differ by {off:.0e}")


if __name__ == "__main__":
    main()
