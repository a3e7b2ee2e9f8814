"""The networks at small sizes, and images for them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmark.methods.depth.dfnet import DFNetConfig, DFNetwork
from benchmark.methods.depth.nlspn import NLSPNConfig, NLSPNetwork
from benchmark.methods.depth.swindrnet.swindrnet_network import SwinDRNetConfig, SwinDRNetwork
from benchmark.methods.protocol import View
from std_toolkit.geometry.camera import Camera

# These networks are small: several threads would mostly wait for one another.
torch.set_num_threads(1)

SIDE = 64
TINY_SWIN = SwinDRNetConfig(
    channels=16, depths=(2, 2, 2, 2), heads=(1, 2, 4, 8), head_channels=16, input_size=(SIDE, SIDE)
)


@dataclass(frozen=True)
class Case:
    """A method, a small network of it, and the settings that make its restorer of that size."""

    method: str
    network: type[nn.Module]
    config: Any
    settings: dict[str, str]

    def make(self, seed: int = 0) -> nn.Module:
        torch.manual_seed(seed)
        network = self.network(self.config)
        if isinstance(network, NLSPNetwork):
            stir(network)
        return network


def stir(network: NLSPNetwork) -> None:
    """Propagation begins without any effect; let it have one."""
    layer = network.prop_layer.conv_offset_aff
    nn.init.normal_(layer.weight, std=0.05)


def _swin_case(**changes: Any) -> Case:
    settings = {
        "channels": "16",
        "depths": "2,2,2,2",
        "heads": "1,2,4,8",
        "head_channels": "16",
        "input_size": f"{SIDE},{SIDE}",
    }
    told = {name: str(value).lower() for name, value in changes.items()}
    return Case("swindrnet", SwinDRNetwork, replace(TINY_SWIN, **changes), settings | told)


CASES = {
    "swindrnet-released": _swin_case(),
    "swindrnet-paper": _swin_case(fusion="paper"),
    "swindrnet-windowed": _swin_case(fusion="paper", fusion_window=7, fusion_heads=2),
    "swindrnet-relative": _swin_case(fusion="paper", relative=True),
    "swindrnet-details": _swin_case(fusion="paper", relative=True, details=True),
    "swindrnet-no-confidence": _swin_case(confidence=False),
    "swindrnet-no-fusion": _swin_case(fusion="none", confidence=False),
    "nlspn": Case(
        "nlspn",
        NLSPNetwork,
        NLSPNConfig(channels=16, blocks=(1, 1, 1, 1), steps=6, input_size=(SIDE, SIDE)),
        {"channels": "16", "blocks": "1,1,1,1", "steps": "6", "input_size": f"{SIDE},{SIDE}"},
    ),
    "nlspn-relative": Case(
        "nlspn",
        NLSPNetwork,
        NLSPNConfig(
            channels=16, blocks=(1, 1, 1, 1), steps=6, relative=True, input_size=(SIDE, SIDE)
        ),
        {
            "channels": "16",
            "blocks": "1,1,1,1",
            "steps": "6",
            "relative": "true",
            "input_size": f"{SIDE},{SIDE}",
        },
    ),
    "dfnet": Case(
        "dfnet",
        DFNetwork,
        DFNetConfig(channels=16, layers=2, input_size=(SIDE, SIDE)),
        {"channels": "16", "layers": "2", "input_size": f"{SIDE},{SIDE}"},
    ),
    "dfnet-relative": Case(
        "dfnet",
        DFNetwork,
        DFNetConfig(channels=16, layers=2, relative=True, input_size=(SIDE, SIDE)),
        {"channels": "16", "layers": "2", "relative": "true", "input_size": f"{SIDE},{SIDE}"},
    ),
}


def frames(count: int, side: int = SIDE, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Colour, the sensor's depth and true depth of a slope with boxes.

    The sensor sees nothing at one box and what is behind it at another.
    """
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:side, :side] / side
    colors, sensors, truths = [], [], []
    for _ in range(count):
        a, b = random.uniform(-0.2, 0.2, 2)
        truth = 0.8 + a * x + b * y
        sensor = truth.copy()
        color = np.stack([0.5 + 0.3 * x, 0.5 + 0.3 * y, 0.5 + 0 * x])
        for lost in (True, False):
            top, left = random.integers(4, side // 2, 2)
            box = np.s_[top : top + side // 4, left : left + side // 3]
            truth[box] -= random.uniform(0.1, 0.2)
            sensor[box] = 0 if lost else sensor[box]
            color[(slice(None), *box)] = random.uniform(0, 1, (3, 1, 1))
        colors.append(color)
        sensors.append(sensor[None])
        truths.append(truth[None])
    return tuple(
        torch.tensor(np.stack(images), dtype=torch.float32) for images in (colors, sensors, truths)
    )  # type: ignore[return-value]


def views(count: int, size: tuple[int, int] = (SIDE, SIDE), seed: int = 0) -> list[View]:
    """Noise above a slope with a hole."""
    random = np.random.default_rng(seed)
    w, h = size
    camera = Camera(w, h, w, w, w / 2 - 0.5, h / 2 - 0.5)
    found = []
    for _ in range(count):
        depth = np.linspace(0.5, 1.0, h * w, dtype=np.float32).reshape(h, w)
        depth = depth + random.uniform(0, 0.1)
        depth[h // 3 : h // 2, w // 4 : w // 2] = 0
        color = random.integers(0, 256, (h, w, 3), dtype=np.uint8)
        found.append(View(color, depth.astype(np.float32), camera))
    return found


def weights_of(case: Case, folder: Path, seed: int = 0) -> Path:
    """A file of the network's random weights."""
    from benchmark.methods.weights import save_weights

    path = folder / f"{case.method}-{seed}.safetensors"
    save_weights(case.make(seed), path)
    return path
