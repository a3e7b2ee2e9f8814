"""Check that scenes are of the same recording, and pairing of their frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import umeyama
from std_toolkit.io.documents import digest_file
from std_toolkit.io.images import read_color
from std_toolkit.scene import Frame, Scene
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Number of images compared in addition to those of labelled frames.
_SPREAD_IMAGES = 8
# Poses that differ by less are equal.
_SAME_POSE = 1e-9


@dataclass(frozen=True, kw_only=True)
class SameRecordingSettings(Settings):
    """When two recordings are the same."""

    same_focal: float = limit(1e-4, source=NOT_RECORDED)
    """relative difference of focal lengths that affects positions along the viewing ray"""


@dataclass(frozen=True)
class SharedRecording:
    """Common frames of two scenes.

    Attributes:
        frames: frame id in the first scene to frame id in the second.
        notes: sentences on differences that matter for a comparison.
    """

    frames: dict[int, int]
    notes: tuple[str, ...]


def shared_recording(a: Scene, b: Scene, names: tuple[str, str] = ("A", "B")) -> SharedRecording:
    """Pair the frames of two scenes by name, or by id if no name is common.

    The images of the labelled frames and of a few others spread over the recording must have equal
    files or pixels. If an image is missing in one scene, names and sizes are compared instead.

    Raises:
        ToolkitError: the folders are the same, there is no common frame, or image size or content
            differ.
    """
    if a.root.resolve() == b.root.resolve():
        raise ToolkitError(
            "the two scenes are the same folder",
            path=b.root,
            hint="give the folders of two annotators",
        )
    pairs, by_name = _pairs(a, b)
    for one, other in pairs:
        size_a, size_b = a.camera(one).size, b.camera(other).size
        if size_a != size_b:
            raise _other_recording(
                a, b, f"frame {one.name} is {_size(size_a)} in one and {_size(size_b)} in the other"
            )
    compared = _compare_images(a, b, pairs)
    notes = []
    if not by_name:
        notes.append("no frame names are common, so frames are matched by their ids")
    if not compared:
        notes.append(
            "no image is available in both scenes: only frame names and image sizes confirm that "
            "they are of one recording"
        )
    for scene, name in ((a, names[0]), (b, names[1])):
        alone = len(scene.frames) - len(pairs)
        if alone:
            frames = "frame is" if alone == 1 else "frames are"
            notes.append(f"{alone} of {len(scene.frames)} {frames} only in {name}")
    notes += _camera_notes(a, b, pairs, names)
    note = _pose_note(a, b, pairs, names)
    return SharedRecording(
        {one.id: other.id for one, other in pairs}, (*notes, *([note] if note else []))
    )


def _pairs(a: Scene, b: Scene) -> tuple[list[tuple[Frame, Frame]], bool]:
    by_name = {f.name: f for f in b.frames}
    pairs = [(f, by_name[f.name]) for f in a.frames if f.name in by_name]
    if pairs:
        return pairs, True
    by_id = {f.id: f for f in b.frames}
    pairs = [(f, by_id[f.id]) for f in a.frames if f.id in by_id]
    if not pairs:
        raise _other_recording(a, b, "no frame is common by name or id")
    return pairs, False


def _compare_images(a: Scene, b: Scene, pairs: list[tuple[Frame, Frame]]) -> int:
    """Return the number of compared images, all of which are equal."""
    labelled_a = {f for x in a.labels.labels for f in (x.frame, *map(int, x.views))}
    labelled_b = {f for x in b.labels.labels for f in (x.frame, *map(int, x.views))}
    spread = {int(i) for i in np.linspace(0, len(pairs) - 1, _SPREAD_IMAGES).round()}
    compared = 0
    for i, (one, other) in enumerate(pairs):
        if i not in spread and one.id not in labelled_a and other.id not in labelled_b:
            continue
        path_a, path_b = a.color_path(one), b.color_path(other)
        if not (path_a.is_file() and path_b.is_file()):
            continue
        same = path_a.stat().st_size == path_b.stat().st_size
        if not (same and digest_file(path_a) == digest_file(path_b)):
            # The files may be compressed differently with equal pixels.
            size = a.camera(one).size
            if not np.array_equal(read_color(path_a, size=size), read_color(path_b, size=size)):
                raise _other_recording(a, b, f"the images of frame {one.name} differ")
        compared += 1
    return compared


def _camera_notes(
    a: Scene, b: Scene, pairs: list[tuple[Frame, Frame]], names: tuple[str, str]
) -> Iterable[str]:
    limits = SameRecordingSettings.current()
    seen = set()
    for one, other in pairs:
        if (one.camera, other.camera) in seen:
            continue
        seen.add((one.camera, other.camera))
        ca, cb = a.camera(one), b.camera(other)
        if abs(ca.fx / cb.fx - 1) > limits.same_focal or abs(ca.fy / cb.fy - 1) > limits.same_focal:
            yield (
                f"the focal length of camera {one.camera} is {ca.fx:.2f} px in {names[0]} and "
                f"{cb.fx:.2f} px in {names[1]}: this changes distances by "
                f"{abs(ca.fx / cb.fx - 1):.2%}"
            )


def _pose_note(
    a: Scene, b: Scene, pairs: list[tuple[Frame, Frame]], names: tuple[str, str]
) -> str | None:
    """Return a sentence on how the camera poses of the two differ, or None."""
    poses = [
        (Ta, Tb)
        for one, other in pairs
        if (Ta := a.T_world_cam(one.id)) is not None and (Tb := b.T_world_cam(other.id)) is not None
    ]
    if not poses:
        have = [name for scene, name in ((a, names[0]), (b, names[1])) if scene.registered_frames()]
        if not have:
            return None
        return f"camera poses in common frames: {' and '.join(have)} only"
    if all(
        np.abs(Ta.t - Tb.t).max() < _SAME_POSE and np.abs(Ta.R - Tb.R).max() < _SAME_POSE
        for Ta, Tb in poses
    ):
        return None
    text = f"the two have their own camera poses ({len(poses)} common frames)"
    try:
        fit = umeyama(np.stack([Tb.t for _, Tb in poses]), np.stack([Ta.t for Ta, _ in poses]))
    except ToolkitError:  # too few, or on a line
        return text
    return f"{text}; {names[1]} times {fit.scale:.4f} is the scale of {names[0]}"


def _other_recording(a: Scene, b: Scene, what: str) -> ToolkitError:
    return ToolkitError(
        f"not the same recording as {a.root}: {what}",
        path=b.root,
        hint="compare scene folders that were made from the same images",
    )


def _size(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"
