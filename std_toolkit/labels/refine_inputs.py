"""Inputs of `refine_objects` (frames, objects, coordinate frame), and its report sentences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.geometry.surface_colors import SurfaceColors
from std_toolkit.labels.keyframes import choose_keyframes
from std_toolkit.labels.refine.directions import covariance_at
from std_toolkit.labels.refine.problem import RefineObject, RefineView
from std_toolkit.labels.refine_step import (
    load_texture_views,
    load_views,
    scene_object,
    texture_surface,
)
from std_toolkit.scene.scene import Scene, require_metres
from std_toolkit.settings import NOT_RECORDED, Settings, limit

if TYPE_CHECKING:
    import trimesh

    from std_toolkit.scene.model import Frame

MeshSource = Callable[[str], "trimesh.Trimesh"]

NOT_CONVERGED = (
    "the refinement did not converge: its last step still moved the object; refine again and check"
)


@dataclass(frozen=True, kw_only=True)
class RefineReportSettings(Settings):
    """Fits that are reported as doubtful."""

    loose_px: float = limit(
        4.0,
        unit="px",
        source="edges scatter by one or two pixels around a correct contour",
    )
    """a larger distance of the edges is reported"""
    little_explained: float = limit(0.5, source=NOT_RECORDED)
    """a smaller fraction of explained readings is reported"""


@dataclass(frozen=True, eq=False)
class AutoProblem:
    """Views and objects in one coordinate frame.

    Attributes:
        views: images; a single view has the identity as camera pose if the scene has none.
        objects: objects by id, at their start poses; chosen ones with the colours of their meshes.
        posed: whether the coordinate frame is the world; otherwise the camera of the only view.
        texture_views: more images, for the textures of the chosen objects.
        left_out: errors of the frames that cannot be read, by frame id.
    """

    views: list[RefineView]
    objects: dict[int, RefineObject]
    posed: bool
    texture_views: list[RefineView] = field(default_factory=list)
    left_out: dict[int, ToolkitError] = field(default_factory=dict)

    @property
    def has_depth(self) -> bool:
        return any(v.depth is not None for v in self.views)

    def placed(self, poses: Mapping[int, SE3]) -> dict[int, RefineObject]:
        """All objects, with the given poses replaced."""
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
        ToolkitError: a chosen object has no pose, no frame can be used, or files are unreadable.
    """
    for object_id in chosen:
        if object_id not in poses:
            raise ToolkitError(
                "this object has no initial pose",
                field=scene.objects.object(object_id).name,
                hint="align it with its image first",
            )
    left_out: dict[int, ToolkitError] = {}
    views, posed = _views(scene, poses, chosen, frames, keyframes, always, left_out)
    objects = {
        i: _object(scene, i, T, mesh or scene.mesh, colors=i in chosen)
        for i, T in sorted(poses.items())
    }
    more: list[RefineView] = []
    if posed and frames is None:
        textured = {i: poses[i] for i in chosen if objects[i].texture is not None}
        loaded = [*(v.frame for v in views), *left_out]
        more = load_texture_views(scene, textured, loaded, left_out=left_out)
    return AutoProblem(views, objects, posed, more, left_out)


def _views(
    scene: Scene,
    poses: Mapping[int, SE3],
    chosen: Sequence[int],
    frames: Sequence[int] | None,
    keyframes: int,
    always: Sequence[int],
    left_out: dict[int, ToolkitError],
) -> tuple[list[RefineView], bool]:
    metric = _is_metric(scene)
    if frames is None:
        if not metric:
            raise ToolkitError(
                "the scene has no camera poses in metres, so one frame must be given",
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
                hint="align the object with its image first",
            )
        return load_views(scene, picked, left_out=left_out), True
    named = [scene.frame(i) for i in dict.fromkeys(frames)]
    registered = [f for f in named if metric and scene.T_world_cam(f.id) is not None]
    if registered:
        return load_views(scene, registered, left_out=left_out), True
    if len(named) != 1:
        raise ToolkitError(
            "without camera poses in metres, refinement needs exactly one frame",
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
    obj = scene_object(scene, object_id, pose, mesh=mesh)
    if not colors:
        return obj
    return replace(
        obj, colors=SurfaceColors.from_mesh(mesh), texture=texture_surface(scene, object_id, mesh)
    )


def method_sentence(edge_rms_px: float | None, depth_m: float | None, views: int) -> str:
    """Provenance of a label, such as "depth and edges, 7 views, edges 0.6 px"."""
    means = [
        name for name, value in (("depth", depth_m), ("edges", edge_rms_px)) if value is not None
    ]
    parts = [" and ".join(means), f"{views} view{'s' if views != 1 else ''}"]
    if edge_rms_px is not None:
        parts.append(f"edges {edge_rms_px:.1f} px")
    if depth_m is not None:
        parts.append(f"depth {1000 * depth_m:.1f} mm")
    return ", ".join(parts)


def quality_warnings(
    problem: AutoProblem,
    obj: RefineObject,
    covariance: NDArray[np.floating],
    edge_rms_px: float | None,
    depth_m: float | None,
    explained: float | None,
) -> list[str]:
    """Warnings as sentences.

    Args:
        obj: the object at its refined pose.
        covariance: (6, 6) of a right perturbation.
    """
    limits = RefineReportSettings.current()
    found = []
    if len(problem.views) == 1 and depth_m is None:
        along = _std_along_ray(problem, obj, covariance)
        found.append(
            f"one view without depth: the distance to the camera is weak (about "
            f"{1000 * along:.0f} mm); check it in another frame or on the table"
        )
    if edge_rms_px is not None and edge_rms_px > limits.loose_px:
        found.append(
            f"the edges scatter by {edge_rms_px:.1f} px around the contour; are the mesh and "
            "the initial pose right?"
        )
    if explained is not None and explained < limits.little_explained:
        found.append(
            f"only {100 * explained:.0f} % of the sensor depth on it agrees with the mesh; is it "
            "opaque, and the mesh the right one?"
        )
    return found


def _std_along_ray(
    problem: AutoProblem, obj: RefineObject, covariance: NDArray[np.floating]
) -> float:
    """Standard deviation of the object's centre along the ray of the first view, metres."""
    centre = obj.T_world_obj @ obj.centre
    ray = centre - problem.views[0].T_world_cam.t
    ray = obj.T_world_obj.R.T @ ray / np.linalg.norm(ray)
    C = covariance_at(covariance, obj.centre)[:3, :3]
    return float(np.sqrt(max(float(ray @ C @ ray), 0.0)))
