"""Three versions of a scene meet: what only one side changed wins, what both changed is told."""

from __future__ import annotations

import msgspec
import pytest

from annotator.session.ledger import History, Step, conflicts, take_over
from annotator.session.merge import Stored, Version, differ, merge
from annotator.session.saving import documents_of
from annotator.session.state import AnnotationState, Cameras, Click, ObjectState, Placement
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.scene import Annotation, Labels, Model, ObjectTable

CAMERAS = Cameras("no camera poses", (0, 1), {})
BOX = Model(id="box", mesh="models/box/box.ply", size_m=[0.1, 0.1, 0.1], diameter_m=0.17)


def thing(number: int, name: str, x: float | None = 0.0, **changes: object) -> ObjectState:
    placements = {}
    if x is not None:
        pose = SE3.exp([x, 0, 0.5, 0, 0, 0]).flat()
        placements = {0: Placement(T_cam_obj=pose, method="m", time="2025-01-01T00:00:00Z")}
    made = ObjectState(id=number, name=name, model="box", material="diffuse", placements=placements)
    return msgspec.structs.replace(made, **changes)


def version(*objects: ObjectState) -> Version:
    """Objects as they stand in a scene's files."""
    state = AnnotationState(models=[BOX], objects=sorted(objects, key=lambda o: o.id))
    empty = Version(
        Stored(objects=ObjectTable(), labels=Labels(), annotation=Annotation()), AnnotationState()
    )
    return Version(documents_of(state, empty, None, CAMERAS), state)


def history(*states: AnnotationState) -> History:
    made = History(states[0])
    for state in states[1:]:
        made.push(Step("", (), state))
    return made


BASE = version(thing(1, "a"), thing(2, "b"))
MINE = version(thing(1, "a", 0.1), thing(2, "b")).state


def test_who_changed_nothing_gets_what_the_other_has() -> None:
    theirs = version(thing(1, "a"), thing(2, "b", 0.2), thing(3, "c"))
    for prefer in ("mine", "theirs"):
        assert merge(BASE, BASE.state, theirs, prefer=prefer).state == theirs.state  # type: ignore[arg-type]
        assert merge(BASE, MINE, BASE, prefer=prefer).state is MINE  # type: ignore[arg-type]
        same = merge(BASE, theirs.state, theirs, prefer=prefer)  # type: ignore[arg-type]
        assert same.state == theirs.state
        assert not same.conflicts


def test_changes_of_different_objects_come_together() -> None:
    theirs = version(thing(1, "a"), thing(2, "b", 0.2))
    merged = merge(BASE, MINE, theirs, prefer="mine")
    assert merged.state == version(thing(1, "a", 0.1), thing(2, "b", 0.2)).state
    assert (merged.conflicts, merged.taken) == ((), ("b",))


def test_changes_of_different_parts_of_one_object_come_together() -> None:
    theirs = version(thing(1, "a", material="specular"), thing(2, "b"))
    noted = AnnotationState(models=[BOX], objects=[thing(1, "a", 0.1, note="x"), thing(2, "b")])
    merged = merge(BASE, noted, theirs, prefer="theirs")
    assert merged.conflicts == ()
    assert merged.state.object("a") == thing(1, "a", 0.1, note="x", material="specular")


@pytest.mark.parametrize("prefer", ["mine", "theirs"])
def test_two_poses_of_one_object_are_a_conflict(prefer: str) -> None:
    theirs = version(thing(1, "a", 0.2), thing(2, "b"))
    merged = merge(BASE, MINE, theirs, prefer=prefer)  # type: ignore[arg-type]
    assert merged.conflicts == ("a",)
    assert merged.state.object("a") == thing(1, "a", 0.1 if prefer == "mine" else 0.2)


@pytest.mark.parametrize("prefer", ["mine", "theirs"])
def test_removed_by_one_and_moved_by_the_other_is_a_conflict(prefer: str) -> None:
    removed = version(thing(2, "b"))
    moved = version(thing(1, "a", 0.2), thing(2, "b"))
    ours = merge(BASE, removed.state, moved, prefer=prefer)  # type: ignore[arg-type]
    assert ours.conflicts == ("a",)
    assert [o.name for o in ours.state.objects] == (["b"] if prefer == "mine" else ["a", "b"])
    others = merge(BASE, moved.state, removed, prefer=prefer)  # type: ignore[arg-type]
    assert others.conflicts == ("a",)
    assert [o.name for o in others.state.objects] == (["a", "b"] if prefer == "mine" else ["b"])


def test_removed_by_one_and_left_alone_by_the_other_is_removed() -> None:
    removed = version(thing(2, "b"))
    assert merge(BASE, removed.state, BASE, prefer="theirs").state == removed.state
    assert merge(BASE, BASE.state, removed, prefer="mine").state == removed.state
    assert merge(BASE, removed.state, removed, prefer="mine").conflicts == ()


def test_a_removal_that_was_cut_off_while_it_was_saved_is_no_conflict() -> None:
    """The label is gone from the disk, the object is still there."""
    removed = version(thing(2, "b"))
    half = version(thing(1, "a", None), thing(2, "b"))
    merged = merge(BASE, removed.state, half, prefer="theirs")
    assert merged.conflicts == ()
    assert merged.state == removed.state


def test_meshes_that_both_changed_differently_are_a_conflict() -> None:
    def with_category(category: str) -> Version:
        state = msgspec.structs.replace(
            BASE.state, models=[msgspec.structs.replace(BOX, category=category)]
        )
        return Version(documents_of(state, BASE, None, CAMERAS), state)

    merged = merge(BASE, with_category("can").state, with_category("mug"), prefer="mine")
    assert merged.conflicts == ("mesh box",)
    assert merged.state.model("box").category == "can"


def test_two_new_objects_of_one_id_get_two_ids_in_every_state() -> None:
    added = version(thing(1, "a"), thing(2, "b"), thing(3, "ours")).state
    moved = version(thing(1, "a"), thing(2, "b"), thing(3, "ours", 0.3)).state
    theirs = version(thing(1, "a"), thing(2, "b"), thing(3, "theirs"))
    steps = history(BASE.state, added, moved)
    assert conflicts(BASE, steps, theirs) == ()
    take_over(BASE, steps, theirs, prefer="mine")
    assert [{o.name: o.id for o in s.objects} for s in steps.states] == [
        {"a": 1, "b": 2, "theirs": 3},
        {"a": 1, "b": 2, "theirs": 3, "ours": 4},
        {"a": 1, "b": 2, "theirs": 3, "ours": 4},
    ]
    assert steps.state.object("ours").placements == moved.object("ours").placements


def test_one_new_object_that_both_entered_is_one_object() -> None:
    ours = version(thing(1, "a"), thing(2, "b"), thing(3, "x"), thing(4, "new", 0.3)).state
    theirs = version(thing(1, "a"), thing(2, "b"), thing(3, "new", None))
    steps = history(BASE.state, ours)
    take_over(BASE, steps, theirs, prefer="mine")
    assert {o.name: o.id for o in steps.state.objects} == {"a": 1, "b": 2, "new": 3, "x": 5}
    assert steps.state.object("new").placements == ours.object("new").placements


def test_undo_never_takes_back_what_others_did() -> None:
    theirs = version(thing(1, "a"), thing(2, "b", 0.2), thing(3, "c"))
    steps = history(BASE.state, MINE)
    take_over(BASE, steps, theirs, prefer="mine")
    assert steps.state.object("a") == MINE.object("a")
    steps.undo()
    assert steps.state == theirs.state


def test_an_older_state_that_cannot_be_joined_becomes_theirs() -> None:
    """We renamed b to c for a while; meanwhile the others entered a c."""
    renamed = version(thing(1, "a"), thing(2, "c")).state
    theirs = version(thing(1, "a"), thing(2, "b"), thing(3, "c"))
    steps = history(BASE.state, renamed, MINE)
    take_over(BASE, steps, theirs, prefer="mine")
    steps.undo()
    assert steps.state == theirs.state
    now = history(BASE.state, renamed)
    with pytest.raises(ToolkitError, match=r"same name.*'c'.*rename yours"):
        take_over(BASE, now, theirs, prefer="mine")
    assert now.state is renamed


def test_what_differs_in_who_and_when_only_is_not_worth_saving() -> None:
    again = msgspec.structs.replace(
        BASE.state,
        objects=[
            msgspec.structs.replace(
                o,
                placements={
                    f: msgspec.structs.replace(p, time="2025-01-02T00:00:00Z", method="typed")
                    for f, p in o.placements.items()
                },
            )
            for o in BASE.state.objects
        ],
    )
    assert not differ(BASE.state, again)
    clicked = thing(1, "a", clicks={0: [Click(u=1, v=1, point=[0, 0, 0])]})
    assert differ(BASE.state, BASE.state.with_object(clicked))
