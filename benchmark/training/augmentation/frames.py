"""Augmentation of whole frames: turned, mirrored and enlarged, with objects of others, on patterned
floors.

Geometry as published for NLSPN on indoor scenes: rotation, mirroring, enlargement.
"""

import math

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate

from benchmark.data.frame import BACKGROUND, Material
from benchmark.training.augmentation.holes import smooth_field
from benchmark.training.step import Batch, ModelInput, made_of

_PASTED = 127  # first instance id of pasted objects

_TAKEN = 0.5  # share of a frame's objects that are pasted

_TURN = math.radians(5.0)  # at most, either way

_LARGEST = 1.5

_OF_POSES = ("nocs", "classes")

_KEPT = ("true", "mask", "materials", "K", "index", "behind")

# By class: the axis across which an object is symmetric, of its normalised coordinates. A mirrored
# object is one of its class with this coordinate mirrored, too: a mug across its handle, the others
# from side to side. What is round about y is symmetric across either.
_ACROSS = {1: 0, 2: 0, 3: 0, 4: 0, 5: 0, 6: 2, 7: 0}


@torch.no_grad()
def cropped(inputs: ModelInput, size: tuple[int, int]) -> ModelInput:
    """The largest part of the frames with the proportions of a size, anywhere, at that size.

    Colour is averaged where it becomes smaller; depth and masks go by the nearest pixel.

    Args:
        inputs: frames; those of the batch may be larger or smaller.
        size: width and height.
    """
    h, w = inputs.depth.shape[-2:]
    scale = min(w / size[0], h / size[1])
    width, height = (
        min(round(scale * side), most) for side, most in zip(size, (w, h), strict=True)
    )
    x, y = (int(torch.randint(most - side + 1, ())) for side, most in ((width, w), (height, h)))

    def part(images: Tensor) -> Tensor:
        return images[..., y : y + height, x : x + width]

    def nearest(maps: Tensor) -> Tensor:
        rows = ((torch.arange(size[1], device=maps.device) + 0.5) * height / size[1]).long()
        columns = ((torch.arange(size[0], device=maps.device) + 0.5) * width / size[0]).long()
        return part(maps)[..., rows[:, None], columns]

    batch = dict(inputs.batch)
    for name in ("true", "mask", "behind"):
        if name in batch:
            batch[name] = nearest(batch[name])
    if "nocs" in batch:
        batch["nocs"] = nearest(batch["nocs"].permute(0, 3, 1, 2)).permute(0, 2, 3, 1)
    K = batch["K"].clone()
    K[:, 0, 2], K[:, 1, 2] = K[:, 0, 2] + 0.5 - x, K[:, 1, 2] + 0.5 - y
    K[:, 0] *= size[0] / width
    K[:, 1] *= size[1] / height
    K[:, :2, 2] -= 0.5
    batch["K"] = K
    color = interpolate(
        part(inputs.color), size[::-1], mode="bilinear", align_corners=False, antialias=True
    )
    return ModelInput(color.clamp(0, 1), nearest(inputs.depth), batch)


@torch.no_grad()
def copy_paste(inputs: ModelInput, share: float) -> ModelInput:
    """Objects of other frames of the batch among those of a share of the frames (Ghiasi et al.,
    CVPR 2021), each where it stood in its own frame and in front of or behind what is there.

    Depths of the other frame are multiplied so that both backgrounds have the same mean distance.
    Half of its objects are taken; instance ids from 127 are theirs. Frames that have such ids
    before take none. The batch gets `behind`, (b, h, w) metres: the exact depth that pasted objects
    hide, 0 elsewhere.
    """
    batch = dict(inputs.batch)
    mask, true = batch["mask"], batch["true"]
    b, on = len(mask), mask.device

    def of_other(values: Tensor) -> Tensor:
        return values.roll(1, dims=0)

    own, other = _distance(true, mask), _distance(of_other(true), of_other(mask))
    factor = torch.where((own > 0) & (other > 0), own / other.clamp(min=1e-6), 1.0)
    chosen = torch.rand(b, 256, device=on) < _TAKEN
    chosen &= torch.rand(b, 1, device=on) < share
    free = ((mask < _PASTED) | (mask == BACKGROUND)).flatten(1).all(dim=1)
    chosen &= (free & of_other(free) & (b > 1))[:, None]
    chosen[:, _PASTED:] = False

    theirs, depth = of_other(mask), of_other(true) * factor[:, None, None]
    hit = chosen.gather(1, theirs.flatten(1).long()).reshape(mask.shape)
    hit &= (depth > 0) & ((depth < true) | (true == 0))
    scaled = of_other(inputs.depth) * factor[:, None, None, None]
    batch["behind"] = torch.where(hit, true, 0.0)
    batch["true"] = torch.where(hit, depth, true)
    batch["mask"] = torch.where(hit, theirs + _PASTED, mask)
    if "nocs" in batch:
        batch["nocs"] = torch.where(hit[..., None], of_other(batch["nocs"]), batch["nocs"])
    for name in ("materials", "classes"):
        if name in batch:
            table = batch[name].clone()
            table[:, _PASTED : 2 * _PASTED] = of_other(table)[:, :_PASTED]
            batch[name] = table
    return ModelInput(
        torch.where(hit[:, None], of_other(inputs.color), inputs.color),
        torch.where(hit[:, None], scaled, inputs.depth),
        batch,
    )


def _distance(true: Tensor, mask: Tensor) -> Tensor:
    """(b,) mean depth of the background, metres; 0 without any."""
    behind = ((mask == BACKGROUND) & (true > 0)).to(true.dtype)
    return (true * behind).sum(dim=(1, 2)) / behind.sum(dim=(1, 2)).clamp(min=1)


def moved(inputs: ModelInput) -> ModelInput:
    """Every frame mirrored or not, turned by up to 5 degrees and enlarged up to 1.5 times.

    Intrinsics stay as they are: the camera rolls about its axis, whatever the pixels' aspect, and
    the scene is mirrored in the plane through axis and vertical; depth is the same then. What is
    enlarged by s lies at depth / s, as published: points keep their x and y. Depth and masks go
    by the nearest pixel; what comes from outside of the image is unknown.

    The batch keeps `true`, `mask`, `nocs`, `behind` and what is no map. All draws are from torch's
    global generator.
    """
    batch = {n: inputs.batch[n] for n in (*_KEPT, *_OF_POSES) if n in inputs.batch}
    b, _, h, w = inputs.depth.shape
    motion, scale = _motions(b)
    motion, scale = motion.to(inputs.depth), scale.to(inputs.depth)
    places = _sources(motion, batch["K"].to(inputs.depth), h, w)
    size = torch.tensor([w - 1, h - 1], device=places.device).clamp(min=1)
    grid = 2 * places / size - 1

    def nearest(maps: Tensor) -> Tensor:
        return grid_sample(maps, grid, mode="nearest", padding_mode="zeros", align_corners=True)

    color = grid_sample(
        inputs.color, grid, mode="bilinear", padding_mode="zeros", align_corners=True
    )
    smaller = scale[:, None, None, None]
    true = nearest(batch["true"][:, None]) / smaller
    # Outside there is 0, which is to be the background.
    apart = nearest((BACKGROUND - batch["mask"].to(inputs.depth))[:, None])
    batch["true"] = true[:, 0]
    if "behind" in batch:
        batch["behind"] = (nearest(batch["behind"][:, None]) / smaller)[:, 0]
    batch["mask"] = (BACKGROUND - apart[:, 0]).round().to(torch.uint8)
    if "nocs" in batch:
        maps = nearest(batch["nocs"].permute(0, 3, 1, 2).to(inputs.depth)).round()
        mirrored = torch.linalg.det(motion) < 0
        batch["nocs"] = _mirrored(maps, batch, mirrored).to(torch.uint8).permute(0, 2, 3, 1)
    return ModelInput(color.clamp(0, 1), nearest(inputs.depth) / smaller, batch)


def _mirrored(nocs: Tensor, batch: Batch, which: Tensor) -> Tensor:
    """Coordinates (b, 3, h, w) in 0..255 of which (b,) are of mirrored frames."""
    mask = batch["mask"]
    classes = batch["classes"].gather(1, mask.flatten(1).long()).reshape(mask.shape)
    known = which[:, None, None] & (nocs > 0).any(dim=1)
    axis = torch.full_like(classes, -1, dtype=torch.int8)
    for class_id, one in _ACROSS.items():
        axis[classes == class_id] = one
    swapped = [
        torch.where(known & (axis == number), 255 - nocs[:, number], nocs[:, number])
        for number in range(3)
    ]
    return torch.stack(swapped, dim=1)


def _motions(count: int) -> tuple[Tensor, Tensor]:
    """(count, 2, 2) what becomes of points (x, y) at z = 1, and (count,) the enlargement in it."""
    scale = 1 + (_LARGEST - 1) * torch.rand(count)
    angle = _TURN * (2 * torch.rand(count) - 1)
    side = 1 - 2 * (torch.rand(count) < 0.5).float()
    cosine, sine = scale * angle.cos(), scale * angle.sin()
    rows = (torch.stack([side * cosine, -sine], 1), torch.stack([side * sine, cosine], 1))
    return torch.stack(rows, dim=1), scale


def _sources(motion: Tensor, K: Tensor, h: int, w: int) -> Tensor:
    """(b, h, w, 2) from which place (u, v) of the image every pixel comes."""
    v, u = torch.meshgrid(
        torch.arange(h, dtype=K.dtype, device=K.device),
        torch.arange(w, dtype=K.dtype, device=K.device),
        indexing="ij",
    )
    centre = K[:, :2, 2][:, None, None]
    focal = torch.stack([K[:, 0, 0], K[:, 1, 1]], dim=1)[:, None, None]
    points = (torch.stack([u, v], dim=2) - centre) / focal
    back = torch.linalg.inv(motion)
    return torch.einsum("bij,bhwj->bhwi", back, points) * focal + centre


# Sizes of the patches of a pattern, how hard their borders are, and how strong it is.
_PATCHES_PX, _HARDNESS, _STRENGTH = (2, 4, 8, 16), (2.0, 20.0), (0.2, 0.9)
_THROUGH, _BENT_PX = 0.7, 4  # of a pattern seen through glass, and by how much it is moved there


@torch.no_grad()
def with_patterns(inputs: ModelInput, share: float) -> Tensor:
    """Colour (b, 3, h, w) with random patterns on the background of a share of the frames.

    Simulated floors are plainer than real ones, on which a mask takes speckles for glass. Through
    glass the pattern is seen weaker, and moved by up to 4 pixels.
    """
    color, mask = inputs.color, inputs.batch["mask"]
    b, _, h, w = color.shape
    on = color.device
    sizes = [_PATCHES_PX[int(torch.randint(len(_PATCHES_PX), ()))] for _ in range(2)]
    coarse, fine = (smooth_field(3 * b, h, w, on, size).reshape(b, 3, h, w) for size in sizes)
    hard, strength = (
        torch.empty(b, 1, 1, 1, device=on).uniform_(*limits) for limits in (_HARDNESS, _STRENGTH)
    )
    field = torch.sigmoid((0.6 * coarse + 0.4 * fine - 0.5) * hard)
    chosen = torch.rand(b, 1, 1, 1, device=on) < share
    apart = chosen * strength * (2 * field - 1)
    glass = made_of(inputs.batch, Material.TRANSPARENT)[:, None]
    moved = [int(torch.randint(-_BENT_PX, _BENT_PX + 1, ())) for _ in range(2)]
    through = _THROUGH * apart.roll(moved, dims=(2, 3))
    floor = (mask == BACKGROUND)[:, None]
    apart = torch.where(floor, apart, torch.where(glass, through, 0.0))
    return (color * (1 + apart)).clamp(0, 1)
