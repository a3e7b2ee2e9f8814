"""The scan: photos to poses, masks, depth maps, a closed surface, texture, files and report."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.documents import digest_file, digest_of
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.jobs.door import check_own, has_record, output, own_files
from std_toolkit.log import logger
from std_toolkit.scanning.board.photo_poses import BoardFound, posed_photos
from std_toolkit.scanning.clock import JOINED, REVOLVED, STAGES, Clock
from std_toolkit.scanning.masks.object_masks import Things, both_positions, object_masks
from std_toolkit.scanning.model.bake import bake_texture
from std_toolkit.scanning.model.model_frame import find_symmetry, model_frame, write_symmetry
from std_toolkit.scanning.model.write_model import Scan, file_names, write_model
from std_toolkit.scanning.options import LIMITS, MODEL_FOLDER, ScanOptions
from std_toolkit.scanning.photos import photos as photo_files
from std_toolkit.scanning.photos.posed_photos import PosedPhotos
from std_toolkit.scanning.photos.video import is_video, sample_video
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.preview import PREVIEW, remove_preview, write_preview
from std_toolkit.scanning.surface.depth_maps import DepthEngine, depth_engine
from std_toolkit.scanning.surface.measured_surface import (
    Side,
    Surface,
    fused_surface,
    measure_side,
    side_surface,
)
from std_toolkit.scanning.surface.turned_over import find_turn
from std_toolkit.scanning.vessel.glass_outlines import find_vessel
from std_toolkit.scanning.vessel.inside import StatedInside, with_inside
from std_toolkit.scanning.vessel.revolve import fit_revolution
from std_toolkit.scanning.vessel.revolved_surface import OutlineView, RevolvedSurface
from std_toolkit.settings import NOT_RECORDED, Settings, limit


@dataclass(frozen=True, kw_only=True)
class SupportSettings(Settings):
    """Which faces of a scan are measured."""

    supported: float = limit(0.3, source=NOT_RECORDED)
    """support of a face below which its place is a guess"""


def scan(options: ScanOptions) -> Scan:
    """Make the model of an object from photos and write it to `options.out`, as `std-scan` does.

    A scan that was interrupted resumes. See `examples/09_scan_an_object.py`.

    Args:
        options: photos, board, folder of the model, and everything else.

    Returns:
        The model in metres, in its own frame (z up where it stood on the board). Its files are
        written, too, if it has `faults`, for which `std-scan` ends with status 1.

    Raises:
        ToolkitError: the photos do not suffice, and the message says what to photograph; or the
            options ask for all objects, see `scan_all`.
    """
    if options.all_objects:
        raise ToolkitError("scans many objects", field="--all", hint="call scan_all in Python")
    with output(options.out, MODEL_FOLDER, "std-scan photos"):
        if (options.out / "library.json").exists():
            raise ToolkitError(
                "holds the models of several objects", path=options.out,
                hint="choose another folder, or add --all",
            )  # fmt: skip
        work, known = prepare(options)
        return _scan(options, work, known)


def prepare(options: ScanOptions) -> tuple[Path, Sequence[str]]:
    """Make the folder of stages of a model, and check that no file of the user is replaced.

    Returns:
        The folder, and names of files that are no user's, of an earlier version.

    Raises:
        ToolkitError: a file of the user is in the way.
    """
    work, names = options.out / ".scan", file_names(options.out.resolve().name)
    # A model of an earlier version has no record.
    known = names if work.is_dir() and not has_record(options.out) else []
    check_own(options.out, [*names, PREVIEW], known=known)
    work.mkdir(exist_ok=True)
    return work, known


def _scan(options: ScanOptions, work: Path, known: Sequence[str]) -> Scan:
    threads = options.jobs.worker_count
    if options.flipped is not None:
        clock = Clock(work, JOINED)
        engine = depth_engine(options.depth)
        posed, views, sides = _joined(options, engine, work, threads, clock.lap)
        found = fused_surface(options, sides, posed.facts, threads)
    elif options.revolve:
        clock = Clock(work, REVOLVED)
        posed = pose_step(options, work, clock.lap)
        vessel, views = _vessel(options, posed, work, threads)
        clock.lap("masks")
        found = _revolved(vessel, posed)
    else:
        clock = Clock(work, STAGES)
        # Unknown engines are refused before minutes are spent.
        depth_engine(options.depth)
        posed = pose_step(options, work, clock.lap)
        return scan_object(options, posed, work, known, clock)
    clock.lap("surface")
    return _finished(options, posed, views, found, known, clock)


def scan_object(
    options: ScanOptions, posed: PosedPhotos, work: Path, known: Sequence[str], clock: Clock,
    things: Things | None = None,
) -> Scan:  # fmt: skip
    """Model of one object from photos with poses, and its files.

    Args:
        options: of this object; `out` is its folder.
        posed: the photos; receives its facts and warnings.
        work: folder that keeps its stages.
        known: names of files that are no user's.
        clock: of the stages.
        things: what stands on the board, if that is known.
    """
    threads = options.jobs.worker_count
    views = object_masks(options, posed, work, threads, things)
    clock.lap("masks")
    side = measure_side(
        options, posed, views, depth_engine(options.depth), work, threads, clock.lap
    )
    found = fused_surface(options, [(side, SE3.identity())], posed.facts, threads)
    clock.lap("surface")
    return _finished(options, posed, side.views, found, known, clock)


def _finished(
    options: ScanOptions, posed: PosedPhotos, views: Sequence[View], found: Surface,
    known: Sequence[str], clock: Clock,
) -> Scan:  # fmt: skip
    """The surface with its texture, in the frame of the model, and its files."""
    from std_toolkit.scanning.model.report import write_report

    threads, lap = options.jobs.worker_count, clock.lap
    vertices, faces, support = found.vertices, found.faces, found.support
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
        supported=support > SupportSettings.current().supported,
        views=[replace(v, T_world_cam=T_model_world @ v.T_world_cam) for v in views],
        facts={**posed.facts, **words},
        warnings=posed.warnings,
        seconds=clock.seconds,
    )
    with own_files(options.out, file_names(result.name), known=known):
        write_model(options.out, result.name, result.vertices, faces, texture)
        write_symmetry(options.out, symmetry)
        result = write_report(options.out, result)
    remove_preview(options)
    lap("files")
    return result


def pose_step(options: ScanOptions, work: Path, lap: Callable[[str], None]) -> PosedPhotos:
    """Photos of one position with poses."""
    found = _photos(options, work)
    if options.known.cameras is not None and options.preview:
        logger.info("preview: none: --cameras gives no board")
    return _posed(options, found, work, lap, partial(write_preview, options))


def _photos(options: ScanOptions, work: Path) -> photo_files.Photos:
    """Photos of one position: of a folder, a video or a scene."""
    if photo_files.is_scene(options.photos):
        return photo_files.scene_photos(options.photos, work, longest=options.image_size)
    folder = sample_video(options.photos, work) if is_video(options.photos) else options.photos
    # Given intrinsics and poses belong to the pixels as they are stored.
    stored = options.intrinsics is not None or options.known.cameras is not None
    return photo_files.find_photos(folder, work, longest=options.image_size, stored=stored)


def _posed(
    options: ScanOptions, found: photo_files.Photos, work: Path,
    lap: Callable[[str], None], first: Callable[[BoardFound], None],
) -> PosedPhotos:  # fmt: skip
    """Photos of one position with poses; `first` as of `posed_photos`."""
    files = [*found.paths, *([] if found.sensor is None else found.sensor.paths())]
    inputs = digest_of([digest_file(p) for p in files], [p.name for p in files])
    posed = posed_photos(options, found, work, inputs, first)
    lap("poses")
    return posed


def _no_preview(_: BoardFound) -> None:
    """The board of the second position."""


def _joined(
    options: ScanOptions, engine: DepthEngine, work: Path, threads: int, lap: Callable[[str], None]
) -> tuple[PosedPhotos, list[View], list[tuple[Side, SE3]]]:
    """Photos of both positions, each measured on its own, and the motion between them.

    Returns:
        The first photos with the facts of both, all views in their world with names that tell the
        folder, and both sides with the motions into it.
    """
    parts, names = both_positions(options), ("", "flipped")
    for name in names:
        (work / name).mkdir(exist_ok=True)
    # Photos of both are looked for before any is measured, which takes minutes.
    photos = [_photos(part, work / name) for part, name in zip(parts, names, strict=True)]
    both = []
    for part, found, label, name in zip(parts, photos, options.labels(), names, strict=True):
        folder = work / name

        def told(stage: str, name: str = name) -> None:
            lap(f"{stage} of the flipped" if name else stage)

        # The first position is enough for a look.
        preview = _no_preview if name else partial(write_preview, part)
        posed = _posed(part, found, folder, told, preview)
        views = object_masks(part, posed, folder, threads, folder=label)
        told("masks")
        side = measure_side(part, posed, views, engine, folder, threads, told)
        named = [replace(v, name=f"{label}/{v.name}") for v in side.views]
        both.append((posed, replace(side, views=named)))
    (posed, first), (over, second) = both

    def make() -> dict[str, Any]:
        surfaces = [side_surface(s, options.voxels, threads) for s in (first, second)]
        turn = find_turn(first, surfaces[0], second, surfaces[1])
        return {
            "T": turn.T_first_second.matrix(),
            "ambiguous": np.array(turn.ambiguous),
            "by_shape": np.array(turn.by == "shape"),
            "doubted": np.array(turn.doubted),
            "facts": np.array(list(turn.facts().items())),
        }

    inputs = {"first side": first.digest, "flipped side": second.digest}
    a = Artefact(work, "turn", inputs, {"format": 5}, limits=LIMITS).arrays(make)
    lap("turn")
    posed.facts.update({f"{k} of the flipped": v for k, v in over.facts.items()})
    posed.facts.update({str(k): str(v) for k, v in a["facts"]})
    posed.warnings.extend(f"{options.labels()[1]}: {w}" for w in over.warnings)
    if a["ambiguous"]:
        posed.warnings.append(
            "other turns of the object fit the second photos as well, for its shape or texture "
            "repeats: the underside may be turned, unless turns leave the object the same. Stick a "
            "few small, different marks on its sides and photograph both positions again"
        )
        logger.warning("%s", posed.warnings[-1])
    elif a["by_shape"]:
        posed.warnings.append(
            "too little texture is in both folders, so the turn is from shapes alone and inexact: "
            "stick a few small, different marks on the sides and photograph both positions again"
        )
        logger.warning("%s", posed.warnings[-1])
    if a["doubted"]:
        posed.warnings.append(
            "some outlines of both folders disagree, so the turn is inexact: look at the masks, "
            "which lack parts of the object or have too much, and correct them with --masks"
        )
        logger.warning("%s", posed.warnings[-1])
    sides = [(first, SE3.identity()), (second, SE3.from_matrix(a["T"]))]
    views = [replace(v, T_world_cam=T @ v.T_world_cam) for side, T in sides for v in side.views]
    return posed, views, sides


def _vessel(
    options: ScanOptions, posed: PosedPhotos, work: Path, threads: int
) -> tuple[RevolvedSurface, list[View]]:
    """The surface of revolution of an unsprayed vessel, and the views with its masks.

    Raises:
        ToolkitError: without a board, the object is no surface of revolution, or what is stated of
            its inside is not in it.
    """
    if posed.on_table and not (options.masks or options.pick or options.box):
        found, views = find_vessel(posed.views, posed.corners, threads=threads)
        return _with_inside(options, found, views), views
    if not posed.on_table:
        raise ToolkitError("needs the board, which tells what is upright", field="--revolve")
    views = object_masks(options, posed, work, threads)
    return _with_inside(options, fit_revolution(_outline_views(views)), views), views


def _with_inside(
    options: ScanOptions, found: RevolvedSurface, views: Sequence[View]
) -> RevolvedSurface:
    stated = StatedInside(
        wall_mm=options.wall_mm, base_mm=options.base_mm, depth_mm=options.inside_depth_mm
    )
    return with_inside(found, _outline_views(views), stated)


def _outline_views(views: Sequence[View]) -> list[OutlineView]:
    return [OutlineView(v.camera, v.T_world_cam, v.shown, v.image) for v in views]


def _revolved(found: RevolvedSurface, posed: PosedPhotos) -> Surface:
    """Surface of revolution; no depth supports it."""
    posed.facts["outline residual"] = f"{found.outline_px:.2f} px"
    posed.facts["outline left out"] = f"{100 * found.outside:.1f} %"
    posed.facts["deviation of the radii"] = f"{1000 * float(np.median(found.deviation_m)):.2f} mm"
    posed.facts.update(found.facts)
    posed.warnings.extend(found.warnings)
    vertices, faces = found.mesh()
    return Surface(vertices=vertices, faces=faces, support=np.zeros(len(faces), np.float32))
