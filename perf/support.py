"""Guides of the annotator against their time limits: `python perf/support.py`.

Point clouds and the table plane of a 1280x720 recording, and penetration among six meshes of
50 000 faces. Times are the least of several runs, because the machine may be busy. Penetration is
compared with the signed distance of all vertices, the baseline without culling.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import partial
from itertools import permutations
from pathlib import Path

import numpy as np
import trimesh

from sensors.synthetic.recording import UPRIGHT, RecordingOptions, make_recording
from sensors.synthetic.shapes import default_shapes
from sensors.synthetic.truth import scene_from_truth
from std_toolkit.geometry import SE3
from std_toolkit.labels.support import (
    PlacedObject,
    Plane,
    find_penetrations,
    find_table,
    frame_cloud,
    fuse_clouds,
    prepare_objects,
)
from std_toolkit.labels.support.penetration import TABLE
from std_toolkit.scene import Scene

RECORDED, FUSED = 10, 30
FACES = 50_000


def least_ms(work: Callable[[], object], repeats: int) -> float:
    work()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(1000 * (time.perf_counter() - began))
    return min(times)


def row(title: str, measured_ms: float, limit_ms: float | None, note: str = "") -> None:
    limit = "" if limit_ms is None else f"limit {limit_ms:6.0f} ms"
    print(f"{title:44s} {measured_ms:8.1f} ms   {limit:16s} {note}")


def recorded(folder: Path) -> Scene:
    options = RecordingOptions(frames=RECORDED, width=1280, height=720, samples=1)
    make_recording(folder / "recording", options)
    return scene_from_truth(folder / "recording", folder / "scene")


def clouds(scene: Scene) -> None:
    frame = scene.frames[0]
    row("frame cloud, 1280x720", least_ms(lambda: frame_cloud(scene, frame), 8), 100)
    frames = (scene.frames * (FUSED // RECORDED + 1))[:FUSED]
    size = len(fuse_clouds(scene, frames).points)
    note = f"{size} points"
    row(
        f"fused cloud of {FUSED} frames",
        least_ms(lambda: fuse_clouds(scene, frames), 2),
        5000,
        note,
    )
    row("table plane from 10 frames", least_ms(lambda: find_table(scene), 3), None)


def fine(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """About `FACES` faces."""
    while len(mesh.faces) < FACES / 2:
        mesh = mesh.subdivide()
    return mesh


def crowded(gap_m: float, meshes: list[trimesh.Trimesh]) -> list[PlacedObject]:
    return [
        PlacedObject(str(i), mesh, SE3(UPRIGHT, np.array([gap_m * (i % 3), gap_m * (i // 3), z])))
        for i, mesh in enumerate(meshes)
        for z in [mesh.extents[1] / 2 - 0.001]
    ]


def naive(things: list[PlacedObject]) -> None:
    for a, b in permutations(things, 2):
        points = (
            b.T_frame_obj.inverse() @ a.T_frame_obj @ (a.solid.mesh.vertices + a.solid.centre)
            - b.solid.centre
        )
        b.solid.caster.distance(points)
        b.solid.caster.inside(points)


def penetration() -> None:
    meshes = [fine(shape.mesh) for shape in default_shapes()]
    ground = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    began = time.perf_counter()
    prepare_objects(crowded(0.1, meshes))
    row("six meshes made ready, once", 1000 * (time.perf_counter() - began), None)
    for gap in (0.13, 0.095, 0.07):
        things = crowded(gap, meshes)
        found = find_penetrations(things, plane=ground)
        pairs = [p for p in found if p.second != TABLE]
        note = f"{len(pairs)} pairs meet, {len(found) - len(pairs)} things in the table"
        work = least_ms(partial(find_penetrations, things, plane=ground), 20)
        row(f"penetration, {1000 * gap:.0f} mm apart", work, 50, note)
    plain = least_ms(lambda: naive(things), 1)
    row(
        "  signed distance of all vertices, 70 mm", plain, None, f"{plain / work:.0f} times as long"
    )


def main() -> None:
    penetration()
    with tempfile.TemporaryDirectory() as folder:
        clouds(recorded(Path(folder)))


if __name__ == "__main__":
    main()
