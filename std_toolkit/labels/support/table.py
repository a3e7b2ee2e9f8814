"""Search for the table in sensor depth, in reconstructed points, or under placed objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.plane_fit import PlaneFit, connected_patch, find_planes
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.support import evidence, neighbours
from std_toolkit.labels.support.plane import (
    WORLD,
    Plane,
    TablePlane,
    TableSearch,
    camera_frame_name,
)
from std_toolkit.labels.support.solid import PlacedObject
from std_toolkit.scene.scene import Frame, Scene, require_metres
from std_toolkit.settings import NOT_RECORDED, Settings, limit

MOST_FRAMES = 12

_PLANES = 4


# Largest relative depth bias of an uncalibrated sensor.
UNKNOWN_BIAS = 0.02

_CALIBRATED_BIAS = 0.005


# Gaps in a table, relative to the distance, that do not split it.
_GAP = 0.04


@dataclass(frozen=True, kw_only=True)
class TableSettings(Settings):
    """Which planes are a table, and which are doubtful."""

    fewest_points: int = limit(60, source=NOT_RECORDED)
    """points that the search needs"""
    small_share: float = limit(0.1, source=NOT_RECORDED)
    """a plane with a smaller share of the points is doubtful"""
    rival: float = limit(0.6, source=NOT_RECORDED)
    """a second plane with a larger part of the score makes the first doubtful"""
    small_m: float = limit(0.08, unit="m", source=NOT_RECORDED)
    """a smaller plane is doubtful"""
    rough_m: float = limit(0.01, unit="m", source=NOT_RECORDED)
    """a plane with a larger scatter is doubtful"""


@dataclass(frozen=True)
class _Place:
    """Input of the search: views, their cameras, objects and name of the common frame."""

    scene: Scene
    views: list[evidence.View]
    cameras: neighbours.Cameras
    objects: Sequence[PlacedObject]
    frame: str


def search_table(
    scene: Scene,
    *,
    frames: Sequence[Frame] | None = None,
    objects: Sequence[PlacedObject] | None = None,
    camera_frame: int | None = None,
) -> TableSearch:
    """Find the plane on which the objects of a scene stand, or the reason why none was found.

    Searches in sensor depth, then in reconstructed points, then under the resting faces of placed
    objects. Ignores depth inside the outlines of these objects.

    Args:
        scene: the recording.
        frames: frames to use, at most 12 of them; default: spread over the recording.
        objects: placed objects in the common frame; default: the labels of the scene.
        camera_frame: id of a frame: use only this frame, and return the plane in its camera. For
            frames without camera pose.

    Raises:
        ToolkitError: there is no such frame, or a file of the scene cannot be read.
    """
    if camera_frame is None:
        views, problem = _world_views(scene, frames)
        if problem:
            return TableSearch(None, problem)
        name = WORLD
    else:
        views = [evidence.View(scene.frame(camera_frame), SE3.identity())]
        name = camera_frame_name(camera_frame)
    objects = evidence.placed_objects(scene, camera_frame) if objects is None else objects
    place = _Place(
        scene, views, neighbours.Cameras.of([v.T_frame_cam for v in views]), objects, name
    )
    reasons = []
    for look in (_from_depth, _from_reconstruction, _from_objects):
        found = look(place)
        if isinstance(found, TablePlane):
            return TableSearch(found)
        reasons.append(found)
    return TableSearch(None, "no table found: " + "; ".join(reasons))


def _world_views(scene: Scene, frames: Sequence[Frame] | None) -> tuple[list[evidence.View], str]:
    try:
        require_metres(scene)
    except ToolkitError as error:
        return [], f"no table in the world: {error.problem}"
    posed = [
        evidence.View(f, T)
        for f in (scene.frames if frames is None else frames)
        if (T := scene.T_world_cam(f.id)) is not None
    ]
    if not posed:
        return [], "no table in the world: no frame has a camera pose"
    with_depth = [v for v in posed if v.frame.depth is not None]
    usable = with_depth or posed
    chosen = np.linspace(0, len(usable) - 1, min(MOST_FRAMES, len(usable))).round().astype(int)
    return [usable[i] for i in chosen], ""


def _from_depth(place: _Place) -> TablePlane | str:
    points = evidence.depth_points(place.scene, place.views, place.objects)
    if points is None:
        return "no sensor depth outside the objects"
    found = _support(points, place)
    if isinstance(found, str):
        return f"sensor depth shows {found}"
    table = _described(points, *found, place)
    height = found[1].height_m
    bias = _CALIBRATED_BIAS if place.scene.info.depth_correction != 1 else UNKNOWN_BIAS
    correction = None
    if place.frame == WORLD:
        sparse = evidence.reconstructed_points(place.scene, place.cameras.centres, place.objects)
        if sparse is not None:
            correction = evidence.correction_by_points(
                table.plane, sparse.xyz, height, table.centre, table.radius_m
            )
        if correction is None and not _metres_of_the_sensor(place.scene):
            correction = evidence.correction_by_heights(
                table.plane, points, found[0].inliers, place.cameras.centres
            )
    if correction is not None:
        return _corrected(table, correction)
    note = (
        f"a sensor that reads {100 * bias:.1f} % too far puts this plane "
        f"{1000 * bias * height:.0f} mm too low"
    )
    return replace(table, source="depth", uncertainty_m=bias * height, notes=(*table.notes, note))


def _metres_of_the_sensor(scene: Scene) -> bool:
    """Whether the scale of the camera poses is from depth, so that the two cannot disagree."""
    scale = None if scene.poses is None else scene.poses.scale
    return scale is not None and scale.chosen == "depth"


def _from_reconstruction(place: _Place) -> TablePlane | str:
    if place.frame != WORLD:
        return "one frame has no reconstructed points"
    points = evidence.reconstructed_points(place.scene, place.cameras.centres, place.objects)
    if points is None:
        return "no reconstructed points outside the objects"
    found = _support(points, place)
    if isinstance(found, str):
        return f"the reconstructed points show {found}"
    table = _described(points, *found, place)
    uncertainty = 3 * table.rms_m / np.sqrt(table.points) + 0.0005
    return replace(table, source="reconstruction", uncertainty_m=float(uncertainty), frames=0)


def _from_objects(place: _Place) -> TablePlane | str:
    if not place.objects:
        return "no object is placed yet"
    found = neighbours.common_support(place.objects, place.cameras)
    if found is None:
        return "the cameras see no placed object from above"
    plane = Plane(found.normal, found.offset, place.frame)
    middle = plane.project(found.contacts.mean(axis=0))
    notes = [f"the plane under {', '.join(found.standing)}"]
    doubts = []
    if len(found.standing) < 2:
        doubts.append("only one object determines the table")
    elif 2 * len(found.standing) <= len(place.objects):
        doubts.append("half of the objects or more stand elsewhere")
    if found.rms_m > 0.003:
        doubts.append(f"the objects deviate from the plane by {1000 * found.rms_m:.0f} mm")
    if found.upright < 0:
        doubts.append("the cameras would see it upside down")
    return TablePlane(
        plane,
        "objects",
        found.rms_m,
        len(found.contacts),
        0,
        middle,
        float(np.linalg.norm(plane.project(found.contacts) - middle, axis=1).max()) + 0.1,
        max(found.rms_m, 0.002),
        quality="doubtful" if doubts else "good",
        notes=(*notes, *doubts),
    )


def _support(
    points: evidence.Points, place: _Place
) -> tuple[PlaneFit, neighbours.SupportScore, str] | str:
    """The best support among the planes in points, and a doubt about it; or why there is none."""
    limits = TableSettings.current()
    if len(points.xyz) < limits.fewest_points:
        return "too few points"
    planes = find_planes(points.xyz, points.sigma, points.weight, count=_PLANES)
    if not planes:
        return "no plane"
    sight = np.linalg.norm(points.xyz - place.cameras.centres.mean(axis=0), axis=1)
    judged = []
    for whole in planes:
        cell = _GAP * float(np.median(sight[whole.inliers]))
        p = connected_patch(points.xyz, points.weight, whole, points.sigma, cell_m=cell)
        middle = points.xyz[p.inliers].mean(axis=0)
        args = (p.normal, p.offset, p.weight, middle, place.cameras, place.objects)
        judged.append((p, neighbours.score_support(*args)))
    judged.sort(key=lambda pair: -pair[1].score)
    best, verdict = judged[0]
    if verdict.score == 0:
        return "no plane that the cameras see from above"
    rival = judged[1][1].score if len(judged) > 1 else 0.0
    doubt = "another plane is almost as large" if rival > limits.rival * verdict.score else ""
    return best, verdict, doubt


def _described(
    points: evidence.Points,
    fit: PlaneFit,
    verdict: neighbours.SupportScore,
    doubt: str,
    place: _Place,
) -> TablePlane:
    limits = TableSettings.current()
    plane = Plane(verdict.normal, verdict.offset, place.frame)
    inside = points.xyz[fit.inliers]
    centre = plane.project(np.average(inside, axis=0, weights=points.weight[fit.inliers]))
    reach = np.linalg.norm(plane.project(inside) - centre, axis=1)
    radius = float(np.quantile(reach, 0.9))
    doubts = [doubt] if doubt else []
    if fit.weight < limits.small_share:
        doubts.append(f"only {100 * fit.weight:.0f} % of the points are in it")
    if verdict.upright < 0.15:
        doubts.append("it could be a wall: the cameras do not look down on it")
    if radius < limits.small_m:
        doubts.append(f"it is small: {200 * radius:.0f} cm across")
    if fit.rms_m > limits.rough_m:
        doubts.append(f"the points scatter by {1000 * fit.rms_m:.0f} mm")
    if place.objects and not verdict.carried:
        doubts.append("no placed object stands on it")
    seen = points.view[fit.inliers]
    return TablePlane(
        plane,
        "depth",
        fit.rms_m,
        int(fit.inliers.sum()),
        len(np.unique(seen[seen >= 0])),
        centre,
        radius,
        0.0,
        quality="doubtful" if doubts else "good",
        notes=tuple(doubts),
    )


def _corrected(table: TablePlane, correction: evidence.Correction) -> TablePlane:
    plane = Plane(table.plane.normal, table.plane.offset - correction.shift_m, table.plane.frame)
    return replace(
        table,
        plane=plane,
        centre=plane.project(table.centre),
        uncertainty_m=correction.uncertainty_m,
        depth_factor=correction.depth_factor,
        notes=(*table.notes, correction.note),
    )


def find_table(
    scene: Scene,
    *,
    frames: Sequence[Frame] | None = None,
    objects: Sequence[PlacedObject] | None = None,
    camera_frame: int | None = None,
) -> TablePlane | None:
    """Return the table of a scene, or None; `search_table` also returns the reason.

    See `search_table` for the arguments and errors.
    """
    return search_table(scene, frames=frames, objects=objects, camera_frame=camera_frame).table
