"""Training of the depth restorers: network, loss and optimization of each."""

from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from benchmark.methods.depth.cleargrasp.cleargrasp_network import PRESETS as CLEARGRASP
from benchmark.methods.depth.cleargrasp.cleargrasp_network import ClearGraspNetwork
from benchmark.methods.depth.compactdr import PRESETS as COMPACTDR
from benchmark.methods.depth.compactdr import CompactDRNetwork
from benchmark.methods.depth.dfnet import PRESETS as DFNET
from benchmark.methods.depth.dfnet import DFNetwork
from benchmark.methods.depth.lidf.lidf import LIDFNetwork
from benchmark.methods.depth.lidf.voxels import PRESETS as LIDF
from benchmark.methods.depth.nlspn import PRESETS as NLSPN
from benchmark.methods.depth.nlspn import NLSPNetwork
from benchmark.methods.depth.nlspn import load_imagenet as load_resnet
from benchmark.methods.depth.swindrnet.swindrnet import load_imagenet as load_swin
from benchmark.methods.depth.swindrnet.swindrnet_network import PRESETS as SWINDRNET
from benchmark.methods.depth.swindrnet.swindrnet_network import SwinDRNetwork
from benchmark.methods.depth.two_branch import PRESETS as TWO_BRANCH
from benchmark.methods.depth.two_branch import TwoBranchNetwork
from benchmark.methods.efficientnet import load_imagenet as load_efficientnet
from benchmark.methods.torch_camera import points_of
from benchmark.training import step
from benchmark.training.catalogue import Trainable
from benchmark.training.config import ADAM, Optimization
from benchmark.training.depth import (
    cleargrasp_losses,
    cleargrasp_training,
    compactdr_training,
    depth_losses,
    lidf_training,
)
from benchmark.training.validation import DepthValidator

COMPACTDR_TRAINING = Trainable(
    presets=COMPACTDR,
    network=CompactDRNetwork,
    loss=compactdr_training.CompactDRLoss(),
    step=compactdr_training.compactdr_step,
    validator=compactdr_training.CompactDRValidator,
    optimization=Optimization(
        learning_rate=1e-3,
        batch_size=16,
        epochs=40,
        warmup_steps=200,
        phase_epochs={
            compactdr_training.MASK: 20,
            compactdr_training.ENCODER: 5,
            compactdr_training.DEPTH: 15,
        },
        encoder_rate=0.1,
    ),
    colors=True,
    geometry=True,
    imagenet=lambda network, path: load_efficientnet(network.encoder, path),
    idle=lambda config: True,  # noqa: ARG005  # the phases train other parts
    channels_last=True,
)


NLSPN_TRAINING = Trainable(
    presets=NLSPN,
    network=NLSPNetwork,
    loss=depth_losses.NLSPNLoss(),
    optimization=replace(
        ADAM,
        learning_rate=1e-3,
        batch_size=12,
        epochs=20,
        milestones=(10 / 20, 15 / 20),
        factor=0.2,
        warmup_share=1 / 20,
    ),
    jitter=True,
    geometry=True,
    imagenet=load_resnet,
    channels_last=True,
)


DFNET_TRAINING = Trainable(
    presets=DFNET,
    network=DFNetwork,
    loss=depth_losses.DFNetLoss(),
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
    loss=lidf_training.LIDFLoss(),
    step=lidf_training.lidf_step,
    validator=partial(DepthValidator, restore=lidf_training.lidf_depth),
    optimization=replace(
        ADAM,
        learning_rate=1e-3,
        batch_size=32,
        epochs=120,
        phase_epochs={lidf_training.COARSE: 60, lidf_training.REFINE: 30, lidf_training.HARD: 30},
        phase_rates={lidf_training.HARD: 0.1},
    ),
    geometry=False,
    idle=lambda config: True,  # noqa: ARG005  # one stage always rests
)


# Batch and epochs are not known; colour alone is what the networks see, so that it is augmented.
CLEARGRASP_TRAINING = Trainable(
    presets=CLEARGRASP,
    network=ClearGraspNetwork,
    loss=cleargrasp_losses.ClearGraspLoss(),
    step=cleargrasp_training.cleargrasp_step,
    validator=cleargrasp_training.ClearGraspValidator,
    optimization=replace(
        ADAM,
        learning_rate=1e-4,
        batch_size=32,
        epochs=20,
    ),
    colors=True,
    geometry=False,
    idle=lambda config: True,  # noqa: ARG005  # networks whose loss has no weight
)


SWINDRNET_TRAINING = Trainable(
    presets=SWINDRNET,
    # The preset is the network whose weights are published; trained is the paper's.
    settings={"published": {"fusion": "paper"}},
    network=SwinDRNetwork,
    loss=depth_losses.SwinDRNetLoss(),
    optimization=Optimization(warmup_steps=500),
    colors=True,
    geometry=False,
    imagenet=load_swin,
    idle=lambda config: config.fusion == "released",
    channels_last=True,
)


def rays_step(
    network: nn.Module,
    loss: Any,
    inputs: step.ModelInput,
    step_info: step.StepInfo,  # noqa: ARG001
) -> step.Loss:
    """The step of a network from colour, depth and rays to `Prediction`."""
    rays = points_of(torch.ones_like(inputs.depth), inputs.batch["K"])
    prediction = step.in_full_precision(network(inputs.color, inputs.depth, rays))
    with torch.autocast(inputs.color.device.type, enabled=False):
        return loss(prediction, step.target_of(inputs.batch)._replace(sensor=inputs.depth))


def rays_depth(network: nn.Module, batch: step.Batch) -> Tensor:
    """(b, h, w) metres that such a network restores."""
    color, depth = step.network_inputs(batch)
    return network(color, depth, points_of(torch.ones_like(depth), batch["K"])).depth[:, 0]


# Its training is not published: that of SwinDRNet, which it is compared with.
TWO_BRANCH_TRAINING = Trainable(
    presets=TWO_BRANCH,
    network=TwoBranchNetwork,
    loss=depth_losses.SwinDRNetLoss(),
    step=rays_step,
    validator=partial(DepthValidator, restore=rays_depth),
    optimization=Optimization(warmup_steps=500),
    colors=True,
    geometry=False,
)
