"""Pictures of the meshes in the library, drawn beside the work."""

from __future__ import annotations

import base64
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from annotator.desk.controller import Controller
from annotator.desk.events import Event
from annotator.desk.runner import Task
from annotator.session.meshes import Version
from std_toolkit.scene import Model

SIZE_PX = 96


class Thumbnails:
    """Draws the pictures that are missing, one after the other.

    Args:
        show: hands the pictures (data URLs by the id of the model) to the page.
    """

    def __init__(self, controller: Controller, show: Callable[[dict[str, str]], None]) -> None:
        self._c, self._show = controller, show
        # By mesh, with the meshes that there were: how boxes stand is told by the others.
        self._pictures: dict[Version, tuple[frozenset[Version], str]] = {}
        self._shown: dict[str, str] = {}
        self._asked_for: tuple[Version, frozenset[Version]] | None = None
        self._unsubscribe = controller.subscribe(self._on_event)
        self._draw_next()

    def close(self) -> None:
        self._unsubscribe()

    def _on_event(self, event: Event) -> None:
        if event.kind == "edited":
            self._show_all()
            self._draw_next()

    def _draw_next(self) -> None:
        snapshot = self._c.session.snapshot()
        models, meshes = snapshot.state.models, snapshot.meshes
        versions = {m.id: meshes.version(m) for m in models}
        library = frozenset(versions.values())

        def is_missing(model: Model) -> bool:
            drawn, _ = self._pictures.get(versions[model.id], (frozenset(), ""))
            return not library <= drawn

        model = next((m for m in models if is_missing(m)), None)
        if model is None or self._asked_for == (versions[model.id], library):
            return
        self._asked_for = versions[model.id], library

        def work(_: Task) -> NDArray[np.uint8] | None:
            from annotator.views import model_picture

            return model_picture(snapshot, model, SIZE_PX)

        def finish(rgb: NDArray[np.uint8] | None) -> None:
            picture = "" if rgb is None else _as_png(rgb)
            self._pictures[versions[model.id]] = library, picture
            self._show_all()
            self._draw_next()

        self._c.start_aside("Thumbnails", work, finish)

    def _show_all(self) -> None:
        session = self._c.session
        versions = {m.id: session.meshes.version(m) for m in session.state.models}
        pictures = {i: self._pictures.get(v, (None, ""))[1] for i, v in versions.items()}
        if pictures != self._shown:
            self._shown = pictures
            self._show(pictures)


def _as_png(rgb: NDArray[np.uint8]) -> str:
    done, data = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    assert done
    return "data:image/png;base64," + base64.b64encode(data.tobytes()).decode("ascii")
