"""The window gives every label the word that the check gives it, and remembers it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from desk_without_window import Desk

from annotator.app import pose_checks
from annotator.app.background_updates import BackgroundUpdates
from annotator.app.verdicts import object_verdict
from annotator.session import ChangeObject, Move, Session
from sensors.synthetic import RecordingOptions, scene_from_truth
from sensors.synthetic.recording import textured_meshes
from std_toolkit.checks.check_step import run_check
from std_toolkit.checks.label_check import LabelCheck
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.options import CheckOptions, PropagateOptions
from std_toolkit.scene import Labels, ObjectTable, Scene
from std_toolkit.scene.judgement import Judgement
from std_toolkit.scene.label_verdicts import label_verdicts
from std_toolkit.scene.model import pose_from_list

BOX = "cereal_box"
NAMES = (BOX, "mug", "glass")
QUICK = CheckOptions(overlay_frames=0)


def write_table(recording: Path, out: Path) -> Scene:
    """A textured box, a bare mug and a glass, with right labels."""
    scene = scene_from_truth(recording, out)
    kept = [o for o in scene.objects.objects if o.name in NAMES]
    path = f"models/{BOX}/{BOX}.obj"
    textured_meshes(RecordingOptions(frames=9, seed=1))[BOX].export(out / path)
    models = [
        msgspec.structs.replace(m, mesh=path) if m.id == BOX else m for m in scene.objects.models
    ]
    ids = {o.id for o in kept}
    scene.save_labels(Labels(labels=[x for x in scene.labels.labels if x.object in ids]))
    scene.save_objects(ObjectTable(models=models, objects=kept))
    return Scene.open(out)


@dataclass(frozen=True)
class Off:
    """How far a label is off: mm along the world's x axis, degrees about the object's own axis."""

    mm: float = 0.0
    half_turn: bool = False


def displace(scene: Scene, off: dict[str, Off]) -> None:
    """Move labels away from the truth."""
    labels = []
    for label in scene.labels.labels:
        found = off.get(scene.objects.object(label.object).name, Off())
        assert label.T_world_obj is not None
        T = pose_from_list(label.T_world_obj)
        if found.half_turn:
            low, high = scene.mesh(BOX).bounds
            R = so3_exp([0, 0, np.pi])
            centre = (low + high) / 2
            T = T @ SE3(R, centre - R @ centre)
        T = SE3(T.R, T.t + np.array([found.mm / 1000, 0, 0]))
        T_world_cam = scene.T_world_cam(label.frame)
        assert T_world_cam is not None
        labels.append(
            msgspec.structs.replace(
                label, T_world_obj=T.flat(), T_cam_obj=(T_world_cam.inverse() @ T).flat()
            )
        )
    scene.save_labels(Labels(labels=labels))


def in_window(root: Path) -> dict[str, Judgement]:
    """The judgements of an annotation session that knows of no other."""
    with Session.open(root, annotator="mk") as session:
        found, judge = {}, LabelCheck()
        for name in NAMES:
            pose_checks.doubt(session, name, judge=judge)
            found[name] = session.judged[session.object(name).id].judgement
        return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("off", "grades"),
    [
        pytest.param(
            {}, {BOX: "fits", "mug": "fits", "glass": "fits"}, id="right", marks=pytest.mark.long
        ),
        pytest.param(
            {BOX: Off(8), "mug": Off(-8), "glass": Off(8)},
            {BOX: "wrong", "mug": "wrong", "glass": "wrong"},
            id="8 mm off",
            marks=pytest.mark.long,
        ),
        pytest.param(
            {BOX: Off(half_turn=True)},
            {BOX: "wrong", "mug": "fits", "glass": "fits"},
            id="half a turn",
        ),
    ],
)
def test_the_same_label_gets_the_same_word(
    synthetic_table: Path, tmp_path: Path, off: dict[str, Off], grades: dict[str, str]
) -> None:
    scene = write_table(synthetic_table, tmp_path / "scene")
    displace(scene, off)
    window = in_window(scene.root)
    report = run_check(scene, QUICK)
    assert {o.name: o.verdict for o in report.objects} == grades
    assert {name: j.grade for name, j in window.items()} == grades
    for verdict in label_verdicts(Scene.open(scene.root)):
        judged = window[verdict.name]
        assert judged.reason == verdict.reason
        assert judged.probability == pytest.approx(verdict.probability, abs=1e-3)


@pytest.mark.slow
def test_a_script_judges_by_the_limits_of_the_last_check(
    synthetic_table: Path, tmp_path: Path
) -> None:
    scene = write_table(synthetic_table, tmp_path / "scene")
    displace(scene, {"mug": Off(-8)})
    with Session.open(scene.root, annotator="mk") as session:
        assert pose_checks.ScriptDoubt()(session, "mug")
    run_check(scene, replace(QUICK, max_motion_mm=16.0))
    with Session.open(scene.root, annotator="mk") as session:
        assert pose_checks.ScriptDoubt()(session, "mug") == ""


@pytest.fixture
def checked(synthetic_table: Path, tmp_path: Path) -> Iterator[Desk]:
    """A window on a scene that was just checked."""
    scene = write_table(synthetic_table, tmp_path / "scene")
    run_check(scene, QUICK)
    desk = Desk(scene.root)
    desk.controller.select("mug")
    yield desk
    desk.close()


@pytest.mark.slow
def test_a_fresh_judgement_of_the_check_is_shown_and_a_stale_one_measured_again(
    checked: Desk,
) -> None:
    c = checked.controller
    assert object_verdict(c, "mug").text.startswith("Not judged yet")
    updates = BackgroundUpdates(c)
    checked.wait(lambda: c.findings.recalled, at_most_s=60)
    stored = {x.object: x.judgement for x in c.session.scene.labels.labels}
    for name in NAMES:
        judged = c.findings.judgements[name].judgement
        assert judged == stored[c.session.object(name).id]
        assert object_verdict(c, name).grade == "fits"
    # A note and a nudge below a tenth of the deviation keep it, and nudges add up.
    c.apply(ChangeObject(object="mug", note="look again"))
    step = 0.06 * c.findings.judgements["mug"].judgement.deviation_mm
    nudge = Move(object="mug", frame=0, axes="camera", shift_mm=[step, 0, 0])
    c.apply(nudge)
    assert object_verdict(c, "mug").grade == "fits"
    for _ in range(4):
        c.apply(nudge)
    assert object_verdict(c, "mug").grade == "unknown"
    assert object_verdict(c, "glass").grade == "fits"
    c.apply(Move(object="mug", frame=0, axes="camera", shift_mm=[9, 0, 0]))
    checked.wait(lambda: "mug" in c.findings.judgements, at_most_s=120)
    assert object_verdict(c, "mug").grade == "wrong"
    updates.close()


@pytest.mark.slow
def test_a_verdict_is_saved_carried_and_found_again(checked: Desk) -> None:
    """Also that on a pose that was never checked: in `info` and in the next window."""
    c = checked.controller
    c.apply(Move(object="mug", frame=0, axes="camera", shift_mm=[9, 0, 0]))
    updates = BackgroundUpdates(c)
    checked.wait(lambda: "mug" in c.findings.judgements, at_most_s=120)
    updates.close()
    made = c.findings.judgements["mug"].judgement
    c.session.save()
    c.session.propagate(PropagateOptions())
    scene = Scene.open(c.session.scene.root)
    found = {v.name: v for v in label_verdicts(scene)}
    assert (found["mug"].grade, found["mug"].reason) == ("wrong", made.reason)
    assert found["glass"].grade == "fits"
    row = scene.annotation.of(c.session.object("mug").id)
    assert isinstance(row.judgement, Judgement) and row.judgement.reason == made.reason
    updates = BackgroundUpdates(c)  # as in a window that is opened now
    checked.wait(lambda: c.findings.recalled, at_most_s=60)
    updates.close()
    assert object_verdict(c, "mug").grade == "wrong"
