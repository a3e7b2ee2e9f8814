"""Metric scale from CAD models whose poses were annotated in two or more frames."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.mesh import hull_vertices
from std_toolkit.log import logger
from std_toolkit.poses.known_points import KnownView, fit_body, scale_from_known_points
from std_toolkit.poses.scale_sources import ScaleContext
from std_toolkit.scene.model import Label, Object, ScaleEstimate, pose_from_list
from std_toolkit.scene.scale_model import mesh_deviation
from std_toolkit.settings import NOT_RECORDED, Settings, limit

_POINTS = 60


@dataclass(frozen=True, kw_only=True)
class CadScaleSettings(Settings):
    """When annotations of a CAD model in several frames give a scale."""

    smallest_angle_deg: float = limit(15.0, unit="deg", source=NOT_RECORDED)
    """frames under a smaller angle are refused"""
    good_angle_deg: float = limit(60.0, unit="deg", source=NOT_RECORDED)
    """frames under a smaller angle bring a warning"""
    largest_correction: float = limit(
        0.03,
        source="annotations are off by 1-2 % along the line of sight",
    )
    """a larger change of the scale by edges is due to wrong edges"""


class CadScale:
    """Scale from the size of annotated objects.

    An annotation defines where the mesh appears in its image. The hull vertices, projected with
    the annotated pose, are pixels of points of known metric position. One pose and one scale must
    explain them in all annotated frames. Frames far apart make this well determined: the scale is
    the ratio of the observed size to the triangulated distance. Image edges then refine the
    result.
    """

    name = "cad"

    def available(self, context: ScaleContext) -> bool:
        return any(len(annotated_poses(context, x)) >= 2 for x in context.scene.labels.labels)

    def estimate(self, context: ScaleContext) -> ScaleEstimate:
        estimates: list[tuple[ScaleEstimate, str]] = []
        for label in context.scene.labels.labels:
            poses = annotated_poses(context, label)
            if len(poses) >= 2:
                model = context.scene.objects.object(label.object).model
                estimates.append((self._from_label(context, label, poses), model))
        if not estimates:
            raise ToolkitError(
                "no object is annotated in two or more registered frames",
                path=context.scene.root / "labels.json",
                hint="annotate one object in 2-4 frames at least 60 degrees apart: "
                "`std-curate label SCENE ... --frame N` for each frame",
            )
        return _combine(estimates)

    def _from_label(
        self, context: ScaleContext, label: Label, poses: dict[int, SE3]
    ) -> ScaleEstimate:
        limits = CadScaleSettings.current()
        scene = context.scene
        obj = scene.objects.object(label.object)
        vertices = _spread(hull_vertices(scene.mesh(obj.model)), _POINTS)
        angle = _largest_angle(poses)
        if angle < limits.smallest_angle_deg:
            raise ToolkitError(
                f"object {obj.name!r}: its annotated frames are {angle:.0f} degrees apart, "
                "too close to determine the scale",
                path=scene.root / "labels.json",
                hint=f"annotate it in frames at least {limits.good_angle_deg:.0f} degrees apart",
            )
        if angle < limits.good_angle_deg:
            logger.warning(
                "object %r is annotated in frames only %.0f degrees apart; the scale from its "
                "size is more accurate from %.0f degrees",
                obj.name,
                angle,
                limits.good_angle_deg,
            )
        views = []
        for frame_id, T_cam_obj in sorted(poses.items()):
            camera = context.camera(scene.frame(frame_id))
            # The annotator worked on the camera of the scene at that time: what was annotated is
            # where the object appears, so its pixels are made with the camera of the annotation.
            uv = scene.camera(scene.frame(frame_id)).project(T_cam_obj @ vertices)
            views.append(
                KnownView(
                    T_cam_world=context.poses[frame_id],
                    camera=camera,
                    ids=np.arange(len(vertices)),
                    xyz=vertices,
                    uv=uv,
                )
            )
        size = scene.objects.model(obj.model).diameter_m
        note = f"{obj.name}: {len(views)} annotated frames, up to {angle:.0f} degrees apart"
        annotated = scale_from_known_points(
            views, source=self.name, note=note, threshold_m=0.2 * size
        )
        return _sharpen(context, obj, views, sorted(poses), annotated, 0.2 * size)


def _sharpen(
    context: ScaleContext,
    obj: Object,
    views: list[KnownView],
    frames: list[int],
    annotated: ScaleEstimate,
    threshold_m: float,
) -> ScaleEstimate:
    """Refine the object's pose and the scale with the edges in all annotated images.

    One pixel of annotation error along the outline is nearly one per cent of the distance; edges
    in several images are several times better. If they contradict the annotation, the annotation
    is kept.
    """
    from std_toolkit.labels.refine.edges.solver import refine_poses
    from std_toolkit.labels.refine.problem import RefineObject, RefineOptions, RefineView

    scene = context.scene
    fit = fit_body(views, threshold_m=threshold_m)
    images = []
    for frame_id, view in zip(frames, views, strict=True):
        T_world_cam = view.T_cam_world.inverse()
        metric = SE3(T_world_cam.R, fit.scale * T_world_cam.t)
        color = scene.read_color(scene.frame(frame_id))
        images.append(RefineView.of(view.camera, metric, color, frame=frame_id))
    mesh = scene.mesh(obj.model)
    body = RefineObject(
        name=obj.name,
        vertices=np.asarray(mesh.vertices, dtype=np.float64),
        faces=np.asarray(mesh.faces, dtype=np.int64),
        T_world_obj=fit.T_world_body,
        material=obj.material,
        symmetry=scene.objects.model(obj.model).symmetry.symmetry(),
    )
    options = RefineOptions(refine_scale=True, use_depth=False, search_px=24, iterations=8)
    try:
        refined = refine_poses(images, [body], options)
    except ToolkitError as error:
        logger.warning("object %r: edges were not used for the scale: %s", obj.name, error)
        return annotated
    if not refined.scale_converged:
        logger.warning(
            "object %r: the scale from edges did not settle; annotations are used", obj.name
        )
        return annotated
    if abs(refined.scale - 1) > CadScaleSettings.current().largest_correction:
        logger.warning(
            "object %r: scale from edges and from annotations differ by %.1f %%; the annotations "
            "are used; check the annotations and the mesh",
            obj.name,
            100 * (refined.scale - 1),
        )
        return annotated
    return msgspec.structs.replace(
        annotated,
        factor=fit.scale * refined.scale,
        standard_error=refined.scale_std / refined.scale,
        note=f"{annotated.note}; edges changed the scale by {100 * (refined.scale - 1):+.2f} %",
    )


def annotated_poses(context: ScaleContext, label: Label) -> dict[int, SE3]:
    """T_cam_obj by frame id, of the registered frames in which the object was annotated."""
    every = {label.frame: label.T_cam_obj, **{int(k): v for k, v in label.views.items()}}
    return {f: pose_from_list(T) for f, T in every.items() if f in context.image_ids}


def _combine(estimates: list[tuple[ScaleEstimate, str]]) -> ScaleEstimate:
    """Weighted mean of the estimates of single objects, each with its model's id.

    The measurements of the objects are independent. So are the errors of different meshes; those
    of one mesh are not. Objects that differ by more than their deviations widen the result.
    """
    found = [e for e, _ in estimates]
    sigma = np.array([mesh_deviation(e.standard_error, 1) for e in found])
    weight = sigma**-2 / (sigma**-2).sum()
    factors = np.array([e.factor for e in found])
    factor = float(weight @ factors)
    error = float(np.sqrt(weight**2 @ np.array([e.standard_error for e in found]) ** 2))
    if len(found) > 1:
        chi = float((((factors / factor - 1) / sigma) ** 2).sum()) / (len(found) - 1)
        error = float(np.hypot(error, np.sqrt(max(chi - 1, 0) * (weight**2 @ sigma**2))))
    single = len(found) == 1
    return ScaleEstimate(
        source=CadScale.name,
        factor=factor,
        spread=found[0].spread if single else float(np.ptp(factors)) / factor,
        standard_error=error,
        count=sum(e.count for e in found),
        note=" | ".join(e.note if single else f"{e.note}: {e.factor:.6g}" for e in found),
        deviation=mesh_deviation(error, len({model for _, model in estimates})),
    )


def _largest_angle(poses: dict[int, SE3]) -> float:
    """Largest angle in degrees between two cameras, seen from the object."""
    directions = []
    for T_cam_obj in poses.values():
        centre = T_cam_obj.inverse().t
        directions.append(centre / np.linalg.norm(centre))
    D = np.array(directions)
    return float(np.degrees(np.arccos(np.clip((D @ D.T).min(), -1, 1))))


def _spread(points: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """At most `count` of the points, far from each other."""
    if len(points) <= count:
        return points
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]
