"""Which pose methods there are, and how one is made."""

from __future__ import annotations

import traceback
from collections.abc import Callable

from benchmark.methods.registry import MethodOptions
from benchmark.pose_methods.protocol import PoseEstimator
from std_toolkit.errors import ToolkitError
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
    factory = pose_methods.get(name)
    if not callable(factory):
        raise ToolkitError(
            "is not a class that takes MethodOptions", value=name, hint="docs/pose.md shows one"
        )
    try:
        method = factory(options or MethodOptions())
    except (ToolkitError, MemoryError):
        raise
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        raise ToolkitError(
            f"the method cannot be made: {type(error).__name__}: {' '.join(str(error).split())}",
            value=name,
            hint=f"raised in {place.filename}, line {place.lineno}",
        ) from error
    absent = [part for part in ("input_size", "needs_truth") if not hasattr(method, part)]
    if not callable(getattr(method, "estimate", None)):
        absent.append("estimate")
    if absent:
        raise ToolkitError(
            "the method has no such attribute",
            field=", ".join(absent),
            value=name,
            hint="docs/pose.md tells what a method must have",
        )
    return method
