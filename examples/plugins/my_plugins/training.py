"""Plug-ins of `std-train`."""

from dataclasses import replace

from benchmark.training.config import Optimization
from benchmark.training.depth.depth_catalogue import TWO_BRANCH_TRAINING

# `std-train --method slow-two-branch`: a network, its loss and how they are trained.
SLOW_TWO_BRANCH = replace(TWO_BRANCH_TRAINING, optimization=Optimization(warmup_steps=2000))
