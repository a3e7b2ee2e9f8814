"""SPD as a pose estimator, and the base of estimators that deform a prior."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.methods.network import narrow_type, network_of, parameter_count, torch_device
from benchmark.methods.pose.fitting import FitMethod, FitOptions, fit_pose
from benchmark.methods.pose.released_keys import spd_state
from benchmark.methods.pose.segmented import Crop, Segmented, crop_object, stacked, true_segments
from benchmark.methods.pose.spd_network import PRESETS, PriorNetwork, SPDNetwork
from benchmark.methods.protocol import Estimated, PoseView
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.pose.pose_frames import PosePrediction
from benchmark.metrics.pose.pose_protocol import DREDS_CLASSES
from std_toolkit.errors import ToolkitError

TRUE = "true"

_AT_ONCE = 16  # objects that go through the network together

Floats = NDArray[np.float64]


class DeformingEstimator:
    """A pose estimator around a network from patches and points to `Deformed`.

    Points come from the depth that poses are fitted to. Boxes are as large as the deformed prior.

    Args:
        network: with its weights; it is put on the device and into evaluation mode.
        options: device, precision and compilation.

    Raises:
        ToolkitError: the device is not there, no such precision, an impossible threshold, or what
            the method that segments says of its weights.
    """

    def __init__(self, network: PriorNetwork, options: MethodOptions) -> None:
        config = network.config
        self.config = config
        # Of the benchmark's classes: those of NOCS have a laptop in place of the car.
        self._places = {
            number: config.categories.index(name)
            for number, name in enumerate(DREDS_CLASSES)
            if name in config.categories
        }
        self.input_size: tuple[int, int] | None = config.input_size
        self.needs_truth = config.masks == TRUE
        self.device = torch_device(options.device)
        self._narrow = narrow_type(options.precision)
        self.fit = FitOptions(
            fit=FitMethod(config.fit), threshold_m=config.threshold_m, last=config.last
        )
        self.network = network.to(self.device).eval().requires_grad_(False)
        self._run: Any = torch.compile(self.network) if options.compile else self.network
        self._segmenter = None if self.needs_truth else _segmenter(network, options)

    @property
    def parameter_count(self) -> int:
        """Parameters of the network, without those of the one that segments."""
        return parameter_count(self.network)

    def estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        """See `PoseEstimator`.

        Raises:
            ToolkitError: true masks are asked for and not given, or the device's memory does not
                hold the batch.
        """
        try:
            with torch.inference_mode():
                return self._estimate(views)
        except torch.OutOfMemoryError as error:
            raise ToolkitError(
                f"the memory of {self.device} does not hold {len(views)} frames at once",
                hint="make --batch-size smaller",
            ) from error

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
            with torch.autocast(
                self.device.type, dtype=self._narrow, enabled=self._narrow is not None
            ):
                answer = self._run(some.color, some.points, some.pixels, category)
            for k, (coordinates, shape, points) in enumerate(
                zip(
                    answer.coordinates.double().cpu().numpy(),
                    answer.shape.double().cpu().numpy(),
                    some.points.double().cpu().numpy(),
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
        return Segmented(found.class_ids[known], found.scores[known], found.masks[known])

    def _crops(self, view: PoseView, found: Segmented) -> list[Crop | None]:
        color = torch.from_numpy(view.color).to(self.device).permute(2, 0, 1).float() / 255
        depth = torch.from_numpy(view.depth).to(self.device)
        K = torch.from_numpy(view.camera.K).to(self.device).float()
        return [
            crop_object(
                color,
                depth,
                torch.from_numpy(mask).to(self.device),
                K,
                side=self.config.side,
                points=self.config.points,
                # The same draw for an object whatever else is in the batch.
                generator=torch.Generator().manual_seed(0),
            )
            for mask in found.masks
        ]


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


def _segmenter(network: PriorNetwork, options: MethodOptions) -> Any:
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


class SPD(DeformingEstimator):
    """A prior of the category, deformed to the object; settings are those of `SPDConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        _, network = network_of("spd", PRESETS, SPDNetwork, options, renamed=spd_state)
        super().__init__(network, options)
