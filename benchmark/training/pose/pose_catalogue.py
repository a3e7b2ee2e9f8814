"""Training of the pose networks: network, loss and optimization of each."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from benchmark.methods.depth.swindrnet.swindrnet import begin_streams
from benchmark.methods.pose.crop_nocs import PRESETS as CROP_NOCS
from benchmark.methods.pose.crop_nocs import CropNOCSNetwork
from benchmark.methods.pose.nocs.nocs import NOCSNetwork
from benchmark.methods.pose.nocs.nocs_backbone import PRESETS as NOCS
from benchmark.methods.pose.nocs.nocs_backbone import load_imagenet as load_resnet
from benchmark.methods.pose.sgpa import PRESETS as SGPA
from benchmark.methods.pose.sgpa import SGPANetwork
from benchmark.methods.pose.spd import PRESETS as SPD
from benchmark.methods.pose.spd import SPDNetwork, load_imagenet
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs import begin_pose_network, pose_network
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs_network import PRESETS as SWINDRNET_NOCS
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs_network import SwinNOCSNetwork
from benchmark.training.catalogue import Trainable
from benchmark.training.config import ADAM, Optimization
from benchmark.training.packed_frames import fitting_frames_with_nocs
from benchmark.training.pose import (
    crop_nocs_training,
    deformation_loss,
    deformation_training,
    nocs_losses,
    nocs_training,
)
from std_toolkit.errors import ToolkitError

CROP_NOCS_TRAINING = Trainable(
    presets=CROP_NOCS,
    network=CropNOCSNetwork,
    loss=crop_nocs_training.CropNOCSLoss(),
    step=crop_nocs_training.crop_nocs_step,
    validator=deformation_training.DeformationValidator,
    optimization=Optimization(
        learning_rate=1e-3,
        weight_decay=0.01,
        batch_size=8,
        epochs=30,
        decay="linear",
        warmup_steps=100,
    ),
    colors=True,
)

SPD_TRAINING = Trainable(
    presets=SPD,
    network=SPDNetwork,
    loss=deformation_loss.DeformationLoss(),
    step=deformation_training.deformation_step,
    validator=deformation_training.DeformationValidator,
    # Whether and how the rate falls is not known: it stays.
    optimization=replace(
        ADAM,
        learning_rate=1e-4,
        batch_size=32,
        epochs=50,
    ),
    imagenet=load_imagenet,
)

SGPA_TRAINING = Trainable(
    presets=SGPA,
    network=SGPANetwork,
    loss=deformation_loss.DeformationLoss(),
    step=deformation_training.deformation_step,
    validator=deformation_training.DeformationValidator,
    optimization=replace(
        ADAM,
        learning_rate=1e-4,
        batch_size=24,
        epochs=15,
        phase_epochs={"first": 5, "second": 5, "third": 5},
        phase_rates={"second": 0.6, "third": 0.3},
    ),
    imagenet=load_imagenet,
)


def _swin_imagenet(network: Any, path: Path) -> None:
    if not isinstance(network, SwinNOCSNetwork):
        raise ToolkitError(
            "a network with a frozen trunk has no streams to begin",
            field="trunk",
            value=network.config.trunk,
            hint="leave --imagenet away, or train with --set trunk=own",
        )
    begin_streams([network.backbone_rgb_branch, network.backbone_xyz_branch], path)


def _nocs_imagenet(network: NOCSNetwork, path: Path) -> None:
    load_resnet(network.pyramid.backbone, path)


SWINDRNET_NOCS_TRAINING = Trainable(
    presets=SWINDRNET_NOCS,
    # The preset is the network of the authors' weights; trained is the paper's.
    settings={"published": {"fusion": "paper"}},
    network=pose_network,
    frames=fitting_frames_with_nocs,
    loss=nocs_losses.SwinNOCSLoss(),
    step=nocs_training.swin_nocs_step,
    validator=partial(nocs_training.PoseValidator, pixels_of=nocs_training.pixels_of_swin),
    # As SwinDRNet: what the paper says of both.
    optimization=Optimization(warmup_steps=500),
    colors=True,
    geometry=False,
    imagenet=_swin_imagenet,
    begin=begin_pose_network,
    idle=lambda config: config.fusion == "released",
)

NOCS_TRAINING = Trainable(
    presets=NOCS,
    network=NOCSNetwork,
    frames=fitting_frames_with_nocs,
    loss=nocs_losses.NOCSLoss(),
    step=nocs_training.nocs_step,
    validator=partial(nocs_training.PoseValidator, pixels_of=nocs_training.pixels_of_nocs),
    # Own: what is published is for another detector, with parts of the network frozen by turns.
    optimization=Optimization(
        learning_rate=2e-4,
        batch_size=16,
        epochs=20,
        decay="steps",
        milestones=(0.7, 0.9),
        factor=0.1,
        warmup_steps=500,
    ),
    colors=True,
    imagenet=_nocs_imagenet,
)
