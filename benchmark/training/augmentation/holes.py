"""Holes of every cause, anywhere: the true surface is the answer.

In a simulated recording nearly every hole is an object. Real depth is missing in the shadow of the
second camera, at the border, out of range, on dark and glossy surfaces, in patches; and a hole of
any shape, an object's, too, may lie on a bare table.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from benchmark.data.frame import BACKGROUND
from benchmark.training.step import ModelInput

_EACH = 0.3  # chance of each cause in a frame that has holes
_ELLIPSES = 5  # at most
_RADII = (0.01, 0.10)  # of the width
_BAND = (0.02, 0.15)  # of the side
_RANGE = 0.4  # of the depths of a frame, at most, at the far end; a third of it at the near end
_BASELINE_M = (0.02, 0.08)  # between the cameras that see a surface, to either side
_DARK, _GLOSSY = (0.8, 2.0), (1.0, 2.5)  # standard deviations from the mean brightness
_COARSE_PX, _FINE_PX = 24, 6  # size of patches
_MOVED = 0.3  # of the size of the image, by which another frame's objects are moved at most


class _Frames(NamedTuple):
    """What holes are made from.

    Attributes:
        color: (b, 3, h, w) RGB in [0, 1].
        true: (b, h, w) exact depth, metres, 0 = none.
        other: (b, h, w) ids of objects of another frame.
        K: (b, 3, 3) intrinsics.
    """

    color: Tensor
    true: Tensor
    other: Tensor
    K: Tensor

    def uniform(self, low: float, high: float, *more: int) -> Tensor:
        """(b, *more, 1, 1) draws."""
        shape = (len(self.true), *more, 1, 1)
        return torch.empty(shape, device=self.true.device).uniform_(low, high)


@torch.no_grad()
def cut_holes(inputs: ModelInput, share: float) -> Tensor:
    """Sensor depth with holes of the causes in `CAUSES`, in a share of the frames.

    Args:
        inputs: frames with `true`, `mask` and `K`.
        share: of the frames; each cause has a chance of 0.3 in each of them.

    Returns:
        (b, 1, h, w) metres, 0 = none.
    """
    batch, depth = inputs.batch, inputs.depth
    b, on = len(depth), depth.device
    frames = _Frames(
        inputs.color,
        batch["true"],
        batch["mask"].roll(1, dims=0),
        batch["K"].to(depth),
    )
    # Drawn where no device has to be waited for; each cause sees its own frames alone.
    chosen = torch.rand(b) < share
    gone = torch.zeros_like(batch["true"], dtype=torch.bool)
    for cause in CAUSES.values():
        where = (chosen & (torch.rand(b) < _EACH)).nonzero()[:, 0].to(on)
        if len(where):
            holes = cause(_Frames(*(values[where] for values in frames)))
            gone[where] |= holes
    return depth.masked_fill(gone[:, None], 0.0)


def smooth_field(b: int, h: int, w: int, on: torch.device, patch: int = _COARSE_PX) -> Tensor:
    """(b, h, w) smooth random fields, about evenly distributed over 0..1."""
    rows, columns = (_enlarged(-(-side // patch) + 1, side) for side in (h, w))
    coarse = torch.rand(b, rows.shape[1], columns.shape[1], device=on)
    field = rows.to(on) @ coarse @ columns.to(on).T
    centred = field - field.mean(dim=(1, 2), keepdim=True)
    scaled = centred / centred.std(dim=(1, 2), keepdim=True).clamp(min=1e-6)
    return 0.5 * (1 + torch.erf(scaled / 2**0.5))


@lru_cache(maxsize=16)
def _enlarged(count: int, size: int) -> Tensor:
    """(size, count) weights of the bicubic enlargement of a row; a product of two matrices takes a
    fraction of the time of `interpolate`."""
    rows = torch.eye(count)[None, None]
    return interpolate(rows, (size, count), mode="bicubic", align_corners=False)[0, 0]


def _ellipses(frames: _Frames) -> Tensor:
    b, h, w = frames.true.shape
    on = frames.true.device
    x, y = (frames.uniform(0, side, _ELLIPSES) for side in (w, h))
    long, short = (frames.uniform(*_RADII, _ELLIPSES) * w for _ in range(2))
    turn = frames.uniform(0, torch.pi, _ELLIPSES)
    there = torch.rand(b, _ELLIPSES, 1, 1, device=on) < 0.7
    dx = torch.arange(w, device=on) - x
    dy = torch.arange(h, device=on)[:, None] - y
    along, across = dx * turn.cos() + dy * turn.sin(), dy * turn.cos() - dx * turn.sin()
    inside = (along / long) ** 2 + (across / short) ** 2 < 1
    return (inside & there).any(dim=1)


def _band(frames: _Frames) -> Tensor:
    b, h, w = frames.true.shape
    on = frames.true.device
    u = torch.arange(w, device=on).expand(1, h, w) / w
    v = torch.arange(h, device=on)[:, None].expand(1, h, w) / h
    from_side = torch.stack([u, 1 - u, v, 1 - v], dim=1).expand(b, 4, h, w)
    side = torch.randint(4, (b,), device=on)
    distance = from_side[torch.arange(b, device=on), side]
    return distance < frames.uniform(*_BAND)


def _range(frames: _Frames) -> Tensor:
    true = frames.true
    far = true.amax(dim=(1, 2), keepdim=True)
    near = torch.where(true > 0, true, torch.inf).amin(dim=(1, 2), keepdim=True).minimum(far)
    depths = far - near
    beyond = true > far - frames.uniform(0, _RANGE) * depths
    return beyond | (true < near + frames.uniform(0, _RANGE / 3) * depths)


def _shadow(frames: _Frames) -> Tensor:
    """What one camera sees and another, to the left or right of it, does not."""
    true = frames.true
    b, _, w = true.shape
    shift = frames.K[:, 0, 0][:, None, None] * frames.uniform(*_BASELINE_M)
    left = torch.rand(b, 1, 1, device=true.device) < 0.5
    disparity = shift / torch.where(true > 0, true, torch.inf)
    u = torch.arange(w, device=true.device, dtype=true.dtype)
    # A camera to the left is one to the right in the mirror.
    seen = u - torch.where(left, disparity.flip(2), disparity)
    before = seen.flip(2).cummin(dim=2).values.flip(2)  # of this pixel and all right of it
    hidden = torch.zeros_like(seen, dtype=torch.bool)
    hidden[..., :-1] = before[..., 1:] < seen[..., :-1]
    return torch.where(left, hidden.flip(2), hidden) & (true > 0)


def _by_brightness(frames: _Frames, sign: int, limits: tuple[float, float]) -> Tensor:
    b, h, w = frames.true.shape
    grey = frames.color.mean(dim=1)
    apart = sign * (grey - grey.mean(dim=(1, 2), keepdim=True))
    extreme = apart > frames.uniform(*limits) * grey.std(dim=(1, 2), keepdim=True)
    return extreme & (smooth_field(b, h, w, grey.device, _FINE_PX) < 0.8)


def _patches(frames: _Frames) -> Tensor:
    b, h, w = frames.true.shape
    on = frames.true.device
    fine = smooth_field(b, h, w, on, _FINE_PX)
    return 0.7 * smooth_field(b, h, w, on) + 0.3 * fine < frames.uniform(0.1, 0.6)


def _silhouettes(frames: _Frames) -> Tensor:
    """Some objects of another frame, anywhere: no shape of a hole says what it is."""
    b, h, w = frames.other.shape
    taken = torch.rand(b, 256, device=frames.other.device) < 0.5
    taken[:, BACKGROUND] = False
    objects = taken.gather(1, frames.other.flatten(1).long()).reshape(b, h, w)
    moved = [int((2 * torch.rand(()) - 1) * _MOVED * side) for side in (h, w)]
    return objects.roll(moved, dims=(1, 2))


CAUSES: Mapping[str, Callable[[_Frames], Tensor]] = {
    "ellipses": _ellipses,
    "band": _band,
    "range": _range,
    "shadow": _shadow,
    "dark": lambda frames: _by_brightness(frames, -1, _DARK),
    "glossy": lambda frames: _by_brightness(frames, 1, _GLOSSY),
    "patches": _patches,
    "silhouettes": _silhouettes,
}
