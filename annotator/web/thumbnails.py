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
from std_toolkit.errors import ToolkitError

SIZE_PX = 96


class Thumbnails:
    """Draws the pictures that are missing, one after the other.

    Args:
        show: hands the pictures (data URLs by the id of the model) to the page.
    """

    def __init__(self, controller: Controller, show: Callable[[dict[str, str]], None]) -> None:
        self._c, self._show = controller, show
        # By id and file: a mesh may be replaced.
        self._pictures: dict[tuple[str, str], str] = {}
        self._drawing = False
        self._unsubscribe = controller.subscribe(self._on_event)
        self._draw_next()

    def close(self) -> None:
        self._unsubscribe()

    def _on_event(self, event: Event) -> None:
        if event.kind == "edited":
            self._draw_next()

    def _draw_next(self) -> None:
        models = self._c.session.state.models
        model = next((m for m in models if (m.id, m.mesh) not in self._pictures), None)
        if model is None or self._drawing:
            return
        self._drawing = True
        snapshot = self._c.session.snapshot()

        def work(_: Task) -> NDArray[np.uint8] | None:
            from annotator.views import cached_thumbnail, thumbnail

            try:
                mesh = snapshot.meshes.mesh(model)
            except ToolkitError:
                return None  # told where the mesh itself is drawn
            if snapshot.writable:
                return cached_thumbnail(snapshot.scene.root, mesh, SIZE_PX)
            return thumbnail(mesh, SIZE_PX)

        def finish(rgb: NDArray[np.uint8] | None) -> None:
            self._drawing = False
            self._pictures[model.id, model.mesh] = "" if rgb is None else _as_png(rgb)
            models = self._c.session.state.models
            self._show({m.id: self._pictures.get((m.id, m.mesh), "") for m in models})
            self._draw_next()

        self._c.start_aside("Thumbnails", work, finish)


def _as_png(rgb: NDArray[np.uint8]) -> str:
    done, data = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    assert done
    return "data:image/png;base64," + base64.b64encode(data.tobytes()).decode("ascii")
