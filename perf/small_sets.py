"""Small sets of wide-baseline views: `std-curate poses` against plain exhaustive pycolmap.

    python perf/small_sets.py [--views 16 24] [--meshes NAME ...] [--images DIR --intrinsics FILE]

Renders rings of views around textured YCB meshes (640x480, grey background) and prints registered
images, wall times and the largest rotation error of ours after alignment of the orientations.
"plain" has the default options of pycolmap and fixed intrinsics.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from perf.poses import DATA, make_scene, plain

MESHES = (
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "010_potted_meat_can",
    "021_bleach_cleanser",
)
SIZE = (640, 480)
FOCAL = 800.0


def render_ring(mesh: Path, count: int, out: Path, *, seed: int = 0) -> list[np.ndarray]:
    """Render views around a mesh; return the (4, 4) poses T_world_cam."""
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    import cv2
    import pyrender
    import trimesh

    rng = np.random.default_rng(seed)
    model = trimesh.load(mesh, process=False, force="mesh")
    low, high = model.bounds
    centre, diameter = (low + high) / 2, float(np.linalg.norm(high - low))
    scene = pyrender.Scene(bg_color=[0.55, 0.55, 0.55, 1], ambient_light=[0.55] * 3)
    scene.add(pyrender.Mesh.from_trimesh(model, smooth=False))
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    light = _look_at(centre + diameter * np.array([1, 1, 2.0]), centre)
    scene.add(pyrender.DirectionalLight(intensity=2.0), pose=light @ flip)
    cx, cy = SIZE[0] / 2, SIZE[1] / 2
    node = scene.add(pyrender.IntrinsicsCamera(FOCAL, FOCAL, cx, cy, znear=0.01, zfar=20))
    renderer = pyrender.OffscreenRenderer(*SIZE)
    out.mkdir(parents=True)
    poses = []
    for i in range(count):
        a, elevation = 2 * np.pi * i / count, np.radians(28)
        ray = [np.cos(a) * np.cos(elevation), np.sin(a) * np.cos(elevation), np.sin(elevation)]
        T = _look_at(centre + 2.4 * diameter * np.array(ray), centre)
        scene.set_pose(node, T @ flip)
        image = renderer.render(scene)[0] + rng.normal(size=(SIZE[1], SIZE[0], 1)) * 1.5
        cv2.imwrite(str(out / f"{i:04d}.png"), np.clip(image, 0, 255).astype(np.uint8)[..., ::-1])
        poses.append(T)
    renderer.delete()
    return poses


def _look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), eye
    return T


def largest_turn_deg(scene: Any, truth: list[np.ndarray]) -> float:
    """Largest rotation error of the registered frames after the best common rotation."""
    from std_toolkit.geometry import rotation_angle

    found = {f.id: scene.T_world_cam(f.id) for f in scene.registered_frames()}
    U, _, Vt = np.linalg.svd(sum(truth[i][:3, :3] @ T.R.T for i, T in found.items()))
    return max(
        float(np.degrees(rotation_angle(truth[i][:3, :3].T @ U @ Vt @ T.R)))
        for i, T in found.items()
    )


def measure(name: str, images: Path, K: np.ndarray, truth: list[np.ndarray], work: Path) -> None:
    """Print one row of the table."""
    from std_toolkit.errors import ToolkitError
    from std_toolkit.poses import PoseOptions
    from std_toolkit.poses.pose_step import estimate_poses

    seconds, registered = plain(images, K, work / "plain", exhaustive=True)
    scene = make_scene(images, K, work / "scene")
    start = time.perf_counter()
    turn, failed = "", ""
    try:
        poses = estimate_poses(scene, PoseOptions(scale="none"))
        count = sum(p.status == "registered" for p in poses.frames)
        turn = f"{largest_turn_deg(scene, truth):.2f}" if truth else ""
        failed = ", ".join(g.name for g in poses.gates if not g.passed)
    except ToolkitError as error:
        count, failed = 0, error.problem
    ours = time.perf_counter() - start
    print(
        f"{name:28} {registered:6} {count:6} {seconds:8.1f} {ours:8.1f} {ours / seconds:7.1f} "
        f"{turn:>9}  {failed}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--views", type=int, nargs="+", default=[16, 24])
    parser.add_argument("--meshes", nargs="*", default=list(MESHES))
    parser.add_argument("--images", type=Path, help="a folder of your own images")
    parser.add_argument("--intrinsics", type=Path, help="JSON with K")
    args = parser.parse_args()
    print(
        f"{'set':28} {'plain':>6} {'ours':>6} {'plain s':>8} {'ours s':>8} {'ratio':>7} "
        f"{'max deg':>9}  failed gates"
    )
    with tempfile.TemporaryDirectory() as folder:
        if args.images is not None:
            K = np.array(json.loads(args.intrinsics.read_text())["K"])
            measure(args.images.name, args.images, K, [], Path(folder))
            return
        # Integer pixel centres: the renderer's principal point is half a pixel larger.
        K = np.array([[FOCAL, 0, SIZE[0] / 2 - 0.5], [0, FOCAL, SIZE[1] / 2 - 0.5], [0, 0, 1]])
        for mesh in args.meshes:
            for count in args.views:
                work = Path(folder) / f"{mesh}-{count}"
                source = DATA / "ycb_meshes" / mesh / "textured.obj"
                truth = render_ring(source, count, work / "images")
                measure(f"{mesh} {count}", work / "images", K, truth, work)


if __name__ == "__main__":
    main()
