"""The VTK interactor of a plotter, without the habits of VTK and pyvista."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from vtkmodules.vtkInteractionStyle import vtkInteractorStyleUser


def interactor_of(plotter: Any) -> Any:
    """The VTK interactor of a pyvista plotter or Qt widget."""
    return plotter.iren.interactor


class Events:
    """Observers of a plotter's interactor; nothing else listens to mouse and keys any more.

    Their styles would turn the camera, and have keys of their own: w changes what is drawn, q
    closes.
    """

    def __init__(self, plotter: Any, handlers: dict[str, Callable[..., None]]) -> None:
        self.interactor = interactor_of(plotter)
        style: Any = vtkInteractorStyleUser()
        style.AddObserver("CharEvent", lambda *_: None)
        # pyvista sets its own style anew after a double click, so it must take ours for its own.
        plotter.iren.style = style
        # The interactor does not keep it alive from Python's side.
        self._style = style
        plotter.iren.clear_key_event_callbacks()
        self._tags = [self.interactor.AddObserver(e, h) for e, h in handlers.items()]

    def close(self) -> None:
        for tag in self._tags:
            self.interactor.RemoveObserver(tag)
