"""How GraspNet is trained."""

from __future__ import annotations

from benchmark.grasp_methods.graspnet.config import PRESETS
from benchmark.grasp_methods.graspnet.network import GraspNetwork
from benchmark.training.catalogue import Trainable
from benchmark.training.grasps.judge import GraspJudge
from benchmark.training.grasps.packed import PackedGrasps
from benchmark.training.grasps.step import grasp_step
from benchmark.training.losses.graspnet import GraspNetLoss
from benchmark.training.optimization import Optimization

GRASPNET_TRAINING = Trainable(
    presets=PRESETS,
    network=GraspNetwork,
    loss=GraspNetLoss(),
    frames=PackedGrasps,
    images=False,
    step=grasp_step,
    judge=GraspJudge,
    optimization=Optimization(
        optimizer="adam",
        learning_rate=1e-3,
        weight_decay=0.0,
        batch_size=2,
        epochs=18,
        decay="steps",
        milestones=(8 / 18, 12 / 18, 16 / 18),
        factor=0.1,
    ),
)
