"""Checks of poses that the window runs: rank among nearby poses, marking as done, taking a turn."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.tasks import Task
from annotator.app.verdicts import object_verdict
from annotator.session import SetPoses
from annotator.session.state import ObjectState, Snapshot

if TYPE_CHECKING:
    from annotator.session.residuals import FrameResidual
    from std_toolkit.checks.measure.ranking import PoseRank

RANKS = "Ranks"

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


def _keep(
    c: Controller,
    objects: Sequence[ObjectState],
    ranks: dict[int, PoseRank],
    rows: dict[int, list[FrameResidual]],
) -> None:
    """Store results of objects that did not move meanwhile."""
    now = {o.name: o.placements for o in c.session.state.objects}
    kept = [o for o in objects if now.get(o.name) == o.placements]
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
    if c.session.object(name).status == "done":
        c.mark("open")
    elif DOUBT not in c.dialogs or object_verdict(c, name).grade == "fits":
        c.mark("done")
    elif name in c.residuals and name in c.ranks:
        c.ask(DOUBT)
    else:
        _measure_then_mark(c, name)


def _measure_then_mark(c: Controller, name: str) -> None:
    snapshot, frames = c.session.snapshot(), list(dict.fromkeys(c.view_frames))
    objects = [snapshot.object(name)]

    def work(task: Task) -> tuple[dict[int, list[FrameResidual]], dict[int, PoseRank]]:
        rows = measure_objects(snapshot, objects, frames, task)
        return rows, _rank(snapshot, objects, frames, task)

    def finish(found: tuple[dict[int, list[FrameResidual]], dict[int, PoseRank]]) -> None:
        rows, ranks = found
        _keep(c, objects, ranks, rows)
        if c.selected != name or name not in c.ranks:
            return
        if object_verdict(c, name).grade == "fits":
            c.mark("done")
        else:
            c.ask(DOUBT)

    c.start(f"Check {name}", work, finish)


def can_take_turn(c: Controller) -> bool:
    """Whether another turn of the selected object fits the texture better."""
    found = c.textures.get(c.selected or "")
    return (
        found is not None
        and found.verdict == "turned"
        and found.turn is not None
        and c.session.writable
        and c.session.pose(str(c.selected), c.active_frame) is not None
    )


def take_turn(c: Controller) -> None:
    """Turn the selected object to where its texture fits better, as one edit."""
    if not can_take_turn(c):
        return
    name, frame = str(c.selected), c.active_frame
    pose, found = c.session.pose(name, frame), c.textures[name]
    assert pose is not None and found.turn is not None
    turned = pose @ found.turn
    if c.apply(SetPoses.one(name, frame, turned, method="turn", label=f"Turn {name}")):
        c.tell(f"{name} is {found.text} now. Press R to refine it there.")
