"""The ways to relate two scenes: a printed board, matched features, points that a person gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.foreign_files import csv_rows, read_json
from std_toolkit.io.regular import read_text
from std_toolkit.jobs import JobOptions
from std_toolkit.labels.carry.options import CarryOptions
from std_toolkit.labels.carry.shared_features import (
    Progress,
    depth_at,
    shared_features,
    spread_frames,
)
from std_toolkit.labels.carry.world_relation import (
    RelationSettings,
    SharedPoints,
    WorldRelation,
    make_relation,
    relate_worlds,
    with_scale,
)
from std_toolkit.poses.board_scale import Board, BoardSettings, board_views
from std_toolkit.poses.known_points import KnownView, fit_body, triangulate_points
from std_toolkit.scene import Scene

Array = NDArray[np.float64]

_BOARD = "board.json"
# Frames in which the board is looked for.
_FRAMES = 10


def find_relation(
    a: Scene,
    b: Scene,
    options: CarryOptions,
    *,
    progress: Progress = lambda _: None,
    check: Callable[[], None] = lambda: None,
) -> WorldRelation:
    """How the worlds of two scenes with metric camera poses lie to each other.

    Args:
        a: the scene that points and poses come from.
        b: the other one.
        options: the way.
        progress: called with the completed fraction, 0 to 1.
        check: called often; raises an error to stop.

    Raises:
        ToolkitError: they cannot be related in this way; see `relate_worlds`.
    """
    if options.points is not None:
        return relate_worlds(read_points(options.points, a, b))
    passed_over: tuple[str, ...] = ()
    if options.by in ("auto", "board"):
        board = _board(a, b, options)
        if board is not None:
            try:
                return _by_board(a, b, board)
            except ToolkitError as error:
                if options.by == "board" or options.board is not None:
                    raise
                passed_over = (f"not by the board: {error.problem}",)
        elif options.by == "board":
            raise ToolkitError(
                "no board is described",
                path=b.root,
                hint=f"give --board FILE, or put {_BOARD} into one of the scenes",
            )
    found = relate_worlds(shared_features(a, b, progress=progress, check=check))
    return WorldRelation(**{**vars(found), "notes": (*passed_over, *found.notes)})


def _board(a: Scene, b: Scene, options: CarryOptions) -> Board | None:
    """The board that both scenes may show; None if none is described."""
    if options.board is not None:
        return Board.read(options.board)
    files = [s.root / _BOARD for s in (a, b) if (s.root / _BOARD).is_file()]
    boards = [Board.read(path) for path in files]
    if len(boards) == 2 and boards[0] != boards[1]:
        if options.by == "auto":
            return None
        raise ToolkitError(f"{_BOARD} of the two scenes describe different boards", path=files[1])
    return boards[0] if boards else None


def _by_board(a: Scene, b: Scene, board: Board) -> WorldRelation:
    """Find the board in the images of both scenes by the ids of its tags.

    The pose step keeps no pose of the board, and its world is that of the first camera.
    """
    fewest = BoardSettings.current().fewest_frames
    views: list[list[KnownView]] = []
    for scene in (a, b):
        cameras = {
            f.id: (T.inverse(), scene.camera(f))
            for f in spread_frames(scene.registered_frames(), _FRAMES)
            if (T := scene.T_world_cam(f.id)) is not None
        }
        found = board_views(scene, cameras, board, JobOptions(engine="serial", progress=False))
        if len(found) < fewest:
            problem = f"the board is detected in {len(found)} registered frames, {fewest} needed"
            raise ToolkitError(problem, path=scene.root)
        views.append(found)
    extent = float(np.ptp(np.concatenate([v.xyz for v in views[0]]), axis=0).max())
    fits = [fit_body(v, threshold_m=0.02 * extent) for v in views]
    # In the units of each world, in which the labels are.
    placed = [SE3(f.T_world_body.R, f.T_world_body.t / f.scale) for f in fits]
    T_b_a = placed[1] @ placed[0].inverse()
    (ids_a, points_a, _), (ids_b, points_b, _) = (triangulate_points(v) for v in views)
    _, at_a, at_b = np.intersect1d(ids_a, ids_b, return_indices=True)
    if len(at_a) < BoardSettings.current().fewest_corners:
        raise ToolkitError(f"the two scenes show {len(at_a)} common corners of the board")
    points = SharedPoints(
        by="board",
        a=points_a[at_a],
        b=points_b[at_b],
        eye_a=_mean_eye([v.T_cam_world for v in views[0]]),
        eye_b=_mean_eye([v.T_cam_world for v in views[1]]),
    )
    distance = np.linalg.norm(T_b_a @ points.a - points.b, axis=1)
    # The corner of a tag that is seen at a grazing angle may be anywhere.
    inliers = distance < RelationSettings.current().corner_mm / 1000
    if 2 * inliers.sum() <= len(inliers):
        raise ToolkitError(
            "the board has another shape in the two scenes",
            value=f"its corners differ by {1000 * float(np.median(distance)):.0f} mm",
            hint="was it bent, or are the camera poses of one scene wrong?",
        )
    relation = make_relation(points, T_b_a, inliers, ())
    return with_scale(relation, fits[0].scale / fits[1].scale, "the board")


def _mean_eye(T_cam_world: list[SE3]) -> Array:
    return np.mean([T.inverse().t for T in T_cam_world], axis=0)


# --- points that a person gives -------------------------------------------------------------------


def read_points(path: Path, a: Scene, b: Scene) -> SharedPoints:
    """Points of two scenes from a file; see `CarryOptions.points`.

    Raises:
        ToolkitError: unreadable, a key is missing, no number, no such frame, a pixel outside the
            image or without depth.
    """
    sides: list[list[tuple[Array, Array]]] = [[], []]
    for field, row in _rows(path):
        for side, scene, name in zip(sides, (a, b), ("from", "to"), strict=True):
            try:
                side.append(_place(scene, row, name))
            except ToolkitError as error:
                within = f"{field}.{error.field}" if error.field else field
                raise error.revised(path=path, field=within) from error
    if len(sides[0]) < 3:
        raise ToolkitError(f"{len(sides[0])} points, three or more are needed", path=path)
    places = [np.array([place for place, _ in side]) for side in sides]
    eyes = [np.mean([eye for _, eye in side], axis=0) for side in sides]
    return SharedPoints(by="points", a=places[0], b=places[1], eye_a=eyes[0], eye_b=eyes[1])


def _rows(path: Path) -> list[tuple[str, Mapping[str, Any]]]:
    if path.suffix.lower() == ".json":
        rows = read_json(path)
        if not isinstance(rows, list) or not all(isinstance(r, dict) for r in rows):
            raise ToolkitError("must be a list of objects", path=path)
        return [(f"[{i}]", row) for i, row in enumerate(rows)]
    lines = [line for line in read_text(path, "CSV file").splitlines() if line.strip()]
    table = list(csv_rows(lines, path))
    if not table:
        raise ToolkitError("the file has no points", path=path)
    header = [name.strip().lower() for name in table[0]]
    return [
        (f"row {n}", {k: v for k, v in zip(header, row, strict=False) if v.strip()})
        for n, row in enumerate(table[1:], start=2)
    ]


def _place(scene: Scene, row: Mapping[str, Any], name: str) -> tuple[Array, Array]:
    """The place of a point in the world, and the position of the camera that sees it."""
    if f"{name}_x" in row:
        place = np.array([_number(row, f"{name}_{axis}") for axis in "xyz"])
        eyes = [T.t for f in scene.frames if (T := scene.T_world_cam(f.id)) is not None]
        return place, np.mean(eyes, axis=0)
    if f"{name}_frame" not in row:
        raise ToolkitError(
            "a key is missing",
            field=f"{name}_frame",
            hint=f"give {name}_frame, {name}_u, {name}_v or {name}_x, {name}_y, {name}_z",
        )
    frame = scene.find_frame(row[f"{name}_frame"])
    pixel = np.array([[_number(row, f"{name}_u"), _number(row, f"{name}_v")]])
    T_world_cam, camera = scene.T_world_cam(frame.id), scene.camera(frame)
    if T_world_cam is None:
        raise ToolkitError("this frame has no camera pose", field=f"{name}_frame", value=frame.name)
    if (pixel < -0.5).any() or (pixel > np.array(camera.size) - 0.5).any():
        raise ToolkitError(
            f"outside the {camera.width}x{camera.height} image",
            field=f"{name}_u",
            value=pixel[0].tolist(),
        )
    depth = scene.read_depth(frame)
    z = np.zeros(1) if depth is None else depth_at(depth, pixel)
    if z[0] <= 0:
        raise ToolkitError(
            "the depth sensor sees no smooth surface here",
            field=f"{name}_u",
            value=pixel[0].tolist(),
            hint=f"choose a point on the table or an opaque object, or give {name}_x, {name}_y, "
            f"{name}_z",
        )
    return (T_world_cam @ camera.unproject(pixel, z))[0], T_world_cam.t


def _number(row: Mapping[str, Any], key: str) -> float:
    try:
        number = float(row[key])
    except KeyError as error:
        raise ToolkitError("a key is missing", field=key) from error
    except (TypeError, ValueError, OverflowError) as error:
        raise ToolkitError("not a number", field=key, value=row[key]) from error
    if isinstance(row[key], bool) or not isfinite(number):
        raise ToolkitError("not a finite number", field=key, value=row[key])
    return number
