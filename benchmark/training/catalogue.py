"""Registry of the networks that can be trained."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import nn

from benchmark.methods.registry import preset_of
from benchmark.methods.weights import load_weights
from benchmark.training.config import Optimization
from benchmark.training.packed_frames import fitting_frames
from benchmark.training.step import StepFunction, depth_step
from benchmark.training.validation import DepthValidator, Validator
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import Registry, configured


@dataclass(frozen=True, kw_only=True)
class Trainable:
    """A method that can be trained.

    Attributes:
        presets: configurations of its network by name.
        settings: what training sets otherwise than a preset does, by preset.
        network: makes the network of a configuration.
        loss: the loss, a frozen dataclass, whose fields are what `--loss` sets.
        frames: `frames(folders, configuration)`: the packs, which must fit the network.
        images: whether its batches hold images, that can be augmented.
        step: sends a batch through the network to that loss.
        validator: `validator(frames, chosen, batch, loss)`: validation.
        optimization: as published.
        colors: whether colour is augmented as published for SwinDRNet.
        jitter: whether it is as published for NLSPN.
        geometry: whether frames are turned, mirrored and enlarged; None where that is not
            possible, because the method wants more than depth, masks and materials.
        imagenet: begins the network with weights of a classifier, of those that have this.
        begin: begins the network with the weights of a training.
        idle: whether a configuration leaves parameters without gradient.
        channels_last: whether weights of convolutions are stored with channels last, which makes
            some networks faster.
    """

    presets: Mapping[str, Any]
    network: Callable[[Any], nn.Module]
    loss: Any
    frames: Callable[[Sequence[Path], Any], Any] = fitting_frames
    images: bool = True
    step: StepFunction = depth_step
    validator: Callable[..., Validator] = DepthValidator
    optimization: Optimization
    colors: bool = False
    jitter: bool = False
    geometry: bool | None = None
    settings: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    imagenet: Callable[[Any, Path], None] | None = None
    begin: Callable[[Any, Path], None] = load_weights
    idle: Callable[[Any], bool] = lambda config: False  # noqa: ARG005
    channels_last: bool = False

    def config(self, preset: str, settings: Mapping[str, str]) -> Any:
        """Configuration of the network.

        Raises:
            ToolkitError: no such preset or setting.
        """
        return configured(preset_of(self.presets, preset), settings)

    def loss_with(self, changes: Mapping[str, str]) -> Any:
        """The loss, with what a user sets of it.

        Raises:
            ToolkitError: no such field, or a number that no loss can have.
        """
        loss = configured(self.loss, changes)
        for name in changes:
            value = getattr(loss, name)
            if isinstance(value, float) and not 0 <= value < math.inf:
                raise ToolkitError(
                    "must be 0 or more, and finite", field=f"--loss {name}", value=value
                )
        return loss

    def settings_of(self, preset: str, asked: Mapping[str, str]) -> dict[str, str]:
        """All settings that make the network from its preset."""
        return {**self.settings.get(preset, {}), **asked}


trainables: Registry[Trainable] = Registry(
    "std_toolkit.trainables",
    {
        "swindrnet": "benchmark.training.depth.depth_catalogue:SWINDRNET_TRAINING",
        "compactdr": "benchmark.training.depth.depth_catalogue:COMPACTDR_TRAINING",
        "nlspn": "benchmark.training.depth.depth_catalogue:NLSPN_TRAINING",
        "dfnet": "benchmark.training.depth.depth_catalogue:DFNET_TRAINING",
        "two-branch": "benchmark.training.depth.depth_catalogue:TWO_BRANCH_TRAINING",
        "lidf": "benchmark.training.depth.depth_catalogue:LIDF_TRAINING",
        "cleargrasp": "benchmark.training.depth.depth_catalogue:CLEARGRASP_TRAINING",
        "graspnet": "benchmark.training.grasp.grasp_catalogue:GRASPNET_TRAINING",
        "swindrnet-nocs": "benchmark.training.pose.pose_catalogue:SWINDRNET_NOCS_TRAINING",
        "nocs": "benchmark.training.pose.pose_catalogue:NOCS_TRAINING",
        "crop-nocs": "benchmark.training.pose.pose_catalogue:CROP_NOCS_TRAINING",
        "spd": "benchmark.training.pose.pose_catalogue:SPD_TRAINING",
        "sgpa": "benchmark.training.pose.pose_catalogue:SGPA_TRAINING",
    },
)


def get_trainable(method: str) -> Trainable:
    """How a method is trained.

    Raises:
        ToolkitError: nothing of this name can be trained.
    """
    found = trainables.get(method)
    if not isinstance(found, Trainable):
        raise ToolkitError("is no benchmark.training.catalogue.Trainable", value=method)
    return found
