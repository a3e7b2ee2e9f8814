"""Entry point for refining labelled objects with the data that the scene has.

Opaque objects are aligned with sensor depth, then refined with image edges. Glass and metal, on
which sensors err, and scenes without depth are refined with contours in several views. In a single
view contours determine the distance weakly; a warning reports this.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels import refine_inputs
from std_toolkit.labels.refine.caster import LayerStore
from std_toolkit.labels.refine.depth import icp
from std_toolkit.labels.refine.edges.approach import search_turns
from std_toolkit.labels.refine.edges.solver import refine_poses
from std_toolkit.labels.refine.problem import (
    Progress,
    RefinedObject,
    RefineObject,
    RefineOptions,
    sub_progress,
)
from std_toolkit.labels.refine_step import left_out_sentences
from std_toolkit.labels.texture.comparison import TextureComparison
from std_toolkit.labels.texture.views import Views
from std_toolkit.labels.texture_step import compare_objects, scene_views
from std_toolkit.scene.scene import Scene
from std_toolkit.settings import Settings, limit

Method = Literal["auto", "depth", "multiview"]

# Search radius around the contour for edges, pixels: after alignment by depth, or by hand.
_NEAR_PX, _FAR_PX = 24.0, 48.0
# Fraction of the time after which only textures are compared.
_COMPARED = 0.92
# Time for an object without depth, in units of one with depth.
_SEARCHED = 2.5


@dataclass(frozen=True, kw_only=True)
class AutoRefineSettings(Settings):
    """Which measurements refine an object."""

    views_around: int = limit(
        3,
        source="with fewer, the sensor depth factor cannot be separated from the distance",
    )
    """views from which edges and depth are used together"""


@dataclass(frozen=True, eq=False)
class RefinedPose:
    """Outcome for one object.

    Attributes:
        object: its id.
        name: its name.
        pose: refined pose, in the coordinate frame of the input poses.
        method: sentence for the label's provenance, such as
            "depth and edges, 7 views, edges 0.6 px, depth 1.1 mm".
        covariance: (6, 6) of a right perturbation `pose @ SE3.exp(xi)`.
        weak_direction: sentence on the least determined direction.
        edge_rms_px: robust standard deviation of the edges around the contour, or None.
        depth_m: typical distance between sensor depth and surface, metres; None if depth was not
            used.
        explained: fraction of the sensor depth on the visible surface that agrees with it, or None.
        views: number of views used.
        frames: their ids.
        warnings: sentences on what to inspect.
        texture: the texture at the pose against near-symmetric alternatives; None if not compared.
    """

    object: int
    name: str
    pose: SE3
    method: str
    covariance: NDArray[np.float64]
    weak_direction: str
    edge_rms_px: float | None
    depth_m: float | None
    explained: float | None
    views: int
    frames: tuple[int, ...]
    warnings: tuple[str, ...]
    texture: TextureComparison | None = None


@dataclass(frozen=True, eq=False)
class RefineOutcome:
    """Outcome of `refine_objects`.

    Attributes:
        objects: refined objects, by id.
        failures: reasons by id of objects that were not refined; they keep their poses.
        posed: whether the poses are in the world; otherwise in the camera of the only frame.
        left_out: one sentence per frame that cannot be read.
    """

    objects: dict[int, RefinedPose]
    failures: dict[int, ToolkitError]
    posed: bool
    left_out: tuple[str, ...] = ()


class RefineCancelled(Exception):
    """`cancelled` of the caller returned True."""


def refine_objects(
    scene: Scene,
    poses: Mapping[int, SE3],
    chosen: Sequence[int] | None = None,
    *,
    frames: Sequence[int] | None = None,
    method: Method = "auto",
    keyframes: int = 8,
    always: Sequence[int] = (),
    mesh: refine_inputs.MeshSource | None = None,
    progress: Callable[[float], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> RefineOutcome:
    """Refine the poses of objects. Writes nothing and ignores the labels of the scene.

    Args:
        poses: poses of all placed objects by object id; objects that are not chosen act as
            occluders. T_world_obj, or T_cam_obj of the one frame in `frames` if the scene has no
            camera poses in metres or that frame has none.
        chosen: ids of the objects to refine; default: all.
        frames: ids of the frames to use; those without a camera pose are skipped. Default:
            keyframes spread over the viewpoints.
        method: "auto" selects by material; "depth" uses sensor depth on any material;
            "multiview" uses no depth.
        keyframes: number of frames if `frames` is not given.
        always: frames to use in any case, if they have a camera pose, such as the annotated one.
        mesh: model id to mesh in metres, if loaded; default: read from the scene.
        progress: called with the completed fraction, 0 to 1.
        cancelled: called repeatedly; True stops the refinement.

    Raises:
        ToolkitError: no object or frame to refine, or no object could be refined.
        RefineCancelled: `cancelled` returned True.
    """
    chosen = list(dict.fromkeys(poses if chosen is None else chosen))
    if not chosen:
        raise ToolkitError("no object to refine", path=scene.root)
    problem = refine_inputs.auto_problem(
        scene, poses, chosen, frames=frames, keyframes=keyframes, always=always, mesh=mesh
    )
    run = _Run(scene, problem, method, progress or (lambda _: None), cancelled or (lambda: False))
    run.go(chosen)
    if not run.found:
        raise next(iter(run.failures.values()))
    left_out = left_out_sentences(scene, problem.left_out)
    return RefineOutcome(run.found, run.failures, problem.posed, tuple(left_out))


class _Run:
    """One call of `refine_objects`: depth first, because aligned objects occlude others."""

    def __init__(
        self,
        scene: Scene,
        problem: refine_inputs.AutoProblem,
        method: Method,
        progress: Callable[[float], None],
        cancelled: Callable[[], bool],
    ) -> None:
        self._scene, self._problem, self._method = scene, problem, method
        self._progress, self._cancelled = progress, cancelled
        self._reported = 0.0
        self._layers = LayerStore()
        self._fits: dict[int, icp.DepthFit] = {}
        self._notes: dict[int, list[str]] = {}
        self.found: dict[int, RefinedPose] = {}
        self.failures: dict[int, ToolkitError] = {}

    def go(self, chosen: Sequence[int]) -> None:
        by_depth = [i for i in chosen if self._uses_depth(i)]
        around = len(self._problem.views) >= AutoRefineSettings.current().views_around
        left = [i for i in chosen if i not in by_depth]
        # Depth takes about as long as the edges, and a search much longer.
        each = 1.0 if not around else 0.5
        whole = len(by_depth) + _SEARCHED * len(left)
        share = each * len(by_depth) / whole
        for done, i in enumerate(by_depth):
            within = share * done / len(by_depth), share * (done + 1) / len(by_depth)
            if not self._fit_depth(
                i, finish=not around, progress=sub_progress(self._report, *within)
            ):
                left.append(i)
        self._report(share)
        if around:
            self._turn_about()
        left += [i for i in self._fits if i not in self.found]
        if left:
            self._fit_edges(left, sub_progress(self._report, share, _COMPARED))
        self._compare_textures()
        self._report(1.0)

    def _uses_depth(self, i: int) -> bool:
        if self._method == "multiview":
            return False
        if self._method == "depth":
            return True
        return self._problem.has_depth and self._problem.objects[i].trusts_depth

    def _report(self, fraction: float) -> None:
        if self._cancelled():
            raise RefineCancelled
        self._reported = max(self._reported, fraction)
        self._progress(self._reported)

    def _fit_depth(self, i: int, *, finish: bool, progress: Progress) -> bool:
        """Align an object with depth; False if only its edges can be used."""
        objects = self._placed()
        others = [o for k, o in objects.items() if k != i]
        options = icp.DepthFitOptions(use_edges=finish)
        try:
            fit = icp.refine_on_depth(
                self._problem.views,
                objects[i],
                options,
                others=others,
                layers=self._layers,
                progress=progress,
            )
        except ToolkitError as error:
            if self._method == "depth":
                self.failures[i] = error
                return True
            self._notes[i] = [f"{error.problem}, so only edges were used"]
            return False
        self._fits[i] = fit
        if finish:
            self.found[i] = self._of_depth(i, fit)
        return True

    def _turn_about(self) -> None:
        """Rotate a nearly round object: its depth fits at any rotation, as do edges nearby."""
        options = RefineOptions(use_depth=False)
        for i, fit in list(self._fits.items()):
            objects = self._placed()
            others = [replace(o, fixed=True) for k, o in objects.items() if k != i]
            T = search_turns(self._problem.views, objects[i], others, options, layers=self._layers)
            self._fits[i] = replace(fit, T_world_obj=T)

    def _fit_edges(self, chosen: Sequence[int], progress: Progress) -> None:
        """Refine objects jointly with the edges (and usable depth) of all views."""
        objects = self._placed()
        prepared = []
        for k, obj in objects.items():
            trusted = self._method == "depth" and k in self._fits
            material = "diffuse" if trusted else obj.material
            # Objects aligned with depth are near their edges; manual poses may be far.
            rough = k not in self._fits
            prepared.append(replace(obj, material=material, fixed=k not in chosen, rough=rough))
        near = all(k in self._fits for k in chosen)
        options = RefineOptions(
            use_depth=self._method != "multiview", search_px=_NEAR_PX if near else _FAR_PX
        )
        try:
            result = refine_poses(
                self._problem.views,
                prepared,
                options,
                texture_views=self._problem.texture_views,
                layers=self._layers,
                progress=progress,
            )
        except ToolkitError as error:
            for k in chosen:
                self._fall_back(k, error)
            return
        for (k, obj), refined in zip(objects.items(), result.objects, strict=True):
            if k not in chosen:
                continue
            if refined.views == 0:
                hidden = f"{refined.name} is not visible enough in the selected frames"
                self._fall_back(k, ToolkitError(hidden, hint="move it onto its image first"))
            elif k in self._fits and icp.moved_too_far(obj, refined.T_world_obj):
                self._fall_back(k, ToolkitError("the edges contradict the sensor depth"))
            else:
                self.found[k] = self._of_edges(k, prepared, refined, result.depth_factor)

    def _fall_back(self, i: int, error: ToolkitError) -> None:
        """Without edges, use the pose from depth, if any."""
        if i in self._fits:
            self._notes[i] = [f"{error.problem}, so only sensor depth was used"]
            self.found[i] = self._of_depth(i, self._fits[i])
        else:
            self.failures[i] = error

    def _compare_textures(self) -> None:
        """Judge the texture at each refined pose, in all frames that have a camera pose."""
        poses = {i: found.pose for i, found in self.found.items()}
        objects = self._problem.placed(poses)
        views = Views.of(self._problem.views)
        if self._problem.posed:
            views = scene_views(self._scene, loaded=self._problem.views)
        for done, (i, found) in enumerate(self.found.items()):
            self._report(_COMPARED + (1 - _COMPARED) * done / len(self.found))
            judged = compare_objects(views, objects, [i])[i]
            warnings = found.warnings
            if judged.verdict == "turned":
                warnings += (judged.sentence(),)
            self.found[i] = replace(found, texture=judged, warnings=warnings)

    def _placed(self) -> dict[int, RefineObject]:
        return self._problem.placed({i: f.T_world_obj for i, f in self._fits.items()})

    def _of_depth(self, i: int, fit: icp.DepthFit) -> RefinedPose:
        obj = self._problem.objects[i]
        return self._refined(
            i,
            obj,
            fit.T_world_obj,
            fit.covariance,
            fit.weak_direction,
            fit.edge_rms_px,
            fit.depth.median_m,
            fit.depth.explained,
            fit.views,
        )

    def _of_edges(
        self, i: int, prepared: Sequence[RefineObject], found: RefinedObject, depth_factor: float
    ) -> RefinedPose:
        obj = self._problem.objects[i]
        explained = None
        if i in self._fits:
            at_end = replace(obj, T_world_obj=found.T_world_obj)
            others = [o for o in prepared if o.name != obj.name]
            agreement = icp.depth_agreement(
                self._problem.views,
                at_end,
                others,
                depth_factor=depth_factor,
                layers=self._layers,
            )
            explained = agreement.explained
        return self._refined(
            i,
            obj,
            found.T_world_obj,
            found.covariance,
            found.weak_direction,
            found.edge_rms_px,
            found.depth_rms_m,
            explained,
            found.views,
            settled=found.converged,
            texture_note=found.texture_sentence(obj.centre),
        )

    def _refined(
        self,
        i: int,
        obj: RefineObject,
        pose: SE3,
        covariance: NDArray[np.float64],
        weak_direction: str,
        edge_rms_px: float | None,
        depth_m: float | None,
        explained: float | None,
        views: int,
        *,
        settled: bool = True,
        texture_note: str = "",
    ) -> RefinedPose:
        seen = replace(self._problem.objects[i], T_world_obj=pose)
        warnings = [
            *self._notes.get(i, []),
            *([] if settled else [refine_inputs.NOT_CONVERGED]),
            *([texture_note] if texture_note else []),
            *refine_inputs.quality_warnings(
                self._problem, seen, covariance, edge_rms_px, depth_m, explained
            ),
        ]
        return RefinedPose(
            i,
            obj.name,
            pose,
            refine_inputs.method_sentence(edge_rms_px, depth_m, views),
            covariance,
            weak_direction,
            edge_rms_px,
            depth_m,
            explained,
            views,
            tuple(v.frame for v in self._problem.views),
            tuple(warnings),
        )
