"""Base of pose networks: tensors from views, poses from NOCS coordinates at pixels."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import interpolate

from benchmark.data.frame import resize_nearest
from benchmark.methods.network import HeldNetwork, color_and_depth, count_macs
from benchmark.methods.pose.fitting import FitMethod, FitOptions, FittedPose, fit_pose
from benchmark.methods.pose.segmented import Segmented
from benchmark.methods.protocol import Estimated, PoseView, View
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.pose.pose_frames import PosePrediction
from std_toolkit.errors import ToolkitError

_LEAST_POINTS = 4  # three points leave a fit nothing to be checked by


class Found(NamedTuple):
    """What a network sees in an image.

    Attributes:
        segmented: the objects, at the network's size.
        coordinates: (h, w, 3) or (N, h, w, 3) float32 normalised coordinates in [0, 1].
    """

    segmented: Segmented
    coordinates: NDArray[np.float32]


class NetworkSettings(Protocol):
    """What a network's configuration says of its images, and of the fit."""

    @property
    def input_size(self) -> tuple[int, int]: ...
    @property
    def fit_options(self) -> FitOptions: ...


class NetworkEstimator(HeldNetwork):
    """A pose estimator, and a segmenter, around a network. A method says what `inputs` the network
    is called with and what was `found`.

    Args:
        network: with its weights; it is put on the device and into evaluation mode.
        options: device, precision and compilation.
        config: the size that the network works at, and how poses are fitted.

    Raises:
        ToolkitError: the device is not there, no such precision, or an impossible threshold.
    """

    needs_truth = False

    def __init__(self, network: nn.Module, options: MethodOptions, config: NetworkSettings) -> None:
        self.input_size: tuple[int, int] | None = config.input_size
        self.size = config.input_size
        super().__init__(network, options)
        self.fit = config.fit_options

    def estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        """See `PoseEstimator`.

        Raises:
            ToolkitError: views of several sizes, or the device's memory does not hold the batch.
        """
        answers = []
        for view, found in zip(views, self._seen(views), strict=True):
            size = view.camera.size
            coordinates = found.coordinates
            if coordinates.ndim == 3:
                coordinates = resize_nearest(coordinates, size)
            else:
                many = [resize_nearest(each, size) for each in coordinates]
                coordinates = np.stack(many) if many else np.zeros((0, *size[::-1], 3), np.float32)
            answers.append(posed(found.segmented.resized(size), coordinates, view, self.fit))
        return answers

    def segment(self, views: Sequence[PoseView]) -> list[Segmented]:
        """The objects of each of a batch of views, at the view's size, best first."""
        seen = zip(views, self._seen(views), strict=True)
        return [found.segmented.resized(view.camera.size) for view, found in seen]

    def inputs(self, color: Tensor, depth: Tensor, K: Tensor) -> tuple[Tensor, ...]:
        """What the network is called with.

        Args:
            color: (b, 3, h, w) RGB in [0, 1].
            depth: (b, 1, h, w) metres, 0 where there is none.
            K: (b, 3, 3) intrinsics at this size.
        """
        raise NotImplementedError

    def found(self, outputs: Any) -> list[Found]:
        """What the network's outputs say of each image."""
        raise NotImplementedError

    def macs(self, view: PoseView) -> int:
        """Multiplications with addition that one view costs; element-wise work is not counted."""
        with torch.inference_mode():
            return count_macs(self.network, *self._inputs([view]))

    def _seen(self, views: Sequence[PoseView]) -> list[Found]:
        if not views:
            return []
        with self._running(len(views)):
            return self.found(self._answer(*self._inputs(views)))

    def _inputs(self, views: Sequence[PoseView]) -> tuple[Tensor, ...]:
        plain = [View(view.color, view.sensor, view.camera) for view in views]
        color, depth = color_and_depth(plain, self.device)
        if color.shape[-1:-3:-1] != self.size:
            # As frames are packed for training, and as the runner shows them.
            color = interpolate(color, size=self.size[::-1], mode="nearest")
            depth = interpolate(depth, size=self.size[::-1], mode="nearest")
        K = np.stack([view.camera.resized(*self.size).K for view in views])
        return self.inputs(color, depth, torch.from_numpy(K).float().to(self.device))


def posed(
    found: Segmented,
    coordinates: NDArray[np.float32],
    view: PoseView,
    options: FitOptions | None = None,
) -> Estimated:
    """Fit a pose to every object.

    Args:
        found: objects, at the view's size.
        coordinates: (h, w, 3) of all objects together, or (N, h, w, 3), normalised coordinates in
            [0, 1] at the pixels of the masks.
        view: whose depth the poses are fitted to.
        options: how outliers are met. `FitMethod.PAPER` answers what cannot be fitted with the
            identity; RANSAC leaves it out.
    """
    options = options or FitOptions()
    measured = np.isfinite(view.depth) & (view.depth > 0)
    rays = view.camera.rays()
    fits: list[FittedPose] = []
    kept: list[int] = []
    for number, mask in enumerate(found.masks):
        chosen = mask & measured
        nocs = coordinates if coordinates.ndim == 3 else coordinates[number]
        points = rays[chosen] * view.depth[chosen][:, None]
        fitted = _fit(nocs[chosen] - 0.5, points, options)
        if fitted is not None:
            fits.append(fitted)
            kept.append(number)
    prediction = PosePrediction(
        found.class_ids[kept],
        np.array([f.RT for f in fits]).reshape(-1, 4, 4),
        np.array([f.size for f in fits]).reshape(-1, 3),
        found.scores[kept],
    )
    return Estimated(prediction, found.masks[kept])


def _fit(
    coordinates: NDArray[np.floating], points: NDArray[np.floating], options: FitOptions
) -> FittedPose | None:
    if options.fit is not FitMethod.PAPER and len(points) < _LEAST_POINTS:
        return None
    try:
        return fit_pose(coordinates, points, options)
    except ToolkitError:
        return None  # points that no pose explains: the object is found, and counts as missed
