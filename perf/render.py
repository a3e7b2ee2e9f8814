"""Speed of ground truth rendering by step, compared with a plain pyrender loop.

    python perf/render.py [--frames 40] [--workers 2]

Frames are 1280x720 with six objects of 50,000 faces in view. The parts are measured in one
process (median over frames); the rate is of the whole command in steady state, all maps written
to disk. The plain loop is what a script on pyrender does: one pass for depth and colour-coded NOCS,
one for the mask, one per object for its silhouette, 8-bit PNGs; it gives no normals.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import trimesh

from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.images import write_color
from std_toolkit.jobs import JobOptions
from std_toolkit.options import RenderOptions
from std_toolkit.rendering import ground_truth
from std_toolkit.rendering.choose import find_gl, get_renderer
from std_toolkit.rendering.maps import compose, mask_of, surface_maps
from std_toolkit.rendering.placements import frame_placements, place_meshes
from std_toolkit.rendering.render_step import render_ground_truth
from std_toolkit.scene.model import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Label,
    Labels,
    Model,
    Object,
    ObjectTable,
    SceneInfo,
)
from std_toolkit.scene.scene import Scene

CAMERA = Camera(1280, 720, 918.0, 918.0, 640.0, 360.0)


def bumpy_solid(seed: int) -> trimesh.Trimesh:
    """A closed, bumpy solid of 50,160 faces, 0.11 x 0.11 x 0.17 m."""
    mesh = trimesh.creation.uv_sphere(radius=1.0, count=[112, 113])
    points = np.asarray(mesh.vertices)
    points = points * (1 + 0.08 * np.sin(5 * points[:, [1, 2, 0]] + seed)) * [0.05, 0.05, 0.08]
    return trimesh.Trimesh(points, mesh.faces, process=False)


def make_scene(root: Path, frames: int) -> Scene:
    """Six solids in two rows, and a camera that moves to and fro in front of them."""
    models, objects, labels = [], [], []
    for k in range(6):
        mesh = bumpy_solid(k)
        path = root / "models" / f"m{k}" / "mesh.ply"
        path.parent.mkdir(parents=True)
        mesh.export(path)
        models.append(
            Model(
                id=f"m{k}",
                mesh=f"models/m{k}/mesh.ply",
                size_m=mesh.extents.tolist(),
                diameter_m=float(mesh.scale),
            )
        )
        objects.append(Object(id=k + 1, name=f"o{k}", model=f"m{k}", material="diffuse"))
        turn = SE3.exp(np.array([0, 0, 0, 1.2 + 0.1 * k, 0.3 * k, 0.2]))
        place = np.array(
            [
                -0.2 + 0.18 * (k % 3) + 0.03 * (k // 3),
                -0.08 + 0.13 * (k // 3),
                0.62 + 0.05 * (k % 2),
            ]
        )
        pose = SE3(turn.R, place).matrix().ravel().tolist()
        labels.append(Label(object=k + 1, frame=0, T_cam_obj=pose, T_world_obj=pose))
    rows, poses = [], []
    write_color(root / "color.png", np.zeros((720, 1280, 3), np.uint8))
    for i in range(frames):
        rows.append(Frame(id=i, name=f"{i:06d}", color="color.png"))
        sway = SE3.exp(np.array([0.03 * np.sin(i), 0.02 * np.cos(i), 0, 0, 0, 0.05 * np.sin(i)]))
        poses.append(
            FramePose(frame=i, status="registered", T_world_cam=sway.matrix().ravel().tolist())
        )
    scene = Scene.create(
        root,
        SceneInfo(name="perf", cameras={"color": CameraModel.of(CAMERA)}),
        Frames(frames=rows),
        ObjectTable(models=models, objects=objects),
    )
    scene.save_poses(CameraPoses(frames=poses))
    scene.save_labels(Labels(labels=labels))
    return scene


class Stopwatch:
    """Milliseconds by name, the median over repetitions."""

    def __init__(self) -> None:
        self.times: dict[str, list[float]] = {}

    @contextmanager
    def measure(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.times.setdefault(name, []).append(1000 * (time.perf_counter() - start))

    def median(self, name: str) -> float:
        return float(np.median(self.times[name]))


def measure_parts(scene: Scene, renderer_name: str, repeats: int, out: Path) -> dict[str, float]:
    """Milliseconds per frame of drawing, maps and encoding, in one process."""
    renderer, watch = get_renderer(renderer_name), Stopwatch()
    for i in range(repeats + 2):
        placed = place_meshes(scene, frame_placements(scene, i))
        start = Stopwatch() if i < 2 else watch  # the first frames build caches
        with start.measure("draw"):
            drawn = compose(renderer, CAMERA, placed, canvas=3)
        with start.measure("maps"):
            mask = mask_of(drawn.index, [p.object_id for p in placed])
            nocs, normals = surface_maps(CAMERA, placed, drawn)
        parts: dict[str, Callable[[], None]] = {
            "depth": lambda drawn=drawn: ground_truth.write_depth(out / "d.exr", drawn.depth),
            "mask": lambda mask=mask: ground_truth.write_mask(out / "m.png", mask),
            "nocs": lambda n=nocs, m=mask: ground_truth.write_nocs(out / "n.png", n, m),
            "normals": lambda n=normals, m=mask: ground_truth.write_normals(out / "v.png", n, m),
        }
        for name, write in parts.items():
            with start.measure(name):
                write()
    return {name: watch.median(name) for name in ("draw", "maps", *parts)}


def plain_pyrender_ms(scene: Scene, repeats: int, out: Path) -> float:
    """Milliseconds per frame of a plain loop on pyrender, in one process."""
    import pyrender

    placed = place_meshes(scene, frame_placements(scene, 0))
    renderer = pyrender.OffscreenRenderer(CAMERA.width, CAMERA.height)
    world = pyrender.Scene(bg_color=(0, 0, 0))
    lens = pyrender.IntrinsicsCamera(CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, 0.05, 5.0)
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    world.add(lens)
    nodes = []
    for item in placed:
        mesh = item.mesh.copy()
        colours = (mesh.vertices - mesh.bounds.mean(axis=0)) / mesh.scale + 0.5
        mesh.visual.vertex_colors = np.rint(255 * colours).astype(np.uint8)
        nodes.append(world.add(pyrender.Mesh.from_trimesh(mesh, smooth=True)))
    times = []
    for i in range(repeats + 1):
        start = time.perf_counter()
        for node, item in zip(nodes, place_meshes(scene, frame_placements(scene, i)), strict=True):
            world.set_pose(node, flip @ item.T_cam_obj.matrix())
        colour, depth = renderer.render(world, pyrender.RenderFlags.FLAT)
        ids = {node: (k + 1,) * 3 for k, node in enumerate(nodes)}
        mask, _ = renderer.render(world, pyrender.RenderFlags.SEG, ids)
        for node in nodes:
            for other in nodes:
                other.mesh.is_visible = other is node
            np.count_nonzero(renderer.render(world, pyrender.RenderFlags.DEPTH_ONLY))
        for node in nodes:
            node.mesh.is_visible = True
        cv2.imwrite(str(out / "plain_nocs.png"), colour[..., ::-1])
        cv2.imwrite(str(out / "plain_mask.png"), mask[..., 0])
        cv2.imwrite(str(out / "plain_depth.png"), np.rint(depth * 10000).astype(np.uint16))
        times.append(1000 * (time.perf_counter() - start))
    renderer.delete()
    return float(np.median(times[1:]))


def command_rate(scene: Scene, renderer: str, frames: int, workers: int) -> float:
    """Frames per second of the step in steady state: a long run minus the shortest one."""
    options = RenderOptions(renderer=renderer, policy="models", force=True)
    jobs = JobOptions(workers=workers, progress=False)
    seconds = []
    for count in (2 * workers, frames):
        start = time.perf_counter()
        render_ground_truth(scene, options, frames=range(count), jobs=jobs).raise_if_failed()
        seconds.append(time.perf_counter() - start)
    return (frames - 2 * workers) / (seconds[1] - seconds[0])


def processor_ms(scene: Scene, renderer: str, frames: int) -> float:
    """Processor milliseconds per frame of the whole step, in this process.

    It hardly depends on other load; cores / this is the rate on idle cores.
    """
    options = RenderOptions(renderer=renderer, policy="models", force=True)
    jobs = JobOptions(engine="serial", progress=False)
    seconds = []
    for count in (2, frames):
        start = time.process_time()
        render_ground_truth(scene, options, frames=range(count), jobs=jobs).raise_if_failed()
        seconds.append(time.process_time() - start)
    return 1000 * (seconds[1] - seconds[0]) / (frames - 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    renderers = ["raycast", "pyrender"] if find_gl()[0] else ["raycast"]
    print(f"load average {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        scene = make_scene(out / "scene", args.frames)
        repeats = min(12, args.frames - 2)
        for name in renderers:
            parts = measure_parts(scene, name, repeats, out)
            total = sum(parts.values())
            split = "  ".join(f"{k} {v:.1f}" for k, v in parts.items())
            print(f"{name:9s} one process, ms/frame: {split}  sum {total:.1f}")
            rate = command_rate(scene, name, args.frames, args.workers)
            print(f"{name:9s} whole step, {args.workers} workers: {rate:.1f} frames/s")
            cpu = processor_ms(scene, name, args.frames)
            print(f"{name:9s} whole step, processor time: {cpu:.1f} ms/frame", flush=True)
        if "pyrender" in renderers:
            plain = plain_pyrender_ms(scene, repeats, out)
            print(f"plain pyrender loop, one process: {plain:.1f} ms, {1000 / plain:.1f} frames/s")


if __name__ == "__main__":
    main()
