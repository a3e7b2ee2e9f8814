"""Which way up a mesh stands."""

from __future__ import annotations

from collections.abc import Iterable


def up_axis(own: int | None, *others: Iterable[int | None]) -> int:
    """The coordinate axis (0, 1, 2) of a mesh that is up when it is shown or placed.

    Args:
        own: the axis about which its shape is turned; None where that does not tell.
        others: the axes that are up in meshes that most likely follow the same habit; of several
            groups the first that tells anything decides. Where none does, z is up.
    """
    if own is not None:
        return own
    for group in others:
        axes = [axis for axis in group if axis is not None]
        if axes:
            return max(sorted(set(axes)), key=axes.count)
    return 2
