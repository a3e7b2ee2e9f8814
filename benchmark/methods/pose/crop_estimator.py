"""Poses of objects that are cut out of a frame one by one.

Objects come from true masks or from another method. A network says the normalised coordinates of an
object's points and how large its box is; pose and size are fitted to them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from benchmark.methods.network import HeldNetwork
from benchmark.methods.pose.fitting import FitMethod, FitOptions, fit_pose
from benchmark.methods.pose.segmented import (
    Crop,
    Placed,
    Segmented,
    crop_object,
    longest_axis,
    stacked,
    true_segments,
    turned_about_z,
    with_mask,
)
from benchmark.methods.protocol import Estimated, PoseView
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.pose.pose_frames import PosePrediction
from benchmark.metrics.pose.pose_protocol import DREDS_CLASSES
from std_toolkit.errors import ToolkitError

TRUE = "true"

_AT_ONCE = 16  # objects that go through the network together

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CropConfig:
    """What networks over object crops share.

    Attributes:
        categories: names, in the order of the weights.
        side: of the patch of colour, pixels; a multiple of the network's `step`.
        points: of an object.
        input_size: (width, height) of the frames that patches are cut out of.
        trained_on: depth that the points of training come from; `mixed` draws for each frame
            whether it is raw or true.
        restorer, restorer_weights: of `trained_on=restored`; by default the weights that ship.
        masks: whose masks objects are cut out by: a pose method that segments, such as `nocs`, or
            `true` for those of the ground truth.
        mask_preset, mask_weights: of that method; by default the weights that come with it.
        fit: `ransac` with a metric threshold, or `paper`: least squares over all points.
        threshold_m: largest distance of an inlier, metres.
        last: last fit of `ransac`, see `FitOptions`.
    """

    categories: tuple[str, ...] = DREDS_CLASSES[1:]
    side: int = 192
    points: int = 1024
    input_size: tuple[int, int] = (640, 360)
    trained_on: Literal["raw", "true", "restored", "mixed"] = "raw"
    restorer: str = "swindrnet"
    restorer_weights: str | None = None
    masks: str = "nocs"
    mask_preset: str = "published"
    mask_weights: str | None = None
    fit: Literal["ransac", "paper"] = "ransac"
    threshold_m: float = 0.02
    last: Literal["tukey", "inliers"] = "tukey"


class Shaped(Protocol):
    """What a network says of a batch of objects.

    Attributes:
        coordinates: (b, n, 3) normalised coordinates of the object's points, the middle at 0.
        shape: (b, m, 3) points that reach as far as the whole object does, as normalised.
    """

    @property
    def coordinates(self) -> Tensor: ...
    @property
    def shape(self) -> Tensor: ...


class CropNetwork(nn.Module):
    """A network over crops: colour, points, pixels and categories to `Shaped`.

    Args:
        config: its configuration.

    Attributes:
        masked: whether the mask is a fourth channel of the colour.
        aligned: whether crops are turned so that the longest axis of the mask is upright.
        step: what the side of a patch is a multiple of, pixels.

    Raises:
        ToolkitError: the side is no such multiple, or there are no points.
    """

    masked = False
    aligned = False
    step = 8

    def __init__(self, config: CropConfig) -> None:
        super().__init__()
        self.config = config
        if config.side < self.step or config.side % self.step:
            raise ToolkitError(
                f"must be a multiple of {self.step}", field="side", value=config.side
            )
        if config.points < 1:
            raise ToolkitError("must be 1 or more", field="points", value=config.points)


class CropEstimator(HeldNetwork):
    """A pose estimator around a network over object crops.

    Points come from the depth that poses are fitted to. Boxes are as large as the shape that
    the network answers with. Its parameters are counted without those of the network that
    segments.

    Args:
        network: with its weights; it is put on the device and into evaluation mode.
        options: device, precision and compilation.

    Raises:
        ToolkitError: the device is not there, no such precision, an impossible threshold, or what
            the method that segments says of its weights.
    """

    def __init__(self, network: CropNetwork, options: MethodOptions) -> None:
        config = network.config
        self.config = config
        self._masked, self._aligned = network.masked, network.aligned
        # Of the benchmark's classes: those of NOCS have a laptop in place of the car.
        self._places = {
            number: config.categories.index(name)
            for number, name in enumerate(DREDS_CLASSES)
            if name in config.categories
        }
        self.input_size: tuple[int, int] | None = config.input_size
        self.needs_truth = config.masks == TRUE
        super().__init__(network, options)
        self.fit = FitOptions(
            fit=FitMethod(config.fit), threshold_m=config.threshold_m, last=config.last
        )
        self._segmenter = None if self.needs_truth else _segmenter(network, options)

    def estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        """See `PoseEstimator`.

        Raises:
            ToolkitError: true masks are asked for and not given, or the device's memory does not
                hold the batch.
        """
        with self._running(len(views)):
            return self._estimate(views)

    def _estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        found = [self._known_classes(segmented) for segmented in self._segmented(views)]
        places, crops, categories = [], [], []
        for view, segmented in enumerate(found):
            for number, crop in enumerate(self._crops(views[view], segmented)):
                if crop is not None:
                    places.append((view, number))
                    crops.append(crop)
                    categories.append(self._places[int(segmented.class_ids[number])])
        fits: list[dict[int, tuple[Floats, Floats]]] = [{} for _ in views]
        for begin in range(0, len(crops), _AT_ONCE):
            some = stacked(crops[begin : begin + _AT_ONCE])
            category = torch.tensor(categories[begin : begin + _AT_ONCE], device=self.device)
            answer = self._answer(some.color, some.points, some.pixels, category)
            for k, (coordinates, shape, points) in enumerate(
                zip(
                    answer.coordinates.double().cpu().numpy(),
                    answer.shape.double().cpu().numpy(),
                    turned_about_z(some.points.double(), -some.turn).cpu().numpy(),
                    strict=True,
                )
            ):
                view, number = places[begin + k]
                box = fitted_box(coordinates, points, shape, self.fit)
                if box is not None:
                    fits[view][number] = box
        return [_estimated(*both) for both in zip(found, fits, strict=True)]

    def _segmented(self, views: Sequence[PoseView]) -> list[Segmented]:
        if self._segmenter is not None:
            return self._segmenter.segment(views)
        truths = [view.truth for view in views]
        if any(truth is None for truth in truths):
            raise ToolkitError("the true masks are not given", field="masks", value=TRUE)
        return [true_segments(truth.mask, truth.instances) for truth in truths if truth]

    def _known_classes(self, found: Segmented) -> Segmented:
        known = np.isin(found.class_ids, list(self._places))
        return found.of(known)

    def _crops(self, view: PoseView, found: Segmented) -> list[Crop | None]:
        color = torch.from_numpy(view.color).to(self.device).permute(2, 0, 1).float() / 255
        depth = torch.from_numpy(view.depth).to(self.device)
        K = torch.from_numpy(view.camera.K).to(self.device).float()
        crops = []
        for each in found.masks:
            mask = torch.from_numpy(each).to(self.device)
            crop = crop_object(
                with_mask(color, mask) if self._masked else color,
                depth,
                mask,
                K,
                side=self.config.side,
                points=self.config.points,
                placed=Placed(longest_axis(mask)) if self._aligned else None,
                # The same draw for an object whatever else is in the batch.
                generator=torch.Generator().manual_seed(0),
            )
            crops.append(crop)
        return crops


def fitted_box(
    coordinates: Floats, points: Floats, shape: Floats, options: FitOptions
) -> tuple[Floats, Floats] | None:
    """Pose and size of an object, as wide along each axis as its whole shape.

    Args:
        coordinates: (n, 3) normalised coordinates of the points that are seen, the middle at 0.
        points: (n, 3) these points in the camera frame, metres.
        shape: (m, 3) the whole object, as normalised as the coordinates.
        options: how outliers are met.

    Returns:
        (4, 4) object to camera, the box's diagonal in metres inside, and (3,) its size, of length
        1; None where no pose explains the points.
    """
    try:
        fitted = fit_pose(coordinates, points, options)
    except ToolkitError:
        return None
    if not fitted.inliers.any():
        return fitted.RT, fitted.size
    whole = fitted.with_sides(2 * np.abs(shape).max(axis=0))
    return whole.RT, whole.size


def _estimated(found: Segmented, boxes: dict[int, tuple[Floats, Floats]]) -> Estimated:
    kept = sorted(boxes)
    prediction = PosePrediction(
        found.class_ids[kept],
        np.array([boxes[k][0] for k in kept]).reshape(-1, 4, 4),
        np.array([boxes[k][1] for k in kept]).reshape(-1, 3),
        found.scores[kept],
    )
    return Estimated(prediction, found.masks[kept])


def _segmenter(network: CropNetwork, options: MethodOptions) -> Any:
    from benchmark.methods.registry import make_pose_method

    config = network.config
    try:
        method: Any = make_pose_method(
            config.masks,
            MethodOptions(
                preset=config.mask_preset,
                weights=Path(config.mask_weights) if config.mask_weights else None,
                device=options.device,
                precision=options.precision,
                compile=options.compile,
            ),
        )
    except ToolkitError as error:
        raise ToolkitError(
            f"objects are cut out by masks of {config.masks}: {error}",
            hint="give --set mask_weights=FILE, or masks=true for those of the ground truth",
        ) from error
    if not callable(getattr(method, "segment", None)):
        raise ToolkitError("the method does not segment", field="masks", value=config.masks)
    return method
