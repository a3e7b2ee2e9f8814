"""Scripts: JSON lists of edits, requests and commands, executed in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec

from annotator.session import edits
from annotator.session.merge import Side
from annotator.session.requests import AnyRequest, CarryOver, ImportMesh, Request
from annotator.session.script_frames import frame_or_name, frames_of, with_frame_ids
from annotator.session.session import Session
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import decode_document, read_document
from std_toolkit.log import logger
from std_toolkit.scene.document import Count, Document
from std_toolkit.scene.frame_names import frame_title
from std_toolkit.scene.model import SymmetryModel
from std_toolkit.scene.scene import Scene

# Fields of requests that name files.
_PATHS: dict[type[Request], tuple[str, ...]] = {
    ImportMesh: ("mesh",),
    CarryOver: ("source", "board", "points"),
}


class Save(Document, frozen=True, kw_only=True, tag_field="edit", tag="save"):
    """Saves the edits into the scene; see `Session.save`."""

    on_conflict: Side | None = None


class Propagate(Document, frozen=True, kw_only=True, tag_field="edit", tag="propagate"):
    """Saves and propagates the labels to all frames; fields as in `PropagateOptions`."""

    refine: bool = False
    refine_scale: bool = False
    objects: list[str] | None = None
    keyframes: Count = 10
    use_depth: bool = True


class Undo(Document, frozen=True, kw_only=True, tag_field="edit", tag="undo"):
    """Undoes the last edit."""


class Redo(Document, frozen=True, kw_only=True, tag_field="edit", tag="redo"):
    """Redoes the last undone edit."""


Command = Save | Propagate | Undo | Redo
Step = edits.AnyEdit | AnyRequest | Command

# Says why an object of a session is not known to fit; "" if it fits.
Doubt = Callable[[Session, str], str]


def read_script(path: Path | str, scene: Scene | None = None) -> list[Step]:
    """Read and validate the steps of a script file.

    Args:
        path: the file.
        scene: scene whose frames may be named by their files; None if all are given by id.

    Raises:
        ToolkitError: the file is unreadable or a step is invalid; the field is named, such as
            `[3].frame`.
    """
    try:
        if scene is None:
            steps: list[Step] = read_document(path, list[Step])
        else:
            content = with_frame_ids(read_document(path, Any), scene, Path(path))
            steps = decode_document(msgspec.json.encode(content), list[Step], path=path)
    except ToolkitError as error:
        hint = error.hint
        if error.field is not None and error.field.endswith(".edit"):
            hint = f"known: {', '.join(sorted(known_steps()))}"
        raise ToolkitError(
            error.problem, path=error.path, field=error.field, value=error.value, hint=hint
        ) from error
    return steps


def run_script(
    session: Session, steps: list[Step], path: Path | str, *, doubt: Doubt | None = None
) -> Iterator[str]:
    """Execute the steps; yields lines of text.

    Args:
        path: path of the script, for messages; mesh paths are relative to its folder.
        doubt: asked before an object is marked as done without `anyway`; None: not asked.

    Raises:
        ToolkitError: a step fails; its index is named. Later steps are not executed, and unsaved
            edits of earlier steps are not saved.
    """
    described: set[int] = set()
    for index, step in enumerate(steps):
        try:
            for frame in frames_of(step):
                if frame not in described:
                    described.add(frame)
                    yield f"[{index}] {frame_title(session.scene.frame(frame))}"
            if doubt is not None and isinstance(step, edits.ChangeObject):
                _refuse_doubt(session, step, doubt)
            for line in _carry_out(session, step, Path(path)):
                yield f"[{index}] {line}"
        except ToolkitError as error:
            problem = error.problem
            if error.path is not None and Path(error.path) != Path(path):
                problem = f"{error.path}: {problem}"
            raise ToolkitError(
                problem,
                path=path,
                field=f"[{index}]" + (f".{error.field}" if error.field else ""),
                value=error.value,
                hint=error.hint,
            ) from error


def _refuse_doubt(session: Session, step: edits.ChangeObject, doubt: Doubt) -> None:
    """Raise an error if a step marks an object as done that is not known to fit."""
    if step.status != "done" or step.anyway:
        return
    obj = session.object(step.object)
    reason = doubt(session, obj.name) if obj.status != "done" and obj.placements else ""
    if reason:
        raise ToolkitError(
            f"{obj.name} is not known to fit: {reason}",
            field="status",
            value="done",
            hint='give "anyway": true if you have checked it by eye',
        )


def run(
    scene: Path,
    script: Path,
    *,
    annotator: str | None,
    recover: Literal["ask", "yes", "no"],
    doubt: Doubt | None = None,
) -> int:
    """`std-annotate SCENE --script FILE`: prints a line for every step; exit status 0.

    Args:
        doubt: see `run_script`.

    Raises:
        ToolkitError: a step fails, or there are unsaved edits of an earlier session.
    """
    steps = read_script(script, Scene.open(scene))
    with Session.open(scene, annotator=annotator, recover=recover, by_hand=False) as session:
        if session.recovery is not None:
            raise ToolkitError(
                str(session.recovery),
                path=scene,
                hint="give --recover yes to restore them, or --recover no to set them aside",
            )
        for warning in session.warnings:
            logger.warning("%s", warning)
        recovered = session.unsaved
        try:
            for line in run_script(session, steps, script, doubt=doubt):
                print(line)
        except ToolkitError:
            # Edits of the script need no recovery, because it can be run again. Recovered manual
            # edits do.
            session.close(discard=not recovered)
            raise
        if session.unsaved:
            logger.warning(
                '%s: the last edits are not saved; end it with {"edit": "save"}, or open the '
                "scene to recover them",
                script,
            )
    return 0


def export_edits(session: Session, path: Path | str) -> None:
    """Write a script that repeats the session's edits on the same or another scene.

    Poses are written as numbers. Added meshes refer to this scene's folder.

    Raises:
        ToolkitError: the file is not writable.
    """
    made = [step.edit for step in session.steps if step.edit is not None]
    steps = [step for edit in made for step in _exported(session, edit)]
    text = msgspec.json.format(msgspec.json.encode(steps), indent=2)
    write_bytes_atomic(path, text + b"\n")


def script_schema() -> bytes:
    """Return the JSON Schema of a script."""
    schema = frame_or_name(msgspec.json.schema(list[Step]))
    return msgspec.json.format(msgspec.json.encode(schema), indent=2)


def known_steps() -> list[str]:
    """Return the valid values of "edit"."""
    return [str(leaf.__struct_config__.tag) for leaf in _leaves(Step)]


def _carry_out(session: Session, step: Step, path: Path) -> Iterator[str]:
    match step:
        case Save():
            yield str(session.save(on_conflict=step.on_conflict))
        case Propagate():
            yield from _propagate(session, step)
        case Undo():
            undone = session.undoable
            session.undo()
            yield f"Undo: {undone.title if undone else ''}"
        case Redo():
            session.redo()
            redone = session.undoable
            yield f"Redo: {redone.title if redone else ''}"
        case Request():
            # Relative to the script, independent of the working directory.
            given = {name: getattr(step, name) for name in _PATHS.get(type(step), ())}
            there = {
                name: str(path.parent / Path(value).expanduser())
                for name, value in given.items()
                if value is not None
            }
            step = msgspec.structs.replace(step, **there)
            outcome = session.perform(step)
            yield step.title
            yield from (f"  {line}" for line in outcome.report)
            for warning in outcome.warnings:
                logger.warning("%s", warning)
        case _:
            session.apply(step)
            yield step.title


def _propagate(session: Session, step: Propagate) -> Iterator[str]:
    from std_toolkit.options import PropagateOptions

    report = session.propagate(
        PropagateOptions(
            refine=step.refine,
            refine_scale=step.refine_scale,
            objects=None if step.objects is None else tuple(step.objects),
            keyframes=step.keyframes,
            use_depth=step.use_depth,
        )
    )
    yield f"Propagate. {report.saved}"
    yield from (f"  {line.strip()}" for line in report.lines)


def _exported(session: Session, edit: edits.AnyEdit) -> Iterator[Step]:
    match edit:
        case edits.CompoundEdit() if any(isinstance(e, edits.EnterModel) for e in edit.edits):
            for part in edit.edits:
                yield from _exported(session, part)
        case edits.CompoundEdit():
            yield msgspec.structs.replace(edit, edits=[_anywhere(e) for e in edit.edits])
        case edits.EnterModel(model=model):
            yield ImportMesh(
                mesh=str((session.scene.root / model.mesh).resolve()),
                category=model.category,
                model=model.id,
            )
            if model.symmetry != SymmetryModel():
                yield edits.SetSymmetry(model=model.id, symmetry=model.symmetry)
        case _:
            yield _anywhere(edit)


def _anywhere(edit: edits.SingleEdit) -> edits.SingleEdit:
    """Remove object ids, which are specific to one scene."""
    return msgspec.structs.replace(edit, id=None) if isinstance(edit, edits.AddObject) else edit


def _leaves(union: object) -> Iterator[type[msgspec.Struct]]:
    for part in get_args(union):
        if get_args(part):
            yield from _leaves(part)
        else:
            yield part
