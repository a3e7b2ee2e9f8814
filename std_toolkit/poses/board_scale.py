"""Metric scale from a printed AprilTag grid or ChArUco board, detected with OpenCV."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.foreign_files import read_json
from std_toolkit.io.images import read_color
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.poses.known_points import KnownView, scale_from_known_points
from std_toolkit.poses.scale_sources import ScaleContext
from std_toolkit.poses.tag_edges import edge_corners
from std_toolkit.scene import Scene
from std_toolkit.scene.model import ScaleEstimate
from std_toolkit.settings import NOT_RECORDED, Settings, limit

MAX_FRAMES = 60


@dataclass(frozen=True, kw_only=True)
class BoardSettings(Settings):
    """Frames and corners from which a board gives the scale."""

    fewest_corners: int = limit(8, source=NOT_RECORDED)
    """a frame counts with at least this many corners of the board"""
    fewest_frames: int = limit(3, source=NOT_RECORDED)
    """a board gives a scale with at least this many frames"""
    most_squares: int = limit(100, source="no printed board has more; memory grows by their square")
    """squares of a ChArUco board along a side"""
    most_tags: int = limit(10_000, source="no printed board has more")
    """tags of a grid"""
    smallest_tag_mm: float = limit(1.0, unit="mm", source="no camera resolves a smaller one")
    """shortest side of a tag; below, or with corners at one place, the file is in another unit"""
    largest_tag_mm: float = limit(5000.0, unit="mm", source="no printed tag is larger")
    """longest side of a tag"""


@dataclass(frozen=True, eq=False)
class BoardDetection:
    """Corners of the board in one image.

    Attributes:
        ids: (N,) corner ids, unique over the board.
        xyz: (N, 3) corners in the board's frame, metres.
        uv: (N, 2) sub-pixel positions, pixel centres at integers.
    """

    ids: NDArray[np.int64]
    xyz: NDArray[np.float64]
    uv: NDArray[np.float64]


@dataclass(frozen=True)
class Board:
    """Geometry of a board, read from its file.

    Attributes:
        dictionary: name of OpenCV's marker dictionary.
        tags: for a tag grid, pairs of a tag id and its four corners in metres, in OpenCV's order:
            top left, top right, bottom right, bottom left.
        charuco: for a ChArUco board, number of squares in x and y, edge of a square and of a
            marker in metres.
    """

    dictionary: str
    tags: tuple[tuple[int, tuple[tuple[float, float, float], ...]], ...] = ()
    charuco: tuple[int, int, float, float] | None = None

    @staticmethod
    def read(path: Path) -> Board:
        """Read a board file.

        The file holds either `{"0": [[x, y, z], ...4 corners in mm], ...}` for a grid of tags
        (AprilTag 36h11 unless `"dictionary"` names another; other keys are ignored), or
        `{"charuco": {"squares_x", "squares_y", "square_mm", "marker_mm", "dictionary"}}`.

        Raises:
            ToolkitError: the file does not exist, is not JSON, or does not describe a board.
        """
        if not path.is_file():
            raise ToolkitError("board file not found", path=path)
        data = read_json(path)
        if not isinstance(data, dict):
            raise ToolkitError("a board file must hold one JSON object", path=path)
        if "charuco" in data:
            return _read_charuco(data["charuco"], path)
        dictionary = str(data.get("dictionary", "DICT_APRILTAG_36h11"))
        known = len(_dictionary(dictionary, path).bytesList)
        tags = []
        ids = sorted((k for k in data if k.isascii() and k.isdecimal()), key=int)
        most = BoardSettings.current().most_tags
        if len(ids) > most:
            raise ToolkitError(f"a board has at most {most} tags", path=path, value=len(ids))
        for key in ids:
            corners = _corners(data[key], path, key)
            if int(key) >= known:
                raise ToolkitError(
                    f"{dictionary} has no tag of this id: its ids end at {known - 1}",
                    path=path, field=key, hint="give the dictionary that was printed",
                )  # fmt: skip
            tags.append((int(key), tuple((x, y, z) for x, y, z in corners.tolist())))
        if not tags:
            others = [key for key in data if key not in ("dictionary", "paper_mm")]
            raise ToolkitError(
                "the board has no tags", path=path, value=", ".join(others[:5]) or None,
                hint='expected {"<tag id>": 4 corners in mm}',
            )  # fmt: skip
        return Board(dictionary=dictionary, tags=tuple(tags))


class BoardScale:
    """Scale from the printed size of a board, fitted to its corners in all frames at once."""

    name = "board"

    def available(self, context: ScaleContext) -> bool:
        return context.board is not None

    def estimate(self, context: ScaleContext) -> ScaleEstimate:
        limits = BoardSettings.current()
        if context.board is None:
            raise ToolkitError(
                "no board is described",
                hint="give --board FILE or put board.json into the scene folder",
            )
        views = board_views(
            context.scene,
            {f.id: (context.poses[f.id], context.camera(f)) for f in context.frames()},
            Board.read(context.board),
            context.jobs,
        )
        if len(views) < limits.fewest_frames:
            raise ToolkitError(
                f"the board was detected in {len(views)} registered frames, "
                f"{limits.fewest_frames} are needed",
                path=context.board,
                hint="check that the file describes this board and names its marker dictionary",
            )
        extent = float(np.ptp(np.concatenate([v.xyz for v in views]), axis=0).max())
        corners = sum(len(v.ids) for v in views)
        return scale_from_known_points(
            views,
            source=self.name,
            note=f"{corners} corners in {len(views)} frames",
            threshold_m=0.02 * extent,
        )


def board_views(
    scene: Scene,
    cameras: Mapping[int, tuple[SE3, Camera]],
    board: Board,
    jobs: JobOptions | None = None,
) -> list[KnownView]:
    """The corners of a board in up to `MAX_FRAMES` frames of a scene.

    Args:
        scene: the images.
        cameras: T_cam_world and intrinsics of the registered frames by frame id.
        board: what is looked for.
        jobs: where the work runs.

    Returns:
        A view for each frame with enough corners.

    Raises:
        ToolkitError: an image cannot be read.
    """
    frames = [scene.frame(i) for i in cameras]
    chosen = frames[:: max(1, -(-len(frames) // MAX_FRAMES))]
    paths = [str(scene.color_path(f)) for f in chosen]
    report = run_jobs(partial(detect_board, board=board), paths, name="board", options=jobs)
    report.raise_if_failed()
    views = []
    for frame, path in zip(chosen, paths, strict=True):
        found, (T_cam_world, camera) = report.results[path], cameras[frame.id]
        if len(found.ids) >= BoardSettings.current().fewest_corners:
            views.append(
                KnownView(
                    T_cam_world=T_cam_world,
                    camera=camera,
                    ids=found.ids,
                    xyz=found.xyz,
                    uv=found.uv,
                )
            )
    return views


def detect_board(path: Path | str, *, board: Board) -> BoardDetection:
    """Find the corners of a board in an image file, at sub-pixel positions."""
    grey = np.asarray(cv2.cvtColor(read_color(path), cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    if board.charuco is not None:
        return _detect_charuco(grey, board)
    known = dict(board.tags)
    corners, ids, _ = _tag_detector(board.dictionary).detectMarkers(grey)
    found = sorted(
        (int(i), c.reshape(4, 2))
        for i, c in zip(_flat(ids), corners, strict=True)
        if int(i) in known
    )
    if not found:
        return _nothing()
    return BoardDetection(
        ids=np.concatenate([np.arange(4) + 4 * i for i, _ in found]),
        xyz=np.concatenate([np.array(known[i]) for i, _ in found]),
        uv=edge_corners(grey, np.stack([c for _, c in found])).reshape(-1, 2),
    )


def _detect_charuco(grey: NDArray[np.uint8], board: Board) -> BoardDetection:
    assert board.charuco is not None
    nx, ny, square, marker = board.charuco
    drawn = cv2.aruco.CharucoBoard((nx, ny), square, marker, _dictionary(board.dictionary, None))
    corners, ids, _, _ = cv2.aruco.CharucoDetector(drawn).detectBoard(grey)
    if ids is None or len(ids) == 0:
        return _nothing()
    flat = _flat(ids)
    return BoardDetection(
        ids=flat,
        xyz=np.asarray(drawn.getChessboardCorners(), dtype=np.float64)[flat],
        uv=np.asarray(corners, dtype=np.float64).reshape(-1, 2),
    )


def _nothing() -> BoardDetection:
    return BoardDetection(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 2)))


def _flat(ids: NDArray[Any] | None) -> NDArray[np.int64]:
    return np.zeros(0, dtype=np.int64) if ids is None else np.asarray(ids, np.int64).ravel()


@lru_cache(maxsize=4)
def _tag_detector(dictionary: str) -> Any:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.ArucoDetector(_dictionary(dictionary, None), parameters)


def _dictionary(name: str, path: Path | None) -> Any:
    number = getattr(cv2.aruco, name, None)
    if not name.startswith("DICT_") or not isinstance(number, int):
        raise ToolkitError(
            "unknown OpenCV marker dictionary",
            path=path,
            field="dictionary",
            value=name,
            hint="such as DICT_APRILTAG_36h11 or DICT_5X5_100",
        )
    return cv2.aruco.getPredefinedDictionary(number)


def _corners(value: object, path: Path, key: str) -> NDArray[np.float64]:
    """Four corners in metres, from a value in millimetres."""
    try:
        corners = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        corners = np.zeros(0)
    if corners.shape != (4, 3) or not np.isfinite(corners).all():
        raise ToolkitError("a tag needs 4 corners of 3 numbers, in mm", path=path, field=key)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    limits = BoardSettings.current()
    if not limits.smallest_tag_mm <= sides.min() <= sides.max() <= limits.largest_tag_mm:
        raise ToolkitError(
            f"a tag has sides of {limits.smallest_tag_mm:g} to {limits.largest_tag_mm:g} mm",
            path=path, field=key, value=sides.tolist(), hint="corners are in mm, in their order",
        )  # fmt: skip
    return corners / 1000


def _read_charuco(value: object, path: Path) -> Board:
    if not isinstance(value, dict):
        raise ToolkitError("must be an object", path=path, field="charuco")
    numbers: list[float] = []
    for name in ("squares_x", "squares_y", "square_mm", "marker_mm"):
        number = value.get(name)
        if isinstance(number, bool) or not isinstance(number, int | float) or not number > 0:
            raise ToolkitError(
                "must be a positive number", path=path, field=f"charuco.{name}", value=number
            )
        numbers.append(float(number))
    nx, ny, square, marker = numbers
    most = BoardSettings.current().most_squares
    if max(nx, ny) > most:
        raise ToolkitError(
            f"has at most {most} x {most} squares",
            path=path,
            field="charuco",
            value=numbers[:2],
        )
    if nx < 2 or ny < 2 or nx != int(nx) or ny != int(ny) or marker >= square:
        raise ToolkitError(
            "needs at least 2x2 whole squares, and markers smaller than squares",
            path=path,
            field="charuco",
            value=numbers,
        )
    dictionary = str(value.get("dictionary", "DICT_5X5_100"))
    _dictionary(dictionary, path)
    return Board(dictionary=dictionary, charuco=(int(nx), int(ny), square / 1000, marker / 1000))
