"""What can be trained: network, loss and optimization of each method."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from torch import nn

from benchmark.methods.cleargrasp.config import PRESETS as CLEARGRASP
from benchmark.methods.cleargrasp.network import ClearGraspNetwork
from benchmark.methods.dfnet.config import PRESETS as DFNET
from benchmark.methods.dfnet.network import DFNetwork
from benchmark.methods.lidf.config import PRESETS as LIDF
from benchmark.methods.lidf.network import LIDFNetwork
from benchmark.methods.nlspn.config import PRESETS as NLSPN
from benchmark.methods.nlspn.imagenet import load_imagenet as load_resnet
from benchmark.methods.nlspn.network import NLSPNetwork
from benchmark.methods.settings import configured, preset_of
from benchmark.methods.swindrnet.config import PRESETS as SWINDRNET
from benchmark.methods.swindrnet.imagenet import load_imagenet as load_swin
from benchmark.methods.swindrnet.network import SwinDRNetwork
from benchmark.methods.weights import load_weights
from benchmark.training.cleargrasp import ClearGraspJudge, cleargrasp_step
from benchmark.training.judging import Judge, Judging
from benchmark.training.lidf import lidf_depth, lidf_step
from benchmark.training.losses.cleargrasp import ClearGraspLoss
from benchmark.training.losses.dfnet import DFNetLoss
from benchmark.training.losses.lidf import COARSE, HARD, REFINE, LIDFLoss
from benchmark.training.losses.nlspn import NLSPNLoss
from benchmark.training.losses.swindrnet import SwinDRNetLoss
from benchmark.training.optimization import Optimization
from benchmark.training.packed_frames import fitting_frames
from benchmark.training.step import StepFunction, depth_step
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import Registry


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
        judge: `judge(frames, chosen, batch, loss)`: validation.
        optimization: as published.
        colors: whether colour is augmented as published for SwinDRNet.
        jitter: whether it is as published for NLSPN.
        geometry: whether frames are turned, mirrored and enlarged; None where that is not
            possible, because the method wants more than depth, masks and materials.
        imagenet: begins the network with weights of a classifier, of those that have this.
        begin: begins the network with the weights of a training.
        idle: whether a configuration leaves parameters without gradient.
    """

    presets: Mapping[str, Any]
    network: Callable[[Any], nn.Module]
    loss: Any
    frames: Callable[[Sequence[Path], Any], Any] = fitting_frames
    images: bool = True
    step: StepFunction = depth_step
    judge: Callable[..., Judging] = Judge
    optimization: Optimization
    colors: bool = False
    jitter: bool = False
    geometry: bool | None = None
    settings: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    imagenet: Callable[[Any, Path], None] | None = None
    begin: Callable[[Any, Path], None] = load_weights
    idle: Callable[[Any], bool] = lambda config: False  # noqa: ARG005

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


SWINDRNET_TRAINING = Trainable(
    presets=SWINDRNET,
    # The preset is the network whose weights are published; trained is the paper's.
    settings={"published": {"fusion": "paper"}},
    network=SwinDRNetwork,
    loss=SwinDRNetLoss(),
    optimization=Optimization(warmup_steps=500),
    colors=True,
    geometry=False,
    imagenet=load_swin,
    idle=lambda config: config.fusion == "released",
)
NLSPN_TRAINING = Trainable(
    presets=NLSPN,
    network=NLSPNetwork,
    loss=NLSPNLoss(),
    optimization=Optimization(
        optimizer="adam",
        learning_rate=1e-3,
        weight_decay=0.0,
        batch_size=12,
        epochs=20,
        decay="steps",
        milestones=(10 / 20, 15 / 20),
        factor=0.2,
        warmup_share=1 / 20,
    ),
    jitter=True,
    geometry=True,
    imagenet=load_resnet,
)
DFNET_TRAINING = Trainable(
    presets=DFNET,
    network=DFNetwork,
    loss=DFNetLoss(),
    optimization=Optimization(
        learning_rate=1e-3,
        batch_size=32,
        epochs=40,
        decay="steps",
        milestones=(5 / 40, 15 / 40, 25 / 40, 35 / 40),
        factor=0.2,
    ),
    geometry=False,
)
# Published are the lengths of the first two phases. The last one's is not; it is as long as the
# one before.
LIDF_TRAINING = Trainable(
    presets=LIDF,
    network=LIDFNetwork,
    loss=LIDFLoss(),
    step=lidf_step,
    judge=partial(Judge, restore=lidf_depth),
    optimization=Optimization(
        optimizer="adam",
        learning_rate=1e-3,
        weight_decay=0.0,
        batch_size=32,
        epochs=120,
        decay="steps",
        phase_epochs={COARSE: 60, REFINE: 30, HARD: 30},
        phase_rates={HARD: 0.1},
    ),
    geometry=False,
    idle=lambda config: True,  # noqa: ARG005  # one stage always rests
)
# Batch and epochs are not known; colour alone is what the networks see, so that it is augmented.
CLEARGRASP_TRAINING = Trainable(
    presets=CLEARGRASP,
    network=ClearGraspNetwork,
    loss=ClearGraspLoss(),
    step=cleargrasp_step,
    judge=ClearGraspJudge,
    optimization=Optimization(
        optimizer="adam",
        learning_rate=1e-4,
        weight_decay=0.0,
        batch_size=32,
        epochs=20,
        decay="steps",
    ),
    colors=True,
    geometry=False,
    idle=lambda config: True,  # noqa: ARG005  # networks whose loss has no weight
)

trainables: Registry[Trainable] = Registry(
    "std_toolkit.trainables",
    {
        "swindrnet": "benchmark.training.catalogue:SWINDRNET_TRAINING",
        "nlspn": "benchmark.training.catalogue:NLSPN_TRAINING",
        "dfnet": "benchmark.training.catalogue:DFNET_TRAINING",
        "lidf": "benchmark.training.catalogue:LIDF_TRAINING",
        "cleargrasp": "benchmark.training.catalogue:CLEARGRASP_TRAINING",
        "graspnet": "benchmark.training.grasps.catalogue:GRASPNET_TRAINING",
        "swindrnet-nocs": "benchmark.training.pose_catalogue:SWINDRNET_NOCS_TRAINING",
        "nocs": "benchmark.training.pose_catalogue:NOCS_TRAINING",
        "spd": "benchmark.training.prior_methods:SPD_TRAINING",
        "sgpa": "benchmark.training.prior_methods:SGPA_TRAINING",
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
