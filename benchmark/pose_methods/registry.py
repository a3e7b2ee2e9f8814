"""Which pose methods there are, and how one is made."""

from __future__ import annotations

from collections.abc import Callable

from benchmark.methods.making import make_of
from benchmark.methods.registry import MethodOptions
from benchmark.pose_methods.protocol import PoseEstimator
from std_toolkit.plugins import Registry

PoseMethodFactory = Callable[[MethodOptions], PoseEstimator]

pose_methods: Registry[PoseMethodFactory] = Registry(
    "std_toolkit.pose_methods",
    {
        "gt-nocs": "benchmark.pose_methods.ground_truth:GroundTruthNOCS",
        "swindrnet-nocs": "benchmark.pose_methods.swindrnet_nocs.estimator:SwinDRNetNOCS",
        "nocs": "benchmark.pose_methods.nocs.estimator:NOCS",
        "spd": "benchmark.pose_methods.spd.estimator:SPD",
        "sgpa": "benchmark.pose_methods.sgpa.estimator:SGPA",
    },
)


def make_pose_method(name: str, options: MethodOptions | None = None) -> PoseEstimator:
    """A pose method by its name, or by `package.module:Class`.

    Raises:
        ToolkitError: no such method, or what the method says of its options and weights.
    """
    return make_of(
        pose_methods,
        name,
        options or MethodOptions(),
        called="estimate",
        has=("input_size", "needs_truth"),
        guide="docs/pose.md",
    )
