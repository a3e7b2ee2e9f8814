"""Sources of metric scale: protocol, scale from sensor depth, and selection among several.

All available sources are reported. Sources that contradict each other stop the run.

Scale from depth is the ratio of sensor z-depth to z-depth in the model. A depth image holds
z-depth, the distance along the optical axis. Dividing it by the distance from the camera centre
(range) would make every ratio too small by the cosine of the angle to the axis, 0.9-6.5 % for
common fields of view.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit import errors, log, plugins
from std_toolkit.geometry import SE3, Camera
from std_toolkit.jobs import JobOptions
from std_toolkit.poses.colmap import Observations, observations
from std_toolkit.scene import Frame, Scene
from std_toolkit.scene.model import ScaleEstimate, ScaleReport
from std_toolkit.scene.scale_model import (
    CALIBRATED_DEPTH_ERROR,
    MAX_RELATIVE,
    MAX_SIGMA,
    contradiction,
    fuse,
)
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Order of equally precise sources; plug-ins follow.
TRUST = ("board", "cad", "depth")

NO_SCALE_HINT = (
    "add a source of metric scale: sensor depth, a board (--board FILE), or an object annotated "
    "in two or more frames (--scale none accepts the unknown unit without a warning)"
)

MAX_FRAMES = 60


@dataclass(frozen=True, kw_only=True)
class DepthScaleSettings(Settings):
    """Sensor depths that give the scale."""

    shortest_track: int = limit(3, source=NOT_RECORDED)
    """images that must see a point"""
    fewest_ratios: int = limit(100, source=NOT_RECORDED)
    """fewer depths give no scale"""
    largest_step: float = limit(
        0.01,
        source="at an edge, a sub-pixel error selects foreground or background",
    )
    """largest change of depth per pixel, as a fraction of the depth"""
    nearest_m: float = limit(0.15, unit="m", source=NOT_RECORDED)
    """nearest depth that counts"""
    farthest_m: float = limit(
        4.0,
        unit="m",
        source="the error of stereo depth grows with the square of the distance",
    )
    """farthest depth that counts"""
    largest_error_px: float = limit(1.5, unit="px", source=NOT_RECORDED)
    """largest mean reprojection error of a point that counts"""


@dataclass(frozen=True)
class ScaleContext:
    """Input of a scale source.

    Attributes:
        scene: frames, images, labels.
        model: pycolmap.Reconstruction of unknown unit.
        image_ids: COLMAP image ids by frame id, registered frames only, in ascending order.
        cameras: adjusted intrinsics by camera key.
        board: file of a fiducial board, or None.
        jobs: where work over frames runs.
    """

    scene: Scene
    model: Any
    image_ids: dict[int, int]
    cameras: dict[str, Camera]
    board: Path | None = None
    jobs: JobOptions | None = None

    @cached_property
    def poses(self) -> dict[int, SE3]:
        """T_cam_world of the registered frames by frame id, in units of the model."""
        from std_toolkit.poses.colmap import from_rigid3d

        return {
            frame: from_rigid3d(self.model.image(image).cam_from_world())
            for frame, image in self.image_ids.items()
        }

    def frames(self) -> list[Frame]:
        """Return the registered frames in recording order."""
        return [f for f in self.scene.frames if f.id in self.image_ids]

    def camera(self, frame: Frame) -> Camera:
        """Return the adjusted intrinsics of a frame."""
        return self.cameras[frame.camera]

    def observations(self, frame_id: int) -> Observations:
        """Return the points of the model observed in a registered frame."""
        return observations(self.model, self.image_ids[frame_id])


class ScaleSource(Protocol):
    """A source of metric scale.

    An implementation is a class without constructor arguments, or another factory, registered in
    the entry-point group `std_toolkit.scale_sources`.
    """

    name: str

    def available(self, context: ScaleContext) -> bool:
        """Return whether the scene has the input of this source; must be fast."""
        ...

    def estimate(self, context: ScaleContext) -> ScaleEstimate:
        """Estimate the metres per unit of the model.

        A source whose systematic error is known sets `deviation`; others get `OTHER_ERROR` of
        `scene.scale_model`.

        Raises:
            ToolkitError: the data are insufficient or contradictory.
        """
        ...


# Factories by name.
SOURCES: plugins.Registry[Callable[[], ScaleSource]] = plugins.Registry(
    "std_toolkit.scale_sources",
    {
        "depth": "std_toolkit.poses.scale_sources:DepthScale",
        "cad": "std_toolkit.labels.cad_scale:CadScale",
        "board": "std_toolkit.poses.board_scale:BoardScale",
    },
)


def summarise(
    name: str,
    ratios: NDArray[np.floating],
    *,
    groups: NDArray[np.integer] | None = None,
    note: str = "",
) -> ScaleEstimate:
    """Summarise single estimates of the scale robustly.

    The factor is the median. The spread is the interquartile range relative to it. The
    standard error is 1.2533 x 1.4826 x MAD / sqrt(n), relative to the factor; with `groups` it is
    that of the medians per group, because estimates from one image share their errors.

    Args:
        name: name of the source.
        ratios: (N,) positive single estimates.
        groups: (N,) group ids, such as frames.
        note: description of the measurements.
    """
    r = np.asarray(ratios, dtype=np.float64)
    factor = float(np.median(r))
    q1, q3 = np.percentile(r, [25, 75])
    single = r
    if groups is not None:
        single = np.array([np.median(r[groups == g]) for g in np.unique(groups)])
    mad = float(np.median(np.abs(single - np.median(single))))
    error = 1.2533 * 1.4826 * mad / np.sqrt(len(single))
    return ScaleEstimate(
        source=name,
        factor=factor,
        spread=float(q3 - q1) / factor,
        standard_error=float(error) / factor,
        count=len(r),
        note=note,
    )


def check_source_name(scale: str) -> None:
    """Check a value of `--scale`; fast, so that it can run before the mapping.

    Raises:
        ToolkitError: it is not "auto", "none", a known source or the path of a plug-in.
    """
    if scale not in ("auto", "none", *SOURCES.names()) and ":" not in scale:
        raise errors.ToolkitError(
            "unknown scale source",
            field="scale",
            value=scale,
            hint=f"one of auto, none, {', '.join(SOURCES.names())}",
        )


def resolve_scale(
    context: ScaleContext,
    *,
    scale: str,
    max_disagreement: float = MAX_RELATIVE,
    max_sigma: float = MAX_SIGMA,
) -> tuple[float, ScaleReport]:
    """Return the metres per unit of the model, and the scale report.

    With "auto" the factor is the mean of all sources, weighted by inverse variance.

    Args:
        context: the reconstruction and the scene.
        scale: "auto", "none" or the name of a source.
        max_disagreement, max_sigma: two sources contradict each other if their relative
            difference exceeds the first and, in units of their joint deviation, the second.

    Raises:
        ToolkitError: the named source fails; with "auto", an available source fails or sources
            contradict each other.
    """
    if scale == "none":
        return 1.0, ScaleReport(unit="unknown", chosen="none")
    named = scale != "auto"
    check_source_name(scale)
    names = SOURCES.names() if scale in SOURCES.names() or not named else [*SOURCES.names(), scale]
    estimates: dict[str, ScaleEstimate] = {}
    for name in names:
        source = SOURCES.get(name)()
        if name != scale and not source.available(context):
            continue
        try:
            estimates[name] = source.estimate(context)
        except errors.ToolkitError as error:
            if name == scale or not named:
                # An available source that fails needs inspection, so it is not skipped.
                raise errors.ToolkitError(
                    f"scale source {name!r}: {error}",
                    hint=None if named else "fix it or name another source with --scale",
                ) from error
            log.logger.warning("scale source %s (not used): %s", name, error)
    if not estimates:
        log.logger.warning(
            "no source of metric scale in this scene: the unit of its poses is UNKNOWN and every "
            "step that needs metres will reject them; %s",
            NO_SCALE_HINT,
        )
        return 1.0, ScaleReport(unit="unknown", chosen="none")
    found = list(estimates.values())
    wrong = contradiction(found, max_relative=max_disagreement, max_sigma=max_sigma)
    if wrong is not None and not named:
        raise errors.ToolkitError(
            f"scale sources contradict each other: {wrong} (limits {100 * max_disagreement:.2f} % "
            f"and {max_sigma:g}); {_line(wrong.a)}; {_line(wrong.b)}",
            hint="fix the wrong one or name the right one: "
            f"--scale {wrong.a.source} or --scale {wrong.b.source}",
        )
    if wrong is not None:
        log.logger.warning("scale sources contradict each other: %s; using %s", wrong, scale)
    used = [estimates[scale]] if named else found
    order = {name: i for i, name in enumerate(TRUST)}
    best = min(used, key=lambda e: (e.sigma, order.get(e.source, len(order))))
    factor, deviation = fuse(used)
    report = ScaleReport(
        unit="metre",
        chosen=next(name for name, e in estimates.items() if e is best),
        estimates=found,
        factor=factor,
        deviation=deviation,
        fused=[e.source for e in used],
    )
    return factor, report.consistent()


def _line(estimate: ScaleEstimate) -> str:
    return f"{estimate.source}: spread {100 * estimate.spread:.2f} %, {estimate.note}"


class DepthScale:
    """Median of sensor z-depth over the z-depth of reconstructed points."""

    name = "depth"

    def available(self, context: ScaleContext) -> bool:
        return any(f.depth is not None for f in context.frames())

    def estimate(self, context: ScaleContext) -> ScaleEstimate:
        limits = DepthScaleSettings.current()
        frames = [f for f in context.frames() if f.depth is not None]
        # A sample spread over the recording is enough; reading every depth image takes long.
        step = max(1, -(-len(frames) // MAX_FRAMES))
        ratios, groups = [], []
        for frame in frames[::step]:
            depth = context.scene.read_depth(frame)
            if depth is None:
                continue
            single = z_ratios(depth, context.observations(frame.id))
            ratios.append(single)
            groups.append(np.full(len(single), frame.id))
        found = np.concatenate(ratios) if ratios else np.zeros(0)
        if len(found) < limits.fewest_ratios:
            raise errors.ToolkitError(
                f"scale from depth needs {limits.fewest_ratios} points with sensor depth",
                value=len(found),
                hint="is the depth aligned to colour? name another source with --scale",
            )
        correction = context.scene.info.depth_correction
        estimate = summarise(
            self.name,
            found,
            groups=np.concatenate(groups),
            note=f"z over z at {len(found)} points in {len(ratios)} frames; depth correction "
            f"factor {correction:g} applied",
        )
        if correction == 1:
            return estimate
        deviation = float(np.hypot(estimate.standard_error, CALIBRATED_DEPTH_ERROR))
        return msgspec.structs.replace(estimate, deviation=deviation)


def z_ratios(depth: NDArray[np.floating], seen: Observations) -> NDArray[np.float64]:
    """Return the ratio of sensor z-depth to model z-depth at every point where both are reliable.

    Args:
        depth: (H, W) z-depth in metres, 0 = none.
        seen: observations of the image that belongs to this depth.

    Returns:
        (N,) metres per unit of the model.
    """
    limits = DepthScaleSettings.current()
    p = seen.points_cam
    uv = seen.camera.project(p)
    h, w = depth.shape
    good = (
        np.isfinite(uv).all(axis=1)
        & (seen.track_length >= limits.shortest_track)
        & (np.linalg.norm(uv - seen.uv, axis=1) < limits.largest_error_px)
    )
    good[good] &= (uv[good] >= 1).all(axis=1) & (uv[good] <= [w - 3, h - 3]).all(axis=1)
    uv, z = uv[good], p[good, 2]
    if len(z) == 0:
        return np.zeros(0)
    u0, v0 = np.floor(uv).astype(int).T
    patch = np.stack(
        [depth[v0 + dv, u0 + du] for dv in (-1, 0, 1, 2) for du in (-1, 0, 1, 2)], axis=1
    ).astype(np.float64)
    complete = (patch > 0).all(axis=1)
    middle = patch[:, [5, 6, 9, 10]]
    flat = np.ptp(patch, axis=1) < 3 * limits.largest_step * np.maximum(middle.mean(axis=1), 1e-9)
    a, b = uv[:, 0] - u0, uv[:, 1] - v0
    # On a plane, inverse depth is linear in the image and depth is not.
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / middle
        measured = 1 / (
            inverse[:, 0] * (1 - a) * (1 - b)
            + inverse[:, 1] * a * (1 - b)
            + inverse[:, 2] * (1 - a) * b
            + inverse[:, 3] * a * b
        )
    near = (measured > limits.nearest_m) & (measured < limits.farthest_m)
    keep = complete & flat & near & (z > 0)
    return np.asarray(measured[keep] / z[keep], dtype=np.float64)
