"""Shared code of networks: tensors from views, image sizes, device, precision, relative depth.

Relative depth does not depend on the scale of the scene. The input is relative to the mean depth of
the image. The output is relative to the sensor's depth at low resolution, with holes filled from
their surroundings: an output of 0 repeats the sensor.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, interpolate, pad

from benchmark.methods import protocol, registry, weights
from std_toolkit import plugins
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import pixel_rays

_PRECISIONS = {"fp32": None, "bf16": torch.bfloat16, "fp16": torch.float16}

# (width, height) that compact networks work at: that of the main tables, so that their answers are
# scored pixel by pixel, and shaped as the cameras' images.
COMPACT_SIZE = (224, 126)

_SPAN = 0.2  # what counts as 1: a tabletop's depths differ by about this share of their mean

# Of the mean: farther measurements are most often wrong matches. Far walls are among them, too; an
# answer about these has farther to go.
_FARTHEST = 2.5

_CONTRAST = 0.25


class Prediction(NamedTuple):
    """What a restoration network answers.

    Attributes:
        depth: (b, 1, h, w) metres.
        initial: (b, 1, h, w) depth before it was blended or propagated; None where there is none.
        confidence: (b, 1, h, w) trust in the sensor's depth, in [0, 1]; None where there is none.
    """

    depth: Tensor
    initial: Tensor | None = None
    confidence: Tensor | None = None


class NetworkRestorer:
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
        self.input_size = input_size
        self.device = torch_device(options.device)
        self._narrow = narrow_type(options.precision)
        self.network = network.to(self.device).eval().requires_grad_(False)
        self._run: Any = torch.compile(self.network) if options.compile else self.network

    def restore(self, views: Sequence[protocol.View]) -> list[protocol.Restored]:
        """Restore a batch of views, which all have one size unless the restorer has its own.

        Raises:
            ToolkitError: views of several sizes, or the device's memory does not hold the batch.
        """
        if not views:
            return []
        try:
            return self._restore(views)
        except torch.OutOfMemoryError as error:
            raise ToolkitError(
                f"the memory of {self.device} does not hold {len(views)} frames at once",
                hint="make --batch-size smaller",
            ) from error

    @torch.inference_mode()
    def _restore(self, views: Sequence[protocol.View]) -> list[protocol.Restored]:
        inputs = self.inputs(views)
        with torch.autocast(self.device.type, dtype=self._narrow, enabled=self._narrow is not None):
            outputs = self._run(*inputs)
        return self.answers(outputs, views)

    def inputs(self, views: Sequence[protocol.View]) -> tuple[Tensor, ...]:
        """What the network is called with: colour and depth at the input size, on the device."""
        color, depth = color_and_depth(views, self.device)
        return self.resized(color), self.resized(depth)

    def answers(self, outputs: Any, views: Sequence[protocol.View]) -> list[protocol.Restored]:
        """What the network's outputs say of each view, at the view's size."""
        depth = _at_size(outputs.depth.float(), views)
        if outputs.confidence is None:
            return [protocol.Restored(d) for d in depth]
        confidence = _at_size(outputs.confidence.float().clamp(0, 1), views)
        return [protocol.Restored(d, c) for d, c in zip(depth, confidence, strict=True)]

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
    if precision not in _PRECISIONS:
        raise ToolkitError(
            "no such precision",
            field="--precision",
            value=precision,
            hint=f"known: {', '.join(_PRECISIONS)}",
        )
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


def mean_depth(depth: Tensor) -> Tensor:
    """(b, 1, 1, 1) mean of each image's measured depths (b, 1, h, w), metres; 1 m without any."""
    measured = (depth > 0).sum(dim=(1, 2, 3), keepdim=True)
    mean = depth.sum(dim=(1, 2, 3), keepdim=True) / measured.clamp(min=1)
    return mean.masked_fill(measured == 0, 1.0)


def coarse_depth(depth: Tensor) -> Tensor:
    """(b, 1, h, w) metres everywhere: means over 4x4 pixels of what was measured, enlarged.

    What was measured beyond 2.5 times the image's mean is left out: one wrong match would fill a
    whole hole. A pixel of that map without any measurement takes the mean of a region around it
    that has one, the smallest of 8x8, 16x16 and so on; 1 m in an image without any.
    """
    size = depth.shape[-2:]
    filled = mean_depth(depth)
    known = ((depth > 0) & (depth < _FARTHEST * filled)).to(depth.dtype)
    sums, counts = [_halved(_halved(depth * known))], [_halved(_halved(known))]
    while max(sums[-1].shape[-2:]) > 1:
        sums.append(_halved(sums[-1]))
        counts.append(_halved(counts[-1]))
    for total, count in zip(reversed(sums), reversed(counts), strict=True):
        around = interpolate(filled, size=total.shape[-2:], mode="bilinear", align_corners=False)
        filled = (total / count.clamp(min=1e-9)).where(count > 0, around)
    return interpolate(filled, size=size, mode="bilinear", align_corners=False)


def network_depth(depth: Tensor) -> Tensor:
    """(b, 1, h, w) network input from depth in metres: relative to its mean, at most 2.5 times the
    mean."""
    mean = mean_depth(depth)
    return relative_to(mean, torch.minimum(depth, _FARTHEST * mean))


def relative_color(color: Tensor) -> Tensor:
    """(b, 3, h, w) colour in [0, 1] less the image's mean colour, in quarters.

    Most of an image is the table: what stands on it, glass too, is then what differs from 0.
    """
    return (color - color.mean(dim=(2, 3), keepdim=True)) / _CONTRAST


def relative_to(reference: Tensor, depth: Tensor) -> Tensor:
    """Metres (b, 1, h, w) as (depth / reference - 1) / 0.2; what was not measured is -5."""
    return (depth / reference - 1) / _SPAN


def in_metres(reference: Tensor, relative: Tensor) -> Tensor:
    """The inverse of `relative_to`."""
    return reference * (1 + _SPAN * relative)


def _halved(image: Tensor) -> Tensor:
    return avg_pool2d(image, 2, ceil_mode=True, count_include_pad=False)
