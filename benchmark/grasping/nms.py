"""Of grasps that are nearly the same, the best."""

from __future__ import annotations

import math

import numpy as np

from benchmark.grasping.grasp import Grasps

# GraspNet's.
TRANSLATION_M = 0.03
ROTATION_RAD = math.radians(30)


def suppress_similar(
    grasps: Grasps,
    *,
    translation: float = TRANSLATION_M,
    rotation: float = ROTATION_RAD,
    swapped_fingers: bool = False,
) -> Grasps:
    """Keep the best of similar grasps, best first.

    From the best down, a grasp is kept unless one that is kept lies nearer than `translation`
    and is turned by less than `rotation` against it.

    Args:
        translation: metres.
        rotation: radians, of the whole rotation between the two.
        swapped_fingers: count half a turn about the approach as no turn. GraspNet's evaluation
            does not, though both are the same grasp.
    """
    ordered = grasps.top(len(grasps))
    if not len(ordered):
        return ordered
    R, t = ordered.rotations, ordered.translations
    # The angle of A^T B is below the limit where its trace is above this.
    least_trace = 1 + 2 * math.cos(rotation)
    swapped = R * np.array([1.0, -1.0, -1.0])
    standing = np.ones(len(ordered), dtype=bool)
    for first in range(len(ordered)):
        if not standing[first]:
            continue
        rest = first + 1 + np.flatnonzero(standing[first + 1 :])
        rest = rest[((t[rest] - t[first]) ** 2).sum(axis=1) < translation**2]
        alike = np.einsum("nij,ij->n", R[rest], R[first]) > least_trace
        if swapped_fingers:
            alike |= np.einsum("nij,ij->n", swapped[rest], R[first]) > least_trace
        standing[rest[alike]] = False
    return ordered[standing]
