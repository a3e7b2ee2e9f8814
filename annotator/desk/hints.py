"""What to do next, in one sentence: for the status line of every front end."""

from __future__ import annotations

from annotator.desk.controller import Controller
from annotator.desk.object_summary import is_refined, summarize

# A pose from points needs four that do not lie in one line.
POINTS_FOR_A_POSE = 4


def next_hint(c: Controller) -> str:
    """What a person would do next, as the controller is now."""
    state = c.session.state
    if c.dragging is not None:
        return f"Moving {c.dragging}: let go to keep it, Esc to put it back."
    if c.task is not None and c.task.alone:
        return f"{c.task.title} is under way: look around; nothing can be changed until it is done."
    if c.task is not None and not c.clicking:
        return f"{c.task.title} is under way: go on meanwhile, or press Esc to cancel it."
    if not c.session.writable:
        return "This scene is open for looking only: nothing can be changed."
    if not state.models:
        return "Add the CAD mesh of an object with File > Add mesh (Ctrl+M)."
    if not state.objects:
        return "Drag a mesh from the library onto the image, or double-click it."
    if c.selected is None:
        return "Click an object in the list or in a view to select it."
    thing = state.object(c.selected)
    if c.clicking:
        return _clicking_hint(c)
    if c.session.pose(thing.name, c.active_frame) is None:
        if c.active_frame not in c.session.frames:
            return "This frame has no camera pose: choose one that has, below the image."
        return f"Drag {thing.name} onto the image, or press C and click points."
    if thing.status == "done":
        left = [o.name for o in state.objects if o.status != "done"]
        if left:
            return f"{thing.name} is done. Next: {left[0]} (N)."
        if c.session.posed:
            return "All objects are done: save and propagate with Ctrl+P."
        return "All objects are done: save with Ctrl+S." if c.session.unsaved else "All is done."
    placement = thing.placements.get(c.active_frame) or next(iter(thing.placements.values()))
    if not is_refined(placement):
        return (
            f"Move {thing.name} close to its image (Ctrl + drag: along the table), then press R "
            "to refine."
        )
    row = next(r for r in summarize(c) if r.name == thing.name)
    if row.grade == "poor":
        return f"{thing.name} is {row.badge} off: bring it closer, then press R again."
    if row.alarm:
        return f"{thing.name} is {row.alarm}: check it in every view."
    return f"Check {thing.name} in every view; press D if it fits."


def _clicking_hint(c: Controller) -> str:
    name = str(c.selected)
    if c.pending_point is not None:
        return f"Now click the same point of {name} in the image. Esc: take another point."
    count = len(c.session.object(name).clicks.get(c.active_frame, []))
    if count < POINTS_FOR_A_POSE:
        left = POINTS_FOR_A_POSE - count
        more = f"{left} more point{'s' if left > 1 else ''}" if count else "Four points"
        return f"{more} to go: click a point on the mesh of {name}, then in the image."
    return f"{count} points: press Return for the pose of {name}, or click more."
