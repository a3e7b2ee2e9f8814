"""Computations that the user starts: refine, snap, solve, carry over, save, propagate.

Each takes a snapshot, computes in the background and applies one edit. If an object of the result
was edited meanwhile, the result is dropped with a message and nothing is overwritten.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

from annotator.app import pose_checks
from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.tasks import Task
from annotator.session import ClearPose
from annotator.session.saving import PropagationResult, propagate_saved_labels

if TYPE_CHECKING:
    from annotator.session.merge import Side
    from annotator.session.requests import CarryOver, Outcome, Request
    from annotator.session.residuals import FrameResidual
    from std_toolkit.options import PropagateOptions

# Key of the task that measures residuals of objects that are not selected.
OTHER_RESIDUALS = "Residuals of the others"


def tell_opening(controller: Controller) -> None:
    """Show warnings about a scene that was just opened."""
    session = controller.session
    for warning in (*session.warnings, session.pose_problem):
        if warning is not None:
            controller.tell(warning, "warning")
    if not session.writable:
        controller.tell("This scene is open read-only: nothing can be changed.")


def refine(controller: Controller, *, all_objects: bool = False) -> None:
    """Fit the selected object, or all placed ones jointly, to the images and the depth."""
    from annotator.session.requests import Refine

    session, frame = controller.session, controller.active_frame
    if all_objects:
        names = [o.name for o in session.state.objects if session.pose(o.name, frame) is not None]
    else:
        names = [n for n in (controller.selected,) if n is not None]
    if names and all(session.object(n).locked for n in names):
        controller.may_move(names[0])
        return
    if not names:
        controller.tell("Place an object first: there is nothing to refine.", "warning")
        return
    title = f"Refine {listed(names)}"

    def begin() -> None:
        # Objects may have been removed while others were refined.
        known = {o.name for o in session.state.objects if o.placements}
        if known.issuperset(names):
            perform(controller, title, Refine(objects=names, frame=frame), names)

    controller.start_in_turn(title, begin)


def snap(controller: Controller, mode: Literal["drop", "rest"]) -> None:
    """Put the selected object onto the table."""
    from annotator.session.requests import SnapToTable

    name = controller.selected
    if name is not None:
        request = SnapToTable(object=name, frame=controller.active_frame, mode=mode)
        perform(controller, f"Put {name} onto the table", request, [name], beside=True)


def solve_points(controller: Controller) -> None:
    """Compute the pose of the selected object from the points clicked in the active view."""
    from annotator.session.requests import SolvePnP

    name = controller.selected
    if name is not None:
        request = SolvePnP(object=name, frame=controller.active_frame)
        perform(controller, f"Pose of {name} from points", request, [name], beside=True)


def carry_over(controller: Controller, request: CarryOver) -> None:
    """Carry the poses of objects over from another scene."""

    def begin() -> None:
        objects = controller.session.state.objects
        names = [o.name for o in objects if request.overwrite or not o.placements]
        perform(controller, request.title, request, names)

    controller.start_in_turn(request.title, begin)


def perform(
    controller: Controller,
    title: str,
    request: Request,
    names: Sequence[str],
    *,
    beside: bool = False,
) -> Task | None:
    """Resolve a request in the background; drop its edit if its objects were edited meanwhile.

    Args:
        beside: a short one, which does not wait for another object to be refined.
    """
    session = controller.session
    snapshot = session.snapshot()
    before = {n: session.object(n).placements for n in names}

    def work(task: Task) -> Outcome:
        return request.resolve(snapshot, progress=task.progress, cancelled=lambda: task.cancelled)

    def finish(outcome: Outcome) -> None:
        known = {o.name: o.placements for o in session.state.objects}
        moved = [n for n in names if known.get(n) != before[n]]
        if moved:
            controller.tell(
                f"{title}: {listed(moved)} was edited meanwhile, so the result was dropped. "
                "Try again when you are ready.",
                "warning",
            )
            return
        session.apply(outcome.edit)
        controller.weak_directions.update(outcome.weak_directions)
        controller.findings.keep_textures(outcome.textures)
        if outcome.textures:
            controller.emit(Event("verdict", objects=tuple(outcome.textures)))
        for line in outcome.warnings:
            controller.tell(line, "warning")
        if outcome.report:
            controller.tell("\n".join(outcome.report))

    return controller.start(title, work, finish, beside=beside)


def measure_residuals(controller: Controller, *, delay: float = 0.0) -> None:
    """Measure the selected object against the edges and the depth of the frames in the views.

    Other objects whose poses changed are then measured in the background.

    Args:
        delay: seconds to wait first, such as during repeated key presses.
    """
    name = controller.selected
    if name is None or not controller.session.object(name).placements:
        _measure_others(controller, delay=delay)
    else:
        _measure(controller, "Residuals", [name], _measure_others, delay=delay)


def _measure_others(controller: Controller, *, delay: float = 0.0) -> None:
    state = controller.session.state
    names = [o.name for o in state.objects if o.name in controller.unmeasured and o.placements]
    if names:
        _measure(controller, OTHER_RESIDUALS, names, lambda _: None, delay=delay)


def _measure(
    controller: Controller,
    key: str,
    names: Sequence[str],
    then: Callable[[Controller], None],
    *,
    delay: float,
) -> None:
    """Measure the residuals of objects, then call `then`."""
    snapshot = controller.session.snapshot()
    frames = list(dict.fromkeys(controller.view_frames))
    to_measure = [snapshot.object(n) for n in names]

    def work(task: Task) -> dict[int, list[FrameResidual]]:
        return pose_checks.measure_objects(snapshot, to_measure, frames, task)

    def finish(rows: dict[int, list[FrameResidual]]) -> None:
        now = {o.name: o.placements for o in controller.session.state.objects}
        measured = [o for o in to_measure if now.get(o.name) == o.placements]
        for obj in measured:
            controller.residuals[obj.name] = rows[obj.id]
            controller.unmeasured.discard(obj.name)
        if measured:
            controller.emit(Event("residuals", objects=tuple(o.name for o in measured)))
        # Objects that moved or were removed meanwhile are not ranked. Ranks that were asked for
        # before and are not known yet are asked for again: these take their place.
        known = [o for o in now if o in controller.residuals and o not in controller.ranks]
        unranked = sorted(known, key=lambda name: name != controller.selected)
        pose_checks.rank_objects_aside(controller, unranked)
        then(controller)

    controller.start_aside(key, work, finish, delay=delay)


def unplace(controller: Controller) -> None:
    """Remove the pose of the selected object."""
    if controller.selected is not None:
        controller.apply(ClearPose(object=controller.selected, frame=controller.active_frame))


def save(controller: Controller, *, on_conflict: Side | None = None) -> bool:
    """Write the labels into the scene; on failure, shows a question or message and returns False.

    Args:
        on_conflict: which version to keep of objects that others also changed; default: ask with
            the dialog "conflict" of the front end.
    """
    from annotator.session.session import SaveConflict

    report: list[Any] = []

    def write() -> None:
        try:
            report.append(controller.session.save(on_conflict=on_conflict))
        except SaveConflict as conflict:
            if "conflict" not in controller.dialogs:
                raise
            controller.conflict = str(conflict.value)
            controller.ask("conflict")

    controller.cancel_drag()
    if controller.attempt(write) and report:
        controller.tell(str(report[0]))
    return not controller.session.unsaved


def propagate(controller: Controller, options: PropagateOptions | None = None) -> None:
    """Save, then propagate every label to all frames; edits are blocked meanwhile."""
    session = controller.session
    if not save(controller):
        return

    def finish(carried: PropagationResult) -> None:
        session.reload("Propagate")
        for line in carried.warnings:
            controller.tell(f"{line}.", "warning")
        lines = "; ".join(carried.lines)
        controller.tell(f"Carried to {len(session.frames)} frames: {lines}.")

    root = session.scene.root
    controller.start(
        "Propagate", lambda _: propagate_saved_labels(root, options), finish, alone=True
    )


def fit_view(controller: Controller) -> None:
    controller.emit(Event("look", text="fit"))


def zoom_to_object(controller: Controller) -> None:
    controller.emit(Event("look", text="object"))


def listed(names: Sequence[str]) -> str:
    """Return up to three names."""
    return ", ".join(names[:3]) + (" and others" if len(names) > 3 else "")
