"""The scan: photos to poses, masks, depth maps, a closed surface, texture, files and report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.log import logger
from std_toolkit.scanning import photos as photo_files
from std_toolkit.scanning.bake import bake_texture
from std_toolkit.scanning.depth_maps import ENGINES, DepthEngine, DepthMap
from std_toolkit.scanning.glass_outlines import find_vessel
from std_toolkit.scanning.hull import hull_field, largest_component, surface_of
from std_toolkit.scanning.masks import volume_of_masks
from std_toolkit.scanning.model_frame import find_symmetry, model_frame, write_symmetry
from std_toolkit.scanning.object_masks import object_masks
from std_toolkit.scanning.options import ScanOptions
from std_toolkit.scanning.polish import fit_outlines
from std_toolkit.scanning.posed_photos import PosedPhotos, Scan
from std_toolkit.scanning.revolve import fit_revolution
from std_toolkit.scanning.revolved_surface import OutlineView, RevolvedSurface
from std_toolkit.scanning.stages import Stages
from std_toolkit.scanning.surface import agreeing, closed_mesh, fuse
from std_toolkit.scanning.underside import flatten_unseen
from std_toolkit.scanning.video import is_video, sample_video
from std_toolkit.scanning.views import Array, Grid, View
from std_toolkit.scanning.write_model import write_model
from std_toolkit.scene.document import digest_file, digest_of

# Depth below the hull that is searched, as a share of the longest side.
_DEEPEST = 0.3
# Support of a face below which its place is a guess.
_SUPPORTED = 0.3


def scan(options: ScanOptions) -> Scan:
    """Make the model of an object from photos and write it to `options.out`.

    Raises:
        ToolkitError: the photos do not suffice; the message says what to photograph.
    """
    from std_toolkit.scanning.report import write_report

    work = options.out / ".scan"
    work.mkdir(parents=True, exist_ok=True)
    stages = Stages(work)
    threads = options.jobs.worker_count
    seconds: dict[str, float] = {}
    began = time.perf_counter()

    def lap(name: str) -> None:
        nonlocal began
        seconds[name] = time.perf_counter() - began
        began = time.perf_counter()
        logger.info("%s: %.0f s", name, seconds[name])

    engine = ENGINES.get(options.depth)
    folder = sample_video(options.photos, work) if is_video(options.photos) else options.photos
    found = photo_files.find_photos(folder, work, longest=options.image_size)
    inputs = digest_of([digest_file(p) for p in found.paths], [p.name for p in found.paths])
    posed = _poses(options, found, stages, work, inputs)
    lap("poses")
    vessel: RevolvedSurface | None = None
    if options.revolve and posed.on_table and not (options.masks or options.pick or options.box):
        vessel, views = find_vessel(posed.views, posed.corners, threads=threads)
    else:
        views = object_masks(options, posed, stages, threads)
        vessel = _vessel_of_masks(views, posed) if options.revolve else None
    lap("masks")
    if vessel is not None:
        vertices, faces, support = _revolved(vessel, posed)
    else:
        vertices, faces, support = _fused(options, posed, views, engine, stages, threads, lap)
    lap("surface")
    texture = bake_texture(vertices, faces, views, size=options.texture, threads=threads)
    lap("texture")
    T_model_world = SE3.identity()
    if posed.on_table:
        T_model_world = model_frame(vertices, faces, options.category)
    symmetry, words = find_symmetry(T_model_world @ vertices, faces, texture)
    lap("symmetry")
    result = Scan(
        name=options.out.resolve().name,
        vertices=T_model_world @ vertices,
        faces=faces,
        texture=texture,
        supported=support > _SUPPORTED,
        views=[replace(v, T_world_cam=T_model_world @ v.T_world_cam) for v in views],
        facts={**posed.facts, **words},
        warnings=posed.warnings,
        seconds=seconds,
    )
    write_model(options.out, result.name, result.vertices, faces, texture)
    write_symmetry(options.out, symmetry)
    write_report(options.out, result)
    lap("files")
    return result


def _poses(
    options: ScanOptions, found: photo_files.Photos, stages: Stages, work: Path, inputs: str
) -> PosedPhotos:
    if options.known.cameras is not None:
        views = photo_files.known_views(found, options.known, options.intrinsics)
        digest = digest_of(inputs, [v.P.tolist() for v in views], list(found.size))
        facts = {"poses": f"from {options.known.cameras.name}", "photos": len(views)}
        return PosedPhotos(
            views=views, corners=np.zeros((0, 3)), points=np.zeros((0, 3)), on_table=False,
            facts=facts, warnings=[], digest=digest, photos=found,
        )  # fmt: skip
    if options.board is None:
        raise ToolkitError(
            "without a board nothing tells the size of the object",
            hint="photograph the object on the printed board and give --board FILE, or give known "
            "cameras with --cameras",
        )
    from std_toolkit.importers.intrinsics import read_intrinsics
    from std_toolkit.io.images import image_size
    from std_toolkit.poses.board_scale import Board
    from std_toolkit.scanning import board_poses

    board = Board.read(options.board)
    blurred = photo_files.blurred_photos(found.used)
    warnings = []
    if blurred:
        names = ", ".join(found.paths[i].name for i in blurred[:6])
        warnings.append(f"{len(blurred)} blurred photos were left out: {names}")
        logger.warning("%s", warnings[-1])
    kept = [i for i in range(len(found.paths)) if i not in set(blurred)]
    digest = digest_of(
        inputs, digest_file(options.board), options.intrinsics, options.max_features, found.factor,
        kept, "poses 3",
    )  # fmt: skip

    def make() -> dict[str, Any]:
        paths = [found.used[i] for i in kept]
        detections = board_poses.detect_boards(paths, board, options.jobs)
        assert options.board is not None
        board_poses.check_boards(detections, paths, options.board)
        if options.intrinsics is not None:
            whole = image_size(found.paths[0])
            given = read_intrinsics(options.intrinsics, size=whole)
            camera = given.camera(whole, path=options.intrinsics).resized(*found.size)
        else:
            camera = board_poses.calibrate(detections, found.size)
        p = board_poses.pose_photos(
            paths, detections, camera, work, jobs=options.jobs, max_features=options.max_features
        )
        c = p.camera
        return {
            "camera": np.array([c.fx, c.fy, c.cx, c.cy, *c.distortion]),
            "index": np.array([kept[i] for i in p.poses]),
            "T": np.stack([T.matrix() for T in p.poses.values()]),
            "corners": p.corners,
            "points": p.points,
            "found": np.concatenate(
                [
                    np.column_stack([np.full(len(d.uv), i), d.uv])
                    for i, d in zip(kept, detections, strict=True)
                ]
            ),
            "quality": np.array([p.corner_rms_px, p.feature_rms_px, p.scale_deviation]),
        }

    a = stages.arrays("poses", digest, make)
    fx, fy, cx, cy, *k = (float(x) for x in a["camera"])
    camera = Camera(*found.size, fx, fy, cx, cy, tuple(k))
    views = [
        photo_files.make_view(found, int(i), camera, SE3.from_matrix(T))
        for i, T in zip(a["index"], a["T"], strict=True)
    ]
    lost = sorted(set(kept) - {int(i) for i in a["index"]})
    if lost:
        names = ", ".join(found.paths[i].name for i in lost[:6])
        warnings.append(f"{len(lost)} photos match no other and show no board: {names}")
        logger.warning("%s", warnings[-1])
    if len(views) < photo_files.MIN_PHOTOS:
        raise ToolkitError(
            f"{len(views)} of {len(found.paths)} photos have a pose",
            hint="keep most of the board in view and move by small steps",
        )
    corner, feature, deviation = (float(x) for x in a["quality"])
    facts = {
        "photos": len(views),
        "board residual": f"{corner:.2f} px",
        "feature residual": f"{feature:.2f} px",
        "scale deviation": f"{100 * deviation:.3f} %",
    }
    return PosedPhotos(
        views=views, corners=np.asarray(a["corners"]), points=np.asarray(a["points"]),
        on_table=True, facts=facts, warnings=warnings, digest=digest, photos=found,
        found=_undistorted(a["found"], found, camera),
    )  # fmt: skip


def _undistorted(
    found: Array, photos: photo_files.Photos, camera: Camera
) -> dict[str, NDArray[np.float64]]:
    """Corners of the board (N, 2) by the name of the photo, in pixels of its undistorted image."""
    flat = camera.without_distortion()
    return {
        photos.paths[i].name: flat.project(camera.unproject(found[found[:, 0] == i, 1:]))
        for i in np.unique(found[:, 0]).astype(int)
    }


def _fused(
    options: ScanOptions,
    posed: PosedPhotos,
    views: Sequence[View],
    engine: DepthEngine,
    stages: Stages,
    threads: int,
    lap: Callable[[str], None],
) -> tuple[Array, NDArray[np.int64], NDArray[np.float32]]:
    """Vertices, faces and the support of the faces by depth maps."""
    low, high = volume_of_masks(views)
    if posed.on_table:
        low[2] = 0.0
    longest = float((high - low).max())
    grid = Grid.around(low, high, longest / options.voxels)
    hull = _hull(views, grid, posed.on_table, threads)
    lap("hull")
    key = digest_of(
        posed.digest, _mask_digest(views), options.voxels, options.neighbours, options.depth
    )
    maps = _depth(engine, views, hull, grid, longest, options.neighbours, stages, key, threads)
    lap("depth maps")
    target = (low + high) / 2
    weights = agreeing(views, maps, target, threads=threads)
    fused = fuse(views, maps, weights, hull, grid, threads=threads)
    vertices, faces = closed_mesh(fused.field, grid, options.faces)
    vertices = fit_outlines(
        vertices, faces, views, _at(fused.support, grid, vertices),
        floor=0.0 if posed.on_table else None, threads=threads,
    )  # fmt: skip
    if not posed.on_table:
        vertices, flattened = flatten_unseen(vertices, faces, views)
        if flattened:
            posed.facts["closed by a plane"] = f"{100 * flattened:.0f} % of the surface, unseen"
    return vertices, faces, _at(fused.support, grid, vertices[faces].mean(axis=1))


def _vessel_of_masks(views: Sequence[View], posed: PosedPhotos) -> RevolvedSurface:
    """The surface of revolution that fits the outlines of masks.

    Raises:
        ToolkitError: without a board, or the object is no surface of revolution.
    """
    if not posed.on_table:
        raise ToolkitError("needs the board, which tells what is upright", field="--revolve")
    return fit_revolution([OutlineView(v.camera, v.T_world_cam, v.shown, v.image) for v in views])


def _revolved(
    found: RevolvedSurface, posed: PosedPhotos
) -> tuple[Array, NDArray[np.int64], NDArray[np.float32]]:
    """Vertices and faces of a surface of revolution; no depth supports it."""
    posed.facts["outline residual"] = f"{found.outline_px:.2f} px"
    posed.facts["outline left out"] = f"{100 * found.outside:.1f} %"
    posed.facts["deviation of the radii"] = f"{1000 * float(np.median(found.deviation_m)):.2f} mm"
    posed.facts["wall"] = f"{1000 * found.wall_m:.1f} mm" + ("" if found.wall_seen else ", guessed")
    posed.warnings.extend(found.warnings)
    vertices, faces = found.mesh()
    return vertices, faces, np.zeros(len(faces), np.float32)


def _mask_digest(views: Sequence[View]) -> str:
    return digest_of([np.packbits(v.possible).tobytes().hex()[::7] for v in views],
                     [int(v.shown.sum()) for v in views])  # fmt: skip


def _hull(views: Sequence[View], grid: Grid, on_table: bool, threads: int) -> NDArray[np.float32]:
    field = hull_field(views, grid, allowed=len(views) // 40, threads=threads)
    if on_table:
        z = grid.origin[2] + np.arange(grid.shape[0]) * grid.step
        field = np.maximum(field, -z[:, None, None]).astype(np.float32)
    inside = largest_component(field < 0)
    if not inside.any():
        raise ToolkitError(
            "the masks of the photos contradict each other: they leave no volume",
            hint="look at the masks in the report and correct them with --masks; did the object "
            "move between photos?",
        )
    return np.where(inside | (field >= 0), field, np.float32(grid.step))


def _depth(
    engine: DepthEngine,
    views: Sequence[View],
    hull: NDArray[np.float32],
    grid: Grid,
    longest: float,
    neighbours: int,
    stages: Stages,
    key: str,
    threads: int,
) -> list[DepthMap | None]:
    surface = surface_of(hull, grid)

    def make() -> dict[str, Any]:
        maps = engine(
            views, surface, deepest=_DEEPEST * longest, neighbours=neighbours, threads=threads
        )
        out: dict[str, Any] = {}
        for i, m in enumerate(maps):
            if m is not None:
                out[f"at{i}"] = np.array([m.x, m.y])
                for name in ("depth", "normal", "cost", "contrast"):
                    out[f"{name}{i}"] = getattr(m, name)
        return out

    a = stages.arrays("depth", key, make)
    return [
        DepthMap(
            int(a[f"at{i}"][0]), int(a[f"at{i}"][1]), a[f"depth{i}"], a[f"normal{i}"],
            a[f"cost{i}"], a[f"contrast{i}"],
        )
        if f"at{i}" in a else None
        for i in range(len(views))
    ]  # fmt: skip


def _at(values: NDArray[np.float32], grid: Grid, points: Array) -> NDArray[np.float32]:
    """Largest value of the voxels around points (N, 3)."""
    from scipy.ndimage import map_coordinates, maximum_filter

    index = ((points - np.asarray(grid.origin)) / grid.step)[:, ::-1].T
    wide = maximum_filter(values, 3)
    return np.asarray(map_coordinates(wide, index, order=1, mode="nearest"), np.float32)
