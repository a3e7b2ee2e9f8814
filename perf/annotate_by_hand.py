"""Time that labelling by hand takes: `python perf/annotate_by_hand.py WORK`.

A scripted person labels two textured objects in the real window, on a virtual display: the mustard
bottle of the real recording `tabletop_board_rgb`, and a printed box in a synthetic recording with
pictures of its texture. Every press of a key, click and drag is a real event. Before it, the person
waits as long as the keystroke-level model says (Card, Moran and Newell, 1980): 1.35 s to think,
1.1 s to point, 0.28 s for a key. The aim is off by 8 px, and the turn is judged to 8 degrees.

The time is that of the tool's own timer, as `labels.json` contains it. It includes the time of the
machine, refinement among it, so that a busy machine makes it longer.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "docs/pictures"))

from annotating import AIM_PX, camera_of, display_server

from sensors.output.recording_writer import read_truth
from sensors.synthetic import RecordingOptions, make_recording
from sensors.synthetic.recording import textured_meshes
from std_toolkit.cli.main import main as curate
from std_toolkit.geometry import SE3, so3_exp, so3_log

REPOSITORY = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("STD_TEST_DATA", REPOSITORY.parent / "shared" / "data"))
THINK_S, POINT_S, KEY_S = 1.35, 1.1, 0.28
TURN_DEG = 8.0
# As read off the first image by eye.
BOTTLE = SE3(so3_exp([0.2, 2.7, -0.9]), np.array([0.31, -0.17, 0.77]))


@dataclass(frozen=True)
class Task:
    """An object to label.

    Attributes:
        name: of the row.
        scene: folder of a scene with camera poses.
        mesh: file of the mesh.
        pose: T_cam_obj in the first frame, about.
    """

    name: str
    scene: Path
    mesh: Path
    pose: SE3


def bottle(work: Path) -> Task:
    """The mustard bottle of the real recording."""
    recording, scene = DATA / "tabletop_board_rgb", work / "tabletop"
    if not (work / "posed").is_dir():
        shutil.rmtree(scene, ignore_errors=True)
        intrinsics = ["--intrinsics", str(recording / "cam_intrinsics.json")]
        color = ["--color", str(recording / "color")]
        assert curate(["import", *color, *intrinsics, "--out", str(scene)]) == 0
        shutil.copyfile(recording / "board_mm.json", scene / "board.json")
        assert curate(["poses", str(scene), "--scale", "board"]) == 0
        scene.rename(work / "posed")
    mesh = DATA / "ycb_meshes" / "006_mustard_bottle" / "textured.obj"
    return Task("mustard bottle, real recording", work / "posed", mesh, BOTTLE)


def box(work: Path) -> Task:
    """The printed box of a synthetic recording."""
    recording, scene = work / "recording", work / "box"
    options = RecordingOptions(frames=16, width=1280, height=720, arc_degrees=100.0)
    mesh = work / "cereal_box.glb"
    if not (work / "box_posed").is_dir():
        make_recording(recording, options)
        textured_meshes(options)["cereal_box"].export(mesh)
        shutil.rmtree(scene, ignore_errors=True)
        folders = ["--color", str(recording / "color"), "--depth", str(recording / "depth")]
        numbers = ["--depth-scale", "0.001", "--intrinsics", str(recording / "intrinsics.json")]
        assert curate(["import", *folders, *numbers, "--out", str(scene)]) == 0
        assert curate(["poses", str(scene)]) == 0
        scene.rename(work / "box_posed")
    truth = read_truth(recording)
    pose = truth.camera_pose(0).inverse() @ truth.object_pose("cereal_box")
    return Task("printed box, synthetic recording", work / "box_posed", mesh, pose)


def wait(seconds: float) -> None:
    from window_hands import let_work

    let_work(round(1000 * seconds))


def label(task: Task, work: Path, seed: int) -> tuple[float, float, int, str]:
    """Label one object.

    Returns:
        Seconds by the tool's timer, seconds by the clock, number of actions, and the verdict.
    """
    from PySide6.QtCore import Qt
    from window_hands import Hands

    from annotator.app.verdicts import object_verdict
    from annotator.qt.main_window import Shell
    from annotator.qt.qt_app import make_application

    scene = work / "scene"
    shutil.rmtree(scene, ignore_errors=True)
    shutil.copytree(task.scene, scene)
    make_application()
    shell = Shell(annotator="mk")
    shell.resize(1280, 720)
    shell.show()
    shell.activateWindow()
    wait(0.5)
    assert shell.open_scene(scene, recover="no")
    hand = Hands(shell)
    hand.settle()
    c = hand.controller
    hand.wait(lambda: c.table is not None or bool(c.table_problem))
    rng = np.random.default_rng(seed)
    known = len(c.session.state.models)
    began = time.monotonic()
    wait(THINK_S + POINT_S)
    hand.drop_files([task.mesh])
    hand.wait(lambda: len(c.session.state.models) > known)
    model = c.session.state.models[-1]
    wait(THINK_S + 2 * POINT_S)
    middle = camera_of(c).project(task.pose @ c.session.centre(model.id))
    hand.drop_mesh(model.id, middle + rng.normal(0, AIM_PX, 2))
    name = c.selected
    wait(THINK_S)
    if _tip(hand, name, task.pose):
        middle = camera_of(c).project(task.pose @ c.session.centre(model.id))
        _slide(hand, name, middle + rng.normal(0, AIM_PX, 2))
    _turn(hand, name, task.pose, rng.normal(0, TURN_DEG))
    wait(THINK_S + KEY_S)
    hand.press(Qt.Key.Key_R)
    hand.wait(lambda: name in c.findings.judgements, 120)
    wait(2 * THINK_S)  # looks at the views and the verdict
    compared = c.textures.get(name)
    if compared is not None and compared.verdict == "turned":
        wait(KEY_S)
        hand.press(Qt.Key.Key_Y)
        hand.wait(lambda: name in c.findings.judgements, 120)
        wait(THINK_S)
    verdict = c.findings.judgements[name].judgement.reason
    wait(KEY_S)
    if object_verdict(c, name).grade != "fits":
        verdict += f" ({object_verdict(c, name).text})"
        hand.answer(lambda dialog: dialog.accept())
    hand.press(Qt.Key.Key_D)
    clock = time.monotonic() - began
    c.session.save()
    found = c.session.scene.labels.labels[-1]
    shell.leave_scene()
    return found.provenance.hands_on_s or 0.0, clock, hand.actions, verdict


def _tip(hand: Any, name: str, wanted: SE3) -> bool:
    """Quarter turns until the object stands on the right side; whether any was needed."""
    from PySide6.QtCore import Qt

    c = hand.controller
    up = c.up(0)
    keys = (Qt.Key.Key_X, Qt.Key.Key_Y, Qt.Key.Key_Z)
    pressed = False
    # Three quarter turns at most about one axis, with a look at each.
    for axis in sorted(range(3), key=lambda a: abs(float(wanted.R[:, a] @ up))):
        for _ in range(3):
            standing = c.pose(name, 0).R.T @ up
            if float(standing @ (wanted.R.T @ up)) > np.cos(np.pi / 4):
                return pressed
            if abs(standing[axis]) > np.sin(np.pi / 4):
                break  # a turn about the vertical tips nothing
            wait(THINK_S + KEY_S)
            hand.press(keys[axis], Qt.KeyboardModifier.AltModifier)
            pressed = True
    return pressed


def _slide(hand: Any, name: str, middle: Any) -> None:
    """Drop the object onto the table, and slide it there until its centre is at a pixel."""
    from PySide6.QtCore import Qt

    c = hand.controller
    wait(KEY_S)
    hand.press(Qt.Key.Key_S)
    wait(THINK_S + 2 * POINT_S)
    model = c.session.state.object(name).model
    now = hand.at(camera_of(c).project(c.pose(name, 0) @ c.session.centre(model)))
    hand.drag(now, hand.at(middle) - now, Qt.KeyboardModifier.ControlModifier)


def _turn(hand: Any, name: str, wanted: SE3, error_deg: float) -> None:
    """Steps of 10 degrees about the table's normal until it looks about right."""
    from PySide6.QtCore import Qt

    c = hand.controller
    up = c.up(0)
    turn = so3_log(wanted.R @ c.pose(name, 0).R.T)
    steps = round((float(np.rad2deg(turn @ up)) + error_deg) / 10)
    if steps:
        wait(KEY_S)
        hand.press(Qt.Key.Key_7)
        # Presses follow one another; the person looks when the last one is drawn.
        wait(abs(steps) * KEY_S)
        key = Qt.Key.Key_Right if steps > 0 else Qt.Key.Key_Left
        hand.press(key, Qt.KeyboardModifier.ShiftModifier, abs(steps))


def main() -> None:
    work = Path(sys.argv[1])
    work.mkdir(parents=True, exist_ok=True)
    shown = display_server()
    try:
        print(f"{'object':<34}{'tool s':>8}{'clock s':>9}{'actions':>9}  verdict")
        for task in (bottle(work), box(work)):
            for seed in range(2):
                seconds, clock, actions, verdict = label(task, work, seed)
                print(
                    f"{task.name:<34}{seconds:>8.1f}{clock:>9.1f}{actions:>9}  {verdict}",
                    flush=True,
                )
    finally:
        if shown is not None:
            shown.terminate()


if __name__ == "__main__":
    main()
