"""Labels made with scanned meshes beside those made with the true ones.

    python perf/scanned_labels.py DEMO NAME=MODEL [NAME=MODEL ...]

DEMO is the folder of `make demo`; NAME an object of its recording, such as car_6, and MODEL the
folder that `std-scan` wrote for it. A scan is laid on the true mesh by a rigid motion, which leaves
its faults of shape and size. Both meshes are refined from the annotator's pose of the first frame,
as `std-curate run` does; the other objects keep their true meshes. Prints the median and the 95th
percentile of the MSSD over all frames, of points of the true mesh.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import trimesh

sys.path.insert(0, str(Path(__file__).resolve().parent))

from scan import align

from sensors.output.recording_writer import Truth, read_truth
from sensors.synthetic.truth import annotate_first_frame
from std_toolkit.geometry import SE3, mssd
from std_toolkit.geometry.mesh import hull_vertices, load_mesh
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.labels.auto_refine import refine_objects
from std_toolkit.scene import Scene

_SAMPLES = 20_000
# The recording's meshes have +y upwards, scans +z.
_UPRIGHT = SE3(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.zeros(3))


def laid_on(scan: trimesh.Trimesh, true: trimesh.Trimesh) -> tuple[trimesh.Trimesh, float]:
    """The scan in the frame of the true mesh, and its median distance from it in millimetres."""
    upright = trimesh.Trimesh(_UPRIGHT @ true.vertices, true.faces, process=False)
    points = np.asarray(trimesh.sample.sample_surface(scan, _SAMPLES, seed=0)[0])
    T, _ = align(points, upright)
    T = _UPRIGHT.inverse() @ SE3.from_matrix(T)
    off = RayCaster(true.vertices, true.faces).distance(T @ points)
    laid = trimesh.Trimesh(T @ scan.vertices, scan.faces, process=False)
    return laid, 1000 * float(np.median(off))


def errors_mm(
    scene: Scene, truth: Truth, recording: Path, name: str, mesh: trimesh.Trimesh
) -> np.ndarray:
    """MSSD in every frame of an object that was refined with a mesh, millimetres."""
    true = {o.name: load_mesh(recording / o.mesh) for o in truth.objects}
    extents = {n: float(np.max(m.extents)) for n, m in true.items()}
    T_world_cam = scene.T_world_cam(0)
    assert T_world_cam is not None
    poses, meshes = {}, {}
    for other, T_cam_obj in annotate_first_frame(truth, extents_m=extents).items():
        item = scene.objects.object_named(other)
        poses[item.id] = T_world_cam @ T_cam_obj
        plain = mesh if other == name else true[other]
        meshes[item.model] = trimesh.Trimesh(plain.vertices, plain.faces, process=False)
    chosen = scene.objects.object_named(name).id
    done = refine_objects(scene, poses, [chosen], always=[0], mesh=meshes.__getitem__)
    pose = done.objects[chosen].pose
    item = next(o for o in truth.objects if o.name == name)
    hull, symmetry = hull_vertices(true[name]), item.symmetry.symmetry()
    index = {frame: i for i, frame in enumerate(truth.frames)}
    found = []
    for frame in scene.frames:
        T = scene.T_world_cam(frame.id)
        if T is None:
            continue
        exact = truth.camera_pose(index[frame.name]).inverse() @ truth.object_pose(name)
        found.append(mssd(T.inverse() @ pose, exact, hull, symmetry, steps=180))
    return 1000 * np.array(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("demo", type=Path)
    parser.add_argument("models", nargs="+", metavar="NAME=MODEL")
    options = parser.parse_args()
    recording = options.demo / "recording"
    scene, truth = Scene.open(options.demo / "scene"), read_truth(recording)
    for given in options.models:
        name, _, model = given.partition("=")
        true = load_mesh(recording / next(o.mesh for o in truth.objects if o.name == name))
        scan = load_mesh(next(iter(sorted(Path(model).glob("*.ply")))))
        laid, off = laid_on(scan, true)
        start = time.process_time()
        with_true, with_scan = (
            errors_mm(scene, truth, recording, name, mesh) for mesh in (true, laid)
        )
        print(
            f"{name:12s} scan to true mesh, median {off:.2f} mm   MSSD median, 95 %: true mesh "
            f"{np.median(with_true):.2f}, {np.percentile(with_true, 95):.2f}   scanned "
            f"{np.median(with_scan):.2f}, {np.percentile(with_scan, 95):.2f}   worse by "
            f"{np.median(with_scan) - np.median(with_true):+.2f} mm   "
            f"{time.process_time() - start:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
