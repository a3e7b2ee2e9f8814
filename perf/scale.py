"""Time and memory of the steps by the number of frames: both must be linear and flat.

    python perf/scale.py [--frames 250 500 1000 2000] [--steps import propagate render check export]
    python perf/scale.py --steps poses [--images DIR --intrinsics FILE]

Frames are 1280x720 with 16-bit depth and three objects of 50,000 faces; eight pictures take turns.
Every step is the command in a process of its own, without workers, so that its processor time and
its largest memory are those of the step. Camera poses are given, because noise has none.

`poses` is measured on a recording of its own: real photos of a table from a moving camera, and with
each four pictures near it, which are the photo moved by a tenth and a fifth of the optical flow to
its neighbours. The camera goes along its path and back until there are enough frames; on the way
back the pictures are those of the way there.
"""

from __future__ import annotations

import argparse
import json
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
NEAR = (-0.2, -0.1, 0.0, 0.1, 0.2)
REPOSITORY = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("STD_TEST_DATA", REPOSITORY.parent / "shared" / "data"))
TABLE = DATA / "tabletop_board_rgb"


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


def write_photos(root: Path, photos: Path, frames: int) -> None:
    """A long recording from photos: pictures near each, then back on the same way."""
    (root / "made").mkdir()
    (root / "color").mkdir()
    paths = sorted(photos.iterdir())
    made: list[Path] = []
    for k, path in enumerate(paths):
        if len(made) >= frames:
            break
        photo, before, after = (
            cv2.imread(str(paths[min(max(n, 0), len(paths) - 1)])) for n in (k, k - 1, k + 1)
        )
        back, ahead = flow(photo, before), flow(photo, after)
        for part in NEAR:
            made.append(root / "made" / f"{path.stem}{part:+.1f}.jpg")
            picture = moved(photo, -part * back if part < 0 else part * ahead) if part else photo
            cv2.imwrite(str(made[-1]), picture, [cv2.IMWRITE_JPEG_QUALITY, 95])
    there_and_back = [*made, *made[-2:0:-1]]
    for i in range(frames):
        picture = there_and_back[i % len(there_and_back)]
        (root / "color" / f"{i:06d}.jpg").hardlink_to(picture)


def flow(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(H, W, 2) motion of the pixels of the first picture to the second."""
    grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in (first, second)]
    return cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(*grey, None)


def moved(photo: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """The photo with its pixels moved by a small motion (H, W, 2)."""
    height, width = photo.shape[:2]
    at = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)
    return cv2.remap(photo, at - motion, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


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


def measured(step: str, top: Path, *more: str) -> tuple[float, float, float]:
    """Processor seconds, wall seconds and largest memory in MB of a step."""
    scene, jobs = str(top / "scene"), ["--engine", "serial"]
    words = {
        "photos": ["--color", str(top / "color"), "--out", scene, *more, *jobs],
        "poses": [scene, "--scale", "none", *jobs],
        "import": [
            "--color", str(top / "color"), "--depth", str(top / "depth"), "--depth-scale", "0.001",
            "--intrinsics", f"{CAMERA.fx},{CAMERA.fy},{CAMERA.cx},{CAMERA.cy}", "--out", scene,
            *jobs,
        ],
        "propagate": [scene],
        "render": [scene, "--renderer", "raycast", *jobs],
        "check": [scene, *jobs],
        "export": [scene, "--format", "bop", "--out", str(top / "export"), *jobs],
    }[step]  # fmt: skip
    name = "import" if step == "photos" else step
    command = [sys.executable, "-m", "std_toolkit.cli.main", "--quiet", name, *words]
    began = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    _, status, usage = os.wait4(process.pid, 0)
    assert process.stderr is not None
    # The labels do not fit pictures of noise: the check fails them. `poses` has gates, too.
    if os.waitstatus_to_exitcode(status) not in ((0, 1) if step in ("check", "poses") else (0,)):
        sys.exit(f"{step}: {process.stderr.read().decode()}")
    return (
        usage.ru_utime + usage.ru_stime,
        time.monotonic() - began,
        usage.ru_maxrss * 1024 / 1e6,
    )


def show(step: str, frames: int, cpu: float, wall: float, memory: float) -> None:
    print(
        f"{step:9s} {frames:7d} {cpu:12.1f} {1000 * cpu / frames:9.1f} {wall:8.1f} {memory:10.0f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, nargs="+", default=[250, 500, 1000, 2000])
    parser.add_argument("--steps", nargs="+", choices=(*STEPS, "poses"), default=list(STEPS))
    parser.add_argument("--images", type=Path, default=TABLE / "color")
    parser.add_argument("--intrinsics", type=Path, default=TABLE / "cam_intrinsics.json")
    args = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print("step       frames  processor s  ms/frame   wall s  memory MB")
    for frames in args.frames:
        with tempfile.TemporaryDirectory() as folder:
            if args.steps != ["poses"]:
                measure_noise(Path(folder) / "noise", frames, args.steps)
            if "poses" in args.steps:
                K = np.array(json.loads(args.intrinsics.read_text())["K"])
                measure_poses(Path(folder) / "photos", frames, args.images, K)


def measure_noise(top: Path, frames: int, steps: list[str]) -> None:
    """The steps on a recording of noise; those that others need are always measured."""
    top.mkdir()
    write_recording(top, frames)
    for step in STEPS:
        if step not in steps and step not in ("import", "propagate", "render"):
            continue
        show(step, frames, *measured(step, top))
        if step == "import":
            label(Scene.open(top / "scene"))
    shutil.rmtree(top)


def measure_poses(top: Path, frames: int, images: Path, K: np.ndarray) -> None:
    """`poses` on a long recording from photos."""
    top.mkdir()
    write_photos(top, images, frames)
    given = [float(K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))]
    measured("photos", top, "--intrinsics", ",".join(map(str, given)))
    show("poses", frames, *measured("poses", top))
    poses = Scene.open(top / "scene").poses
    assert poses is not None
    registered = sum(p.status == "registered" for p in poses.frames)
    print(f"          {registered} of {frames} frames registered", flush=True)


if __name__ == "__main__":
    main()
