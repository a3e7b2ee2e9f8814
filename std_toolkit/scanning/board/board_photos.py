"""The printed board in photos: its corners, the camera's intrinsics, the pose of one photo."""

from __future__ import annotations

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
    off_layout: float = limit(
        0.015, source="a lens bends straight lines by less; another sheet puts tags 5 % away"
    )
    """distance, in parts of the longer side of a photo, within which a corner fits the layout"""
    fits_layout: float = limit(
        0.8, source="0.99 with the right file, 0.53 with another one, within 0.02 (real photos)"
    )
    """median share of the corners of a photo that fit the layout of the board file"""
    other_zoom: float = limit(
        0.07,
        source="photos of one lens scatter by 0.02 (rendered and real); phones refocus by 0.03",
    )
    """logarithm of the focal length of a photo against the others from which its zoom differs"""
    zoom_deviations: float = limit(6.0, source="focal lengths of single photos have tails")
    """and this multiple of its standard deviation"""
    zoom_worse: float = limit(
        3.0, source="photos of one lens: up to 1.3 (real); zoomed 1.25 times: 16"
    )
    """times by which the focal length of the others explains it worse than its own"""


@dataclass(frozen=True)
class PhotoCameras:
    """Intrinsics of photos.

    Attributes:
        cameras: of each group of photos.
        groups: number of the group of each photo.
    """

    cameras: tuple[Camera, ...]
    groups: tuple[int, ...]

    @staticmethod
    def one(camera: Camera, count: int) -> PhotoCameras:
        """One camera of so many photos."""
        return PhotoCameras((camera,), (0,) * count)

    def of(self, index: int) -> Camera:
        """Intrinsics of a photo."""
        return self.cameras[self.groups[index]]


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


def check_layout(found: Sequence[BoardDetection], size: tuple[int, int], board: Path) -> None:
    """Raise an error if the tags lie otherwise than the board file says.

    Args:
        found: corners of each photo.
        size: (width, height) of the photos.
        board: the file.

    Raises:
        ToolkitError: another sheet with the same tags.
    """
    limits = BoardPhotoSettings.current()
    shares = []
    for f in found:
        # Of two tags, a homography may explain any layout nearly.
        if len(f.ids) < 2 * limits.fewest_corners or np.ptp(f.xyz[:, 2]) > 1e-3:
            continue
        near = limits.off_layout * max(size)
        _, fits = cv2.findHomography(f.xyz[:, :2], f.uv, cv2.RANSAC, near)
        shares.append(0.0 if fits is None else float(np.mean(fits)))
    if len(shares) >= limits.fewest_photos and np.median(shares) < limits.fits_layout:
        raise ToolkitError(
            f"the tags lie otherwise than this file says: its layout explains "
            f"{100 * float(np.median(shares)):.0f} % of the corners of a photo",
            path=board,
            hint="give the file that was made with the sheet in the photos; its name is at the "
            "foot of the sheet",
        )


def check_zoom(
    found: Sequence[BoardDetection], size: tuple[int, int], names: Sequence[str]
) -> None:
    """Raise an error that names the photos whose zoom differs from that of most.

    Each photo of the board, seen aslant, has a focal length of its own; distortion changes those of
    all photos alike.

    Args:
        found: corners of each photo.
        size: (width, height) of the photos.
        names: their file names.

    Raises:
        ToolkitError: photos of another zoom or lens.
    """
    limits = BoardPhotoSettings.current()
    index, focal, deviation, errors = [], [], [], []
    for i, f in enumerate(found):
        if len(f.ids) >= 2 * limits.fewest_corners and np.ptp(f.xyz[:, 2]) < 1e-3:
            value, spread, error = _focal(f, size)
            if value > 0 and spread < limits.other_zoom / 2:
                index.append(i)
                focal.append(np.log(value))
                deviation.append(spread)
                errors.append(error)
    if len(index) < limits.fewest_photos:
        return
    usual = float(np.median(focal))
    off = np.abs(np.array(focal) - usual)
    most = np.maximum(limits.other_zoom, limits.zoom_deviations * np.array(deviation))
    other = [
        (index[n], float(np.exp(focal[n] - usual)))
        for n in np.flatnonzero(off > most)
        if _focal(found[index[n]], size, float(np.exp(usual)))[2] > limits.zoom_worse * errors[n]
    ]
    if other:
        factor = float(np.median([f for _, f in other]))
        raise ToolkitError(
            f"{len(other)} of {len(found)} photos have another zoom or lens, {factor:.2f} times "
            "that of the others: "
            + ", ".join(names[i] for i, _ in other[:8])
            + (", ..." if len(other) > 8 else ""),
            hint="take them out, or photograph all with one lens, without zoom and cropping",
        )


def _focal(
    found: BoardDetection, size: tuple[int, int], given: float | None = None
) -> tuple[float, float, float]:
    """Focal length in pixels of one photo, 0 for none, or a given one.

    Returns:
        The focal length, its relative standard deviation, and the error in pixels (RMS) with it.
    """
    first = 1.2 * max(size) if given is None else given
    start = np.array([[first, 0, (size[0] - 1) / 2], [0, first, (size[1] - 1) / 2], [0, 0, 1.0]])
    flags = (
        cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO
        | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
        | (0 if given is None else cv2.CALIB_FIX_FOCAL_LENGTH)
    )  # fmt: skip
    try:
        error, K, _, _, _, spread, _, _ = cv2.calibrateCameraExtended(
            [np.asarray(found.xyz, np.float32).reshape(-1, 1, 3)],
            [np.asarray(found.uv, np.float32).reshape(-1, 1, 2)],
            size, start, np.zeros(5), flags=flags,
        )  # fmt: skip
    except cv2.error:
        return 0.0, np.inf, np.inf
    return float(K[0, 0]), float(np.asarray(spread).ravel()[1] / K[0, 0]), float(error)


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
