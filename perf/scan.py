"""Scans against the truth: `python perf/scan.py [dino] [mustard] [TURNTABLE ...] [--work DIR]`.

dino        the ring of 16 photos with known cameras: outline overlap, extent
mustard     the real mustard bottle among other things, against its YCB mesh
TURNTABLE   folder of `std-sim turntable`: photos/, board.json and truth mesh, poses not given;
            FIRST+SECOND joins the photos of SECOND (`--flipped`), with the truth mesh of FIRST
--wall-mm   thickness of the wall of open vessels, as of `std-scan`
--sensor    scans each turntable as an RGB-D scene, too: true depth of object and table with the
            errors of an active stereo camera of 55 mm baseline, correlated noise of 0.06 px of
            disparity and a scale wrong by 1 %

Prints one row per scan: accuracy is mesh to truth, completeness truth to mesh, both on what a
camera saw, after rigid alignment; scale is that of a similarity fitted afterwards. "whole" figures
are of the whole surface, the side that no camera saw included. Normals are those of the faces,
unsmoothed, against the nearest face of the truth; "wider" is by how much the longest difference of
the sides of the upright boxes is too long, "box" the same of the smallest boxes in any orientation;
"flat" is the RMS of the flat faces of the truth, the worst of them; "crossing" counts faces that
cross others. Below it are processor seconds of the stages.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

REPOSITORY = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("STD_TEST_DATA", REPOSITORY.parent / "shared" / "data"))
DINO_BOX = np.array([[-0.061897, -0.018874, -0.057845], [0.010897, 0.068227, 0.015495]])
_SAMPLES = 60_000


def align(
    scan: np.ndarray, truth: Any, start: np.ndarray | None = None, turns: int = 24
) -> tuple[np.ndarray, float]:
    """(4, 4) rigid motion of points (N, 3) onto a mesh, and the scale that is left.

    It begins with `start` (4, 4), or is the best of many turns.
    """
    from std_toolkit.geometry import umeyama
    from std_toolkit.geometry.ray_caster import RayCaster

    middle = np.asarray(truth.bounds).mean(axis=0)
    caster = RayCaster(truth.vertices - middle, truth.faces)
    cloud = scan[:: max(1, len(scan) // 4000)]
    centre = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
    best, lowest = np.eye(4), np.inf
    flips = (np.eye(3), np.diag([1.0, -1.0, -1.0]))
    if start is not None:
        best, turns = start.copy(), 0
        best[:3, 3] -= middle
    for n in range(turns):
        a = 2 * np.pi * (n // 2) / (turns // 2)
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        T = np.eye(4)
        T[:3, :3] = turn @ flips[n % 2]
        T[:3, 3] = -T[:3, :3] @ centre
        for _ in range(40):
            p = cloud @ T[:3, :3].T + T[:3, 3]
            q, _ = caster.closest(p)
            off = np.linalg.norm(p - q, axis=1)
            near = off <= np.percentile(off, 85)
            step = umeyama(p[near], q[near].astype(np.float64), with_scale=False)
            T = step.matrix() @ T
        error = float(np.median(off))
        if error < lowest:
            best, lowest = T, error
    T = best
    for _ in range(60):
        p = scan @ T[:3, :3].T + T[:3, 3]
        q, _ = caster.closest(p)
        off = np.linalg.norm(p - q, axis=1)
        near = off <= np.percentile(off, 90)
        T = umeyama(p[near], q[near].astype(np.float64), with_scale=False).matrix() @ T
    scaled = T.copy()
    for _ in range(60):
        p = scan @ scaled[:3, :3].T + scaled[:3, 3]
        q, _ = caster.closest(p)
        off = np.linalg.norm(p - q, axis=1)
        near = off <= np.percentile(off, 90)
        scaled = umeyama(p[near], q[near].astype(np.float64)).matrix() @ scaled
    T[:3, 3] += middle
    return T, float(np.cbrt(np.linalg.det(scaled[:3, :3])))


def seen_points(
    vertices: Any, faces: Any, views: Any, to_world: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points of a surface that a camera saw, and the normals of their faces, its own frame."""
    import trimesh

    from std_toolkit.geometry.ray_caster import RayCaster

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    points, face = trimesh.sample.sample_surface(mesh, _SAMPLES, seed=0)
    normal = own = mesh.face_normals[face]
    world = points @ to_world[:3, :3].T + to_world[:3, 3]
    normal = normal @ to_world[:3, :3].T
    caster = RayCaster(
        np.asarray(vertices) @ to_world[:3, :3].T + to_world[:3, 3], np.asarray(faces)
    )
    seen = np.zeros(len(points), bool)
    for view in views:
        ray = world - view.centre
        away = np.linalg.norm(ray, axis=1)
        ray /= away[:, None]
        uv, z = view.project(world)
        with np.errstate(invalid="ignore"):
            inside = ((uv > 0) & (uv < np.array(view.camera.size) - 1)).all(axis=1) & (z > 0)
        index = np.flatnonzero(~seen & inside & (-(ray * normal).sum(axis=1) > 0.15))
        x, y = np.rint(uv[index].T).astype(int)
        if view.hidden is not None:
            index = index[~view.hidden[y, x]]
        rays = np.concatenate([np.broadcast_to(view.centre, (len(index), 3)), ray[index]], axis=1)
        seen[index[caster.cast(rays).distance > away[index] - 0.001]] = True
    return np.asarray(points[seen]), np.asarray(own[seen])


def compare(
    scan: Any, truth: Any, start: np.ndarray | None = None
) -> tuple[dict[str, float], np.ndarray]:
    """Accuracy and completeness in millimetres, completeness at 2 mm and scale; and the motion.

    The alignment begins with `start`, as of `align`; its result (4, 4) takes the scan to the truth.
    """
    import trimesh
    from scan_shape import flatness, larger_box

    from std_toolkit.geometry.crossing_faces import crossing_faces
    from std_toolkit.geometry.ray_caster import RayCaster

    points, normals = seen_points(scan.vertices, scan.faces, scan.views, np.eye(4))
    T, scale = align(points, truth, start)
    moved = points @ T[:3, :3].T + T[:3, 3]
    nearest, facing = RayCaster(truth.vertices, truth.faces).closest(moved)
    accuracy = np.linalg.norm(nearest - moved, axis=1)
    # Faces of published meshes may be turned.
    cosine = np.abs(((normals @ T[:3, :3].T) * facing).sum(axis=1))
    angle = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
    sides = np.sort(np.ptp(scan.vertices @ T[:3, :3].T, axis=0))
    wider = 1000 * (sides - np.sort(np.ptp(truth.vertices, axis=0)))
    back = np.linalg.inv(T)
    there, _ = seen_points(truth.vertices, truth.faces, scan.views, back)
    local = there @ back[:3, :3].T + back[:3, 3]
    caster = RayCaster(scan.vertices, scan.faces)
    complete = caster.distance(local)
    every = trimesh.sample.sample_surface(_bare(scan.vertices, scan.faces), _SAMPLES, seed=0)[0]
    everywhere = RayCaster(truth.vertices, truth.faces).distance(
        np.asarray(every) @ T[:3, :3].T + T[:3, 3]
    )
    all_of_it = trimesh.sample.sample_surface(_bare(truth.vertices, truth.faces), _SAMPLES, seed=0)[
        0
    ]
    whole = caster.distance(np.asarray(all_of_it) @ back[:3, :3].T + back[:3, 3])
    row = {
        "median mm": 1000 * float(np.median(accuracy)),
        "95 % mm": 1000 * float(np.percentile(accuracy, 95)),
        "complete 2 mm %": 100 * float((complete < 0.002).mean()),
        "whole median mm": 1000 * float(np.median(everywhere)),
        "whole 95 % mm": 1000 * float(np.percentile(everywhere, 95)),
        "whole complete 2 mm %": 100 * float((whole < 0.002).mean()),
        "scale %": 100 * (1 / scale - 1),
        "normals deg": float(np.median(angle)),
        "normals 90 % deg": float(np.percentile(angle, 90)),
        "wider mm": float(wider[np.abs(wider).argmax()]),
        "box mm": larger_box(_bare(scan.vertices, scan.faces), truth),
        "flat mm": flatness(moved, truth),
        "crossing": float(crossing_faces(scan.vertices, scan.faces).sum()),
    }
    return row, T


def _bare(vertices: Any, faces: Any) -> Any:
    import trimesh

    return trimesh.Trimesh(vertices, faces, process=False)


def by_cameras(scan: Any, folder: Path) -> np.ndarray:
    """(4, 4) T_obj_scan from the true cameras of a turntable: a cup would fit on its rim, too."""
    from sensors.simulation.turntable import read_turntable_truth
    from std_toolkit.geometry import SE3

    truth = read_turntable_truth(folder)
    place = {Path(name).stem: n for n, name in enumerate(truth.photos)}
    view = next(v for v in scan.views if Path(v.name).stem in place)
    nth = place[Path(view.name).stem]
    T_obj_cam = SE3.from_matrix(truth.T_world_obj).inverse() @ truth.pose(nth)
    return (T_obj_cam @ view.T_world_cam.inverse()).matrix()


def measured(name: str, options: Any, truth: Any, folder: Path | None = None) -> Any:
    from std_toolkit.scanning.clock import Clock
    from std_toolkit.scanning.scan_step import scan

    began, cpu = time.perf_counter(), processor_s()
    told, stages = Clock.lap, {}

    def lap(self: Clock, stage: str) -> None:
        stages[stage] = processor_s() - cpu - sum(stages.values())
        told(self, stage)

    Clock.lap = lap  # type: ignore[method-assign]
    try:
        done = scan(options)
    finally:
        Clock.lap = told  # type: ignore[method-assign]
    wall = time.perf_counter() - began
    cpu = processor_s() - cpu
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    start = by_cameras(done, folder) if folder else None
    row = {} if truth is None else compare(done, truth, start)[0]
    row |= {"wall s": wall, "CPU s": cpu, "GiB": memory}
    shown = "  ".join(f"{k} {v:.2f}" for k, v in row.items())
    print(f"{name:24} {shown}", flush=True)
    print(f"{'':24} " + "  ".join(f"{k} {v:.0f} s" for k, v in stages.items()), flush=True)
    return done


def processor_s() -> float:
    """Processor seconds of this process and its children."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in used)


def dino(work: Path) -> None:
    from std_toolkit.geometry.ray_caster import RayCaster
    from std_toolkit.options import KnownCameras
    from std_toolkit.scanning.model.report import outline_overlap
    from std_toolkit.scanning.options import ScanOptions

    folder = DATA / "dino_ring"
    options = ScanOptions(
        photos=folder, out=work / "dino", known=KnownCameras(cameras=folder / "dinoSR_par.txt")
    )
    done = measured("dino_ring", options, None)
    off = 1000 * np.abs(np.stack([done.vertices.min(axis=0), done.vertices.max(axis=0)]) - DINO_BOX)
    caster = RayCaster(done.vertices, done.faces)
    own = [outline_overlap(v, caster) for v in done.views]
    # A mask of its own kind: brighter than the black cloth, without holes. It lacks shadows.
    bright = []
    for view in done.views:
        mask = cv2.GaussianBlur(view.image.max(axis=2), (0, 0), 1) > 40
        kernel = np.ones((5, 5), np.uint8)
        mask = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel)
        outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        filled = np.zeros_like(mask)
        cv2.drawContours(filled, [max(outlines, key=cv2.contourArea)], -1, 1, -1)
        bright.append(outline_overlap(view.with_mask(filled > 0), caster))
    print(f"{'':24} extent off by at most {off.max():.2f} mm of the published box")
    print(f"{'':24} overlap with the scan's masks: lowest {min(own):.3f}, mean {np.mean(own):.3f}")
    print(f"{'':24} with a threshold's: lowest {min(bright):.3f}, mean {np.mean(bright):.3f}")


def mustard(work: Path) -> None:
    from std_toolkit.geometry.mesh import load_mesh
    from std_toolkit.scanning.options import ScanOptions

    folder = DATA / "tabletop_board_rgb"
    options = ScanOptions(
        photos=folder / "color", out=work / "mustard", board=folder / "board_mm.json",
        intrinsics=str(folder / "cam_intrinsics.json"), pick="000040.jpg:300,400",
    )  # fmt: skip
    meshes = sorted((DATA / "ycb_meshes").rglob("006*/*.obj"))
    measured("mustard bottle, real", options, load_mesh(meshes[0]))


def turntable(what: str, work: Path, *, wall_mm: float | None, sensor: bool) -> None:
    from std_toolkit.geometry.mesh import load_mesh
    from std_toolkit.scanning.options import ScanOptions

    first, _, second = what.partition("+")
    folder = Path(first)
    truth = next(p for s in ("obj", "ply", "glb") for p in sorted(folder.glob(f"truth/*.{s}")))
    name = folder.name + (f"+{Path(second).name}" if second else "")
    options = ScanOptions(
        photos=folder / "photos",
        flipped=Path(second) / "photos" if second else None,
        out=work / name,
        board=folder / "board.json",
        wall_mm=wall_mm,
    )
    done = measured(name, options, load_mesh(truth), folder)
    if sensor:
        scene = write_rgbd(folder, work / f"{name}-scene")
        with_depth = replace(options, photos=scene, flipped=None, out=work / f"{name}-rgbd")
        found = measured(f"{name}, with sensor", with_depth, load_mesh(truth), folder)
        print(f"{'':24} {found.facts.get('sensor depth')}; on the object "
              f"{found.facts.get('sensor depth on the object')}")  # fmt: skip
    for key, value in done.facts.items():
        if key.startswith("turned over"):
            print(f"{'':24} {key}: {value}")


def write_rgbd(folder: Path, root: Path) -> Path:
    """The photos of a turntable as an RGB-D scene; see `--sensor`."""
    from sensors.simulation.turntable import read_turntable_truth
    from std_toolkit.geometry import SE3
    from std_toolkit.geometry.mesh import load_mesh
    from std_toolkit.geometry.ray_caster import RayCaster
    from std_toolkit.io.images import read_color, write_color, write_depth_png16
    from std_toolkit.scene import Frame, Frames, ObjectTable, Scene, SceneInfo

    truth = read_turntable_truth(folder)
    mesh = load_mesh(folder / "truth" / "mesh.ply")
    caster = RayCaster(SE3.from_matrix(truth.T_world_obj) @ mesh.vertices, mesh.faces)
    rng = np.random.default_rng(0)
    camera, frames = truth.camera.camera(), []
    for n, photo in enumerate(truth.photos):
        T = truth.pose(n)
        world = camera.rays() @ T.R.T
        with np.errstate(divide="ignore"):
            table = np.where(world[..., 2] < 0, -T.t[2] / world[..., 2], np.inf)
        hits = caster.cast(np.concatenate([np.broadcast_to(T.t, world.shape), world], axis=-1))
        depth = np.minimum(hits.distance, table)
        error = cv2.GaussianBlur(rng.normal(size=depth.shape), (0, 0), 1.5)
        disparity = camera.fx * 0.055 / depth + 0.06 * error / error.std()
        measured_depth = np.where(depth < 3, camera.fx * 0.055 / disparity / 1.01, 0)
        name = Path(photo).stem
        write_color(root / "color" / f"{name}.png", read_color(folder / "photos" / photo))
        write_depth_png16(root / "depth" / f"{name}.png", measured_depth, scale=0.0001)
        frames.append(Frame(id=n, name=name, color=f"color/{name}.png", depth=f"depth/{name}.png"))
    info = SceneInfo(name=folder.name, cameras={"color": truth.camera}, depth_scale=0.0001)
    Scene.create(root, info, Frames(frames=frames), ObjectTable(models=[], objects=[]))
    return root


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("what", nargs="*", default=["dino", "mustard"])
    parser.add_argument("--work", type=Path)
    parser.add_argument("--wall-mm", type=float)
    parser.add_argument("--sensor", action="store_true")
    given = parser.parse_args()
    work = given.work or Path(tempfile.mkdtemp(prefix="scan-"))
    for what in given.what:
        if what in ("dino", "mustard"):
            {"dino": dino, "mustard": mustard}[what](work)
        else:
            turntable(what, work, wall_mm=given.wall_mm, sensor=given.sensor)


if __name__ == "__main__":
    main()
