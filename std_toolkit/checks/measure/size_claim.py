"""Whether a contour shows that an object has another size than its mesh, or something else.

Edges that lie inside or outside of the whole outline, as a shade or a shine along it shows them,
and an object of another shape look like another size, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from std_toolkit.checks.measure.motion_solver import PRIOR_SIZE, Motion
from std_toolkit.settings import Settings, limit


@dataclass(frozen=True, kw_only=True)
class SizeClaimSettings(Settings):
    """When a size is claimed."""

    odds: float = limit(3.0, source="as `checks.gates.hypotheses.noted_odds`")
    """a size is claimed where it is more likely than a shade or another shape by this factor"""
    shaded_odds: Mapping[str, float] = limit(
        {"raw": 1.0, "specular": 1.0, "transparent": 1.0},
        source="by argument: what shines has a shade along its outline as often as a wrong size",
    )
    """how much more often such objects have a shade along their outline than a wrong size"""
    opaque_shaded_odds: float = limit(0.1, source="by argument: matt surfaces have few")
    """the same on other materials"""
    spread: float = limit(0.03, source="meshes of like objects differ by 1 to 3 %")
    """deviation of sizes, and of sizes along one axis, that are wrong"""


def is_claimed(plain: Motion, shaded: Motion, sized: Motion, material: str, floor: float) -> bool:
    """Whether another size is more likely than a shade along the outline and another shape.

    Args:
        plain, shaded: the motion at the size of the mesh, with the usual errors of edges and with
            those of `SharedErrors.shaded`.
        sized: with a size, and with the sizes along the axes of the object.
        material: of the object.
        floor: systematic deviation of a size.
    """
    limits = SizeClaimSettings.current()
    glossy = limits.shaded_odds.get(material, limits.opaque_shaded_odds)
    edges = max(plain.evidence, shaded.evidence + float(np.log(glossy))) - _evidence(sized)
    return max(edges, _shape_odds(sized, floor)) <= -np.log(limits.odds)


def _evidence(sized: Motion) -> float:
    """The evidence with what is known of sizes that are wrong."""
    spread = SizeClaimSettings.current().spread
    assert sized.size is not None
    squares = sized.size**2 * (1 / spread**2 - 1 / PRIOR_SIZE**2)
    return sized.evidence - float(np.log(spread / PRIOR_SIZE) + 0.5 * squares)


def _shape_odds(sized: Motion, floor: float) -> float:
    """Log odds of three sizes, each along one axis of the object, against one."""
    assert sized.stretch is not None and sized.stretch_covariance is not None
    variance = SizeClaimSettings.current().spread ** 2
    known = sized.stretch_covariance + floor**2 * np.eye(3)
    densities = []
    for together in (np.eye(3), np.ones((3, 3))):
        C = known + variance * together
        square = sized.stretch @ np.linalg.solve(C, sized.stretch)
        densities.append(-0.5 * float(square + np.linalg.slogdet(C)[1]))
    return densities[0] - densities[1]
