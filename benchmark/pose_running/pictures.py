"""Pictures of a few frames of a run: true boxes in green, estimated ones in red.

Every run over the same frames shows the same ones, so that depths can be set side by side.
"""

from __future__ import annotations

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.data.splits import open_split
from benchmark.metrics.pose import get_pose_protocol, match_poses
from benchmark.pose_running.boxes_drawn import ESTIMATE_COLOR, TRUE_COLOR, draw_boxes
from benchmark.pose_running.run import PoseRun
from benchmark.pose_running.table import POSES, READ, PoseFrames, frames_of
from benchmark.running.parts import INDEX, read_table
from benchmark.running.pieces import chosen_frames
from std_toolkit.geometry.camera import Camera
from std_toolkit.io.documents import write_document
from std_toolkit.io.images import write_color

POSE_GALLERY = "gallery"
PICTURES_FILE = "pictures.json"
SHOWN = 6
WIDTH = 560


class PosePicture(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One frame.

    Attributes:
        scene, frame: which it is.
        picture: file name.
        objects, found: number of true objects and of predictions.
        right: predictions within 10 degrees and 5 cm of a true object of their class.
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


def make_pose_pictures(run: PoseRun) -> PosePictures:
    """Draw frames of a finished run, in its folder.

    Raises:
        ToolkitError: a frame cannot be read, or a picture not be written.
    """
    table = read_table(run.folder / POSES)
    source = open_split(run.split, run.root)
    readable = sorted(set(table.loc[table[READ], INDEX].tolist()))
    shown = [readable[i] for i in chosen_frames(len(readable), SHOWN)]
    frames = frames_of(table[table[INDEX].isin(shown)])
    pictures = []
    for place, index in enumerate(frames.indices.tolist()):
        frame = source.load(index)
        name = f"{index:07d}.jpg"
        picture = picture_of(frame.color, frame.camera, frames, place)
        write_color(run.folder / POSE_GALLERY / name, picture, quality=88)
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
    # Last: it says that all are there.
    write_document(run.folder / POSE_GALLERY / PICTURES_FILE, found)
    return found


def picture_of(
    color: NDArray[np.uint8], camera: Camera, frames: PoseFrames, place: int
) -> NDArray[np.uint8]:
    """(h, `WIDTH`, 3) the image, a little paler, with the boxes of one of the frames."""
    size = (WIDTH, round(WIDTH * camera.height / camera.width))
    shrinks = color.shape[1] > size[0]
    way = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    resized = cv2.resize(color, size, interpolation=way)
    image = np.ascontiguousarray(255 - (0.85 * (255 - resized.astype(np.float32)))).astype(np.uint8)
    drawn = camera.resized(*size)
    truth, found = frames.truths[place], frames.found[place]
    draw_boxes(image, drawn, truth.RT, truth.sizes, TRUE_COLOR)
    draw_boxes(image, drawn, found.RT, found.sizes, ESTIMATE_COLOR, width=1)
    return image


def _right(frames: PoseFrames, place: int) -> int:
    protocol = get_pose_protocol("strict")
    matches = match_poses([frames.truths[place]], [frames.found[place]], protocol)
    return int(matches.hits[:, protocol.columns.index("10deg5cm")].sum())
