"""A judgement stays with the label while its pose stays: through notes, nudges, undo and saving."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from annotator.session import ChangeObject, Move, Session, SetPoses
from std_toolkit.geometry import SE3
from std_toolkit.scene import Annotation, ObjectAnnotation, Scene
from std_toolkit.scene.judgement import Judgement
from std_toolkit.scene.model import pose_from_list


def judged(T: list[float]) -> Judgement:
    """A judgement that allows 0.1 mm."""
    return Judgement(
        grade="fits",
        probability=0.99,
        reason="the images agree",
        T_obj=T,
        T_rival=T,
        deviation_mm=1.0,
        deviation_deg=1.0,
        inputs="0" * 32,
        time="2025-01-01T00:00:00Z",
    )


@pytest.fixture()
def checked(root: Path) -> Path:
    """The scene with a judgement of its label, of the check and of the annotation tool."""
    scene = Scene.open(root)
    (label,) = scene.labels.labels
    assert label.T_world_obj is not None
    with_judgement = msgspec.structs.replace(label, judgement=judged(label.T_world_obj))
    scene.save_labels(scene.labels.with_label(with_judgement))
    row = ObjectAnnotation(object=1, judgement=judged(label.T_cam_obj))
    scene.save_annotation(Annotation(objects=[row]))
    return root


def stored(root: Path) -> tuple[Judgement | None, Judgement | None]:
    """The judgements in labels.json and annotation.json."""
    scene = Scene.open(root)
    label = scene.labels.of(1)
    assert label is not None
    found = (label.judgement, scene.annotation.of(1).judgement)
    return tuple(None if isinstance(x, msgspec.UnsetType) else x for x in found)  # type: ignore[return-value]


def nudge(session: Session, mm: float, frame: int = 0) -> None:
    session.apply(Move(object="box_1", frame=frame, shift_mm=[mm, 0, 0]))


def test_notes_and_status_keep_it(checked: Path) -> None:
    before = stored(checked)
    with Session.open(checked) as session:
        assert session.judgement("box_1") == before[1]
        session.apply(ChangeObject(object="box_1", note="look again"))
        session.apply(ChangeObject(object="box_1", status="done"))
        session.apply(ChangeObject(object="box_1", name="carton"))
        session.save()
    assert stored(checked) == before and None not in before
    assert Scene.open(checked).annotation.of(1).note == "look again"


def test_nudges_add_up_and_undo_brings_it_back(checked: Path) -> None:
    with Session.open(checked) as session:
        nudge(session, 0.06)
        session.save()
        assert None not in stored(checked) and session.judgement("box_1") is not None
        nudge(session, 0.06)
        assert session.judgement("box_1") is None
        session.save()
        assert stored(checked) == (None, None)
        session.undo()
        assert session.judgement("box_1") is not None
        session.save()
        # That of the check is measured again.
        assert stored(checked)[1] is not None
    with Session.open(checked) as session:
        assert session.judgement("box_1") is not None


def test_it_follows_the_label_into_the_camera_of_another_frame(checked: Path) -> None:
    with Session.open(checked) as session:
        nudge(session, 0.05, frame=2)
        session.save()
        now = session.pose("box_1", 2)
    _, judgement = stored(checked)
    assert judgement is not None and now is not None
    measured = pose_from_list(judgement.T_obj)
    apart = (now.inverse() @ measured).t
    assert (apart @ apart) ** 0.5 == pytest.approx(5e-5, abs=1e-6)
    assert judgement.T_rival == judgement.T_obj
    # The same numbers in another camera are another pose.
    with Session.open(checked) as session:
        session.apply(SetPoses.one("box_1", 0, measured, method="typed"))
        assert session.judgement("box_1") is None


def test_a_check_meanwhile_is_no_conflict(checked: Path) -> None:
    with Session.open(checked) as session:
        session.apply(SetPoses.one("box_1", 0, SE3.exp([0, 0, 0.5, 0, 0, 0]), method="typed"))
        scene = Scene.open(checked)
        (label,) = scene.labels.labels
        again = msgspec.structs.replace(judged(label.T_world_obj or []), grade="wrong")
        again = msgspec.structs.replace(label, judgement=again)
        scene.save_labels(scene.labels.with_label(again))
        session.save()
    assert stored(checked) == (None, None)


def test_edits_before_a_crash_bring_it_back(checked: Path) -> None:
    session = Session.open(checked)
    nudge(session, 0.05)
    session.close()  # unsaved edits stay in the journal
    with Session.open(checked, recover="yes") as session:
        assert session.unsaved and session.judgement("box_1") is not None
