"""Continuation of the trusted depth into holes, as a layer of networks and in augmentation.

The inverse depth of a plane is linear in the image, so that a harmonic function continues a table
exactly. It is found from coarse to fine: at each level the unknown pixels begin at the coarser
level's values and become means of their neighbours a few times (Jacobi's method). What is continued
so is the difference from the plane that most of the image lies on, which goes on beyond the border.
"""

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate, pad

from benchmark.methods.relative_depth import mean_depth

_ROUNDS = 8  # of averaging at each level
_HALVINGS = 11  # to one pixel of 2048; a number that no size decides is one of a graph of any size
_SMALL = 1e-6
# Trust to this power, against distrust to it: a pixel of trust 0.1 must not hold the continuation.
_SHARPNESS = 4
# Share of trusted pixels of a cell at which it keeps half of its own mean.
_HALF = 0.1
# Weighted fits of the plane, and the difference in inverse depth, relative to its mean, from which
# on a pixel hardly counts: that of an object of 5 cm on a table 1 m away.
_FITS, _OFF = 6, 0.05


def continued(depth: Tensor, weight: Tensor) -> Tensor:
    """(b, 1, h, w) metres everywhere; differentiable in `weight`.

    Args:
        depth: (b, 1, h, w) metres, 0 where nothing was measured.
        weight: (b, 1, h, w) trust in each measurement, in [0, 1].

    An image without any trusted measurement continues the mean of all, or 1 m without any.
    """
    measured = depth > 0
    weight = decided(weight) * measured
    inverse = measured / depth.clamp(min=_SMALL)
    plane = main_plane(inverse, weight)
    # A pixel of a coarse level is known as far as its part of the image is.
    found = relaxed(inverse - plane, weight, lambda sure: sure / (sure + _HALF), _ROUNDS)
    # Where the plane comes near its horizon the image is at most four times as far as its mean.
    least = 0.25 / mean_depth(depth)
    return 1 / torch.maximum(found + plane, least)


def decided(trust: Tensor) -> Tensor:
    """Trust in [0, 1], nearer to 0 and 1: half a trust stays, 0.1 becomes 0.0002."""
    sure = trust**_SHARPNESS
    return sure / (sure + (1 - trust) ** _SHARPNESS)


def relaxed(
    values: Tensor, weight: Tensor, known: Callable[[Tensor], Tensor], rounds: int
) -> Tensor:
    """(b, 1, h, w) values continued harmonically: unknown pixels are means of their neighbours.

    Weighted means at half the size, and so on down to one pixel of 2048; back up, each size begins
    with the coarser solution and is relaxed.

    Args:
        values: (b, 1, h, w).
        weight: (b, 1, h, w), 0 where a value is unknown; an image of weight 0 has the value 0.
        known: share, 0 to 1, in which a pixel keeps its own value, from its weight.
        rounds: of averaging at each size.
    """
    levels = [(values * weight, weight)]
    for _ in range(_HALVINGS):
        total, weight = (avg_pool2d(image, 2, ceil_mode=True) for image in levels[-1])
        levels.append((total, weight))
    found = torch.zeros_like(levels[-1][0])
    for total, weight in reversed(levels):
        found = interpolate(found, size=total.shape[-2:], mode="bilinear", align_corners=False)
        share, own = known(weight), total / weight.clamp(min=_SMALL)
        found = share * own + (1 - share) * found
        for _ in range(rounds):
            found = share * own + (1 - share) * _around(found)
    return found


def main_plane(inverse: Tensor, weight: Tensor) -> Tensor:
    """(b, 1, h, w) inverse depth of the plane that most of the weight lies near.

    Args:
        inverse: (b, 1, h, w) 1 / metres.
        weight: (b, 1, h, w); an image of weight 0 has the inverse depth 1 everywhere.
    """
    h, w = inverse.shape[-2:]
    v = torch.linspace(-1, 1, h, device=inverse.device, dtype=inverse.dtype).reshape(1, 1, h, 1)
    u = torch.linspace(-1, 1, w, device=inverse.device, dtype=inverse.dtype).reshape(1, 1, 1, w)
    believed = weight.detach()
    plane = torch.zeros_like(inverse)
    for _ in range(_FITS):
        total = _sum(believed).clamp(min=_SMALL)

        def mean(values: Tensor, weight: Tensor = believed, total: Tensor = total) -> Tensor:
            return _sum(values * weight) / total

        mid_u, mid_v, mid = mean(u), mean(v), mean(inverse)
        du, dv, d = u - mid_u, v - mid_v, inverse - mid
        uu, vv, uv = mean(du * du) + _SMALL, mean(dv * dv) + _SMALL, mean(du * dv)
        ud, vd = mean(du * d), mean(dv * d)
        determinant = (uu * vv - uv * uv).clamp(min=_SMALL**2)
        across, down = (ud * vv - vd * uv) / determinant, (vd * uu - ud * uv) / determinant
        plane = mid + across * du + down * dv
        off = (inverse - plane) / (_OFF * mid.clamp(min=_SMALL))
        believed = weight.detach() / (1 + off.square()).square()
    return torch.where(_sum(weight) > 0, plane, torch.ones_like(plane))


def _sum(images: Tensor) -> Tensor:
    return images.sum(dim=(2, 3), keepdim=True)


def _around(image: Tensor) -> Tensor:
    """Mean of the four neighbours; beyond the border the image goes on as it is at it."""
    wide = pad(image, (1, 1, 1, 1), mode="replicate")
    rows = wide[..., :-2, 1:-1] + wide[..., 2:, 1:-1]
    return (rows + wide[..., 1:-1, :-2] + wide[..., 1:-1, 2:]) / 4
