"""The picture that goes to a browser is what the view shows."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scene_on_disk import write_scene

from annotator.app.controller import Controller
from annotator.app.image_cache import ImageCache
from annotator.app.tasks import InlineRunner
from annotator.session import Session

pytest.importorskip("pyvista")


def test_pictures_are_right_from_the_first_and_with_other_windows_drawn_between(
    tmp_path: Path,
) -> None:
    from annotator.views import SceneView
    from annotator.web.stream import STILL_QUALITY, StreamedPlotter, as_jpeg, read_pixels

    write_scene(tmp_path / "scene")
    with Session.open(tmp_path / "scene") as session:
        images = ImageCache(session.scene)
        controller = Controller(session, images, runner=InlineRunner(), view_frames=[0, 1])
        streams = [
            StreamedPlotter(can_take=lambda: True, send=lambda _: None, later=lambda *_: None)
            for _ in range(2)
        ]
        views = [
            SceneView(stream.plotter, controller, slot=slot, repaint=stream.repaint)
            for slot, stream in enumerate(streams)
        ]
        first = views[0].screenshot()  # never rendered before
        other = views[1].screenshot()
        again = views[0].screenshot()  # the other's context was the current one
        window = streams[0].plotter.render_window
        streams[1].plotter.render_window.Render()
        window.Render()
        sent = as_jpeg(read_pixels(window), STILL_QUALITY)
        for view, stream in zip(views, streams, strict=True):
            view.close()
            stream.close()
        images.close()
    np.testing.assert_array_equal(first, again)
    assert np.abs(first.astype(int) - other).mean() > 10
    shown = cv2.cvtColor(cv2.imdecode(np.frombuffer(sent, np.uint8), 1), cv2.COLOR_BGR2RGB)
    assert shown.shape == first.shape
    assert np.abs(shown.astype(int) - first).mean() < 4
