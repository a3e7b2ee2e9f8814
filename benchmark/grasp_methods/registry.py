"""Which grasp planners there are, and how one is made."""

from __future__ import annotations

import traceback
from collections.abc import Callable

from benchmark.grasp_methods.protocol import GraspPlanner
from benchmark.methods.registry import MethodOptions
from std_toolkit.errors import ToolkitError
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
    factory = grasp_planners.get(name)
    if not callable(factory):
        raise ToolkitError(
            "is not a class that takes MethodOptions", value=name, hint="docs/grasping.md shows one"
        )
    try:
        planner = factory(options or MethodOptions())
    except (ToolkitError, MemoryError):
        raise
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        raise ToolkitError(
            f"the planner cannot be made: {type(error).__name__}: {' '.join(str(error).split())}",
            value=name,
            hint=f"raised in {place.filename}, line {place.lineno}",
        ) from error
    if not callable(getattr(planner, "plan", None)):
        raise ToolkitError("the planner has no method `plan`", value=name)
    return planner
