"""The local matcher on any device of torch. Integer costs make it equal to the numba backend.

Includes the filters of a disparity map with holes, equal to those of `numba_backend`.
"""

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from sensors.stereo import local_options
from sensors.stereo.stereo_matcher import Disparity, Image
from std_toolkit.errors import ToolkitError

NEVER = 2**31 - 1

# Byte-wise population count of 64 bits; the census uses 48, so that no shift meets a sign.
_HALVES = (0x5555555555555555, 0x3333333333333333, 0x0F0F0F0F0F0F0F0F, 0x0101010101010101)


def match(left: Image, right: Image, options: local_options.LocalMatcherOptions) -> Disparity:
    """See `LocalMatcher.match`."""
    device = device_of(options)
    with torch.inference_mode():
        costs = _aggregated(_pixel_costs(left, right, options, device), options)
        found = _winners(costs, options)
        if options.median_px > 1:
            found = median(found, options.median_px)
        if options.speckle_px > 1:
            found = remove_speckles(found, options.speckle_px, options.speckle_step_px)
        return found.cpu().numpy()


def device_of(options: local_options.LocalMatcherOptions) -> torch.device:
    """The device to compute on.

    Raises:
        ToolkitError: torch does not know the device or cannot use it here.
    """
    name = options.device or ("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        problem = str(error).splitlines()[0]
        raise ToolkitError(
            f"torch cannot use this device: {problem}", field="device", value=name
        ) from error
    return device


def _pixel_costs(
    left: Image, right: Image, options: local_options.LocalMatcherOptions, device: torch.device
) -> Tensor:
    """(D, H, W) int32: cost of disparity min_disparity + d, 0 where the right pixel is outside."""
    height, width = left.shape
    costs = torch.zeros((options.count, height, width), dtype=torch.int32, device=device)
    # Copied: torch takes neither read-only arrays nor mirrored ones.
    pair = [torch.from_numpy(np.array(image)).to(device) for image in (left, right)]
    if options.cost is local_options.Cost.CENSUS:
        a, b = (_census(image) for image in pair)
        for i, d in _disparities(options, width):
            costs[i, :, d:] = _ones(a[:, d:] ^ b[:, : width - d])
        return costs
    size = options.zncc_px
    a, b = (_continued(image, size // 2).int() for image in pair)
    sums = [
        local_options.window_sums(image.to(torch.uint8).cpu().numpy(), size) for image in (a, b)
    ]
    (l_sum, l_inv), (r_sum, r_inv) = ([torch.from_numpy(v).to(device) for v in s] for s in sums)
    for i, d in _disparities(options, width):
        products = _box(a[:, d:] * b[:, : b.shape[1] - d], size)
        top = size * size * products - l_sum[:, d:] * r_sum[:, : width - d]
        correlation = top.double() * l_inv[:, d:] * r_inv[:, : width - d]
        costs[i, :, d:] = ((1.0 - correlation) * local_options.ZNCC_STEPS + 0.5).int()
    return costs


def _disparities(options: local_options.LocalMatcherOptions, width: int) -> list[tuple[int, int]]:
    """(index, disparity) of those that occur in the image width."""
    return [(i, d) for i, d in enumerate(range(options.min_disparity, width)) if i < options.count]


def _continued(image: Tensor, radius: int) -> Tensor:
    """(H + 2 radius, W + 2 radius): the image padded by its border pixels."""
    rows, columns = (
        torch.arange(-radius, n + radius, device=image.device).clamp(0, n - 1) for n in image.shape
    )
    return image[rows][:, columns]


def _census(image: Tensor) -> Tensor:
    """(H, W) int64, one bit for each neighbour in 7x7 that is darker."""
    height, width = image.shape
    padded = _continued(image, 3)
    out = torch.zeros((height, width), dtype=torch.int64, device=image.device)
    for dy in range(7):
        for dx in range(7):
            if (dy, dx) != (3, 3):
                out = (out << 1) | (padded[dy : dy + height, dx : dx + width] < image)
    return out


def _ones(word: Tensor) -> Tensor:
    """Number of set bits."""
    word = word - ((word >> 1) & _HALVES[0])
    word = (word & _HALVES[1]) + ((word >> 2) & _HALVES[1])
    word = (word + (word >> 4)) & _HALVES[2]
    # The top byte of the product is the sum of all bytes; 48 does not reach the sign bit.
    return (word * _HALVES[3]) >> 56


def _box(values: Tensor, size: int) -> Tensor:
    """(..., H, W) int32 to sums over size x size: (..., H - size + 1, W - size + 1)."""
    for axis in (-1, -2):
        sums = pad(values, (1, 0) if axis == -1 else (0, 0, 1, 0)).cumsum(axis, dtype=torch.int32)
        length = sums.shape[axis] - size
        values = sums.narrow(axis, size, length) - sums.narrow(axis, 0, length)
    return values


def _aggregated(costs: Tensor, options: local_options.LocalMatcherOptions) -> Tensor:
    """(D, H, W) int32 sums over the box, scaled to its full size; NEVER where there is no pixel."""
    count, height, width = costs.shape
    side, radius = options.aggregation_px, options.aggregation_px // 2
    x, y = torch.arange(width, device=costs.device), torch.arange(height, device=costs.device)
    rows = (y + radius + 1).clamp(max=height) - (y - radius).clamp(min=0)
    for i in range(count):
        d = options.min_disparity + i
        first = (x - radius).clamp(min=0).clamp(min=d)
        columns = (x + radius + 1).clamp(max=width) - first
        pixels = (rows[:, None] * columns.clamp(min=1)).int()
        sums = _box(pad(costs[i], (radius,) * 4), side)
        costs[i] = torch.where(
            x >= d, (sums * (side * side) + pixels // 2) // pixels, torch.full_like(sums, NEVER)
        )
    return costs


def _winners(costs: Tensor, options: local_options.LocalMatcherOptions) -> Tensor:
    """(H, W) float32 disparity, 0 = none; see `numba_kernels.winners`."""
    count, height, width = costs.shape
    index = torch.arange(count, dtype=torch.int32, device=costs.device)[:, None, None]
    # One disparity at a time: keys of the whole volume would double the memory.
    left_key = torch.full((height, width), NEVER, dtype=torch.int32, device=costs.device)
    right_key = left_key.clone()
    for i, d in _disparities(options, width):
        key = costs[i, :, d:] * local_options.DISPARITIES + i
        left_key[:, d:] = torch.minimum(left_key[:, d:], key)
        right_key[:, : width - d] = torch.minimum(right_key[:, : width - d], key)
    best = (left_key % local_options.DISPARITIES).long()
    x = torch.arange(width, device=costs.device)
    reach = (x - options.min_disparity + 1).clamp(min=0, max=count)
    valid = (left_key != NEVER) & (best > 0) & (best + 1 < reach)
    inner = best.clamp(1, count - 2)
    before, least, after = (costs.gather(0, (inner + k)[None])[0] for k in (-1, 0, 1))

    away = (index - inner.int()).abs() > 1
    second = torch.where(away, costs, NEVER).amin(0)
    share = 100 - options.uniqueness_percent
    valid &= (second == NEVER) | (least.long() * 100 < second.long() * share)
    if options.left_right_px is not None:
        partner = (x - options.min_disparity - inner).clamp(min=0)
        theirs = right_key.gather(1, partner) % local_options.DISPARITIES
        valid &= (theirs - inner).abs() <= options.left_right_px
    offset = _offset(before, least, after, options)
    disparity = (options.min_disparity + inner).float() + offset
    return torch.where(valid, disparity, torch.zeros_like(disparity))


def _offset(
    before: Tensor, least: Tensor, after: Tensor, options: local_options.LocalMatcherOptions
) -> Tensor:
    """Position of the minimum of the curve through three costs, -0.5 to 0.5 of a pixel."""
    curve = options.curve
    if curve is local_options.Subpixel.NONE:
        return torch.zeros_like(least, dtype=torch.float32)
    if curve is local_options.Subpixel.GAUSSIAN:
        plateau = options.gaussian_foot
        a, b, c = ((plateau - v.double()).clamp(min=plateau * 1e-3).log() for v in
                   (before, after, least))  # fmt: skip
        bend = a + b - 2 * c
        offset = torch.where(bend > -1e-12, 0, (a - b) / (2 * bend))
        return offset.clamp(-0.5, 0.5).float()
    # No sum may overflow 32 bits where a cost does not exist; such pixels are dropped anyway.
    before, after = before.long(), after.long()
    if curve is local_options.Subpixel.QUADRATIC:
        bend = 2 * (before + after - 2 * least)
    else:
        bend = 2 * (torch.maximum(before, after) - least)
    offset = (before - after).float() / bend.float()
    return torch.where(bend == 0, 0, offset)


def median(disparity: Tensor, side: int) -> Tensor:
    """(H, W): the (lower) median of the valid pixels in size side x side, for valid pixels."""
    height, width = disparity.shape
    radius = side // 2
    padded = pad(disparity, (radius,) * 4)
    around = torch.stack(
        [padded[v : v + height, u : u + width] for v in range(side) for u in range(side)]
    )
    valid = around > 0
    # Holes are sorted last.
    ordered = torch.where(valid, around, torch.inf).sort(dim=0).values
    middle = ((valid.sum(0) - 1) // 2).clamp(min=0)
    found = ordered.gather(0, middle[None])[0]
    return torch.where(disparity > 0, found, torch.zeros_like(found))


def remove_speckles(disparity: Tensor, smallest: int, step: float) -> Tensor:
    """(H, W) without connected patches of fewer than `smallest` valid pixels.

    Every pixel alternately takes the least label of its neighbours and the label of its label,
    until nothing changes: some tens of rounds, as the paths halve.
    """
    height, width = disparity.shape
    labels = torch.arange(height * width, device=disparity.device)
    grid = labels.view(height, width)
    right = _connected(disparity[:, :-1], disparity[:, 1:], step)
    down = _connected(disparity[:-1], disparity[1:], step)
    pairs = torch.cat(
        [
            torch.stack([grid[:, :-1][right], grid[:, 1:][right]]),
            torch.stack([grid[:-1][down], grid[1:][down]]),
        ],
        dim=1,
    )
    while True:
        roots = labels[pairs]
        low, high = roots.amin(0), roots.amax(0)
        if bool((low == high).all()):
            break
        labels = labels.scatter_reduce(0, high, low, "amin")
        while True:
            jumped = labels[labels]
            if bool((jumped == labels).all()):
                break
            labels = jumped
    size = torch.zeros_like(labels).scatter_add_(0, labels, torch.ones_like(labels))
    large = (size[labels] >= smallest).view(height, width)
    return torch.where(large, disparity, torch.zeros_like(disparity))


def _connected(a: Tensor, b: Tensor, step: float) -> Tensor:
    return (a > 0) & (b > 0) & ((a - b).abs() <= step)
