"""The frame that each pose of a file belongs to."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger
from std_toolkit.poses.camera_table import FiledCameras
from std_toolkit.scene import Frame
from std_toolkit.scene.document import safe_name
from std_toolkit.scene.time_stamps import stamps_of

# Words of a file name that describe its content, not the frame.
_ROLE_WORDS = frozenset(
    [
        "color",
        "colour",
        "rgb",
        "image",
        "img",
        "frame",
        "pose",
        "poses",
        "cam",
        "camera",
        "extrinsic",
        "extrinsics",
        "matrix",
    ]
)
_SECONDS = re.compile(r"\d+\.\d+")
_IMAGE_SUFFIXES = frozenset(
    (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".ppm", ".txt", ".npy", ".json")
)


def match_frames(
    filed: FiledCameras,
    frames: Sequence[Frame],
    *,
    max_dt: float = 0.02,
    first_number: int | None = None,
    what: str = "camera poses",
) -> dict[int, int]:
    """Find the pose of each frame: by name, else time stamp, number in the name, or frame id.

    The way that finds most frames is used. Poses without keys are in the order of the frames.

    Args:
        filed: poses as filed.
        frames: frames of the scene.
        max_dt: largest difference of time stamps in seconds.
        first_number: number of the pose of the first image, if the user states it.
        what: what the rows of `filed` are, for the line that is printed.

    Returns:
        Row of `filed.matrices` by frame id, in the order of the frames.

    Raises:
        ToolkitError: two poses of one image, no pose of any, or another number of poses than
            frames where only the order could tell.
    """
    if filed.keys is None:
        if len(filed.matrices) != len(frames):
            raise ToolkitError(
                f"{len(filed.matrices)} poses without image names for {len(frames)} images",
                path=filed.path,
                hint="one pose per image, or write the image's name before each pose",
            )
        return {f.id: i for i, f in enumerate(frames) if i not in filed.lost}
    named = [keys for keys in (filed.keys, *filed.more_keys) if len(set(keys)) == len(keys)]
    if not named:
        twice = Counter(filed.keys).most_common(1)[0][0]
        raise ToolkitError("two poses of one image", path=filed.path, value=twice)
    found = [(keys, _best(filed, frames, keys, max_dt, first_number)) for keys in named]
    keys, best = max(found, key=lambda pair: len(pair[1]))
    if not best:
        raise ToolkitError(
            "no pose of this file belongs to an image of the scene", path=filed.path,
            value=keys[0],
            hint=f"poses are found by file name or time stamp; the first image is {frames[0].name}",
        )  # fmt: skip
    first = next(iter(best))
    shown = next(f.color for f in frames if f.id == first)
    logger.info("%s: %r belongs to %s", what, keys[best[first]], shown)
    _refuse_other_start(replace(filed, keys=keys), frames, best, first_number)
    best = {frame: row for frame, row in best.items() if row not in filed.lost}
    if not best:
        raise ToolkitError("no image of the scene has a pose in this file", path=filed.path)
    return best


def _best(
    filed: FiledCameras,
    frames: Sequence[Frame],
    keys: Sequence[str],
    max_dt: float,
    first_number: int | None,
) -> dict[int, int]:
    """Row by frame id, by the way that finds most frames."""
    if first_number is not None:
        return _by_number(frames, keys, first_number)
    times = stamps_of([_stem(k) for k in keys], stated=keys is filed.keys and filed.keys_are_times)
    ways: list[dict[int, int]] = [
        _joined(frames, keys, lambda f: f.color.rsplit("/")[-1], _file_name),
        _joined(frames, keys, lambda f: f.name, lambda k: safe_name(_stem(k))),
        _joined(frames, keys, lambda f: _bare(f.name), lambda k: _bare(_stem(k))),
        _by_time(frames, times, max_dt),
        _by_number(frames, keys, None),
        _joined(frames, keys, lambda f: str(f.id), lambda k: k),
    ]
    return max(ways, key=len)


def _refuse_other_start(
    filed: FiledCameras, frames: Sequence[Frame], found: dict[int, int], first: int | None
) -> None:
    """Refuse poses and images joined by their numbers of which one count from 1, one from 0.

    Raises:
        ToolkitError: one pose per image, and each number but the first and the last has both.
    """
    if first is not None or filed.keys is None or len(filed.keys) != len(frames):
        return
    poses = {_number(key) for key in filed.keys}
    images = {_number(f.name) for f in frames}
    if "" in poses | images or len(poses) < len(frames) or len(images) < len(frames):
        return
    lowest, highest = (min(map(int, images)), max(map(int, images)))
    by_number = all(
        _number(filed.keys[row]) == _number(_name_of(frames, f)) for f, row in found.items()
    )
    step = min(map(int, poses)) - lowest
    if by_number and abs(step) == 1 and {int(n) for n in poses} == {int(n) + step for n in images}:
        alone = (
            f"the pose of the last number, {highest + 1}, has no image, and image {lowest} has no "
            "pose: counted from 1?"
            if step == 1
            else f"the last image, {highest}, has no pose, and pose {lowest - 1} has no image: are "
            "the images counted from 1, such as those of ffmpeg?"
        )
        raise ToolkitError(
            alone,
            path=filed.path,
            value=filed.keys[0],
            hint=f"--cameras-first {lowest + step} takes pose {lowest + step} for the first image, "
            f"--cameras-first {lowest} takes the numbers as they are",
        )


def _name_of(frames: Sequence[Frame], frame: int) -> str:
    return next(f.name for f in frames if f.id == frame)


def _by_number(frames: Sequence[Frame], keys: Sequence[str], first: int | None) -> dict[int, int]:
    """Join numbers in names; with `first`, the number of the pose of the first image."""
    if first is None:
        return _joined(frames, keys, lambda f: _number(f.name), _number)
    numbers = [_number(f.name) for f in frames]
    if "" in numbers:
        return {}
    step = first - min(map(int, numbers))
    return _joined(frames, keys, lambda f: str(int(_number(f.name)) + step), _number)


def _joined(
    frames: Sequence[Frame],
    keys: Sequence[str],
    of_frame: Callable[[Frame], str],
    of_key: Callable[[str], str],
) -> dict[int, int]:
    """Join frames and keys by equal text; empty unless the texts are unique on both sides."""
    rows: dict[str, int] = {}
    for i, key in enumerate(keys):
        if text := of_key(key):
            if text in rows:
                return {}
            rows[text] = i
    texts = [of_frame(f) for f in frames]
    if len(set(texts)) < len(texts):
        return {}
    return {f.id: rows[t] for f, t in zip(frames, texts, strict=True) if t in rows}


def _by_time(frames: Sequence[Frame], of_keys: Sequence[float], max_dt: float) -> dict[int, int]:
    times = np.array(of_keys)
    named = stamps_of([_stem(f.name) for f in frames])
    stamps = [
        f.timestamp if f.timestamp is not None else s for f, s in zip(frames, named, strict=True)
    ]
    if not np.isfinite(times).all() or not any(np.isfinite(s) for s in stamps):
        return {}
    found = {}
    for frame, stamp in zip(frames, stamps, strict=True):
        if np.isfinite(stamp):
            nearest = int(np.abs(times - stamp).argmin())
            if abs(times[nearest] - stamp) <= max_dt:
                found[frame.id] = nearest
    # Frames without a pose of their own would share that of a neighbour.
    return found if len(set(found.values())) == len(found) else {}


def _file_name(key: str) -> str:
    # A trajectory has up to hundreds of thousands of keys: Path takes ten times as long.
    return key.rstrip("/").rpartition("/")[2]


def _stem(key: str) -> str:
    name = _file_name(key)
    stem, dot, suffix = name.rpartition(".")
    return stem if stem and f"{dot}{suffix}".lower() in _IMAGE_SUFFIXES else name


def _bare(stem: str) -> str:
    words = [w for w in re.split(r"[-_. ]+", stem.lower()) if w and w not in _ROLE_WORDS]
    return "-".join(words)


def _number(key: str) -> str:
    stem = _stem(key)
    numbers = [] if _SECONDS.fullmatch(stem) else re.findall(r"\d+", stem)
    return str(int(numbers[-1])) if numbers else ""
