"""Augmentation of colour, depth and geometry.

Colour as published for SwinDRNet: a share of the images gets each of four groups of changes. The
operations are those of kornia, because imgaug is no longer maintained. Where kornia has no
equivalent, the nearest one is used: plasma-fractal noise for simplex noise, one blurred line for
`motion k3`. Geometry as published for NLSPN on indoor scenes: rotation, mirroring, enlargement.
"""

import math
from collections.abc import Callable, Sequence

import kornia.augmentation as ka
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample, interpolate

from benchmark.data.frame import BACKGROUND, Material
from benchmark.training.step import Batch, ModelInput

Change = Callable[[Tensor], Tensor]

_PATCHES, _TONES, _NOISES, _GAPS = 0.1, 0.3, 0.2, 0.2  # shares of the images

# Chances that the depth of an object is replaced, in a frame with such objects.
_DROPOUT_CLEAR, _DROPOUT_OPAQUE = 0.6, 0.15
# Ways of it, as limits of a uniform draw: no depth, specks, background, true depth, then patches.
_WAYS = (0.25, 0.4, 0.65, 0.75)
_PATCH = 24  # px, size of patches
_PATCH_LIMITS = (0.35, 0.7)  # background below, no depth above, else as the sensor has it
_SPECKS = 0.1  # largest share of missing readings beside the way "specks"
_NOISE = 0.002  # relative

_PASTED = 127  # first instance id of pasted objects

_TAKEN = 0.5  # share of a frame's objects that are pasted

_TURN = math.radians(5.0)  # at most, either way

_LARGEST = 1.5

_OF_POSES = ("nocs", "classes")

_KEPT = ("true", "mask", "materials", "K", "index")

# By class: the axis across which an object is symmetric, of its normalised coordinates. A mirrored
# object is one of its class with this coordinate mirrored, too: a mug across its handle, the others
# from side to side. What is round about y is symmetric across either.
_ACROSS = {1: 0, 2: 0, 3: 0, 4: 0, 5: 0, 6: 2, 7: 0}


class ColorAugmentation:
    """Colour (b, 3, h, w) in [0, 1] to changed colour; every image by its own draw.

    All draws are from torch's global generator.
    """

    def __init__(self) -> None:
        self.tones: tuple[Change, ...] = (
            lambda x: (x + 20 / 255).clamp(0, 1),
            lambda x: (x * 1.3).clamp(0, 1),
            # A shift by up to 200 of imgaug's 255 is any hue at all.
            ka.RandomHue((-0.5, 0.5)),
            _more_or_less_saturated,
            ka.RandomContrast((0.5, 1.5)),
            _greyer,
        )
        self.blurs: tuple[Change, ...] = (
            ka.RandomMotionBlur(3, (0.0, 360.0), (-1.0, 1.0), border_type="replicate", p=1.0),
            ka.RandomGaussianBlur((5, 5), (0.5, 1.0), p=1.0),
        )
        self.noises: tuple[Change, ...] = (
            lambda x: (x + _uniform(x, -5 / 255, 5 / 255, x.shape)).clamp(0, 1),
            lambda x: (x * _uniform(x, 0.95, 1.05, x.shape)).clamp(0, 1),
            lambda x: (x + 0.01 * torch.randn_like(x)).clamp(0, 1),
            _laplace,
            _pixels_lost,
        )

    @torch.no_grad()
    def __call__(self, color: Tensor) -> Tensor:
        color = _on_some(color, _PATCHES, _bright_patches)
        color = _on_some(color, _TONES, lambda x: _one_of(x, self.tones))
        color = _on_some(color, _NOISES, lambda x: _one_of(_one_of(x, self.blurs), self.noises))
        return _on_some(color, _GAPS, _coarse_gaps)


def jitter() -> Change:
    """Brightness, contrast and saturation by up to 0.4, as published for NLSPN."""
    return ka.ColorJitter(0.4, 0.4, 0.4, p=1.0)


@torch.no_grad()
def drop_object_depth(
    depth: Tensor, true: Tensor, mask: Tensor, materials: Tensor, share: float
) -> Tensor:
    """Sensor depth in which that of some objects is replaced, in a share of the frames.

    Each such object has no depth at all, no depth in specks, the depth of what is behind it, its
    true depth, or patches of all of these. Glass and metal are chosen more often than the others.

    Args:
        depth: (b, 1, h, w) metres, 0 = none.
        true: (b, h, w) exact depth, 0 = none.
        mask: (b, h, w) uint8 instance ids, 255 elsewhere.
        materials: (b, 256) `Material` of each instance, 255 = none.
        share: of the frames.
    """
    b, _, h, w = depth.shape
    on = depth.device
    clear = (materials == Material.SPECULAR) | (materials == Material.TRANSPARENT)
    hit = torch.rand(b, 256, device=on) < torch.where(clear, _DROPOUT_CLEAR, _DROPOUT_OPAQUE)
    hit &= torch.rand(b, 1, device=on) < share
    hit[:, 255] = False

    def of_objects(values: Tensor) -> Tensor:
        return values.gather(1, mask.flatten(1).long()).reshape(b, h, w)

    objects = of_objects(hit)
    if not objects.any():
        return depth
    way = of_objects(torch.rand(b, 256, device=on))
    patches = _patches(b, h, w, on)
    gone, specks, behind, measured = (way < limit for limit in _WAYS)
    patched = ~measured
    measured, behind = measured & ~behind, behind & ~specks
    specks = specks & ~gone
    behind = behind | (patched & (patches < _PATCH_LIMITS[0]))
    gone = gone | (patched & (patches > _PATCH_LIMITS[1]))
    # Readings are missing here and there in every case, by a share of the object's own.
    missing = torch.rand(b, h, w, device=on) < torch.where(specks, 1.0, _SPECKS) * of_objects(
        torch.rand(b, 256, device=on)
    )
    errors = 1 + _NOISE * torch.randn(b, h, w, device=on)
    found = torch.where(measured, true * errors, depth[:, 0])
    found = torch.where(behind, _background(true, mask) * errors, found)
    found = found.masked_fill(gone | missing, 0.0)
    return torch.where(objects, found, depth[:, 0])[:, None]


@torch.no_grad()
def copy_paste(inputs: ModelInput, share: float) -> ModelInput:
    """Objects of other frames of the batch among those of a share of the frames (Ghiasi et al.,
    CVPR 2021), each where it stood in its own frame and in front of or behind what is there.

    Depths of the other frame are multiplied so that both backgrounds have the same mean distance.
    Half of its objects are taken; instance ids from 127 are theirs. Frames that have such ids
    before take none.
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


def _patches(b: int, h: int, w: int, on: torch.device) -> Tensor:
    """(b, h, w) smooth fields, evenly distributed over 0..1."""
    coarse = torch.rand(b, 1, -(-h // _PATCH), -(-w // _PATCH), device=on)
    fine = interpolate(coarse, (h, w), mode="bicubic", align_corners=False)[:, 0]
    order = fine.flatten(1).argsort(dim=1).argsort(dim=1)
    return (order.to(fine.dtype) / (h * w)).reshape(b, h, w)


def _background(true: Tensor, mask: Tensor) -> Tensor:
    """(b, h, w) depth of what surrounds the objects, continued smoothly behind them."""
    weight = ((mask == BACKGROUND) & (true > 0)).to(true.dtype)[:, None]
    sums = [(true[:, None] * weight, weight)]
    while min(sums[-1][0].shape[2:]) > 1:
        value, weight = (avg_pool2d(x, 2, ceil_mode=True) for x in sums[-1])
        sums.append((value, weight))
    value, weight = sums[-1]
    filled = value / weight.clamp(min=1e-6)
    for value, weight in reversed(sums[:-1]):
        coarse = interpolate(filled, value.shape[2:], mode="bilinear", align_corners=False)
        filled = torch.where(weight > 0, value / weight.clamp(min=1e-6), coarse)
    return filled[:, 0]


def _on_some(images: Tensor, share: float, change: Change) -> Tensor:
    """`change` on each image with a chance of `share`."""
    chosen = (torch.rand(len(images)) < share).nonzero()[:, 0].to(images.device)
    if not len(chosen):
        return images
    return images.index_copy(0, chosen, change(images[chosen]).to(images.dtype))


def _one_of(images: Tensor, changes: Sequence[Change]) -> Tensor:
    """Each image through one of the changes."""
    which = torch.randint(len(changes), (len(images),))
    for number, change in enumerate(changes):
        chosen = (which == number).nonzero()[:, 0].to(images.device)
        if len(chosen):
            images = images.index_copy(0, chosen, change(images[chosen]).to(images.dtype))
    return images


def _uniform(like: Tensor, low: float, high: float, shape: Sequence[int]) -> Tensor:
    return torch.empty(*shape, device=like.device).uniform_(low, high)


def _per_image(like: Tensor, low: float, high: float) -> Tensor:
    return _uniform(like, low, high, (len(like), 1, 1, 1))


def _bright_patches(images: Tensor) -> Tensor:
    """1.5 to 3 times as bright where a cloud of noise is, blended in by up to 0.2 to 0.7."""
    from kornia.contrib import diamond_square

    b, _, h, w = images.shape
    roughness = _uniform(images, 0.4, 0.6, (b, 1, 1, 1))
    cloud = diamond_square((b, 1, h, w), roughness, device=images.device)
    cloud = (cloud - cloud.amin(dim=(2, 3), keepdim=True)) / (
        cloud.amax(dim=(2, 3), keepdim=True) - cloud.amin(dim=(2, 3), keepdim=True) + 1e-6
    )
    share = _per_image(images, 0.2, 0.7) * (cloud > 0.5)
    bright = (images * _per_image(images, 1.5, 3.0)).clamp(0, 1)
    return images + share * (bright - images)


def _more_or_less_saturated(images: Tensor) -> Tensor:
    """Saturation up or down by up to 20 of 255."""
    from kornia.color import hsv_to_rgb, rgb_to_hsv

    hue, saturation, value = rgb_to_hsv(images).split(1, dim=1)
    saturation = (saturation + _per_image(images, -20 / 255, 20 / 255)).clamp(0, 1)
    return hsv_to_rgb(torch.cat([hue, saturation, value], dim=1))


def _greyer(images: Tensor) -> Tensor:
    from kornia.color import rgb_to_grayscale

    share = _per_image(images, 0.0, 1.0)
    return images + share * (rgb_to_grayscale(images) - images)


def _laplace(images: Tensor) -> Tensor:
    scale = _per_image(images, 1e-6, 0.01)
    sign = torch.rand(images.shape, device=images.device) < 0.5
    size = torch.empty_like(images).exponential_() * scale
    return (images + torch.where(sign, size, -size)).clamp(0, 1)


def _pixels_lost(images: Tensor) -> Tensor:
    b, _, h, w = images.shape
    lost = torch.rand(b, 1, h, w, device=images.device) < _per_image(images, 0.003, 0.01)
    return images.masked_fill(lost, 0.0)


def _coarse_gaps(images: Tensor) -> Tensor:
    """Black squares with sides of 4 to 16 pixels over 2 % of the image."""
    b, _, h, w = images.shape
    side = int(torch.randint(4, 17, ()))
    coarse = torch.rand(b, 1, -(-h // side), -(-w // side), device=images.device) < 0.02
    fine = coarse.repeat_interleave(side, dim=2).repeat_interleave(side, dim=3)[..., :h, :w]
    return images.masked_fill(fine, 0.0)


def moved(inputs: ModelInput) -> ModelInput:
    """Every frame mirrored or not, turned by up to 5 degrees and enlarged up to 1.5 times.

    Intrinsics stay as they are: the camera rolls about its axis, whatever the pixels' aspect, and
    the scene is mirrored in the plane through axis and vertical; depth is the same then. What is
    enlarged by s lies at depth / s, as published: points keep their x and y. Depth and masks go
    by the nearest pixel; what comes from outside of the image is unknown.

    The batch keeps `true`, `mask`, `nocs` and what is no map. All draws are from torch's global
    generator.
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
