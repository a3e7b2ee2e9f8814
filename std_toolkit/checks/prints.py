"""The print of each labelled object against near-symmetric turns of its label."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import msgspec
import numpy as np

from std_toolkit.checks import result
from std_toolkit.checks.contours import mesh_problem
from std_toolkit.geometry import SE3
from std_toolkit.labels.print import FRAMES, PrintComparison, judge_print
from std_toolkit.labels.refine.problem import RefineObject, RefineView, large_views
from std_toolkit.labels.refine_step import load_views, print_surface, scene_object
from std_toolkit.scene import Frame, Scene


def compare_prints(
    scene: Scene, frames: Sequence[Frame], *, only: Collection[int] | None = None
) -> dict[int, PrintComparison]:
    """Compare the print of every labelled object with a few of the frames.

    Args:
        scene: the scene with its labels.
        frames: registered frames whose images can be read.
        only: ids of the objects to compare; None compares all.

    Returns:
        Comparisons by object id; objects without a label in the world or a readable mesh are
        left out.
    """
    placed: dict[int, SE3] = {}
    for item in scene.objects.objects:
        pose = scene.T_world_obj(item.id)
        if pose is not None and mesh_problem(scene, item.model) is None:
            placed[item.id] = pose
    objects = {i: scene_object(scene, i, pose) for i, pose in placed.items()}
    cameras = [scene.camera(f) for f in frames]
    poses = [T for f in frames if (T := scene.T_world_cam(f.id)) is not None]
    assert len(poses) == len(frames), "only registered frames can be compared"
    views: dict[int, RefineView] = {}
    found = {}
    for i, obj in objects.items():
        if only is not None and i not in only:
            continue
        centre = obj.T_world_obj @ obj.centre
        chosen = large_views(cameras, poses, centre, obj.radius, count=FRAMES)
        for k in chosen:
            if k not in views:
                (views[k],) = load_views(scene, [frames[k]])
        others = [o for j, o in objects.items() if j != i]
        found[i] = _compare(scene, i, obj, others, [views[k] for k in chosen])
    return found


def _compare(
    scene: Scene,
    object_id: int,
    obj: RefineObject,
    others: Sequence[RefineObject],
    views: Sequence[RefineView],
) -> PrintComparison:
    mesh = scene.mesh(scene.objects.object(object_id).model)
    printed = print_surface(scene, object_id, mesh)
    return judge_print(views, replace(obj, print=printed), others)


def with_print(item: result.ObjectCheck, found: PrintComparison | None) -> result.ObjectCheck:
    """The object's row with the comparison of its print."""
    if found is None:
        return item
    return msgspec.structs.replace(
        item,
        print_verdict=found.verdict,
        print_score=_number(found.score),
        print_rival_score=_number(found.rival_score),
        print_frames=found.frames,
        print_text=found.text,
    )


def print_sentence(item: result.ObjectCheck) -> str:
    """The finding in words, such as "turned by 180 deg about z fits the print better"."""
    if not item.print_verdict:
        return ""
    nan = float("nan")
    return PrintComparison(item.print_verdict, None, item.print_text, nan, nan, 0).sentence()


def print_gate(objects: Sequence[result.ObjectCheck]) -> result.CheckGate:
    """The gate that fails where the print fits better after a turn."""
    measured = [o for o in objects if o.print_score is not None]
    turned = [o for o in measured if o.print_verdict == "turned"]
    status = "open" if not measured else "fail" if turned else "pass"
    return result.CheckGate(
        key="print",
        title="labels whose print fits better after a turn",
        value=float(len(turned)) if measured else None,
        limit=0.0,
        rule="at most",
        status=status,  # type: ignore[arg-type]
        detail=", ".join(f"{o.name}: {print_sentence(o)}" for o in turned),
        advice="turn the object in the annotator until its print agrees with the image, refine and "
        "save it, and run `std-curate propagate` again",
    )


def print_warnings(objects: Sequence[result.ObjectCheck]) -> list[result.CheckWarning]:
    """One line per object whose turn neither its silhouette nor a print determines."""
    return [
        result.CheckWarning(
            severity="low",
            about=item.name,
            problem=print_sentence(item),
            advice="use a mesh with texture, or declare the symmetry of the model if both poses "
            "are right",
        )
        for item in objects
        if item.print_verdict == "ambiguous"
    ]


def with_prints(
    objects: Sequence[result.ObjectCheck], found: Mapping[int, PrintComparison]
) -> list[result.ObjectCheck]:
    """All rows with their comparisons."""
    return [with_print(o, found.get(o.object)) for o in objects]


def _number(value: float) -> float | None:
    return round(value, 3) if np.isfinite(value) else None
