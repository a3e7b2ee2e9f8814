"""Training of SPD and SGPA on object crops, and validation of all networks over crops."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmark.methods.depth.full_size import at_full_size, sensor_view
from benchmark.methods.pose.crop_estimator import CropConfig
from benchmark.methods.pose.segmented import Placed, longest_axis
from benchmark.methods.protocol import Restorer
from benchmark.methods.registry import MethodOptions, make_restorer, preset_for
from benchmark.training.pose import deformation_loss
from benchmark.training.step import Batch, Loss, ModelInput, StepInfo, model_input
from benchmark.training.validation import Context, Validator
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

# An error of a coordinate that a fit by RANSAC with its metric threshold can use: 2 cm of 20.
_NEAR = 0.1

_TRUE = 0.4  # of the frames, their depth is true where it is mixed


def deformation_step(
    network: nn.Module,
    loss: Any,
    inputs: ModelInput,
    step_info: StepInfo,  # noqa: ARG001
) -> Loss:
    """One object of each frame through a network that deforms a prior."""
    return loss_of_objects(network, loss, inputs, _objects(network, inputs, one_each=True))


def loss_of_objects(
    network: nn.Module, loss: Any, inputs: ModelInput, found: deformation_loss.Objects | None
) -> Loss:
    """The loss, in full precision, of what a network over crops says of the objects of a batch."""
    if found is None:
        # Nothing can be learned of these frames; the step is there all the same.
        nothing = sum((p.sum() * 0 for p in network.parameters()), torch.zeros(()))
        return Loss(torch.as_tensor(nothing), {"objects": torch.zeros(())})
    answer = _answered(network, found)
    with torch.autocast(inputs.color.device.type, enabled=False):
        total, parts = loss(_in_full_precision(answer), found.truth)
    return Loss(total, {**parts, "objects": torch.tensor(float(len(found.frames)))})


class DeformationValidator(Validator):
    """Validation by the error of coordinates, over all objects that are seen.

    `batch` frames, and objects, go through the network together. The sums are (categories, 3):
    summed error, near points and number of objects.
    """

    main = "coordinates"

    def zeros(self, network: nn.Module) -> np.ndarray:
        self.names: tuple[str, ...] = _config(network).categories
        return np.zeros((len(self.names), 3))

    def add(self, total: np.ndarray, network: nn.Module, batch: Batch, context: Context) -> None:
        found = _objects(network, model_input(batch), one_each=False)
        if found is None:
            return
        for some in deformation_loss.of_batches(found, self.batch):
            with context():
                answer = _answered(network, some)
            error = coordinate_errors(answer.coordinates.float(), some.truth)
            known = some.truth.known
            count = known.sum(dim=1).clamp(min=1)
            mean = (error.masked_fill(~known, 0.0).sum(dim=1) / count).double()
            near = (((error < _NEAR) & known).sum(dim=1) / count).double()
            row = torch.stack([mean, near, torch.ones_like(mean)], dim=1).cpu().numpy()
            np.add.at(total, some.category.cpu().numpy(), row)

    def scores(self, states: np.ndarray) -> dict[str, float]:
        """`coordinates`, the mean error, and `near`, the share of points below 0.1; by category."""
        count = states[:, 2].sum()
        with np.errstate(invalid="ignore", divide="ignore"):
            error, near = states[:, :2].sum(axis=0) / count
            by_category = states[:, 0] / states[:, 2]
        return {
            "coordinates": float(error),
            "near": float(near),
            **{
                f"coordinates_{name}": float(e)
                for name, e in zip(self.names, by_category, strict=True)
            },
        }

    def pictures(
        self,
        network: nn.Module,
        shown: Sequence[int],  # noqa: ARG002
        batch: Batch,
    ) -> Sequence[np.ndarray]:
        """Colour, true coordinates, and those of the network's points, as colours."""
        found = _objects(network, model_input(batch), one_each=False)
        answers = [] if found is None else list(_painted(network, found, self.batch))
        predicted = torch.zeros_like(batch["nocs"])
        for frame, chosen, coordinates in answers:
            values = (255 * (coordinates + 0.5)).round().clamp(0, 255).to(torch.uint8)
            predicted[frame].view(-1, 3)[chosen] = values
        rows = torch.cat([batch["color"], batch["nocs"], predicted], dim=2)
        return list(rows.cpu().numpy())


def coordinate_errors(found: Tensor, truth: deformation_loss.ObjectTruth) -> Tensor:
    """(b, n) distances between found and true coordinates; for round objects after the turn about y
    that makes their squares least."""
    a = torch.where(truth.known[..., None], found, 0.0)
    b = truth.coordinates
    sine = (a[..., 0] * b[..., 2] - a[..., 2] * b[..., 0]).sum(dim=1)
    cosine = (a[..., 0] * b[..., 0] + a[..., 2] * b[..., 2]).sum(dim=1)
    angle = torch.where(truth.turned, torch.atan2(-sine, cosine), 0.0)
    return (found @ deformation_loss.about_y(angle).transpose(1, 2) - b).norm(dim=2)


def _objects(
    network: nn.Module, inputs: ModelInput, *, one_each: bool
) -> deformation_loss.Objects | None:
    config = _config(network)
    return deformation_loss.objects_of(
        inputs.color,
        trained_depth(config, inputs, drawn=one_each),
        inputs.batch,
        categories=len(config.categories),
        side=config.side,
        points=config.points,
        one_each=one_each,
        masked=network.masked,  # type: ignore[arg-type]
        placed=lambda mask: Placed(longest_axis(mask)) if network.aligned else None,
        generators=_none if one_each else _same,
    )


def trained_depth(config: CropConfig, inputs: ModelInput, *, drawn: bool) -> Tensor:
    """(b, h, w) metres: the depth that points of a batch come from.

    Args:
        config: which depth the network is trained on.
        inputs: the batch.
        drawn: whether `mixed` draws true depth for some frames; else it is raw depth.

    Raises:
        ToolkitError: the restorer cannot be made.
    """
    raw = inputs.depth[:, 0]
    match config.trained_on:
        case "restored":
            return restored_depth(inputs, config.restorer, config.restorer_weights)
        case "true":
            return inputs.batch["true"]
        case "mixed" if drawn:
            true = torch.rand(len(raw), 1, 1, device=raw.device) < _TRUE
            return torch.where(true, inputs.batch["true"], raw)
        case _:
            return raw


def _config(network: nn.Module) -> Any:
    return network.config


def _none() -> None:
    return None


def _same() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def _answered(network: nn.Module, found: deformation_loss.Objects) -> Any:
    crop = found.crop
    return network(crop.color, crop.points, crop.pixels, found.category)


def _in_full_precision(answer: Any) -> Any:
    """The same kind of answer, such as `Deformed`, whose parts may be None."""
    return type(answer)(*(None if part is None else part.float() for part in answer))


def _painted(network: nn.Module, found: deformation_loss.Objects, size: int) -> Any:
    for some in deformation_loss.of_batches(found, size):
        answer = _answered(network, some)
        yield from zip(some.frames, some.crop.chosen, answer.coordinates.float(), strict=True)


def restored_depth(inputs: ModelInput, restorer: str, weights: str | None) -> Tensor:
    """Restore the sensor's depth of a batch, as `std-bench pose --depth` does of a frame.

    Args:
        inputs: a batch.
        restorer: name of the restorer.
        weights: its weights; None for those that ship.

    Returns:
        (b, h, w) metres, 0 where there is no answer; without a gradient.

    Raises:
        ToolkitError: the restorer cannot be made, or needs a mask.
    """
    device = inputs.depth.device
    method = _restorer(restorer, weights, str(device))
    colors = (255 * inputs.color.permute(0, 2, 3, 1)).round().clamp(0, 255).byte().cpu().numpy()
    sensed = inputs.depth[:, 0].float().cpu().numpy()
    height, width = sensed.shape[1:]
    cameras = [
        Camera(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        for K in inputs.batch["K"].double().cpu().numpy()
    ]
    views = [
        sensor_view(color, depth, camera, method.input_size)
        for color, depth, camera in zip(colors, sensed, cameras, strict=True)
    ]
    answers = method.restore(views)
    found = [at_full_size(depth, answer) for depth, answer in zip(sensed, answers, strict=True)]
    return torch.from_numpy(np.stack(found)).to(device)


@cache
def _restorer(name: str, weights: str | None, device: str) -> Restorer:
    path = None if weights is None else Path(weights)
    made = make_restorer(
        name, MethodOptions(preset=preset_for(name, None, path), weights=path, device=device)
    )
    if made.needs_mask:
        raise ToolkitError("needs masks, which a pack lacks", field="restorer", value=name)
    return made
