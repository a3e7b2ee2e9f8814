"""Photos to posed photos: given cameras, or those by the board, one for each size and lens."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.io.documents import digest_file, digest_of
from std_toolkit.io.images import image_size
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.log import logger
from std_toolkit.poses.board_scale import Board, BoardDetection
from std_toolkit.scanning.board import board_photos
from std_toolkit.scanning.board.board_photos import PhotoCameras
from std_toolkit.scanning.board.board_poses import pose_photos
from std_toolkit.scanning.options import LIMITS, ScanOptions
from std_toolkit.scanning.photos import photos as photo_files
from std_toolkit.scanning.photos.posed_photos import PosedPhotos


class BoardFound(NamedTuple):
    """The board in the photos, before their poses are adjusted.

    Attributes:
        photos: all photos.
        kept: indices of those that are used.
        detections: the board in each of these.
        cameras: intrinsics of these to begin with.
    """

    photos: photo_files.Photos
    kept: Sequence[int]
    detections: Sequence[BoardDetection]
    cameras: PhotoCameras


def posed_photos(
    options: ScanOptions, found: photo_files.Photos, work: Path, inputs: str,
    first: Callable[[BoardFound], None] = lambda _: None,
) -> PosedPhotos:  # fmt: skip
    """Photos with poses and intrinsics: of a file, or by the board.

    Args:
        options: `known`, `board`, `intrinsics`, `max_features` and `jobs` are used.
        found: the photos.
        work: folder that keeps the poses.
        inputs: digest of the photos.
        first: called as soon as the board is found, unless the poses are kept.

    Raises:
        ToolkitError: no board, or the photos do not determine poses or intrinsics.
    """
    if options.known.cameras is not None:
        views = photo_files.known_views(found, options.known, options.intrinsics)
        sizes = [list(found.size_of(i)) for i in range(len(found.paths))]
        digest = digest_of(inputs, [v.P.tolist() for v in views], sizes)
        facts = {"poses": f"from {options.known.cameras.name}", "photos": len(views)}
        return PosedPhotos(
            views=views, corners=np.zeros((0, 3)), points=np.zeros((0, 3)), on_table=False,
            facts=facts, warnings=[], digest=digest, photos=found,
        )  # fmt: skip
    if options.board is None:
        raise ToolkitError(
            "the scale is unknown: no board",
            hint="photograph the object on the printed board and give --board FILE, or give known "
            "cameras with --cameras",
        )
    board = Board.read(options.board)
    blurred = photo_files.blurred_photos(found.used)
    warnings = []
    if blurred:
        names = ", ".join(found.paths[i].name for i in blurred[:6])
        warnings.append(f"{len(blurred)} blurred photos were left out: {names}")
        logger.warning("%s", warnings[-1])
    kept = [i for i in range(len(found.paths)) if i not in set(blurred)]
    artefact = Artefact(
        work,
        "poses",
        {"photos": inputs, "board": digest_file(options.board)},
        {"intrinsics": options.intrinsics, "max_features": options.max_features,
         "sizes": found.sizes, "groups": found.groups, "photos": kept, "format": 6},
        LIMITS,
    )  # fmt: skip

    def make() -> dict[str, Any]:
        paths = [found.used[i] for i in kept]
        detections = board_photos.detect_boards(paths, board, options.jobs)
        assert options.board is not None
        board_photos.check_boards(detections, paths, options.board)
        cameras = _intrinsics(options, found, kept, detections)
        first(BoardFound(found, kept, detections, cameras))
        p = pose_photos(
            paths, detections, cameras, work, jobs=options.jobs, max_features=options.max_features
        )
        return {
            **{f"camera {n}": np.array([c.fx, c.fy, c.cx, c.cy, *c.distortion])
               for n, c in enumerate(p.cameras)},
            "index": np.array([kept[i] for i in p.poses]),
            "T": np.stack([T.matrix() for T in p.poses.values()]),
            "corners": p.corners,
            "ids": p.ids,
            "points": p.points,
            "found": np.concatenate(
                [
                    np.column_stack([np.full(len(d.uv), i), d.uv])
                    for i, d in zip(kept, detections, strict=True)
                ]
            ),
            "quality": np.array([p.corner_rms_px, p.feature_rms_px, p.scale_deviation]),
        }  # fmt: skip

    a = artefact.arrays(make)

    def camera(index: int) -> Camera:
        fx, fy, cx, cy, *k = (float(x) for x in a[f"camera {found.group_of(index)}"])
        return Camera(*found.size_of(index), fx, fy, cx, cy, tuple(k))

    views = [
        photo_files.make_view(found, int(i), camera(int(i)), SE3.from_matrix(T))
        for i, T in zip(a["index"], a["T"], strict=True)
    ]
    lost = sorted(set(kept) - {int(i) for i in a["index"]})
    if lost:
        names = ", ".join(found.paths[i].name for i in lost[:6])
        warnings.append(f"{len(lost)} photos match no other and show no board: {names}")
        logger.warning("%s", warnings[-1])
    if len(views) < photo_files.PhotoSettings.current().fewest_photos:
        raise ToolkitError(
            f"{len(views)} of {len(found.paths)} photos have a pose",
            hint="keep most of the board in view and move by small steps",
        )
    corner, feature, deviation = (float(x) for x in a["quality"])
    facts = {
        "photos": len(views),
        "cameras": len(set(found.groups)) or 1,
        "board residual": f"{corner:.2f} px",
        "feature residual": f"{feature:.2f} px",
        "scale deviation": f"{100 * deviation:.3f} %",
    }
    return PosedPhotos(
        views=views, corners=np.asarray(a["corners"]), points=np.asarray(a["points"]),
        on_table=True, facts=facts, warnings=warnings, digest=artefact.digest, photos=found,
        found=_undistorted(a["found"], found, camera), ids=np.asarray(a["ids"]),
    )  # fmt: skip


def _intrinsics(
    options: ScanOptions, found: photo_files.Photos, kept: Sequence[int],
    detections: Sequence[BoardDetection],
) -> PhotoCameras:  # fmt: skip
    """Intrinsics to begin with, of each group of photos of one size and lens.

    Raises:
        ToolkitError: the board file is of another sheet, photos are of another zoom, or the board
            does not determine the intrinsics.
    """
    assert options.board is not None
    groups = tuple(found.group_of(i) for i in kept)
    if options.intrinsics is not None and len(set(groups)) > 1:
        raise ToolkitError(
            "describes one camera, and the photos are of several sizes or lenses",
            field="--intrinsics", value=options.intrinsics,
            hint="leave it out: the board calibrates each of them",
        )  # fmt: skip
    cameras: list[Camera] = []
    for group in range(max(found.groups, default=0) + 1):
        places = [n for n, g in enumerate(groups) if g == group]
        first = kept[places[0]] if places else found.groups.index(group)
        size, part = found.size_of(first), [detections[n] for n in places]
        names = [found.paths[kept[n]].name for n in places]
        board_photos.check_layout(part, size, options.board)
        board_photos.check_zoom(part, size, names)
        if options.intrinsics is not None:
            whole = found.whole_size(first) or image_size(found.paths[first])
            given = read_intrinsics(options.intrinsics, size=whole)
            cameras.append(given.scene_camera(whole, path=options.intrinsics).resized(*size))
        elif found.sensor is not None:
            cameras.append(found.sensor.camera(size))
        else:
            try:
                cameras.append(board_photos.calibrate(part, size))
            except ToolkitError as error:
                if len(set(groups)) == 1:
                    raise
                raise error.revised(
                    problem=f"{error.problem}; these {len(places)} photos are of another size or "
                    f"lens than the others: {', '.join(names[:8])}",
                    hint="take them out, or take at least 8 with each lens and orientation",
                ) from error
    return PhotoCameras(tuple(cameras), groups)


def _undistorted(
    found: Array, photos: photo_files.Photos, camera: Callable[[int], Camera]
) -> dict[str, Array]:
    """Corners of the board (N, 2) by the name of the photo, in pixels of its undistorted image."""
    return {
        photos.paths[i].name: camera(i).without_distortion().project(
            camera(i).unproject(found[found[:, 0] == i, 1:])
        )
        for i in np.unique(found[:, 0]).astype(int).tolist()
    }  # fmt: skip
