"""Pictures of a few frames of a run with boxes and axes: true ones green, estimated ones red.

All runs on the same frames show the same pictures, so that depths can be compared side by side.
"""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.data.splits import DepthSource
from benchmark.evaluation.batches import chosen_frames
from benchmark.evaluation.results import INDEX, read_table
from benchmark.evaluation.tasks.pose_table import POSES, READ, PoseFrames, frames_of
from benchmark.metrics.pose import PoseTruth, get_pose_protocol, match_poses
from benchmark.metrics.pose.box_iou import box_corners
from std_toolkit.geometry.camera import Camera
from std_toolkit.io.documents import write_document
from std_toolkit.io.images import write_color

Image = NDArray[np.uint8]

Floats = NDArray[np.float64]

RGB = tuple[int, int, int]

TRUE_COLOR: RGB = (20, 205, 75)

ESTIMATE_COLOR: RGB = (235, 45, 40)

# Fractional bits of line coordinates.
_SHIFT = 4

_NEAREST_M = 0.05

# Corners of a box that differ in one sign: its edges.
_EDGES = tuple((a, b) for a, b in combinations(range(8), 2) if bin(a ^ b).count("1") == 1)

POSE_GALLERY = "gallery"

PICTURES_FILE = "pictures.json"

SHOWN = 6

WIDTH = 560

# Margin of the window around the objects, and its smallest size, as fractions of the image.
_MARGIN, _LEAST_SHARE = 0.06, 0.3

_PALER = 0.25


def draw_boxes(
    image: Image, camera: Camera, RT: Floats, sizes: Floats, color: RGB, *, width: int = 2
) -> None:
    """Draw boxes and, from the centre of each, its three half axes.

    Args:
        image: (h, w, 3) uint8 RGB of the camera's size; modified in place.
        camera: camera of the image.
        RT: (N, 4, 4) object to camera, including the scale.
        sizes: (N, 3) sizes of the boxes before RT.
        color: colour of the lines.
        width: width of the lines, pixels. The up axis is twice as wide.
    """
    for T, size in zip(RT, sizes, strict=True):
        corners = box_corners(T, size).T
        lines: list[tuple[Floats, Floats, int]] = [
            (corners[a], corners[b], width) for a, b in _EDGES
        ]
        centre = T[:3, 3]
        for axis, wide in ((0, width), (2, width), (1, 2 * width)):
            lines.append((centre, centre + T[:3, axis] * size[axis] / 2, wide))
        _draw(image, camera, lines, color)


def _draw(
    image: Image, camera: Camera, lines: Sequence[tuple[Floats, Floats, int]], color: RGB
) -> None:
    pieces = [(*ends, wide) for a, b, wide in lines if (ends := _in_front(a, b)) is not None]
    drawn = [
        (*(np.rint(camera.project(p) * 2**_SHIFT).astype(int).tolist() for p in (a, b)), wide)
        for a, b, wide in pieces
    ]
    for a, b, wide in drawn:
        if max(abs(x) for x in (*a, *b)) < 2**20:
            cv2.line(image, a, b, color, wide, cv2.LINE_AA, _SHIFT)


def _in_front(a: Floats, b: Floats) -> tuple[Floats, Floats] | None:
    """The part of a line in front of the camera; None if the line is behind it."""
    near = _NEAREST_M
    if a[2] < near and b[2] < near:
        return None
    if a[2] < near:
        a = a + (b - a) * (near - a[2]) / (b[2] - a[2])
    elif b[2] < near:
        b = b + (a - b) * (near - b[2]) / (a[2] - b[2])
    return a, b


class PosePicture(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One frame.

    Attributes:
        scene, frame: names of scene and frame.
        picture: file name.
        objects, found: number of true objects and of predictions.
        right: number of predictions within 10 degrees and 5 cm of a true object of their class.
    """

    scene: str
    frame: str
    picture: str
    objects: int
    found: int
    right: int


class PosePictures(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All pictures of a run."""

    pictures: list[PosePicture]


def make_pose_pictures(
    folder: Path, source: DepthSource, wanted: Sequence[int] = ()
) -> PosePictures:
    """Draw frames of the finished run in a folder.

    Args:
        folder: of the run.
        source: its data.
        wanted: indices of the frames; empty for a few, evenly spaced.

    Raises:
        ToolkitError: a frame cannot be read, or a picture cannot be written.
    """
    table = read_table(folder / POSES)
    readable = sorted(set(table.loc[table[READ], INDEX].tolist()))
    shown = [i for i in wanted if i in readable]
    if not wanted:
        shown = [readable[i] for i in chosen_frames(len(readable), SHOWN)]
    frames = frames_of(table[table[INDEX].isin(shown)])
    pictures = []
    for place, index in enumerate(frames.indices.tolist()):
        frame = source.load(index)
        name = f"{index:07d}.jpg"
        picture = picture_of(frame.color, frame.camera, frames, place)
        write_color(folder / POSE_GALLERY / name, picture, quality=88)
        pictures.append(
            PosePicture(
                scene=frame.scene,
                frame=frame.name,
                picture=name,
                objects=int((frames.truths[place].class_ids > 0).sum()),
                found=len(frames.found[place].class_ids),
                right=_right(frames, place),
            )
        )
    found = PosePictures(pictures=pictures)
    # Last: marks the pictures complete.
    write_document(folder / POSE_GALLERY / PICTURES_FILE, found)
    return found


def picture_of(
    color: NDArray[np.uint8], camera: Camera, frames: PoseFrames, place: int
) -> NDArray[np.uint8]:
    """Return the objects of a frame, slightly paler, with their boxes: (h, `WIDTH`, 3).

    Where both boxes coincide, the green line has a red core.
    """
    truth, found = frames.truths[place], frames.found[place]
    whole = camera.resized(color.shape[1], color.shape[0])
    x, y, w, h = _window(whole, truth)
    size = (WIDTH, round(WIDTH * h / w))
    way = cv2.INTER_AREA if w > WIDTH else cv2.INTER_CUBIC
    resized = cv2.resize(color[y : y + h, x : x + w], size, interpolation=way)
    pale = 255 - (1 - _PALER) * (255 - resized.astype(np.float32))
    image = np.ascontiguousarray(pale.astype(np.uint8))
    drawn = whole.cropped(x, y, w, h).resized(*size)
    draw_boxes(image, drawn, truth.RT, truth.sizes, TRUE_COLOR, width=4)
    draw_boxes(image, drawn, found.RT, found.sizes, ESTIMATE_COLOR, width=2)
    return image


def _window(camera: Camera, truth: PoseTruth) -> tuple[int, int, int, int]:
    """x, y, width, height of the part of the image with the true boxes, in the aspect ratio of the
    image, so that all pictures have the same shape."""
    if not len(truth.class_ids):
        return 0, 0, camera.width, camera.height
    pixels = camera.project(box_corners(truth.RT, truth.sizes).transpose(0, 2, 1).reshape(-1, 3))
    size = np.array(camera.size)
    low, high = np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)
    low, high = (np.clip(end, 0, size - 1) for end in (low, high))
    share = np.clip(((high - low) / size).max() * (1 + 2 * _MARGIN), _LEAST_SHARE, 1)
    wanted = np.maximum(1, np.rint(share * size)).astype(int)
    corner = np.clip(np.rint((low + high - wanted) / 2), 0, size - wanted).astype(int)
    return int(corner[0]), int(corner[1]), int(wanted[0]), int(wanted[1])


def _right(frames: PoseFrames, place: int) -> int:
    protocol = get_pose_protocol("strict")
    matches = match_poses([frames.truths[place]], [frames.found[place]], protocol)
    return int(matches.hits[:, protocol.columns.index("10deg5cm")].sum())
