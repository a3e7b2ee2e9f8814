"""What `refine_objects` works on: which frames, which objects, in which coordinate frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.appearance import SurfaceColors
from std_toolkit.labels.refine.keyframes import choose_keyframes
from std_toolkit.labels.refine.problem import RefineObject, RefineView
from std_toolkit.labels.refine.step import load_views, scene_object
from std_toolkit.scene.metres import require_metres
from std_toolkit.scene.scene import Scene

if TYPE_CHECKING:
    import trimesh

    from std_toolkit.scene.model import Frame

MeshSource = Callable[[str], "trimesh.Trimesh"]


@dataclass(frozen=True, eq=False)
class AutoProblem:
    """Views and objects in one coordinate frame.

    Attributes:
        views: images; the only one has the identity as camera pose where the scene has none.
        objects: by id, at their start poses; the chosen ones with the colours of their meshes.
        posed: the coordinate frame is the world; else it is the camera of the only view.
    """

    views: list[RefineView]
    objects: dict[int, RefineObject]
    posed: bool

    @property
    def has_depth(self) -> bool:
        return any(v.depth is not None for v in self.views)

    def placed(self, poses: Mapping[int, SE3]) -> dict[int, RefineObject]:
        """All objects, some of them at other poses."""
        return {
            i: replace(o, T_world_obj=poses[i]) if i in poses else o
            for i, o in self.objects.items()
        }


def auto_problem(
    scene: Scene,
    poses: Mapping[int, SE3],
    chosen: Sequence[int],
    *,
    frames: Sequence[int] | None,
    keyframes: int,
    always: Sequence[int] = (),
    mesh: MeshSource | None = None,
) -> AutoProblem:
    """Read the views and the objects; see `auto.refine_objects` for the arguments.

    Raises:
        ToolkitError: no pose of a chosen object, no frame to look at, or unreadable files.
    """
    for object_id in chosen:
        if object_id not in poses:
            raise ToolkitError(
                "this object has no pose to start from",
                field=scene.objects.object(object_id).name,
                hint="place it near its image first",
            )
    views, posed = _views(scene, poses, chosen, frames, keyframes, always)
    objects = {
        i: _object(scene, i, T, mesh or scene.mesh, colors=i in chosen)
        for i, T in sorted(poses.items())
    }
    return AutoProblem(views, objects, posed)


def _views(
    scene: Scene,
    poses: Mapping[int, SE3],
    chosen: Sequence[int],
    frames: Sequence[int] | None,
    keyframes: int,
    always: Sequence[int],
) -> tuple[list[RefineView], bool]:
    metric = _is_metric(scene)
    if frames is None:
        if not metric:
            raise ToolkitError(
                "the scene has no camera poses in metres, so one frame must be named",
                path=scene.root,
                field="frames",
            )
        picked = choose_keyframes(
            scene, {i: poses[i] for i in chosen}, count=keyframes, always=always
        )
        if not picked:
            raise ToolkitError(
                "no frame with a camera pose shows the object",
                path=scene.root,
                hint="move the object onto its image first",
            )
        return load_views(scene, picked), True
    named = [scene.frame(i) for i in dict.fromkeys(frames)]
    registered = [f for f in named if metric and scene.T_world_cam(f.id) is not None]
    if registered:
        return load_views(scene, registered), True
    if len(named) != 1:
        raise ToolkitError(
            "without camera poses in metres a refinement works in one frame",
            path=scene.root,
            field="frames",
            value=list(frames),
        )
    return [_lone_view(scene, named[0])], False


def _lone_view(scene: Scene, frame: Frame) -> RefineView:
    return RefineView.of(
        scene.camera(frame),
        SE3.identity(),
        scene.read_color(frame),
        scene.read_depth(frame),
        frame=frame.id,
    )


def _is_metric(scene: Scene) -> bool:
    if scene.poses is None or not scene.registered_frames():
        return False
    try:
        require_metres(scene)
    except ToolkitError:
        return False
    return True


def _object(
    scene: Scene, object_id: int, pose: SE3, mesh_of: MeshSource, *, colors: bool
) -> RefineObject:
    mesh = mesh_of(scene.objects.object(object_id).model)
    thing = scene_object(scene, object_id, pose, mesh=mesh)
    return replace(thing, colors=SurfaceColors.of(mesh)) if colors else thing
