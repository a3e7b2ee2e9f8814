"""The textures of placed objects against the images, as `std-curate check` compares them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from annotator.session.state import Snapshot
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.labels.refine.problem import RefineObject, RefineView
from std_toolkit.labels.refine_step import scene_object, texture_surface
from std_toolkit.labels.texture.comparison import TextureComparison
from std_toolkit.labels.texture.views import Views
from std_toolkit.labels.texture_step import compare_objects, scene_views


def compare_textures(
    snapshot: Snapshot,
    names: Sequence[str],
    frame: int,
    *,
    cancelled: Callable[[], bool] = lambda: False,
) -> dict[str, TextureComparison]:
    """Compare the textures of objects with all frames that have a camera pose.

    Without metric camera poses an object is compared in one frame: the given one, or the first one
    in which it was placed.

    Args:
        names: names of placed objects.
        frame: frame that is compared without metric camera poses.
        cancelled: polled between objects; True returns the comparisons made so far.

    Returns:
        By object name; objects whose mesh cannot be read are left out.
    """
    views = scene_views(snapshot.scene) if snapshot.posed else None
    found: dict[str, TextureComparison] = {}
    for name in names:
        if cancelled():
            break
        obj = snapshot.object(name)
        here = frame if frame in obj.placements else next(iter(obj.placements), frame)
        try:
            placed = _objects(snapshot, None if snapshot.posed else here)
            if obj.id not in placed:
                continue
            texture = texture_surface(snapshot.scene, obj.id, snapshot.mesh(obj.model))
            placed[obj.id] = replace(placed[obj.id], texture=texture)
            around = views if views is not None else _lone_view(snapshot, here)
        except ToolkitError:  # reported where mesh and image are shown
            continue
        found[name] = compare_objects(around, placed, [obj.id])[obj.id]
    return found


def _objects(snapshot: Snapshot, frame: int | None) -> dict[int, RefineObject]:
    """The placed objects in the world, or in the camera of a frame; unreadable ones left out."""
    objects = {}
    for o in snapshot.state.objects:
        T = snapshot.T_world_obj(o.name) if frame is None else snapshot.pose(o.name, frame)
        if T is None:
            continue
        try:
            mesh = snapshot.mesh(o.model)
        except ToolkitError:
            continue
        objects[o.id] = scene_object(snapshot.scene, o.id, T, mesh=mesh)
    return objects


def _lone_view(snapshot: Snapshot, frame: int) -> Views:
    """The view of a frame whose camera is the coordinate frame."""
    scene, row = snapshot.scene, snapshot.scene.frame(frame)
    color, depth = scene.read_color(row), scene.read_depth(row)
    view = RefineView.of(scene.camera(row), SE3.identity(), color, depth, frame=frame)
    return Views.of([view])
