"""Training and validation of networks that predict NOCS coordinates."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from benchmark.data.frame import BACKGROUND
from benchmark.methods.pose.nocs.detector import Regions, boxes_of_ids
from benchmark.methods.pose.nocs.nocs import NOCSNetwork, NOCSPrediction, objects_of
from benchmark.methods.pose.pose_network import Found
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs_network import (
    BACKGROUND_CLASS,
    SwinNOCSPrediction,
)
from benchmark.methods.torch_camera import points_of
from benchmark.training.pose import nocs_losses
from benchmark.training.step import Batch, Loss, ModelInput, StepInfo, network_inputs
from benchmark.training.validation import Context, Validator
from std_toolkit.errors import ToolkitError

# Error of a pixel whose class is wrong: half the cube's side, about what a guess is off.
MISSED = 0.5

_IDS = 256

_WIDTH, _GAP = 224, 4

# Colours of 0 other, 1 bottle, ..., 7 aeroplane, 8 background.
_COLORS = np.array(
    [
        (120, 120, 120), (230, 75, 60), (70, 160, 70), (65, 105, 225), (245, 170, 40),
        (150, 70, 180), (40, 190, 190), (240, 120, 180), (28, 28, 32),
    ],
    np.uint8,
)  # fmt: skip

NO_NOCS = ToolkitError(
    "the packed frames hold no NOCS", hint="pack them with `std-train pack --nocs`"
)


class PredictedPixels(NamedTuple):
    """What a network says of pixels.

    Attributes:
        classes: (b, h, w) int64: 0 other, 1 to 7 the classes, 8 background.
        nocs: (b, 3, h, w) normalised coordinates, of what is of a class.
    """

    classes: Tensor
    nocs: Tensor


class PoseValidator(Validator):
    """Validation of classes and coordinates of pixels; what is wrong or missed counts as half the
    cube's side.

    The sums are pixels of objects, those of the right class, errors of the latter, and pixels
    elsewhere that were taken for objects.

    Args:
        pixels_of: what a network predicts of the pixels of a batch.

    Raises:
        ToolkitError: the packs hold no NOCS.
    """

    main = "nocs_error"

    def __init__(
        self, *args: Any, pixels_of: Callable[[nn.Module, Batch], PredictedPixels]
    ) -> None:
        super().__init__(*args)
        if not self.frames.has_nocs:
            raise NO_NOCS
        self.pixels_of = pixels_of

    def zeros(self, network: nn.Module) -> np.ndarray:  # noqa: ARG002
        return np.zeros(4)

    def add(self, total: np.ndarray, network: nn.Module, batch: Batch, context: Context) -> None:
        with context():
            found = self.pixels_of(network, batch)
        total += sums_of(found, pose_target(batch))

    def scores(self, states: np.ndarray) -> dict[str, float]:
        objects, right, error, false = (float(value) for value in states)
        counted = objects + false
        return {
            "nocs_error": (error + MISSED * (counted - right)) / counted if counted else math.nan,
            "nocs_error_where_right": error / right if right else math.nan,
            "class_recall": right / objects if objects else math.nan,
            "class_overlap": right / counted if counted else math.nan,
        }

    def pictures(
        self,
        network: nn.Module,
        shown: Sequence[int],  # noqa: ARG002
        batch: Batch,
    ) -> Sequence[np.ndarray]:
        """Colour, true and found coordinates, true and found classes."""
        predicted = self.pixels_of(network, batch)
        target = pose_target(batch)
        color = batch["color"].cpu().numpy()
        true = _pictures(target.nocs, target.known)
        found = _pictures(
            predicted.nocs, (predicted.classes > 0) & (predicted.classes < BACKGROUND_CLASS)
        )
        kinds = [_COLORS[c.cpu().numpy()] for c in (target.classes, predicted.classes)]
        return [_strip(columns) for columns in zip(color, true, found, *kinds, strict=True)]


def sums_of(predicted: PredictedPixels, target: nocs_losses.PoseTarget) -> NDArray[np.float64]:
    """(4,) the sums of a batch."""
    right = target.known & (predicted.classes == target.classes)
    found = (predicted.classes > 0) & (predicted.classes < BACKGROUND_CLASS)
    image = torch.arange(len(target.mask), device=target.mask.device)[:, None, None]
    group = image * _IDS + target.mask.long()
    nocs = predicted.nocs.float()
    true = nocs_losses.nearest_turn(
        nocs, target.nocs, group, nocs_losses.is_round(target.classes) & right
    )
    error = (nocs - true).square().sum(dim=1).sqrt().clamp(max=MISSED)
    # Objects of a class without known coordinates are not scored.
    nothing = (target.classes == 0) | (target.classes == BACKGROUND_CLASS)
    sums = (target.known.sum(), right.sum(), error[right].double().sum(), (found & nothing).sum())
    return np.array([float(value) for value in sums])


def pixels_of_swin(network: nn.Module, batch: Batch) -> PredictedPixels:
    """What SwinDRNet's pose network says of pixels."""
    color, depth = network_inputs(batch)
    answer: SwinNOCSPrediction = network(color, points_of(depth, batch["K"]))
    return PredictedPixels(answer.classes.argmax(dim=1), answer.nocs.float())


def pixels_of_nocs(network: nn.Module, batch: Batch) -> PredictedPixels:
    """What the objects that NOCS finds say of their pixels, the best of them where they overlap."""
    color, _ = network_inputs(batch)
    answer: NOCSPrediction = network(color)
    decode = cast(NOCSNetwork, network).config.decode
    b, _, h, w = color.shape
    pixels = [painted(objects_of(answer, image, decode, (w, h)), (h, w)) for image in range(b)]
    classes = torch.from_numpy(np.stack([c for c, _ in pixels])).to(color.device)
    nocs = torch.from_numpy(np.stack([n for _, n in pixels])).to(color.device)
    return PredictedPixels(classes, nocs.permute(0, 3, 1, 2))


def painted(found: Found, shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """(h, w) classes and (h, w, 3) coordinates of an image's objects."""
    classes = np.full(shape, BACKGROUND_CLASS, np.int64)
    nocs = np.zeros((*shape, 3), np.float32)
    objects = found.segmented
    for number in np.argsort(objects.scores, kind="stable"):
        mask = objects.masks[number]
        classes[mask] = objects.class_ids[number]
        nocs[mask] = found.coordinates[number][mask]
    return classes, nocs


def _pictures(nocs: Tensor, there: Tensor) -> NDArray[np.uint8]:
    shown = (nocs.float().clamp(0, 1) * 255).round() * there[:, None]
    return shown.permute(0, 2, 3, 1).byte().cpu().numpy()


def _strip(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    height = round(_WIDTH * pictures[0].shape[0] / pictures[0].shape[1])
    gap = np.full((height, _GAP, 3), 255, np.uint8)
    parts = []
    for picture in pictures:
        shown = cv2.resize(picture, (_WIDTH, height), interpolation=cv2.INTER_NEAREST)
        parts += [np.asarray(shown, np.uint8), gap]
    return np.hstack(parts[:-1])


def swin_nocs_step(network: nn.Module, loss: Any, inputs: ModelInput, step_info: StepInfo) -> Loss:  # noqa: ARG001
    """The step of SwinDRNet's pose network."""
    prediction = network(inputs.color, points_of(inputs.depth, inputs.batch["K"]))
    with torch.autocast(inputs.color.device.type, enabled=False):
        full = SwinNOCSPrediction(*(None if p is None else p.float() for p in prediction))  # type: ignore[arg-type]
        return loss(full, pose_target(inputs.batch))


def nocs_step(network: nn.Module, loss: Any, inputs: ModelInput, step_info: StepInfo) -> Loss:  # noqa: ARG001
    """The step of NOCS: masks and coordinates are learnt in the objects' own boxes, jittered."""
    target = nocs_target(inputs.batch, loss)
    regions = jittered(target.objects, loss.jitter)
    prediction: NOCSPrediction = network(inputs.color, regions)
    with torch.autocast(inputs.color.device.type, enabled=False):
        return loss(prediction, target)


def pose_target(batch: Batch) -> nocs_losses.PoseTarget:
    """Classes and coordinates of a batch's pixels.

    Raises:
        ToolkitError: the packs hold no NOCS.
    """
    if "nocs" not in batch:
        raise NO_NOCS
    mask = batch["mask"]
    classes = batch["classes"].gather(1, mask.flatten(1).long()).reshape(mask.shape).long()
    classes = torch.where(classes == BACKGROUND, BACKGROUND_CLASS, classes)
    nocs = batch["nocs"].permute(0, 3, 1, 2)
    # 0 0 0 is a corner of the cube, which no object reaches.
    known = (classes > 0) & (classes < BACKGROUND_CLASS) & (nocs > 0).any(dim=1)
    return nocs_losses.PoseTarget(classes, nocs.float() / 255, known, mask)


def nocs_target(batch: Batch, loss: nocs_losses.NOCSLoss) -> nocs_losses.NOCSTarget:
    """Objects, classes and coordinates of a batch."""
    target = pose_target(batch)
    boxes, counts = boxes_of_ids(target.mask)
    classes = batch["classes"].long()
    there = (counts >= loss.least_pixels) & (classes > 0) & (classes < BACKGROUND_CLASS)
    image, ids = there.nonzero(as_tuple=True)
    chosen = classes[there]
    scores = torch.ones(len(chosen), device=chosen.device)
    return nocs_losses.NOCSTarget(Regions(boxes[there], image, chosen, scores, ids), target)


def jittered(regions: Regions, share: float) -> Regions:
    """Regions moved and resized at random by up to a share of their size."""
    boxes = regions.boxes
    size = boxes[:, 2:] - boxes[:, :2]
    low = boxes[:, :2] + size * _draw(size, share)
    high = boxes[:, 2:] + size * _draw(size, share)
    return regions._replace(boxes=torch.cat([low, high], dim=1))


def _draw(like: Tensor, share: float) -> Tensor:
    return (2 * torch.rand_like(like) - 1) * share
