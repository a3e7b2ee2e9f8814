"""Makes the pictures of docs/annotating.md, and counts what a person does to label six objects.

    python docs/pictures/annotating.py WORK

Records a synthetic scene in WORK (once), recovers its camera poses, and labels it in the real
window, on a virtual display where there is none. At the end it prints the number of presses,
clicks and drags, and how far the labels are from the truth.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.output.recording_writer import Truth, read_truth
from sensors.synthetic import RecordingOptions, make_recording
from sensors.synthetic.recording import textured_meshes
from std_toolkit.cli.main import main as curate
from std_toolkit.geometry import SE3
from std_toolkit.io.images import write_color

if TYPE_CHECKING:
    from PySide6.QtWidgets import QWidget
    from window_hands import Hands

PICTURES = Path(__file__).parent
QUALITY = 82
# A person does not hit the middle of an object exactly: standard deviation in pixels.
AIM_PX = 8.0
MATERIALS = {"glass": "transparent", "steel_bowl": "specular"}
OPTIONS = RecordingOptions(frames=24, width=1280, height=720, arc_degrees=100.0)
ROUND = ("bottle", "soup_can", "glass", "steel_bowl")
# Radius of a numbered disc, px, and the differences of colour that an empty place has.
_DISC = 14
_FLAT = 12
Image = NDArray[np.uint8]


def record(work: Path) -> Truth:
    """A recording and a scene with camera poses, in metres from the sensor depth."""
    recording, scene = work / "recording", work / "scene"
    if not (recording / "truth.json").is_file():
        make_recording(recording, OPTIONS)
    if not (work / "posed").is_dir():
        folders = ["--color", str(recording / "color"), "--depth", str(recording / "depth")]
        numbers = ["--depth-scale", "0.001", "--intrinsics", str(recording / "intrinsics.json")]
        assert curate(["import", *folders, *numbers, "--out", str(scene)]) == 0
        assert curate(["poses", str(scene)]) == 0
        scene.rename(work / "posed")
    shutil.rmtree(scene, ignore_errors=True)
    shutil.copytree(work / "posed", scene)
    return read_truth(recording)


def label(work: Path, truth: Truth) -> None:
    """What the guide describes, in the real window."""
    from window_hands import at_scene

    hand = at_scene(work / "scene")
    place(hand, work / "recording", truth)
    red = push_into_each_other(hand)
    refine(hand)
    judge(hand, red)
    click_points(hand)
    hand.controller.session.save()
    hand.shell.leave_scene()


def place(hand: Hands, recording: Path, truth: Truth) -> None:
    """The meshes, all at once, and each onto its image."""
    textured = textured_meshes(OPTIONS)
    files = []
    for item in truth.objects:
        path = recording / item.mesh
        if item.name not in MATERIALS:
            path = recording / "printed" / f"{item.name}.glb"
            path.parent.mkdir(exist_ok=True)
            textured[item.name].export(path)
        files.append(path)
    hand.drop_files(files)
    c = hand.controller
    hand.wait(lambda: len(c.session.state.models) == len(truth.objects))
    hand.wait(lambda: c.table is not None)
    rng = np.random.default_rng(0)
    counts: dict[str, int] = {}
    # Round ones first: how they stand tells which way up the box and the mug are.
    for name in sorted((o.name for o in truth.objects), key=lambda n: n not in ROUND):
        before = hand.actions
        exact = truth.camera_pose(0).inverse() @ truth.object_pose(name)
        middle = camera_of(c).project(exact @ c.session.centre(name))
        hand.drop_mesh(name, middle + rng.normal(0, AIM_PX, 2))
        if name in MATERIALS:
            hand.choose_material(MATERIALS[name])
        if name not in ROUND:
            turn_roughly(hand, name, exact)
        counts[name] = hand.actions - before + 1  # D at the end
    print("presses, clicks and drags, with marking it as done:", counts)
    print("all, with adding the meshes and refining all:", sum(counts.values()) + 2)


def turn_roughly(hand: Hands, name: str, exact: SE3) -> None:
    """Steps of 10 degrees about the table's normal until it looks about right."""
    from PySide6.QtCore import Qt

    c = hand.controller
    turn = c.pose(name, 0).R.T @ exact.R
    steps = round(float(np.degrees(np.arctan2(turn[0, 2], turn[2, 2]))) / 10)
    if abs(steps) > 9:
        hand.press(Qt.Key.Key_Y, Qt.KeyboardModifier.ShiftModifier)
        steps -= int(np.copysign(18, steps))
    if steps:
        if c.step != 10:
            hand.press(Qt.Key.Key_7)
        key = Qt.Key.Key_Right if steps > 0 else Qt.Key.Key_Left
        hand.press(key, Qt.KeyboardModifier.ShiftModifier, abs(steps))


def push_into_each_other(hand: Hands) -> Image:
    """The can into the table, as the views show it; taken back afterwards."""
    from PySide6.QtCore import QPoint, Qt

    c = hand.controller
    c.select("soup_can")
    hand.press(Qt.Key.Key_Q)
    hand.drag(hand.at(middle_of(c, "soup_can")), QPoint(30, 12))
    hand.wait(lambda: bool(c.penetrations), 120)
    hand.settle()
    picture = hand.picture(hand.space.views.tiles[0])
    hand.press(Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    hand.press(Qt.Key.Key_W)
    hand.press(Qt.Key.Key_8)
    return picture


def refine(hand: Hands) -> None:
    """All objects together; the picture of the whole window."""
    from PySide6.QtCore import Qt

    from annotator.app.pose_checks import no_turn

    c = hand.controller
    hand.press(Qt.Key.Key_R, Qt.KeyboardModifier.ControlModifier)
    for name in ("soup_can", "mug", "bottle"):
        c.select(name)
        hand.wait(lambda name=name: name in c.residuals)
        hand.settle()
        if not no_turn(c):
            hand.press(Qt.Key.Key_Y)
            hand.press(Qt.Key.Key_R)
            hand.settle()
            hand.wait(lambda name=name: name in c.residuals)
    judged(hand)
    hand.space.banner.notices.clear()
    _save("annotating_window", numbered(hand.picture(), parts(hand)))
    c.ask("light_theme")
    hand.settle()
    _save("annotating_light", hand.picture())
    c.ask("light_theme")


def judged(hand: Hands) -> None:
    """Until the card of the selected object is complete."""
    c = hand.controller
    known = (c.residuals, c.ranks, c.findings.judgements)
    hand.wait(lambda: all(c.selected in found for found in known))
    hand.settle()


def judge(hand: Hands, red: Image) -> None:
    """Contours from near, residuals, the cloud."""
    from PySide6.QtCore import QPoint, Qt
    from PySide6.QtTest import QTest

    c, space = hand.controller, hand.space
    c.select("mug")
    space.tabs.setCurrentWidget(space.residuals)
    for key in (Qt.Key.Key_3, Qt.Key.Key_Q, Qt.Key.Key_Space):
        hand.press(key)
    judged(hand)
    _save("annotating_contour", hand.picture(space.views, space.inspector))
    c.select("glass")
    hand.press(Qt.Key.Key_1)
    hand.press(Qt.Key.Key_Tab)
    hand.press(Qt.Key.Key_Home)
    QTest.qWait(3000)
    size = space.views.tiles[0].view.size()
    hand.drag(QPoint(size.width() - 60, size.height() - 130), QPoint(30, -70))
    cloud = hand.picture(space.views.tiles[0])
    hand.press(Qt.Key.Key_Tab)
    hand.press(Qt.Key.Key_Home)
    gap = np.full((cloud.shape[0], 10, 3), 255, np.uint8)
    _save("annotating_cloud", np.concatenate([cloud, gap, red], axis=1))


def click_points(hand: Hands) -> None:
    """Corners of the box: a click on the mesh, a click in the image."""
    from PySide6.QtCore import Qt

    c, space = hand.controller, hand.space
    c.select("cereal_box")
    hand.press(Qt.Key.Key_C)
    hand.press(Qt.Key.Key_2)
    pose, low_high = c.pose("cereal_box", 0), np.asarray(c.session.mesh("cereal_box").bounds)
    corners = np.array([low_high[list(ijk), range(3)] for ijk in np.ndindex(2, 2, 2)])
    corners = corners.mean(axis=0) + 0.97 * (corners - corners.mean(axis=0))
    rng = np.random.default_rng(1)
    view = space.views.tiles[0].view
    for point in corners[np.argsort((pose @ corners)[:, 2])[:5]]:
        pixel = camera_of(c).project(pose @ point)
        hand.click(view, hand.at(pixel))
        hand.click(view, hand.at(pixel + rng.normal(0, 1.0, 2)))
    hand.press(Qt.Key.Key_Return)
    hand.press(Qt.Key.Key_Space)
    _save("annotating_points", hand.picture(space.views.tiles[0], space.tabs))


def camera_of(c: Any) -> Any:
    return c.session.scene.camera(c.session.scene.frame(0))


def middle_of(c: Any, name: str) -> NDArray[np.float64]:
    """Pixel of the middle of a placed object."""
    pixel: NDArray[np.float64] = camera_of(c).project(c.pose(name, 0) @ c.session.centre(name))
    return pixel


def parts(hand: Hands) -> list[QWidget]:
    """What the guide explains, in its order."""
    s = hand.space
    return [
        s.toolbar,
        s.views.tiles[0],
        s.views.tiles[1],
        s.frame_bar,
        s.objects.list,
        s.evidence,
        s.tabs,
        s.status,
    ]


def numbered(picture: Image, widgets: list[QWidget]) -> Image:
    """White numbers on discs, each on an empty place of its part of the window."""
    image = np.ascontiguousarray(picture)
    for number, widget in enumerate(widgets, 1):
        x, y = _empty_place(picture, widget)
        cv2.circle(image, (x, y), _DISC, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.circle(image, (x, y), _DISC - 2, (200, 60, 30), -1, cv2.LINE_AA)
        text = str(number)
        (w, h), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.55, 2)
        place = (x - w // 2, y + h // 2)
        cv2.putText(
            image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255, 255, 255), 2, cv2.LINE_AA
        )
    return image


def _empty_place(picture: Image, widget: QWidget) -> tuple[int, int]:
    """The pixel nearest to a widget's upper left corner around which a disc covers nothing."""
    from PySide6.QtCore import QPoint

    corner = widget.mapTo(widget.window(), QPoint(0, 0))
    left, top = max(corner.x(), 0), max(corner.y(), 0)
    part = picture[top : corner.y() + widget.height(), left : corner.x() + widget.width()]
    around = np.ones((2 * _DISC + 1, 2 * _DISC + 1), np.uint8)
    spread = (cv2.dilate(part, around).astype(int) - cv2.erode(part, around)).sum(axis=2)
    inside = np.full(spread.shape, 1e6)
    # In a bar that is lower than the disc, only its middle row counts.
    rim = min(_DISC, (len(part) - 1) // 2)
    rows = slice(rim, len(part) - rim)
    inside[rows, _DISC:-_DISC] = spread[rows, _DISC:-_DISC]
    y, x = np.nonzero(inside <= max(_FLAT, inside.min()))
    nearest = np.argmin(x.astype(int) + y)
    return left + int(x[nearest]), top + int(y[nearest])


def _save(name: str, picture: Image) -> None:
    write_color(PICTURES / f"{name}.jpg", picture, quality=QUALITY)
    print(f"{name}.jpg: {picture.shape[1]}x{picture.shape[0]}")


def display_server() -> subprocess.Popen[bytes] | None:
    """A virtual display, where there is none."""
    os.environ.setdefault("LIBGL_ALWAYS_SOFTWARE", "1")  # the same pictures everywhere
    if os.environ.get("DISPLAY"):
        return None
    number, tell_number = os.pipe()
    command = ["Xvfb", "-displayfd", str(tell_number), "-screen", "0", "1280x720x24", "-noreset"]
    command += ["-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[tell_number], stderr=subprocess.DEVNULL)
    os.close(tell_number)
    with os.fdopen(number) as answer:
        os.environ["DISPLAY"] = f":{answer.readline().strip()}"
    return server


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    known = record(folder)
    # The list of recent scenes, and the size of windows, of whoever draws stay as they are.
    os.environ["XDG_CONFIG_HOME"] = str(folder / "config")
    display = display_server()
    try:
        label(folder, known)
    finally:
        if display is not None:
            display.terminate()
