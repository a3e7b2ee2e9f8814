"""Augmentation of colour, as published for SwinDRNet.

A share of the images gets each of four groups of changes. The operations are those of kornia,
because imgaug is no longer maintained. Where kornia has no equivalent, the nearest one is used:
plasma-fractal noise for simplex noise, one blurred line for `motion k3`.
"""

from collections.abc import Callable, Sequence

import kornia.augmentation as ka
import torch
from torch import Tensor

Change = Callable[[Tensor], Tensor]

_PATCHES, _TONES, _NOISES, _GAPS = 0.1, 0.3, 0.2, 0.2  # shares of the images


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
