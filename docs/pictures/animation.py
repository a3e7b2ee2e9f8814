"""Makes labelling.webp: a mug is dropped, dragged and refined, and its label is in every frame.

    python docs/pictures/animation.py WORK

Uses the recording of annotating.py in WORK, made if it is not there. The actions are real events in
the real window, on a virtual display where there is none.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from annotating import OPTIONS, camera_of, display_server, middle_of, record
from numpy.typing import NDArray
from PIL import Image

from sensors.output.recording_writer import Truth
from sensors.synthetic.recording import textured_meshes

if TYPE_CHECKING:
    from window_hands import Hands

PICTURE = Path(__file__).with_name("labelling.webp")
NAME = "mug"
# The picture is half as large as the window; a strip below it names the step.
SCALE, STRIP = 0.625, 34
SHORT_MS, LONG_MS = 110, 1100
QUALITY = 62


class Film:
    """Pictures of the window with the name of the step, and how long each is shown."""

    def __init__(self, hand: Hands) -> None:
        self.hand = hand
        self.step = ""
        self.pictures: list[Image.Image] = []
        self.times: list[int] = []

    def take(self, milliseconds: int = SHORT_MS) -> None:
        """Take a picture."""
        views = self.hand.space.views
        whole = self.hand.picture(views)
        size = (round(whole.shape[1] * SCALE), round(whole.shape[0] * SCALE))
        small = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
        strip = np.full((STRIP, size[0], 3), 255, np.uint8)
        cv2.putText(
            strip, self.step, (8, 23), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (30, 30, 30), 1, cv2.LINE_AA
        )
        self.pictures.append(Image.fromarray(np.concatenate([small, strip])))
        self.times.append(milliseconds)

    def save(self, path: Path) -> None:
        """Write an animated WebP that repeats."""
        first, *others = self.pictures
        first.save(
            path,
            save_all=True,
            append_images=others,
            duration=self.times,
            loop=0,
            quality=QUALITY,
            method=4,
        )
        print(f"{path.name}: {len(self.pictures)} pictures, {path.stat().st_size / 1e6:.1f} MB")


def label(work: Path, truth: Truth) -> None:
    """Drop, drag, turn, refine, and step through the frames."""
    from PySide6.QtCore import QPoint, Qt
    from window_hands import at_scene

    hand = at_scene(work / "scene")
    mesh = work / "recording" / "printed" / f"{NAME}.glb"
    mesh.parent.mkdir(exist_ok=True)
    textured_meshes(OPTIONS)[NAME].export(mesh)
    hand.drop_files([mesh])
    c = hand.controller
    hand.wait(lambda: len(c.session.state.models) == 1 and c.table is not None)
    film = Film(hand)
    film.step = "1  Drop the mesh onto the image: it stands on the table."
    film.take(LONG_MS)
    exact = truth.camera_pose(0).inverse() @ truth.object_pose(NAME)
    true_middle: NDArray[np.float64] = camera_of(c).project(exact @ c.session.centre(NAME))
    hand.drop_mesh(NAME, true_middle + np.array([120.0, 40.0]))
    film.take(LONG_MS)
    film.step = "2  Drag it along the table; all views follow."
    start = hand.at(middle_of(c, NAME))
    aim = hand.at(true_middle + np.array([5.0, -3.0]))
    hand.drag(start, QPoint(aim.x() - start.x(), aim.y() - start.y()), look=film.take)
    film.take(LONG_MS)
    film.step = "3  Turn it with Shift and the arrow keys."
    turn = c.pose(NAME, 0).R.T @ exact.R
    steps = round(float(np.degrees(np.arctan2(turn[0, 2], turn[2, 2]))) / 10)
    hand.press(Qt.Key.Key_7)
    key = Qt.Key.Key_Right if steps > 0 else Qt.Key.Key_Left
    for _ in range(abs(steps)):
        hand.press(key, Qt.KeyboardModifier.ShiftModifier)
        film.take()
    film.take(LONG_MS)
    film.step = "4  Refine: edges, texture and sensor depth of eight frames."
    hand.press(Qt.Key.Key_R)
    hand.wait(lambda: NAME in c.residuals)
    hand.settle()
    hand.press(Qt.Key.Key_3)
    film.take(2 * LONG_MS)
    film.step = "5  One label, every frame: the camera poses carry it."
    for frame in [f.id for f in c.session.scene.frames][1::2]:
        c.show_frame(frame)
        hand.settle()
        film.take(2 * SHORT_MS)
    film.take(LONG_MS)
    film.save(PICTURE)
    hand.shell.leave_scene()


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    known = record(folder)
    os.environ["XDG_CONFIG_HOME"] = str(folder / "config")
    display = display_server()
    try:
        label(folder, known)
    finally:
        if display is not None:
            display.terminate()
