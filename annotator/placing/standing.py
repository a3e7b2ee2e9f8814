"""Which way up the meshes of a library were made, as far as some of them tell."""

from __future__ import annotations

from annotator.placing.upright import up_axis
from annotator.session.queries import Queries
from std_toolkit.errors import ToolkitError
from std_toolkit.scene import Model


def standing_axis(session: Queries, model: Model) -> int:
    """The coordinate axis of a model that is up where it is shown alone.

    As it is placed, as long as nothing else is.

    Raises:
        ToolkitError: its mesh cannot be read.
    """
    own = session.meshes.round_axis(model)
    return up_axis(own, () if own is not None else library_axes(session))


def library_axes(session: Queries) -> list[int]:
    """The axes about which the round meshes of a session's or snapshot's library are turned.

    The meshes of one data set have the same axis up, so that these tell it for boxes, too. Reads
    every mesh that was not read before.
    """
    axes = []
    for model in session.state.models:
        try:
            axis = session.meshes.round_axis(model)
        except ToolkitError:  # told where the mesh itself is wanted
            continue
        if axis is not None:
            axes.append(axis)
    return axes
