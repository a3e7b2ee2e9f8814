"""How SPD and SGPA are trained."""

from __future__ import annotations

from benchmark.pose_methods.patch_imagenet import load_imagenet
from benchmark.pose_methods.sgpa.config import PRESETS as SGPA
from benchmark.pose_methods.sgpa.network import SGPANetwork
from benchmark.pose_methods.spd.config import PRESETS as SPD
from benchmark.pose_methods.spd.network import SPDNetwork
from benchmark.training.catalogue import Trainable
from benchmark.training.deforming import DeformationJudge, deformation_step
from benchmark.training.losses.deformation import DeformationLoss
from benchmark.training.optimization import Optimization

SPD_TRAINING = Trainable(
    presets=SPD,
    network=SPDNetwork,
    loss=DeformationLoss(),
    step=deformation_step,
    judge=DeformationJudge,
    # Whether and how the rate falls is not known: it stays.
    optimization=Optimization(
        optimizer="adam",
        learning_rate=1e-4,
        weight_decay=0.0,
        batch_size=32,
        epochs=50,
        decay="steps",
    ),
    imagenet=load_imagenet,
)
SGPA_TRAINING = Trainable(
    presets=SGPA,
    network=SGPANetwork,
    loss=DeformationLoss(),
    step=deformation_step,
    judge=DeformationJudge,
    optimization=Optimization(
        optimizer="adam",
        learning_rate=1e-4,
        weight_decay=0.0,
        batch_size=24,
        epochs=15,
        decay="steps",
        phase_epochs={"first": 5, "second": 5, "third": 5},
        phase_rates={"second": 0.6, "third": 0.3},
    ),
    imagenet=load_imagenet,
)
