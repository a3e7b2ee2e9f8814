"""Which depth restorers there are, and how one is made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from benchmark.methods.making import make_of
from benchmark.methods.protocol import Restorer
from std_toolkit.plugins import Registry


@dataclass(frozen=True, kw_only=True)
class MethodOptions:
    """How to make a restorer.

    Attributes:
        preset: size of a network: `published` or `compact`; others ignore it.
        weights: file of trained weights; None for those that come with the toolkit.
        device: torch device, such as `cpu` or `cuda:0`.
        precision: of a network's arithmetic.
        compile: whether a network goes through `torch.compile`.
        settings: the method's own settings by name, as text.
    """

    preset: str = "published"
    weights: Path | None = None
    device: str = "cpu"
    precision: Literal["fp32", "bf16", "fp16"] = "fp32"
    compile: bool = False
    settings: Mapping[str, str] = field(default_factory=dict)


RestorerFactory = Callable[[MethodOptions], Restorer]

restorers: Registry[RestorerFactory] = Registry(
    "std_toolkit.restorers",
    {
        "raw": "benchmark.methods.filling.raw:Raw",
        "nearest": "benchmark.methods.filling.nearest:Nearest",
        "navier-stokes": "benchmark.methods.filling.inpainting:NavierStokes",
        "telea": "benchmark.methods.filling.inpainting:Telea",
        "joint-bilateral": "benchmark.methods.filling.joint_bilateral:JointBilateral",
        "colorization": "benchmark.methods.filling.colorization:Colorization",
        "planes": "benchmark.methods.filling.planes:Planes",
        "swindrnet": "benchmark.methods.swindrnet.restorer:SwinDRNet",
        "nlspn": "benchmark.methods.nlspn.restorer:NLSPN",
        "lidf": "benchmark.methods.lidf.restorer:LIDF",
        "cleargrasp": "benchmark.methods.cleargrasp.restorer:ClearGrasp",
        "dfnet": "benchmark.methods.dfnet.restorer:DFNet",
    },
)


def make_restorer(name: str, options: MethodOptions | None = None) -> Restorer:
    """A restorer by its name, or by `package.module:Class`.

    Raises:
        ToolkitError: no such method, or what the method says of its options and weights.
    """
    return make_of(
        restorers,
        name,
        options or MethodOptions(),
        called="restore",
        has=("input_size", "needs_mask"),
        guide="docs/methods.md",
    )
