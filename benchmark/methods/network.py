"""Shared code of networks: tensors from views, image sizes, device, precision."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, pad

from benchmark.methods import protocol, registry, weights
from std_toolkit import plugins
from std_toolkit.errors import ToolkitError, check_known
from std_toolkit.geometry.camera import pixel_rays

_PRECISIONS = {"fp32": None, "bf16": torch.bfloat16, "fp16": torch.float16}

# (width, height) that compact networks work at: that of the main tables, so that their answers are
# scored pixel by pixel, and shaped as the cameras' images.
COMPACT_SIZE = (224, 126)


class Prediction(NamedTuple):
    """What a restoration network answers.

    Attributes:
        depth: (b, 1, h, w) metres.
        initial: (b, 1, h, w) depth before it was blended or propagated; None where there is none.
        confidence: (b, 1, h, w) trust in the sensor's depth, in [0, 1]; None where there is none.
        spread: (b, 1, h, w) metres, expected error of `depth`; None where there is none.
        clear: (b, 1, h, w) probability of glass or metal; None where there is none.
    """

    depth: Tensor
    initial: Tensor | None = None
    confidence: Tensor | None = None
    spread: Tensor | None = None
    clear: Tensor | None = None


class HeldNetwork:
    """A network on its device, in evaluation mode, with the arithmetic that options want.

    Args:
        network: with its weights.
        options: device, precision and compilation.

    Raises:
        ToolkitError: the device is not there, or no such precision.
    """

    def __init__(self, network: nn.Module, options: registry.MethodOptions) -> None:
        self.device = torch_device(options.device)
        self._narrow = narrow_type(options.precision)
        self.network = network.to(self.device).eval().requires_grad_(False)
        self._run: Any = torch.compile(self.network) if options.compile else self.network

    @property
    def parameter_count(self) -> int:
        """Parameters of the network."""
        return parameter_count(self.network)

    @contextmanager
    def _running(self, frames: int) -> Iterator[None]:
        """Without gradients.

        Raises:
            ToolkitError: the device's memory does not hold so many frames.
        """
        try:
            with torch.inference_mode():
                yield
        except torch.OutOfMemoryError as error:
            raise ToolkitError(
                f"the memory of {self.device} does not hold {frames} frames at once",
                hint="make --batch-size smaller",
            ) from error

    def _answer(self, *inputs: Tensor) -> Any:
        """What the network answers, in the arithmetic that is wanted."""
        with torch.autocast(self.device.type, dtype=self._narrow, enabled=self._narrow is not None):
            return self._run(*inputs)


class NetworkRestorer(HeldNetwork):
    """A restorer around a network `network(color, depth) -> Prediction`.

    Colour is given as (b, 3, h, w) float32 RGB in [0, 1] and depth as (b, 1, h, w) float32 metres,
    0 where there is none; a network that wants them otherwise does that itself, or its restorer
    overrides `inputs` and `answers`.

    Args:
        network: with its weights; it is put on the device and into evaluation mode.
        options: device, precision and compilation.
        input_size: (width, height) that the network works at, or None for the size of the view.

    Raises:
        ToolkitError: the device is not there, or no such precision.
    """

    needs_mask = False

    def __init__(
        self,
        network: nn.Module,
        options: registry.MethodOptions,
        input_size: tuple[int, int] | None,
    ) -> None:
        super().__init__(network, options)
        self.input_size = input_size

    def restore(self, views: Sequence[protocol.View]) -> list[protocol.Restored]:
        """Restore a batch of views, which all have one size unless the restorer has its own.

        Raises:
            ToolkitError: views of several sizes, or the device's memory does not hold the batch.
        """
        if not views:
            return []
        with self._running(len(views)):
            return self.answers(self._answer(*self.inputs(views)), views)

    def inputs(self, views: Sequence[protocol.View]) -> tuple[Tensor, ...]:
        """What the network is called with: colour and depth at the input size, on the device."""
        color, depth = color_and_depth(views, self.device)
        return self.resized(color), self.resized(depth)

    def answers(self, outputs: Any, views: Sequence[protocol.View]) -> list[protocol.Restored]:
        """What the network's outputs say of each view, at the view's size."""
        depth = _at_size(outputs.depth.float(), views)
        trust = None if outputs.confidence is None else outputs.confidence.float().clamp(0, 1)
        beside = (
            [None] * len(views) if maps is None else _at_size(maps.float(), views)
            for maps in (trust, outputs.spread, outputs.clear)
        )
        return [protocol.Restored(*answer) for answer in zip(depth, *beside, strict=True)]

    def resized(self, images: Tensor) -> Tensor:
        """(b, c, h, w) images at the input size, by the nearest pixel."""
        if self.input_size is None or images.shape[-1:-3:-1] == self.input_size:
            return images
        return interpolate(images, size=self.input_size[::-1], mode="nearest")

    @property
    def takes_color_and_depth(self) -> bool:
        """Whether the network is called with colour and depth alone, and answers as above."""
        own = type(self)
        return own.inputs is NetworkRestorer.inputs and own.answers is NetworkRestorer.answers

    def plain_network(self) -> nn.Module:
        """The network with its weights under the names that their file has; for export."""
        return self.network

    def skeleton(self) -> nn.Module:
        """The network as published, for its parameters and its cost; it may be without weights."""
        return self.network

    @property
    def parameter_count(self) -> int:
        """Parameters of the network as published."""
        return parameter_count(self.skeleton())

    def macs(self, view: protocol.View) -> int:
        """Multiplications with addition that one view costs the network as published.

        Those of element-wise work are not counted.
        """
        skeleton = self.skeleton()
        device = next(skeleton.parameters()).device
        with torch.inference_mode():
            return count_macs(skeleton, *(tensor.to(device) for tensor in self.inputs([view])))


def color_and_depth(views: Sequence[protocol.View], device: torch.device) -> tuple[Tensor, Tensor]:
    """(b, 3, h, w) RGB in [0, 1] and (b, 1, h, w) metres, 0 where a depth is none.

    Raises:
        ToolkitError: the views are of several sizes.
    """
    sizes = {view.depth.shape for view in views}
    if len(sizes) > 1:
        listed = ", ".join(sorted(f"{w}x{h}" for h, w in sizes))
        raise ToolkitError(
            f"views of several sizes in one batch: {listed}", hint="restore them one by one"
        )
    # As bytes to the device: a quarter of the transfer.
    color = torch.from_numpy(np.stack([view.color for view in views])).to(device)
    depth = torch.from_numpy(np.stack([view.depth for view in views])).to(device)
    depth = torch.where(torch.isfinite(depth) & (depth > 0), depth, 0.0)
    return color.permute(0, 3, 1, 2).float() / 255, depth[:, None].float()


def view_rays(views: Sequence[protocol.View], like: Tensor) -> tuple[Tensor, Tensor]:
    """Rays of the pixels of views at the size and on the device of `like` (b, c, h, w).

    Returns:
        (b, 3, h, w) directions with z = 1, and (b, 1, h, w) bool pixels that a ray reaches through
        the lens; (0, 0, 1) elsewhere.
    """
    h, w = like.shape[-2:]
    found = np.stack([pixel_rays(view.camera.resized(w, h)) for view in views])
    rays = torch.from_numpy(found).to(like.device, torch.float32).permute(0, 3, 1, 2)
    reached = rays.isfinite().all(dim=1, keepdim=True)
    return torch.where(reached, rays, rays.new_tensor((0, 0, 1.0))[:, None, None]), reached


def precisely(module: nn.Module, features: Tensor) -> Tensor:
    """A module's answer in float32, also where arithmetic is narrowed.

    Depth must go into a network and come out of it so: a bfloat16 between 0.5 and 1 m is a
    multiple of 4 mm.
    """
    if features.device.type == "meta":  # where nothing is computed
        return module(features)
    with torch.autocast(features.device.type, enabled=False):
        return module(features.float())


Config = TypeVar("Config")
Network = TypeVar("Network", bound=nn.Module)


def network_of(
    method: str,
    presets: Mapping[str, Config],
    make: Callable[[Config], Network],
    options: registry.MethodOptions,
    *,
    ignored: Sequence[str] = (),
    renamed: weights.Renamed | None = None,
) -> tuple[Config, Network]:
    """The configuration and the network of a method, with its weights.

    Args:
        method: its name, for shipped weights.
        presets: its configurations.
        make: the network of a configuration.
        options: preset, settings, weights and device.
        ignored: keys that the weights may have and the network does not need.
        renamed: turns the weights of the authors' program into the network's.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """
    config = plugins.configured(registry.preset_of(presets, options.preset), options.settings)
    torch_device(options.device)  # refused before weights are read
    network = make(config)
    path = weights.weights_for(method, options)
    weights.load_weights(network, path, ignored=ignored, renamed=renamed)
    return config, network


def torch_device(name: str) -> torch.device:
    """The torch device of a name such as `cpu`, `cuda` or `cuda:1`.

    Raises:
        ToolkitError: no device is called so, or this machine does not have it.
    """
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        there = ["cpu", *(f"cuda:{index}" for index in range(count))]
        if torch.backends.mps.is_available():
            there.append("mps")
        built = "" if torch.version.cuda else "; this build of torch has no CUDA"
        raise ToolkitError(
            "there is no such device here",
            field="--device",
            value=name,
            hint=f"there is {', '.join(there)}{built}",
        ) from error
    return device


def narrow_type(precision: str) -> torch.dtype | None:
    """The type that a network's arithmetic is narrowed to; None at full precision.

    Raises:
        ToolkitError: no such precision.
    """
    check_known(precision, _PRECISIONS, "no such precision", field="--precision", told="known:")
    return _PRECISIONS[precision]


def parameter_count(network: nn.Module) -> int:
    """Numbers that training can change."""
    return sum(parameter.numel() for parameter in network.parameters())


def count_macs(network: nn.Module, *inputs: Tensor) -> int:
    """Multiplications with addition of one call: matrix products, convolutions and attention."""
    from torch.nn.attention import SDPBackend, sdpa_kernel
    from torch.utils.flop_counter import FlopCounterMode

    # Only the plain form of attention is counted on every device.
    with FlopCounterMode(display=False) as counter, sdpa_kernel(SDPBackend.MATH):
        network(*inputs)
    return counter.get_total_flops() // 2


def _at_size(images: Tensor, views: Sequence[protocol.View]) -> list[np.ndarray]:
    """Each of (b, 1, h, w) images at the size of its view, as (h, w) arrays."""
    size = views[0].depth.shape
    if images.shape[-2:] != size:
        images = interpolate(images, size=size, mode="nearest")
    return list(images[:, 0].cpu().numpy())


def padded_to(images: Tensor, multiple: int) -> Tensor:
    """(b, c, h, w) images with their last row and column repeated up to multiples of `multiple`."""
    h, w = images.shape[-2:]
    right, below = -w % multiple, -h % multiple
    return pad(images, (0, right, 0, below), mode="replicate") if right or below else images
