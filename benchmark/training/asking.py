"""How std-bench is asked for a method that was trained."""

from __future__ import annotations

from benchmark.grasp_methods.registry import grasp_planners
from benchmark.methods.registry import restorers
from benchmark.pose_methods.registry import pose_methods


def bench_command(method: str) -> str:
    """The command and the name of a method, without its preset and weights.

    >>> bench_command("swindrnet"), bench_command("nocs")
    ('std-bench --method swindrnet', 'std-bench --task pose --method nocs')
    """
    if method not in restorers.names():
        if method in pose_methods.names():
            return f"std-bench --task pose --method {method}"
        if method in grasp_planners.names():
            return f"std-bench --task grasp --planner {method}"
    return f"std-bench --method {method}"
