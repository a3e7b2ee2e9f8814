"""Small packs and trainings of a few steps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from benchmark.training.fit import fit
from benchmark.training.options import Machine, PackOptions, TrainOptions
from benchmark.training.pack import pack_split
from benchmark.training.plan import plan_training
from std_toolkit.jobs import JobOptions
from tests.dreds_on_disk import write_dreds_scene

SPLIT = "dreds-catknown-train"
SIDE = 32
SERIAL = JobOptions(engine="serial")
HERE = Machine(accelerator="cpu", readers=0, log_every=1, progress=False)

# Networks as small as they go, by method.
TINY = {
    "swindrnet": {
        "input_size": f"{SIDE},{SIDE}",
        "channels": "8",
        "depths": "1,1,1,1",
        "heads": "1,1,1,1",
        "head_channels": "8",
    },
    "compactdr": {"depth_channels": "8,8,8,8,8", "channels": "8,8,8,8,8"},
    "nlspn": {
        "input_size": f"{SIDE},{SIDE}",
        "channels": "8",
        "blocks": "1,1,1,1",
        "steps": "2",
    },
    "two-branch": {
        "input_size": f"{SIDE},{SIDE}",
        "channels": "8",
        "depths": "1,1,1,1",
        "heads": "1,1,1,1",
        "head_channels": "8",
        "points": "256",
        "centres": "64,32,16,8",
        "neighbours": "8",
        "point_channels": "8",
    },
    "dfnet": {"input_size": f"{SIDE},{SIDE}", "channels": "8", "layers": "1"},
    "lidf": {
        "input_size": f"{SIDE},{SIDE}",
        "channels": "8",
        "blocks": "1,1,1,1",
        "color_features": "8",
        "point_channels": "8",
        "head": "32,16,8",
    },
    "cleargrasp": {
        "input_size": f"{SIDE},{SIDE}",
        "depth_size": f"{SIDE},{SIDE}",
        "width": "2",
        "bottleneck": "false",
        "blocks": "1,1,1,1,1,1,1,1",
        "head_channels": "8",
    },
}
# Those that train longest are tried in the long form only, where others do the same.
LARGE = ("cleargrasp", "two-branch")


def write_scenes(root: Path, scenes: int = 4, frames: int = 3, seed: int = 0) -> Path:
    """DREDS scenes 00000, 00001, ... below `root`, each of its own pixels."""
    for i in range(scenes):
        folder = root / "DREDS-CatKnown" / "train" / f"{i:05d}"
        write_dreds_scene(folder, frames=frames, seed=seed + i)
    return root


def packed(folder: Path, root: Path, **options: Any) -> Path:
    wanted = PackOptions(**{"size": (SIDE, SIDE), "shard": 5, **options})
    report = pack_split(folder, SPLIT, root, wanted, SERIAL)
    assert not report.failed
    return folder


def wishes(method: str, data: Path, **changes: Any) -> TrainOptions:
    """A training of 6 steps of 4 frames with a checkpoint after every second."""
    plain = TrainOptions(
        method=method,
        settings=TINY[method],
        data=[data],
        steps=6,
        batch_size=4,
        hold_out=0.3,
        checkpoint_every=2,
        validate_every=4,
    )
    return replace(plain, **changes)


def trained(asked: TrainOptions, folder: Path, machine: Machine = HERE) -> dict[str, torch.Tensor]:
    """Train, or go on; the last weights."""
    from safetensors.torch import load_file

    torch.set_num_threads(1)
    config, data, beginning = plan_training(asked)
    fit(folder, config, data, machine, beginning)
    return load_file(folder / "last.safetensors")


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    """Whether weights agree in every bit."""
    return one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)
