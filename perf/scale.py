"""Time and memory of the steps by the number of frames: both must be linear and flat.

    python perf/scale.py [--frames 250 500 1000 2000] [--steps import propagate render check export]

Frames are 1280x720 with 16-bit depth and three objects of 50,000 faces; eight pictures take turns.
Every step is the command in a process of its own, without workers, so that its processor time and
its largest memory are those of the step. Camera poses are given; `perf/poses.py` times `poses`.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from render import CAMERA, bumpy_solid

from std_toolkit.geometry import SE3
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.scene import Scene
from std_toolkit.scene.model import (
    CameraPoses,
    FramePose,
    Label,
    Labels,
    Model,
    Object,
    ObjectTable,
)

STEPS = ("import", "propagate", "render", "check", "export")
PICTURES, OBJECTS = 8, 3


def write_recording(root: Path, frames: int) -> None:
    """Colour and depth by name; links to eight pictures each."""
    rng = np.random.default_rng(0)
    for k in range(PICTURES):
        noise = rng.integers(0, 256, (720, 1280, 3)).astype(np.uint8)
        write_color(root / f"c{k}.png", cv2.GaussianBlur(noise, (0, 0), 2))
        depth = 0.8 + 0.1 * cv2.GaussianBlur(rng.random((720, 1280)), (0, 0), 20)
        write_depth_png16(root / f"d{k}.png", depth, scale=0.001)
    for name in ("color", "depth"):
        (root / name).mkdir()
        for i in range(frames):
            (root / name / f"{i:06d}.png").hardlink_to(root / f"{name[0]}{i % PICTURES}.png")


def label(scene: Scene) -> None:
    """Camera poses on a short path, and labels of three solids in frame 0."""
    poses = []
    for frame in scene.frames:
        a = 0.01 * frame.id
        T = SE3.exp(
            np.array([0.03 * np.sin(a), 0.02 * np.cos(a) - 0.02, 0, 0, 0, 0.05 * np.sin(a)])
        )
        poses.append(
            FramePose(frame=frame.id, status="registered", T_world_cam=T.matrix().ravel().tolist())
        )
    scene.save_poses(CameraPoses(frames=poses))
    models, objects, labels = [], [], []
    for k in range(OBJECTS):
        mesh = bumpy_solid(k)
        path = scene.root / "models" / f"m{k}" / "mesh.ply"
        path.parent.mkdir(parents=True)
        mesh.export(path)
        models.append(
            Model(
                id=f"m{k}", mesh=f"models/m{k}/mesh.ply", size_m=mesh.extents.tolist(),
                diameter_m=float(mesh.scale),
            )
        )  # fmt: skip
        objects.append(Object(id=k + 1, name=f"o{k}", model=f"m{k}", material="diffuse"))
        pose = SE3(np.eye(3), np.array([-0.2 + 0.2 * k, 0.0, 0.7])).matrix().ravel().tolist()
        labels.append(Label(object=k + 1, frame=0, T_cam_obj=pose))
    scene.save_objects(ObjectTable(models=models, objects=objects))
    scene.save_labels(Labels(labels=labels))


def measured(step: str, top: Path) -> tuple[float, float, float]:
    """Processor seconds, wall seconds and largest memory in MB of a step."""
    scene, jobs = str(top / "scene"), ["--engine", "serial"]
    words = {
        "import": [
            "--color", str(top / "color"), "--depth", str(top / "depth"), "--depth-scale", "0.001",
            "--intrinsics", f"{CAMERA.fx},{CAMERA.fy},{CAMERA.cx},{CAMERA.cy}", "--out", scene,
            *jobs,
        ],
        "propagate": [scene],
        "render": [scene, "--renderer", "raycast", *jobs],
        "check": [scene, "--allow-unconfirmed", *jobs],
        "export": [scene, "--format", "bop", "--out", str(top / "export"), *jobs],
    }[step]  # fmt: skip
    command = [sys.executable, "-m", "std_toolkit.cli.main", "--quiet", step, *words]
    began = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    _, status, usage = os.wait4(process.pid, 0)
    assert process.stderr is not None
    # The labels do not fit pictures of noise: the check fails them.
    if os.waitstatus_to_exitcode(status) not in ((0, 1) if step == "check" else (0,)):
        sys.exit(f"{step}: {process.stderr.read().decode()}")
    return (
        usage.ru_utime + usage.ru_stime,
        time.monotonic() - began,
        usage.ru_maxrss * 1024 / 1e6,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, nargs="+", default=[250, 500, 1000, 2000])
    parser.add_argument("--steps", nargs="+", choices=STEPS, default=list(STEPS))
    args = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print("step       frames  processor s  ms/frame   wall s  memory MB")
    for frames in args.frames:
        with tempfile.TemporaryDirectory() as folder:
            top = Path(folder)
            write_recording(top, frames)
            for step in STEPS:
                if step not in args.steps and step not in ("import", "propagate", "render"):
                    continue
                cpu, wall, memory = measured(step, top)
                print(
                    f"{step:9s} {frames:7d} {cpu:12.1f} {1000 * cpu / frames:9.1f} {wall:8.1f} "
                    f"{memory:10.0f}",
                    flush=True,
                )
                if step == "import":
                    label(Scene.open(top / "scene"))
            shutil.rmtree(top / "scene")


if __name__ == "__main__":
    main()
