"""The printed board in photos: its corners, the camera's intrinsics, the pose of one photo."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.poses.board_scale import Board, BoardDetection, detect_board
from std_toolkit.settings import NOT_RECORDED, Settings, limit


@dataclass(frozen=True, kw_only=True)
class BoardPhotoSettings(Settings):
    """What the board must show of itself."""

    fewest_corners: int = limit(8, source=NOT_RECORDED)
    """corners that a photo needs for a pose of its own"""
    fewest_photos: int = limit(3, source=NOT_RECORDED)
    """photos with so many corners that a scan needs"""


def detect_boards(paths: Sequence[Path], board: Board, jobs: JobOptions) -> list[BoardDetection]:
    """Corners of the board in every photo, in the order of the photos.

    Raises:
        ToolkitError: a photo cannot be read.
    """
    report = run_jobs(
        partial(detect_board, board=board), [str(p) for p in paths], name="board", options=jobs
    )
    report.raise_if_failed()
    return [report.results[str(p)] for p in paths]


def check_boards(found: Sequence[BoardDetection], paths: Sequence[Path], board: Path) -> None:
    """Raise an error unless enough photos show enough of the board.

    Raises:
        ToolkitError: the board is in fewer than three photos.
    """
    limits = BoardPhotoSettings.current()
    seen = sum(len(f.ids) >= limits.fewest_corners for f in found)
    if seen < limits.fewest_photos:
        raise ToolkitError(
            f"the board was found in {seen} of {len(paths)} photos",
            path=board,
            hint="photograph the object on the printed board with most of the board in view, "
            "sharp and evenly lit; check that this file describes the board that you printed",
        )


def calibrate(found: Sequence[BoardDetection], size: tuple[int, int]) -> Camera:
    """Intrinsics of the camera from the board alone.

    Args:
        found: corners of each photo.
        size: (width, height) of the photos.

    Raises:
        ToolkitError: the photos do not determine the intrinsics.
    """
    limits = BoardPhotoSettings.current()
    usable = [f for f in found if len(f.ids) >= 2 * limits.fewest_corners]
    if len(usable) < limits.fewest_photos:
        raise ToolkitError(
            f"only {len(usable)} photos show enough of the board to calibrate the camera",
            hint="give --intrinsics, or photograph more of the board",
        )
    usable = usable[:: max(1, len(usable) // 30)]
    flat = [np.asarray(f.xyz, np.float32).reshape(-1, 1, 3) for f in usable]
    pixels = [np.asarray(f.uv, np.float32).reshape(-1, 1, 2) for f in usable]
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_ASPECT_RATIO
    start = np.array([[1.2 * max(size), 0, size[0] / 2], [0, 1.2 * max(size), size[1] / 2],
                      [0, 0, 1.0]])  # fmt: skip
    _, K, found_k, _, _ = cv2.calibrateCamera(
        flat, pixels, size, start, np.zeros(5), flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS
    )
    k = [float(x) for x in np.asarray(found_k).ravel()[:4]]
    try:
        return Camera(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(k))
    except ToolkitError as error:
        raise ToolkitError(
            f"the board does not determine the intrinsics: {error.problem}",
            field=error.field,
            value=error.value,
            hint="give --intrinsics, or photograph the board from more directions",
        ) from error


def board_pose(found: BoardDetection, camera: Camera) -> tuple[SE3, float] | None:
    """T_cam_board and the median error in pixels of one photo; None without enough corners."""
    limits = BoardPhotoSettings.current()
    if len(found.ids) < limits.fewest_corners:
        return None
    xy = camera.unproject(found.uv)[:, :2]
    good = np.isfinite(xy).all(axis=1)
    if good.sum() < limits.fewest_corners:
        return None
    xyz, xy = np.ascontiguousarray(found.xyz[good]), np.ascontiguousarray(xy[good])
    done, rvec, tvec = cv2.solvePnP(xyz, xy, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    if not done:
        return None
    rvec, tvec = cv2.solvePnPRefineLM(xyz, xy, np.eye(3), None, rvec, tvec)
    T = SE3(np.asarray(cv2.Rodrigues(rvec)[0], float), np.asarray(tvec, float).ravel())
    error = np.linalg.norm(camera.project(T @ found.xyz) - found.uv, axis=1)
    return T, float(np.nanmedian(error))
