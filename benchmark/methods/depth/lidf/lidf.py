"""LIDF (Zhu et al., CVPR 2021): network and restorer.

Written from the paper; the authors' weights do not fit.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from benchmark.methods.depth.lidf.features import (
    DIRECTION_WAVES,
    POSITION_WAVES,
    ColorNet,
    PointNet,
    cell_means,
    encoded,
    encoded_size,
    first_largest_of_groups,
    log_softmax_of_groups,
    places,
    spread,
    surroundings,
)
from benchmark.methods.depth.lidf.refinement import (
    Features,
    Head,
    OffsetHead,
    Refinement,
    leaky_clip,
)
from benchmark.methods.depth.lidf.voxels import (
    PRESETS,
    Grid,
    LIDFConfig,
    Pairs,
    Rays,
    Refinements,
    Terminations,
    Voxels,
    occupied,
    passed,
    points_on,
    true_pairs,
)
from benchmark.methods.network import NetworkRestorer, color_and_depth, network_of, view_rays
from benchmark.methods.protocol import View
from benchmark.methods.registry import MethodOptions
from std_toolkit.errors import ToolkitError

_MEAN = (0.485, 0.456, 0.406)

_DEVIATION = (0.229, 0.224, 0.225)


class LIDFPrediction(NamedTuple):
    """What LIDF answers; the first three as `Prediction` has them.

    Attributes:
        depth: (b, 1, h, w) metres; 0 where a ray passes no voxel that holds a measurement and
            there is no believed measurement either.
        initial: (b, 1, h, w) the same after the first stage.
        confidence: None.
        terminations: of the first stage, if it was asked to learn.
        refinements: of the second stage, if that ran.
        spread, clear: None.
    """

    depth: Tensor
    initial: Tensor
    confidence: None = None
    terminations: Terminations | None = None
    refinements: Refinements | None = None
    spread: None = None
    clear: None = None


class _Voxelized(NamedTuple):
    """A batch of images: the measurements, their voxels, what colour says around every pixel."""

    points: Tensor  # (n, 3) metres
    color: Tensor  # (n, 3) normalised
    image: Tensor  # (n,)
    voxels: Voxels
    features: Tensor  # (v, c) of the voxels
    means: Tensor  # of `cell_means`


class LIDFNetwork(nn.Module):
    """`network(color, depth, rays, believed, asked)` to `LIDFPrediction`."""

    color_mean: Tensor
    color_deviation: Tensor

    def __init__(self, config: LIDFConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or LIDFConfig()
        for name, values in (("color_mean", _MEAN), ("color_deviation", _DEVIATION)):
            tensor = torch.tensor(values).reshape(1, 3, 1, 1)
            self.register_buffer(name, tensor, persistent=False)
        self.grid = Grid(config)
        self.diagonal = 3**0.5 * config.voxel
        self.color_net = ColorNet(config)
        self.points = PointNet(config.point_channels)
        ray_size = 4 * config.color_features + encoded_size(DIRECTION_WAVES)
        sizes = (4 * config.point_channels, ray_size, 2 * encoded_size(POSITION_WAVES))
        self.offset = OffsetHead(sizes, config.head)
        self.termination = Head(sizes, config.head)
        self.refinement = Refinement(config, ray_size)

    def forward(
        self,
        color: Tensor,
        depth: Tensor,
        rays: Tensor,
        believed: Tensor,
        asked: Tensor,
        *,
        learns: Literal[1, 2] | None = None,
        follow: Tensor | None = None,
    ) -> LIDFPrediction:
        """Restore depth.

        Args:
            color: (b, 3, h, w) RGB in [0, 1].
            depth: (b, 1, h, w) metres, 0 where the sensor measured nothing.
            rays: (b, 3, h, w) points at z = 1 behind the pixels, x right, y down.
            believed: (b, 1, h, w) bool, whose depth counts.
            asked: (b, 1, h, w) bool, which pixels to predict; in training, a run of
                `config.train_rays` of them in every image that has more.
            learns: which stage learns. 1: the second does not run, and `terminations` are told of
                all pairs at once. 2: nothing is learned in the first. None: both run, chunk by
                chunk.
            follow: (b, 1, h, w) metres: a ray is taken to end in the voxel that holds this depth,
                where there is one, and not in the likeliest.
        """
        with torch.set_grad_enabled(torch.is_grad_enabled() and learns != 2):
            believed = believed & (depth > 0)
            voxelized = self._seen(color, depth, rays, believed)
            chosen = self._rays(rays, self._asked(asked), voxelized)
            if learns == 1:
                found = self._terminations(chosen, voxelized, self._distance(chosen, rays, follow))
                distance = _distances(found)
            else:
                found = None
                distance = self._distances_by_parts(chosen, voxelized, rays, follow)
        kept = torch.where(believed, depth, 0.0)
        initial = _with(kept, chosen, distance)
        if learns == 1 or (learns is None and not self.config.refine):
            return LIDFPrediction(initial, initial, None, found)
        refined = self._refined(chosen, distance, voxelized, color)
        last = (refined.points[-1] * refined.rays.direction).sum(dim=1)
        return LIDFPrediction(_with(kept, refined.rays, last), initial, None, None, refined)

    def train_stage(self, stage: Literal[1, 2]) -> None:
        """Put one stage into training; the other one is frozen."""
        for name, module in self.named_children():
            learns = (name == "refinement") == (stage == 2)
            module.train(learns)
            module.requires_grad_(learns)
        self.training = True

    def _normalised(self, color: Tensor) -> Tensor:
        return (color - self.color_mean) / self.color_deviation

    def _seen(self, color: Tensor, depth: Tensor, rays: Tensor, believed: Tensor) -> _Voxelized:
        color = self._normalised(color)
        means = cell_means(self.color_net(color))
        everywhere = rays * depth
        b, _, h, w = depth.shape
        inside = self.grid.cells_of(_of_pixels(everywhere))[1].reshape(b, h, w)
        pixels = spread(believed[:, 0] & inside, self.config.valid_points)
        points, own = _of_pixels(everywhere)[pixels], _of_pixels(color)[pixels]
        image = pixels // (h * w)
        voxels, voxel = occupied(self.grid, points, image)
        apart = points - (voxels.corner + self.grid.side / 2)[voxel]
        features = self.points(torch.cat([apart, own], dim=1), voxel, len(voxels.image))
        return _Voxelized(points, own, image, voxels, features, means)

    def _asked(self, asked: Tensor) -> Tensor:
        """(r,) pixels to predict; in training not too many of an image."""
        if not self.training:
            return asked.flatten().nonzero().squeeze(1)
        h, w = asked.shape[-2:]
        parts = []
        for index, own in enumerate(asked.flatten(1)):
            pixels = own.nonzero().squeeze(1) + index * h * w
            spare = max(len(pixels) - self.config.train_rays, 0)
            begin = int(torch.randint(spare + 1, ()))
            parts.append(pixels[begin : begin + self.config.train_rays])
        return torch.cat(parts)

    def _rays(self, rays: Tensor, pixels: Tensor, voxelized: _Voxelized) -> Rays:
        h, w = rays.shape[-2:]
        direction = nn.functional.normalize(_of_pixels(rays)[pixels], dim=1)
        around = surroundings(voxelized.means, pixels)
        features = torch.cat([around, encoded(direction, DIRECTION_WAVES)], dim=1)
        return Rays(pixels, places(pixels, h, w)[0], direction, features)

    def _distance(self, chosen: Rays, rays: Tensor, follow: Tensor | None) -> Tensor | None:
        """(r,) metres along the rays of the depth to follow."""
        if follow is None:
            return None
        return follow.flatten()[chosen.pixel] * _of_pixels(rays)[chosen.pixel].norm(dim=1)

    def _features(self, rays: Rays, voxelized: _Voxelized) -> tuple[Pairs, Features]:
        pairs = passed(rays.direction, rays.image, voxelized.voxels, self.grid.side)
        way = rays.direction[pairs.ray]
        ends = [encoded(at[:, None] * way, POSITION_WAVES) for at in (pairs.entry, pairs.exit)]
        own = torch.cat(ends, dim=1)
        return pairs, Features(voxelized.features, pairs.voxel, rays.features, pairs.ray, own)

    def _terminations(
        self, rays: Rays, voxelized: _Voxelized, distance: Tensor | None
    ) -> Terminations:
        pairs, features = self._features(rays, voxelized)
        logits = self._scores(features)
        count = len(rays.pixel)
        chances = log_softmax_of_groups(logits, pairs.ray, count)
        chosen = first_largest_of_groups(logits.detach(), pairs.ray, count)
        true = torch.full_like(chosen, -1)
        if distance is not None:
            true = true_pairs(pairs, distance)
            chosen = torch.where(true >= 0, true, chosen)
        offset = self.offset(features)
        points = points_on(rays.direction, pairs, offset, self.diagonal)
        return Terminations(rays, pairs, chances, offset, points, chosen, true)

    def _scores(self, features: Features) -> Tensor:
        """(p,) scores of voxels along the rays."""
        scores = self.termination(features)
        return leaky_clip(scores) if self.config.clipped else scores

    def _distances_by_parts(
        self, rays: Rays, voxelized: _Voxelized, images: Tensor, follow: Tensor | None
    ) -> Tensor:
        """(r,) metres along the rays, NaN for none. Offsets are computed of chosen voxels only."""
        found = []
        for begin in range(0, len(rays.pixel), self.config.rays_at_once):
            part = rays.chosen(slice(begin, begin + self.config.rays_at_once))
            pairs, features = self._features(part, voxelized)
            logits = self._scores(features)
            chosen = first_largest_of_groups(logits, pairs.ray, len(part.pixel))
            distance = self._distance(part, images, follow)
            if distance is not None:
                true = true_pairs(pairs, distance)
                chosen = torch.where(true >= 0, true, chosen)
            there = (chosen >= 0).nonzero().squeeze(1)
            at = pairs.entry.new_full((len(part.pixel),), torch.nan)
            offset = self.offset(features.chosen(chosen[there]))
            at[there] = pairs.entry[chosen[there]] + offset * self.diagonal
            found.append(at)
        return torch.cat(found) if found else rays.direction.new_zeros(0)

    def _refined(
        self, rays: Rays, distance: Tensor, voxelized: _Voxelized, color: Tensor
    ) -> Refinements:
        there = distance.isfinite().nonzero().squeeze(1)
        chosen = rays.chosen(there)
        start = distance[there].detach()[:, None] * chosen.direction
        own = _of_pixels(self._normalised(color))[chosen.pixel]
        measured = voxelized.points, voxelized.color, voxelized.image
        return Refinements(chosen, tuple(self.refinement(start, chosen, own, measured)))


def _of_pixels(images: Tensor) -> Tensor:
    """(b h w, c) of (b, c, h, w) images."""
    return images.permute(0, 2, 3, 1).flatten(0, 2)


def _distances(found: Terminations) -> Tensor:
    """(r,) metres along the rays to the chosen ends, NaN for none."""
    distance = found.points.new_full((len(found.chosen),), torch.nan)
    there = (found.chosen >= 0).nonzero().squeeze(1)
    ends = found.points[found.chosen[there]]
    along = (ends * found.rays.direction[there]).sum(dim=1)
    return distance.index_put((there,), along)


def _with(depth: Tensor, rays: Rays, distance: Tensor) -> Tensor:
    """(b, 1, h, w) depth with that of the rays that have a distance."""
    there = distance.isfinite().nonzero().squeeze(1)
    z = distance[there] * rays.direction[there, 2]
    return depth.flatten().index_put((rays.pixel[there],), z).reshape(depth.shape)


class LIDF(NetworkRestorer):
    """Where the rays of pixels end among voxels; settings are those of `LIDFConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    settings_type = LIDFConfig

    def __init__(self, options: MethodOptions) -> None:
        self.config, network = network_of("lidf", PRESETS, LIDFNetwork, options)
        super().__init__(network, options, self.config.input_size)
        self.needs_mask = self.config.mask == "objects"

    def inputs(self, views: Sequence[View]) -> tuple[Tensor, ...]:
        """Colour, depth, rays, which depth is believed and which pixels are asked for.

        Raises:
            ToolkitError: a view without a mask, which `mask=objects` needs.
        """
        color, depth = (self.resized(i) for i in color_and_depth(views, self.device))
        directions, reached = view_rays(views, depth)
        believed = (depth > 0) & reached
        if self.needs_mask:
            believed &= ~self.resized(self._masks(views)).bool()
        asked = reached if self.config.predict == "all" else reached & ~believed
        return color, depth, directions, believed, asked

    def _masks(self, views: Sequence[View]) -> Tensor:
        masks = []
        for view in views:
            if view.mask is None:
                raise ToolkitError(
                    "method `lidf` with mask=objects needs to know the pixels of the objects, and "
                    "this view has no mask",
                    field="mask",
                    hint="use mask=holes, or data whose frames have instance masks",
                )
            masks.append(view.mask)
        return torch.from_numpy(np.stack(masks)).to(self.device)[:, None].float()
