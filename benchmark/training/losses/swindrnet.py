"""The loss of SwinDRNet (Dai et al., ECCV 2022, section 5.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy

from benchmark.methods.network import Prediction
from benchmark.training.losses.surfaces import normals, sobel, whole_around
from benchmark.training.losses.terms import Loss, Target, mean_where

# Focal length of the released program at the width that it has it for, and that width and height.
_RELEASED_FOCAL, _RELEASED_SIZE = 446.31, (640, 360)

_USUAL = 0.05  # metres: an error whose square weighs as much as itself
_FAR = 0.2  # metres: farther off, squares grow no faster than at that
_RIGHT = 0.01  # metres: a sensor nearer to the truth is to be trusted
_SURE = 1e-4


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
