"""The mean shape as in SPD: the decoded mean embedding of a category.

One auto-encoder learns the shapes of all categories with the chamfer distance (Tian et al., ECCV
2020): a PointNet encoder and a decoder of fully connected layers. Layer widths, batch size and
number of epochs are chosen here where the paper does not state them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from benchmark.methods.network import torch_device
from benchmark.methods.pointnet.grouping import chamfer
from benchmark.methods.pointnet.layers import SharedMLP
from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class AutoencoderOptions:
    """Network and training.

    Attributes:
        points: of the shape that comes out.
        embedding: length of the embedding of a shape.
        encoder: widths of the network over each point.
        decoder: widths of the hidden layers.
        batch, epochs, learning_rate: of Adam; the rate falls to a tenth in the last third.
        seed: of weights, order and rotation.
        device: torch device.
    """

    points: int = 1024
    embedding: int = 512
    encoder: tuple[int, ...] = (64, 128, 512)
    decoder: tuple[int, ...] = (1024, 1024)
    batch: int = 32
    epochs: int = 50
    learning_rate: float = 1e-4
    seed: int = 0
    device: str = "cpu"


class Autoencoder(nn.Module):
    """Points (b, n, 3) to an embedding (b, e) and back to points (b, m, 3)."""

    def __init__(self, options: AutoencoderOptions) -> None:
        super().__init__()
        self.options = options
        self.each = SharedMLP(3, options.encoder, normalised=False)
        self.embed = nn.Linear(options.encoder[-1], options.embedding)
        widths = (options.embedding, *options.decoder)
        layers: list[nn.Module] = []
        for a, b in pairwise(widths):
            layers += [nn.Linear(a, b), nn.ReLU()]
        self.decode_flat = nn.Sequential(*layers, nn.Linear(widths[-1], 3 * options.points))

    def encode(self, points: Tensor) -> Tensor:
        return self.embed(self.each(points.transpose(1, 2)).amax(dim=2))

    def decode(self, embedding: Tensor) -> Tensor:
        return self.decode_flat(embedding).unflatten(1, (self.options.points, 3))

    def forward(self, points: Tensor) -> Tensor:
        return self.decode(self.encode(points))


def mean_shapes(
    shapes: Mapping[str, NDArray[np.floating]],
    options: AutoencoderOptions | None = None,
    report: Callable[[int, float], None] = lambda epoch, loss: None,  # noqa: ARG005
) -> dict[str, Floats]:
    """(m, 3) mean shape of each category.

    Args:
        shapes: category to (n, p, 3), p the same for all.
        options: of the network.
        report: called with every epoch and its mean loss.

    Raises:
        ToolkitError: no shapes, or the training went astray.
    """
    options = options or AutoencoderOptions()
    if not shapes:
        raise ToolkitError("there are no shapes to take the mean of")
    device = torch_device(options.device)
    torch.manual_seed(options.seed)
    network = Autoencoder(options).to(device)
    points = torch.from_numpy(np.concatenate(list(shapes.values())).astype(np.float32)).to(device)
    train(network, points, report)
    found = {}
    with torch.no_grad():
        for name, of_category in shapes.items():
            some = torch.from_numpy(np.asarray(of_category, np.float32)).to(device)
            codes = torch.cat([network.encode(part) for part in some.split(options.batch)])
            found[name] = network.decode(codes.mean(dim=0, keepdim=True))[0].cpu().numpy()
    return found


def train(network: Autoencoder, points: Tensor, report: Callable[[int, float], None]) -> None:
    """Learn to repeat shapes (n, p, 3)."""
    options = network.options
    optimizer = torch.optim.Adam(network.parameters(), options.learning_rate)
    generator = torch.Generator().manual_seed(options.seed)
    for epoch in range(options.epochs):
        slow = epoch >= 2 * options.epochs / 3
        for group in optimizer.param_groups:
            group["lr"] = options.learning_rate * (0.1 if slow else 1.0)
        losses = []
        for chosen in torch.randperm(len(points), generator=generator).split(options.batch):
            some = points[chosen.to(points.device)]
            loss = chamfer(network(some), some).mean()
            if not torch.isfinite(loss):
                raise ToolkitError("the auto-encoder's loss is not a number", value=epoch)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.detach())
        report(epoch, float(torch.stack(losses).mean()))
