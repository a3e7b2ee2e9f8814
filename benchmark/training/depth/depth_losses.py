"""Losses of SwinDRNet, DFNet (Fang et al., RA-L 2022) and NLSPN (Park et al., ECCV 2020).

Slopes and normals of depth maps, with masks of the pixels where they are defined.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy, conv2d, max_pool2d, pad

from benchmark.methods.network import Prediction
from benchmark.methods.torch_camera import points_of
from benchmark.training.step import (
    Loss,
    Target,
    constant,
    mean_where,
    object_weights,
    weighted_mean,
)

_SOBEL = (-1.0, 0.0, 1.0, -2.0, 0.0, 2.0, -1.0, 0.0, 1.0)

_SMALLEST = 1e-8  # square metres: keeps the length of a cross product from being 0

# Focal length of the released program at the width that it has it for, and that width and height.
_RELEASED_FOCAL, _RELEASED_SIZE = 446.31, (640, 360)

_USUAL = 0.05  # metres: an error whose square weighs as much as itself

_FAR = 0.2  # metres: farther off, squares grow no faster than at that

_RIGHT = 0.01  # metres: a sensor nearer to the truth is to be trusted

_SURE = 1e-4

_KNOWN = 1e-4  # metres; less is no ground truth


def sobel(images: Tensor) -> Tensor:
    """Slopes to the right and downwards: the 3x3 Sobel sums, not divided by anything.

    Args:
        images: (b, 1, h, w), taken as 0 outside.

    Returns:
        (b, 2, h, w).
    """
    right = constant(_SOBEL, images).reshape(3, 3)
    return conv2d(images, torch.stack([right, right.T])[:, None], padding=1)


def normals(depth: Tensor, K: Tensor) -> Tensor:
    """Unit normals, from the differences to the points behind the next pixels right and below.

    Args:
        depth: (b, 1, h, w) metres.
        K: (b, 3, 3) intrinsics.

    Returns:
        (b, 3, h, w), away from the camera where depth is positive. The last row and column repeat
        their neighbours.
    """
    at = points_of(depth, K)
    here = at[..., :-1, :-1]
    to_right, below = at[..., :-1, 1:] - here, at[..., 1:, :-1] - here
    across = torch.linalg.cross(to_right, below, dim=1)
    # Under the root, so that the gradient of a length of 0 is 0 and not NaN.
    length = (across.square().sum(dim=1, keepdim=True) + _SMALLEST**2).sqrt()
    return pad(across / length, (0, 1, 0, 1), mode="replicate")


def whole_around(known: Tensor) -> Tensor:
    """(b, 1, h, w) bool: pixels whose 3x3 surroundings are known, as far as the image goes."""
    unknown = (~known).to(torch.float32)
    return max_pool2d(unknown, 3, stride=1, padding=1) == 0


@dataclass(frozen=True, kw_only=True)
class SwinDRNetLoss:
    """Depth, normals and slopes of the final and of the initial depth, by pixel.

    A pixel's part is |p - g| + `squared` * (p - g)^2 / 5 cm + `normals` * mean |n(p) - n(g)| +
    `slopes` * (|Sx(p - g)| + |Sy(p - g)|), for the final depth and `initial` times for the initial
    one; the loss is `foreground` times its mean over the pixels of objects + `background` times
    that over the others, each over the whole batch.

    Attributes:
        normals, slopes, initial, foreground, background: weights; the published ones.
        squared: weight of the squared error (from 20 cm on its tangent), which the published loss
            has not. Where it is not certain what is there, |p - g| is least for the likelier
            depth, and the square for the mean, whose RMSE is less.
        confidence: weight of the cross entropy between the confidence and whether the sensor is
            within 1 cm of the truth, weighed by foreground and background as all parts. The
            published network learns its confidence from the final depth alone.
        near: metres; pixels farther away than this count (near / g)^2: the error of stereo grows
            with g^2. Otherwise, with `squared`, walls metres away outweigh table and objects. None
            for equal weights, as published.
        form: `paper` leaves out pixels without ground truth, and normals and slopes next to them,
            and computes normals with each frame's camera. `released` does as the authors'
            program: a missing truth is a depth of 0, and one camera is everyone's. On DREDS, where
            the truth is whole and the camera is that one, they are the same up to the camera's
            principal point.
    """

    normals: float = 0.1
    slopes: float = 0.6
    squared: float = 0.0
    confidence: float = 0.0
    initial: float = 0.4
    foreground: float = 1.0
    background: float = 0.4
    near: float | None = None
    form: Literal["paper", "released"] = "paper"

    def __call__(self, prediction: Prediction, target: Target) -> Loss:
        K = target.K if self.form == "paper" else released_camera(target.depth)
        known = target.depth > 0 if self.form == "paper" else torch.ones_like(target.foreground)
        final, parts = self._of_pixels(prediction.depth, target.depth, K, known)
        by_pixel = final
        if prediction.initial is not None and prediction.initial is not prediction.depth:
            by_pixel = (
                final
                + self.initial * self._of_pixels(prediction.initial, target.depth, K, known)[0]
            )
        if self.confidence and prediction.confidence is not None:
            trusted = self._of_trust(prediction.confidence, target)
            parts["trust"] = mean_where(trusted, known).detach()
            by_pixel = by_pixel + self.confidence * trusted
        if self.near is not None:
            by_pixel = by_pixel * (self.near / target.depth.clamp(min=self.near)).square()
        inside = mean_where(by_pixel, known & target.foreground)
        outside = mean_where(by_pixel, known & ~target.foreground)
        total = self.foreground * inside + self.background * outside
        return Loss(total, {"foreground": inside.detach(), "background": outside.detach(), **parts})

    def _of_trust(self, confidence: Tensor, target: Target) -> Tensor:
        assert target.sensor is not None  # as the step gives it
        right = (target.sensor > 0) & ((target.sensor - target.depth).abs() < _RIGHT)
        # A logarithm of 0 has no gradient.
        inner = confidence.clamp(_SURE, 1 - _SURE)
        return binary_cross_entropy(inner, right.to(inner.dtype), reduction="none")

    def _of_pixels(
        self, depth: Tensor, true: Tensor, K: Tensor, known: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """(b, 1, h, w) the loss by pixel, and its parts' means."""
        around = whole_around(known)
        distance = (depth - true).abs()
        turned = (normals(depth, K) - normals(true, K)).abs().mean(dim=1, keepdim=True)
        turned = turned.masked_fill(~around, 0.0)
        steeper = sobel(depth - true).abs().sum(dim=1, keepdim=True).masked_fill(~around, 0.0)
        parts = {
            "depth": mean_where(distance, known).detach(),
            "normals": mean_where(turned, known).detach(),
            "slopes": mean_where(steeper, known).detach(),
        }
        near = distance.clamp(max=_FAR)
        square = self.squared * near * (2 * distance - near) / _USUAL
        return distance + square + self.normals * turned + self.slopes * steeper, parts


def released_camera(depth: Tensor) -> Tensor:
    """(b, 3, 3) the one camera of the authors' program, at the size of the depth."""
    b, _, h, w = depth.shape
    K = torch.zeros(b, 3, 3, dtype=depth.dtype, device=depth.device)
    K[:, 0, 0] = _RELEASED_FOCAL * w / _RELEASED_SIZE[0]
    K[:, 1, 1] = _RELEASED_FOCAL * h / _RELEASED_SIZE[1]
    K[:, 0, 2], K[:, 1, 2], K[:, 2, 2] = w / 2 - 0.5, h / 2 - 0.5, 1.0
    return K


@dataclass(frozen=True, kw_only=True)
class DFNetLoss:
    """Squared error + `smoothness` * (1 - cosine between the normals), over the pixels whose true
    depth is in range.

    Attributes:
        smoothness: weight; the published one.
        near, far: metres, the range of the published network.
        foreground_only: compare only pixels of objects. The paper compares all.
        objects: how many times as much as others pixels of objects count in the squared error, as
            published 1.
    """

    smoothness: float = 0.001
    near: float = 0.3
    far: float = 1.5
    foreground_only: bool = False
    objects: float = 1.0

    def __call__(self, prediction: Prediction, target: Target) -> Loss:
        true = target.depth
        known = (true >= self.near) & (true <= self.far)
        compared = known & target.foreground if self.foreground_only else known
        error = (prediction.depth - true).masked_fill(~compared, 0.0)
        squared = weighted_mean(error.square(), object_weights(target, self.objects) * compared)
        both = normals(prediction.depth, target.K) * normals(true, target.K)
        bent = mean_where(1 - both.sum(dim=1, keepdim=True), compared & whole_around(known))
        return Loss(
            squared + self.smoothness * bent,
            {"squared": squared.detach(), "bent": bent.detach()},
        )


@dataclass(frozen=True, kw_only=True)
class NLSPNLoss:
    """Absolute and squared error of the final depth alone: means over each image's pixels with
    ground truth, then over the batch.

    Attributes:
        absolute, squared: weights; the published ones.
        objects: how many times as much as others pixels of objects count, as published 1.
        farthest: metres; truth and prediction are limited to [0, farthest], as in the authors'
            program (10 m indoors). A prediction outside receives no gradient. None for no limit,
            which is what the paper's formula says; the truth of the data sets here is below 10 m
            either way.
    """

    absolute: float = 1.0
    squared: float = 1.0
    objects: float = 1.0
    farthest: float | None = 10.0

    def __call__(self, prediction: Prediction, target: Target) -> Loss:
        depth, true = prediction.depth, target.depth
        known = true > _KNOWN
        if self.farthest is not None:
            depth, true = depth.clamp(0, self.farthest), true.clamp(0, self.farthest)
        error = (depth - true).masked_fill(~known, 0.0)
        weights = object_weights(target, self.objects) * known
        absolute, squared = _by_image(error.abs(), weights), _by_image(error.square(), weights)
        return Loss(
            self.absolute * absolute + self.squared * squared,
            {"absolute": absolute.detach(), "squared": squared.detach()},
        )


def _by_image(values: Tensor, weights: Tensor) -> Tensor:
    return weighted_mean(values, weights, dim=(1, 2, 3)).mean()
