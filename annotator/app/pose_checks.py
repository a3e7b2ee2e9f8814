"""Checks of poses that the window runs: ranks, textures, marking as done, taking a turn."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.tasks import Task
from annotator.app.verdicts import measured_verdict, object_verdict
from annotator.app.view_options import choose_view_frames
from annotator.session import Session, SetPoses
from annotator.session.state import ObjectState, Snapshot

if TYPE_CHECKING:
    from annotator.session.residuals import FrameResidual
    from std_toolkit.checks.measure.ranking import PoseRank
    from std_toolkit.labels.texture.comparison import TextureComparison

RANKS, TEXTURES = "Ranks", "Textures"

# Dialog that asks before an object is marked as done whose verdict is not good.
DOUBT = "done_anyway"


def measure_objects(
    snapshot: Snapshot, objects: Sequence[ObjectState], frames: Sequence[int], task: Task
) -> dict[int, list[FrameResidual]]:
    """Return residuals by object id; runs in any thread."""
    from annotator.session.residuals import measure_residuals

    return measure_residuals(
        snapshot.scene,
        {o.id: partial(snapshot.pose, o.name) for o in snapshot.state.objects},
        {o.id: o.material for o in objects},
        {o.id: snapshot.mesh(o.model) for o in snapshot.state.objects if o.placements},
        frames,
        cancelled=lambda: task.cancelled,
    )


def _rank(
    snapshot: Snapshot, objects: Sequence[ObjectState], frames: Sequence[int], task: Task
) -> dict[int, PoseRank]:
    from std_toolkit.checks.measure.ranking import rank_objects

    placed = [o for o in snapshot.state.objects if o.placements]
    return rank_objects(
        snapshot.scene,
        {o.id: partial(snapshot.pose, o.name) for o in placed},
        {o.id: snapshot.mesh(o.model) for o in placed},
        {o.id: snapshot.state.model(o.model).symmetry.symmetry() for o in objects},
        snapshot.frames if snapshot.posed else frames,
        cancelled=lambda: task.cancelled,
    )


def rank_objects_aside(c: Controller, names: Sequence[str]) -> None:
    """Rank the poses of objects among nearby poses, in the background."""
    snapshot, frames = c.session.snapshot(), list(dict.fromkeys(c.view_frames))
    objects = [o for n in names if (o := snapshot.object(n)).placements]
    if objects:
        c.start_aside(
            RANKS,
            lambda task: _rank(snapshot, objects, frames, task),
            lambda ranks: _keep(c, objects, ranks, {}),
        )


def compare_textures_aside(
    c: Controller, *, delay: float = 0.0, failed: frozenset[str] = frozenset()
) -> None:
    """Compare the textures of all objects that were not compared at their pose, in the background.

    The selected object comes first; each finding is shown when it is there.

    Args:
        delay: seconds to wait first.
        failed: names of objects that cannot be compared.
    """
    left = [n for n in c.findings.uncompared() if n not in failed]
    names = sorted(left, key=lambda n: n != c.selected)
    if not names:
        return
    snapshot, frame, objects = c.session.snapshot(), c.active_frame, [c.session.object(names[0])]

    def finish(found: dict[str, TextureComparison]) -> None:
        _keep_textures(c, objects, found)
        compare_textures_aside(c, failed=failed if found else failed | {names[0]})

    c.start_aside(
        TEXTURES, lambda task: _compare(snapshot, names[:1], frame, task), finish, delay=delay
    )


def _compare(
    snapshot: Snapshot, names: Sequence[str], frame: int, task: Task
) -> dict[str, TextureComparison]:
    from annotator.session.textures import compare_textures

    return compare_textures(snapshot, names, frame, cancelled=lambda: task.cancelled)


def _unmoved(c: Controller, objects: Sequence[ObjectState]) -> list[ObjectState]:
    """Those objects that were not changed meanwhile, apart from status and note."""
    now = {o.name: o for o in c.session.state.objects}
    return [
        o
        for o in objects
        if (n := now.get(o.name)) is not None
        and (n.placements, n.model, n.material) == (o.placements, o.model, o.material)
    ]


def _keep_textures(
    c: Controller, objects: Sequence[ObjectState], found: dict[str, TextureComparison]
) -> None:
    """Store comparisons of objects that did not move meanwhile."""
    kept = [o.name for o in _unmoved(c, objects) if o.name in found]
    c.findings.keep_textures({name: found[name] for name in kept})
    if kept:
        c.emit(Event("verdict", objects=tuple(kept)))


def _keep(
    c: Controller,
    objects: Sequence[ObjectState],
    ranks: dict[int, PoseRank],
    rows: dict[int, list[FrameResidual]],
) -> None:
    """Store results of objects that did not move meanwhile."""
    kept = _unmoved(c, objects)
    c.ranks |= {o.name: ranks[o.id] for o in kept if o.id in ranks}
    c.residuals |= {o.name: rows[o.id] for o in kept if o.id in rows}
    c.unmeasured -= {o.name for o in kept if o.id in rows}
    if kept:
        c.emit(Event("verdict", objects=tuple(o.name for o in kept)))


def toggle_done(c: Controller) -> None:
    """Mark the selected object as done, or as open again.

    A front end with the dialog "done_anyway" asks first if the verdict is not good; a pose that
    was not measured yet is measured for it.
    """
    name = c.selected
    if name is None:
        return
    grade = object_verdict(c, name).grade
    known = name in c.residuals and name in c.ranks and name not in c.findings.uncompared()
    if c.session.object(name).status == "done":
        c.mark("open")
    elif DOUBT not in c.dialogs or grade == "fits":
        c.mark("done")
    elif known or grade in ("doubtful", "wrong"):
        c.ask(DOUBT)
    else:
        _measure_then_mark(c, name)


def _measure_then_mark(c: Controller, name: str) -> None:
    snapshot, frame = c.session.snapshot(), c.active_frame
    frames = list(dict.fromkeys(c.view_frames))
    objects = [snapshot.object(name)]
    uncompared = [n for n in c.findings.uncompared() if n == name]

    def work(task: Task) -> tuple[Any, Any, Any]:
        return (
            _compare(snapshot, uncompared, frame, task),
            _rank(snapshot, objects, frames, task),
            measure_objects(snapshot, objects, frames, task),
        )

    def finish(found: tuple[Any, Any, Any]) -> None:
        textures, ranks, rows = found
        _keep_textures(c, objects, textures)
        _keep(c, objects, ranks, rows)
        if not _unmoved(c, objects):
            c.tell(f"{name} was changed meanwhile, so it is not marked as done.", "warning")
        elif c.selected != name:
            c.tell(f"{name} is not selected any more, so it is not marked as done.", "warning")
        elif object_verdict(c, name).grade == "fits":
            c.mark("done")
        else:
            c.ask(DOUBT)

    c.start(f"Check {name}", work, finish)


def doubt(session: Session, name: str) -> str:
    """Measure an object as the window does; returns why it is not known to fit, or ""."""
    from annotator.session.textures import compare_textures

    snapshot, obj = session.snapshot(), session.object(name)
    frames = list(dict.fromkeys([*obj.placements, *choose_view_frames(session.scene, session)]))
    task = Task(f"Check {name}")
    rows = measure_objects(snapshot, [obj], frames, task).get(obj.id, [])
    rank = _rank(snapshot, [obj], frames, task).get(obj.id)
    texture = compare_textures(snapshot, [name], frames[0]).get(name)
    verdict = measured_verdict(rows, rank, texture)
    return "" if verdict.grade == "fits" else verdict.text


def can_take_turn(c: Controller) -> bool:
    """Whether the texture of the selected object fits better, or scores higher, after a turn."""
    found = c.textures.get(c.selected or "")
    return (
        found is not None
        and found.turn is not None
        and (found.verdict == "turned" or (found.verdict == "undecided" and found.rival_leads))
        and c.session.writable
        and c.session.pose(str(c.selected), c.active_frame) is not None
    )


def take_turn(c: Controller) -> None:
    """Turn the selected object to where its texture fits better, as one edit; see
    `can_take_turn`.
    """
    if not can_take_turn(c):
        return
    name, frame = str(c.selected), c.active_frame
    pose, found = c.session.pose(name, frame), c.textures[name]
    assert pose is not None and found.turn is not None
    turned = pose @ found.turn
    if c.apply(SetPoses.one(name, frame, turned, method="turn", label=f"Turn {name}")):
        c.tell(f"{name} is {found.text} now. Press R to refine it there.")
