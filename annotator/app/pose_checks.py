"""Checks of poses that the window runs: ranks, verdicts, marking as done, taking a turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from annotator.app.action import not_placed
from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.tasks import Task
from annotator.app.verdicts import can_turn, measured_verdict, object_verdict
from annotator.session import Session, SetPoses
from annotator.session.state import Judged, ObjectState, Snapshot

if TYPE_CHECKING:
    from annotator.session.residuals import FrameResidual
    from std_toolkit.checks.label_check import LabelCheck
    from std_toolkit.checks.measure.ranking import PoseRank
    from std_toolkit.labels.texture.comparison import TextureComparison
    from std_toolkit.scene import Labels

RANKS, JUDGE = "Ranks", "Verdicts"

# Other updates of the background wait so long for a turn of the judge.
TURN_S = 1.0

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


def judge_aside(c: Controller, *, delay: float = 0.0) -> None:
    """Judge all objects without a verdict on their pose, in the background.

    Stored verdicts that still hold are shown at once. The selected object comes first; what its
    texture says is shown when it is there. Contours are measured in short turns, so that other
    updates of the background do not wait.

    Args:
        delay: seconds to wait first.
    """
    names = sorted(_to_judge(c), key=lambda n: n != c.selected)
    if not names:
        return
    name, snapshot, frame = names[0], c.session.snapshot(), c.active_frame
    objects, stored = [c.session.object(name)], c.session.scene.labels
    recalled, known = c.findings.recalled, name in c.findings.judgements

    def work(task: Task) -> _Found:
        from annotator.session.judging import stored_judgements

        if not recalled:
            return _Found(recalled=stored_judgements(snapshot, stored))
        return _judge(snapshot, name, frame, stored, c.judge, task, seconds=TURN_S, known=known)

    def finish(found: _Found) -> None:
        if found.recalled is not None:
            c.findings.recalled = True
            c.findings.keep_judgements(found.recalled)
            if found.recalled:
                c.emit(Event("verdict", objects=tuple(found.recalled)))
        if found.problem:
            c.findings.unjudgeable.add(name)
        _keep_found(c, objects, found)
        judge_aside(c)

    c.start_aside(JUDGE, work, finish, delay=delay)


def _to_judge(c: Controller) -> list[str]:
    """Objects without a verdict, or with a bad one whose texture was not compared."""
    unknown = c.findings.unjudged()
    bad = [
        n
        for n, judged in c.findings.judgements.items()
        if judged.judgement.grade != "fits" and n in c.findings.uncompared()
    ]
    return [n for n in (*unknown, *bad) if n not in c.findings.unjudgeable]


@dataclass(frozen=True)
class _Found:
    """What one turn of judging gave.

    Attributes:
        recalled: stored verdicts; None if they were not looked for.
        textures, judged: by name.
        problem: whether the object cannot be judged.
    """

    recalled: dict[str, Judged] | None = None
    textures: dict[str, TextureComparison] = field(default_factory=dict)
    judged: dict[str, Judged] = field(default_factory=dict)
    problem: bool = False


def _judge(
    snapshot: Snapshot,
    name: str,
    frame: int,
    stored: Labels,
    judge: LabelCheck,
    task: Task,
    *,
    seconds: float = float("inf"),
    known: bool = False,
) -> _Found:
    """Go on judging an object; runs in any thread.

    Args:
        seconds: stop after the frame that ends later.
        known: whether there is a verdict, so that only the texture is compared.
    """
    from annotator.session.judging import frame_of, judged_scene

    i, here = snapshot.object(name).id, frame_of(snapshot, name, frame)
    scene = judged_scene(snapshot, here, stored)
    if scene.labels.of(i) is None:
        return _Found(problem=True)
    if not known and not judge.measure(scene, seconds=seconds, cancelled=lambda: task.cancelled):
        return _Found()
    compared = judge.compare(scene, i)
    textures = {} if compared is None else {name: compared.comparison}
    if known or task.cancelled:
        return _Found(textures=textures, problem=compared is None)
    found = judge.judge(scene, [i]).get(i)
    if found is None:
        return _Found(textures=textures, problem=True)
    at = None if snapshot.posed else here
    return _Found(textures=textures, judged={name: Judged(found.judgement, at)})


def _keep_found(c: Controller, objects: Sequence[ObjectState], found: _Found) -> None:
    """Store what was found of objects that did not move meanwhile."""
    names = [o.name for o in _unmoved(c, objects)]
    textures = {n: found.textures[n] for n in names if n in found.textures}
    judged = {n: found.judged[n] for n in names if n in found.judged}
    c.findings.keep_textures(textures)
    c.findings.keep_judgements(judged)
    if textures or judged:
        c.emit(Event("verdict", objects=tuple({*textures, *judged})))


def _unmoved(c: Controller, objects: Sequence[ObjectState]) -> list[ObjectState]:
    """Those objects that were not changed meanwhile, apart from status and note."""
    now = {o.name: o for o in c.session.state.objects}
    return [
        o
        for o in objects
        if (n := now.get(o.name)) is not None
        and (n.placements, n.model, n.material) == (o.placements, o.model, o.material)
    ]


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

    A front end with the dialog "done_anyway" asks first unless the judge says that the pose fits;
    a pose that was not judged yet is judged for it.
    """
    name = c.selected
    if name is None:
        return
    verdict = object_verdict(c, name)
    if c.session.object(name).status == "done":
        c.mark("open")
    elif DOUBT not in c.dialogs or verdict.grade == "fits":
        c.mark("done")
    elif name in c.findings.judgements or verdict.turned or name in c.findings.unjudgeable:
        c.ask(DOUBT)
    else:
        _judge_then_mark(c, name)


def _judge_then_mark(c: Controller, name: str) -> None:
    c.start_in_turn(f"Check {name}", lambda: _begin_to_judge(c, name))


def _begin_to_judge(c: Controller, name: str) -> None:
    # It may have been removed while another was refined.
    if not any(o.name == name and o.placements for o in c.session.state.objects):
        return
    snapshot, frame = c.session.snapshot(), c.active_frame
    objects, stored = [snapshot.object(name)], c.session.scene.labels

    def work(task: Task) -> _Found:
        return _judge(snapshot, name, frame, stored, c.judge, task)

    def finish(found: _Found) -> None:
        _keep_found(c, objects, found)
        if not _unmoved(c, objects):
            c.tell(f"{name} was changed meanwhile, so it is not marked as done.", "warning")
        elif c.selected != name:
            c.tell(f"{name} is not selected any more, so it is not marked as done.", "warning")
        elif object_verdict(c, name).grade == "fits":
            c.mark("done")
        else:
            c.ask(DOUBT)

    c.start(f"Check {name}", work, finish)


def doubt(session: Session, name: str, *, judge: LabelCheck) -> str:
    """Judge an object as the window does; returns why it is not known to fit, or ""."""
    snapshot, task = session.snapshot(), Task(f"Check {name}")
    frame = next(iter(snapshot.object(name).placements), 0)
    found = _judge(snapshot, name, frame, session.scene.labels, judge, task)
    judged = found.judged.get(name)
    if judged is not None:
        session.judged[snapshot.object(name).id] = judged
    texture = found.textures.get(name)
    verdict = measured_verdict((), None, texture, None if judged is None else judged.judgement)
    return "" if verdict.grade == "fits" else verdict.text


class ScriptDoubt:
    """`doubt` for a script, by the limits of the last check of its scene, as in the window.

    One judge serves all calls: what it measured once it does not measure again.
    """

    def __init__(self) -> None:
        self.judge: LabelCheck | None = None

    def __call__(self, session: Session, name: str) -> str:
        from std_toolkit.checks.label_check import LabelCheck
        from std_toolkit.scene.label_verdicts import options_of_last_check

        if self.judge is None:
            self.judge = LabelCheck(options_of_last_check(session.scene))
        return doubt(session, name, judge=self.judge)


def no_turn(c: Controller) -> str:
    """Say why no turn can be taken after which the texture fits better, or scores higher."""
    found = c.textures.get(c.selected or "")
    known = found is not None and can_turn(found)
    return not_placed(c) or ("" if known else "no turn is known that fits better")


def take_turn(c: Controller) -> None:
    """Turn the selected object to where its texture fits better, as one edit; see
    `no_turn`.
    """
    if no_turn(c):
        return
    name, frame = str(c.selected), c.active_frame
    pose, found = c.session.pose(name, frame), c.textures[name]
    assert pose is not None and found.turn is not None
    turned = pose @ found.turn
    if c.apply(SetPoses.one(name, frame, turned, method="turn", label=f"Turn {name}")):
        c.tell(f"{name} is {found.text} now. Press R to refine it there.")
