"""What pose networks are trained with."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from benchmark.methods.swindrnet.imagenet import begin_streams
from benchmark.pose_methods.nocs.backbone import load_imagenet as load_resnet
from benchmark.pose_methods.nocs.config import PRESETS as NOCS
from benchmark.pose_methods.nocs.network import NOCSNetwork
from benchmark.pose_methods.swindrnet_nocs.config import PRESETS as SWINDRNET_NOCS
from benchmark.pose_methods.swindrnet_nocs.network import SwinNOCSNetwork
from benchmark.pose_methods.swindrnet_nocs.weights import begin_pose_network
from benchmark.training.catalogue import Trainable
from benchmark.training.judging_poses import PoseJudge, look_of_nocs, look_of_swin
from benchmark.training.losses.nocs import NOCSLoss
from benchmark.training.losses.swindrnet_nocs import SwinNOCSLoss
from benchmark.training.optimization import Optimization
from benchmark.training.packed_frames import fitting_frames_with_nocs
from benchmark.training.poses import nocs_step, swin_nocs_step


def _swin_imagenet(network: SwinNOCSNetwork, path: Path) -> None:
    begin_streams([network.backbone_rgb_branch, network.backbone_xyz_branch], path)


def _nocs_imagenet(network: NOCSNetwork, path: Path) -> None:
    load_resnet(network.pyramid.backbone, path)


SWINDRNET_NOCS_TRAINING = Trainable(
    presets=SWINDRNET_NOCS,
    # The preset is the network of the authors' weights; trained is the paper's.
    settings={"published": {"fusion": "paper"}},
    network=SwinNOCSNetwork,
    frames=fitting_frames_with_nocs,
    loss=SwinNOCSLoss(),
    step=swin_nocs_step,
    judge=partial(PoseJudge, look=look_of_swin),
    # As SwinDRNet: what the paper says of both.
    optimization=Optimization(warmup_steps=500),
    colors=True,
    imagenet=_swin_imagenet,
    begin=begin_pose_network,
    idle=lambda config: config.fusion == "released",
)
NOCS_TRAINING = Trainable(
    presets=NOCS,
    network=NOCSNetwork,
    frames=fitting_frames_with_nocs,
    loss=NOCSLoss(),
    step=nocs_step,
    judge=partial(PoseJudge, look=look_of_nocs),
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
