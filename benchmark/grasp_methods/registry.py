"""Which grasp planners there are, and how one is made."""

from __future__ import annotations

from collections.abc import Callable

from benchmark.grasp_methods.protocol import GraspPlanner
from benchmark.methods.making import make_of
from benchmark.methods.registry import MethodOptions
from std_toolkit.plugins import Registry

PlannerFactory = Callable[[MethodOptions], GraspPlanner]

grasp_planners: Registry[PlannerFactory] = Registry(
    "std_toolkit.grasp_planners",
    {
        "antipodal": "benchmark.grasp_methods.antipodal.planner:Antipodal",
        "graspnet": "benchmark.grasp_methods.graspnet.planner:GraspNet",
    },
)


def make_planner(name: str, options: MethodOptions | None = None) -> GraspPlanner:
    """A planner by its name, or by `package.module:Class`.

    Raises:
        ToolkitError: no such planner, or what the planner says of its options and weights.
    """
    return make_of(
        grasp_planners,
        name,
        options or MethodOptions(),
        called="plan",
        guide="docs/grasping.md",
    )
