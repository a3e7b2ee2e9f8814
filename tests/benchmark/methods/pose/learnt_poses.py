"""Frames to learn by heart, and pose networks that have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from benchmark.data.splits import open_split
from benchmark.methods.network import parameter_count
from benchmark.methods.protocol import PoseView
from benchmark.methods.weights import save_weights
from benchmark.training.catalogue import get_trainable
from benchmark.training.options import PackOptions
from benchmark.training.pack import pack_split
from benchmark.training.packed_frames import PackedFrames
from benchmark.training.step import StepInfo, model_input
from std_toolkit.io.images import write_color
from std_toolkit.jobs import JobOptions
from tests.dreds_on_disk import DIFFUSE, SPECULAR, TRANSPARENT, Ball, pose, write_dreds_scene

SPLIT = "dreds-catknown-train"
LARGE = (224, 126)
FRAMES = 2
# Larger than those of other tests, so that there is something to see of them in small images.
THINGS = (
    Ball(1, 1, TRANSPARENT, "02876657", "bottle_a", (-0.21, 0.05, 0.62), 0.09),
    Ball(2, 6, SPECULAR, "03797390", "mug_b", (0.0, -0.05, 0.6), 0.09),
    Ball(3, 3, DIFFUSE, "02942699", "camera_c", (0.2, 0.06, 0.64), 0.09),
)
SIDE = {"swindrnet-nocs": 64, "nocs": 96}
TINY = {
    "swindrnet-nocs": {
        "input_size": "64,64",
        "channels": "16",
        "depths": "1,1,1,1",
        "heads": "1,1,1,1",
        "head_channels": "16",
        "drop_path": "0",
        "dropout": "0",
    },
    "nocs": {
        "input_size": "96,96",
        "channels": "16",
        "blocks": "1,1,1,1",
        "pyramid": "32",
        "tower": "1",
        "region_channels": "32",
        "region_convs": "2",
    },
}


def write_things(root: Path) -> Path:
    """A scene of two frames of DREDS whose colours tell the coordinates; returns `root`."""
    folder = root / "DREDS-CatKnown" / "train" / "00000"
    sizes = {"color_size": LARGE, "label_size": LARGE}
    drawn = write_dreds_scene(folder, frames=FRAMES, balls=THINGS, **sizes)
    for i, frame in enumerate(drawn):
        color = np.rint(60 + 150 * frame.nocs).astype(np.uint8)
        tint = np.zeros((256, 3), np.uint8)
        tint[1:4] = 40 * np.eye(3)
        write_color(folder / f"{i:04d}_color.png", color + tint[frame.mask])
    return root


def packed_things(folder: Path, root: Path, method: str) -> PackedFrames:
    side = SIDE[method]
    options = PackOptions(size=(side, side), color="nearest", nocs=True)
    report = pack_split(folder, SPLIT, root, options, JobOptions(engine="serial"))
    assert not report.failed
    return PackedFrames([folder])


def learn(method: str, frames: PackedFrames, path: Path, steps: int, rate: float) -> list[float]:
    """Train a tiny network on all frames at once; returns the losses, leaves the weights."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    trainable = get_trainable(method)
    network = trainable.network(trainable.config("compact", TINY[method])).train()
    assert parameter_count(network) < 2_000_000
    optimizer = torch.optim.Adam(network.parameters(), rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, steps)
    batch = frames[list(range(len(frames)))]
    losses = []
    for step in range(steps):
        optimizer.zero_grad()
        loss = trainable.step(
            network, trainable.loss, model_input(batch), StepInfo("", step, steps)
        )
        loss.total.backward()
        optimizer.step()
        schedule.step()
        losses.append(float(loss.total.detach()))
    save_weights(network, path)
    return losses


def views_of(root: Path, method: str) -> list[PoseView]:
    """The frames as a method sees them, poses to be fitted to true depth."""
    from benchmark.data.frame import resize_nearest

    size = (SIDE[method], SIDE[method])
    source = open_split(SPLIT, root)
    views = []
    for i in range(FRAMES):
        frame = source.load(i)
        maps = [resize_nearest(m, size) for m in (frame.color, frame.depth_raw, frame.depth_true)]
        views.append(PoseView(*maps, frame.camera.resized(*size)))
    return views


def true_poses(index: int) -> dict[int, np.ndarray]:
    """RT of the things of a frame by class, the scale inside."""
    found = {}
    for ball in THINGS:
        T_cam_obj = pose(ball, index)
        RT = np.eye(4)
        RT[:3, :3], RT[:3, 3] = ball.diagonal * T_cam_obj.R, T_cam_obj.t
        found[ball.class_id] = RT
    return found
