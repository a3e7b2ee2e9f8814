"""Bringing together what we edited and what others wrote into the scene meanwhile.

Three versions meet: the scene as it was when we last read or wrote it (base), our state (mine), and
the scene as it is now (theirs). What only one side changed is taken from that side. What both
changed, differently, is a conflict, which a person decides for one side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal

import msgspec

from annotator.session.history import History, Step
from annotator.session.state import AnnotationState, ObjectState
from annotator.session.stored import Stored
from std_toolkit.errors import ToolkitError
from std_toolkit.labels.label import without_derived

Side = Literal["mine", "theirs"]


@dataclass(frozen=True)
class Version:
    """A scene's documents and the state that they stand for."""

    stored: Stored
    state: AnnotationState


@dataclass(frozen=True)
class Merged:
    """A state in which both sides are contained.

    Attributes:
        conflicts: what both changed differently, for people; decided for one side.
        taken: names of the objects and models that are as the others left them.
    """

    state: AnnotationState
    conflicts: tuple[str, ...]
    taken: tuple[str, ...]


def content(thing: ObjectState | None) -> dict[str, Any]:
    """What of an object is saved, in the parts that are merged one by one."""
    if thing is None:
        return {"object": None, "pose": {}, "work": ("open", "", {})}
    return {
        "object": (thing.name, thing.model, thing.material),
        "pose": {f: p.T_cam_obj for f, p in thing.placements.items()},
        "work": (thing.status, thing.note, thing.clicks),
    }


def differ(a: AnnotationState, b: AnnotationState) -> bool:
    """Whether saving one or the other would leave different scenes."""
    if a is b:
        return False
    one, other = _by_id(a), _by_id(b)
    return (
        a.models != b.models
        or one.keys() != other.keys()
        or any(one[i] is not other[i] and content(one[i]) != content(other[i]) for i in one)
    )


def merge(base: Version, mine: AnnotationState, theirs: Version, *, prefer: Side) -> Merged:
    """Our state with what the others changed; conflicts are decided for `prefer`."""
    if theirs.stored == base.stored and theirs.state == base.state:
        return Merged(mine, (), ())
    old, own, new = _by_id(base.state), _by_id(mine), _by_id(theirs.state)
    objects, conflicts, taken = [], [], []
    for i in sorted({*old, *own, *new}):
        rewritten = _rows(base.stored, i) != _rows(theirs.stored, i)
        thing, clash, took = _merged_object(old.get(i), own.get(i), new.get(i), rewritten, prefer)
        if thing is not None:
            objects.append(thing)
        known = own.get(i) or new.get(i) or old.get(i)
        assert known is not None
        conflicts += [known.name] if clash else []
        taken += [known.name] if took else []
    models, clashes, news = _merged_models(base.state, mine, theirs.state, prefer)
    used = {o.model for o in objects}
    for model in (*mine.models, *theirs.state.models):
        if model.id in used - set(models):
            models[model.id] = model
    repeated = {o.name for o in objects if sum(p.name == o.name for p in objects) > 1}
    if repeated:
        raise ToolkitError(
            "another process entered an object of the same name",
            field="object",
            value=sorted(repeated)[0],
            hint="rename yours, then save",
        )
    state = AnnotationState(models=[models[k] for k in sorted(models)], objects=objects)
    return Merged(
        state, (*conflicts, *(f"mesh {m}" for m in clashes)), (*taken, *(f"mesh {m}" for m in news))
    )


def conflicts(base: Version, history: History, theirs: Version) -> tuple[str, ...]:
    """What `take_over` would have to decide for one side.

    Raises:
        ToolkitError: as `take_over`.
    """
    renumber = _renumbering(base, history, theirs)
    return merge(base, renumber(history.state), theirs, prefer="mine").conflicts


def take_over(base: Version, history: History, theirs: Version, *, prefer: Side) -> Merged:
    """Merge what the others wrote into every state of the history, as if we had started from it.

    Undo therefore takes back our edits only, and never theirs. Giving up ours where both changed
    the same is one step more, so that undo brings it back. On an error nothing has changed.

    Raises:
        ToolkitError: an object of theirs has the name of another one of ours.
    """
    renumber = _renumbering(base, history, theirs)
    before = renumber(history.state)
    merged = merge(base, before, theirs, prefer=prefer)

    def change(state: AnnotationState) -> AnnotationState:
        try:
            return merge(base, renumber(state), theirs, prefer="mine").state
        except ToolkitError:
            # An older state of ours that cannot be joined with theirs: theirs must not be undone.
            return theirs.state

    history.rebase(change)
    if prefer == "theirs" and merged.conflicts:
        names = {o.name: None for state in (before, merged.state) for o in state.objects}
        given_up = tuple(name for name in names if name in merged.conflicts)
        history.push(Step("Keep what others wrote", given_up, merged.state))
    return merged


def _merged_object(
    old: ObjectState | None,
    own: ObjectState | None,
    new: ObjectState | None,
    rewritten: bool,
    prefer: Side,
) -> tuple[ObjectState | None, bool, bool]:
    """The object, whether it is a conflict, and whether anything of theirs was taken.

    Args:
        rewritten: the others wrote more about it than what is derived from its annotation. A pose
            that was only propagated meanwhile gives way to an edit.
    """
    before, ours, others = content(old), content(own), content(new)
    if ours in (before, others):
        return new, False, ours != others
    if not rewritten:
        return own, False, False
    if own is None or new is None:
        # Removed by one side. Where both sides look partly removed, it is our own removal, cut
        # off while it was being saved.
        cut_off = own is None and all(others[p] in (before[p], ours[p]) for p in before)
        return (own if cut_off or prefer == "mine" else new), not cut_off, False
    sides: dict[str, ObjectState] = {}
    clash = False
    for part in before:
        if ours[part] in (before[part], others[part]):
            sides[part] = new
        elif others[part] == before[part]:
            sides[part] = own
        else:
            clash = True
            sides[part] = own if prefer == "mine" else new
    pose, work = sides["pose"], sides["work"]
    thing = msgspec.structs.replace(
        sides["object"],
        placements=pose.placements,
        status=work.status if pose.placements else "open",
        note=work.note,
        clicks=work.clicks,
    )
    return thing, clash, any(side is new for side in sides.values())


def _merged_models(
    base: AnnotationState, mine: AnnotationState, theirs: AnnotationState, prefer: Side
) -> tuple[dict[str, Any], list[str], list[str]]:
    old, own, new = ({m.id: m for m in s.models} for s in (base, mine, theirs))
    models, conflicts, taken = {}, [], []
    for key in sorted({*old, *own, *new}):
        before, ours, others = old.get(key), own.get(key), new.get(key)
        chosen = ours
        if ours == before:
            chosen = others
            taken += [key] if others != before else []
        elif others not in (before, ours):
            conflicts.append(key)
            chosen = ours if prefer == "mine" else others
        if chosen is not None:
            models[key] = chosen
    return models, conflicts, taken


def _renumbering(
    base: Version, history: History, theirs: Version
) -> Callable[[AnnotationState], AnnotationState]:
    """Both sides may have given one id to two new objects; ours get others, in every state."""
    known, new = _by_id(base.state), _by_id(theirs.state)
    named = {o.name: o.id for i, o in new.items() if i not in known}
    used = {o.id for state in history.states for o in state.objects} | set(known) | set(new)
    # Which object of ours is theirs, by its name, is decided in the present state.
    change = {
        o.id: named[o.name]
        for o in history.state.objects
        if o.id not in known and named.get(o.name, o.id) != o.id
    }
    for thing in (o for state in (history.state, *history.states) for o in state.objects):
        if thing.id in known or thing.id in change:
            continue
        if thing.id in new and new[thing.id].name != thing.name:
            change[thing.id] = _free(used)
            used.add(change[thing.id])

    def renumbered(state: AnnotationState) -> AnnotationState:
        if not any(o.id in change for o in state.objects):
            return state
        objects = [msgspec.structs.replace(o, id=change.get(o.id, o.id)) for o in state.objects]
        return msgspec.structs.replace(state, objects=sorted(objects, key=lambda o: o.id))

    return renumbered


def _free(used: Iterable[int]) -> int:
    taken = set(used)
    for number in range(1, 255):
        if number not in taken:
            return number
    raise ToolkitError("no object id is free", hint="a scene holds 254 objects at most")


def _rows(stored: Stored, object_id: int) -> tuple[Any, ...]:
    """What others may have written about an object, less what is derived from it."""
    label = stored.labels.of(object_id)
    row = next((o for o in stored.objects.objects if o.id == object_id), None)
    return row, None if label is None else without_derived(label), stored.annotation.of(object_id)


def _by_id(state: AnnotationState) -> dict[int, ObjectState]:
    return {o.id: o for o in state.objects}
