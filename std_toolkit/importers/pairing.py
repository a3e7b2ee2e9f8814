"""Colour and depth images of one frame: paired by name, number, order, time, or a list."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Literal

from std_toolkit import errors, log
from std_toolkit.importers.ros_images import pair_stamps
from std_toolkit.io.regular import read_text
from std_toolkit.scene.time_stamps import stamps_of

PairBy = Literal["name", "index", "time", "list"]
Images = dict[str, Path]
"""Images by frame key, in natural order."""

_LISTS = ("associations.txt", "associate.txt", "association.txt", "assoc.txt", "assocs.txt")
_LARGEST_LIST_BYTES = 64 * 1024 * 1024
# Of a period: by so much less distance, another frame is not yet the likelier partner.
_UNDECIDED = 0.1
_INDEX = re.compile(r"\d{1,5}\.\d{1,2}")  # such as view 5 of place 12
_OF_1973 = 1e8  # seconds; stamps below it count from a start of their own


def paired(
    color: Images, depth: Images, *, by: PairBy | None = None, skip_unpaired: bool = False
) -> tuple[Images, Images, dict[str, float]]:
    """The images that have a partner, with equal keys, and the seconds of frames that are known.

    Args:
        color, depth: images by frame key.
        by: how to pair them. None: by name; if this leaves images out, by the numbers in the
            names, by a list beside the folders (associations.txt), by an index and a time that do
            not contradict each other, or by time where every name is a time stamp.
        skip_unpaired: whether images without a partner may be left out.

    Raises:
        ToolkitError: a frame lacks its colour or its depth (unless `skip_unpaired`).
    """
    stamps = _stamps(color, "rgb.txt"), _stamps(depth, "depth.txt")
    if by == "index":
        return _joined(color, depth, _by_index(color, depth, skip_unpaired), stamps)
    if by == "time":
        return _joined(color, depth, _by_time(color, depth, stamps, skip_unpaired), stamps)
    if by == "list":
        listed = _by_list(color, depth)
        if not listed:
            raise errors.ToolkitError(
                "no list of pairs beside the folders, or none with these images",
                path=next(iter(color.values())).parent.parent, field="--pair", value=by,
                hint=f"a line of {_LISTS[0]}: time, colour, time, depth",
            )  # fmt: skip
        return _joined(color, depth, listed, stamps)
    if by is None and set(color) == set(depth):
        _check_list(color, _by_list(color, depth))
    if by == "name" or set(color) == set(depth):
        found = pair(color, depth, skip_unpaired=skip_unpaired)
        return _joined(color, depth, {k: k for k in found}, stamps)
    ways: list[tuple[str, Callable[[], dict[str, str]]]] = [
        ("the numbers in their names", lambda: _by_number(color, depth)),
        ("a list beside the folders", lambda: _by_list(color, depth)),
        ("index and time in their names", lambda: _by_index_and_time(color, depth)),
        ("the time stamps of their names", lambda: _by_stamps(color, depth)),
    ]
    for words, way in ways:
        joined = way()
        if joined:
            left = len(color) + len(depth) - 2 * len(joined)
            log.logger.info(
                "colour and depth are paired by %s; %d left out", words, left,
                extra={"doctor": "guessed"},
            )  # fmt: skip
            return _joined(color, depth, joined, stamps)
    found = pair(color, depth, skip_unpaired=skip_unpaired)
    return _joined(color, depth, {k: k for k in found}, stamps)


def pair(color: Images, depth: Images, *, skip_unpaired: bool = False) -> Images:
    """Depth path of every colour key.

    Raises:
        ToolkitError: a frame lacks its colour or its depth (unless `skip_unpaired`).
    """
    no_depth = [k for k in color if k not in depth]
    no_color = [k for k in depth if k not in color]
    if (no_depth or no_color) and not skip_unpaired:
        problems = [
            f"{len(keys)} without {what}: {', '.join(keys[:5])}{' ...' if len(keys) > 5 else ''}"
            for keys, what in ((no_depth, "depth"), (no_color, "colour"))
            if keys
        ]
        raise errors.ToolkitError(
            "colour and depth do not pair by name: " + "; ".join(problems),
            path=next(iter(depth.values())).parent,
            hint="pair them by --pair index or --pair time, skip these frames with "
            "--skip-unpaired, or fix the names",
        )
    paired = {k: depth[k] for k in color if k in depth}
    if not paired:
        raise errors.ToolkitError(
            "no colour image has a depth image with the same name",
            path=next(iter(color.values())).parent,
            hint="pair them by --pair index or --pair time",
        )
    if no_depth or no_color:
        log.logger.warning("skipped %d frames without a partner", len(no_depth) + len(no_color))
    return paired


def _check_list(color: Images, listed: Mapping[str, str]) -> None:
    """Check that a list beside the folders does not contradict the names.

    Raises:
        ToolkitError: it pairs images of different names.
    """
    other = next(((c, d) for c, d in listed.items() if c != d), None)
    if other is not None:
        raise errors.ToolkitError(
            f"a list of pairs beside the folders pairs colour {other[0]} with depth {other[1]}, "
            f"though there is a depth {other[0]}",
            path=next(iter(color.values())).parent.parent,
            hint="pair by the list with --pair list, or by the names with --pair name",
        )


Stamps = tuple[dict[str, float], dict[str, float]]


def _joined(
    color: Images, depth: Images, keys: Mapping[str, str], stamps: Stamps
) -> tuple[Images, Images, dict[str, float]]:
    seconds = {k: stamps[0][k] for k in keys if k in stamps[0]}
    return {k: color[k] for k in keys}, {k: depth[d] for k, d in keys.items()}, seconds


def _by_index(color: Images, depth: Images, skip_unpaired: bool) -> dict[str, str]:
    if len(color) != len(depth) and not skip_unpaired:
        raise errors.ToolkitError(
            f"{len(color)} colour and {len(depth)} depth images do not pair by index",
            path=next(iter(depth.values())).parent,
            hint="--pair time pairs those of the same time; --skip-unpaired leaves the last ones "
            "out",
        )
    return dict(zip(color, depth, strict=False))


def _by_time(color: Images, depth: Images, stamps: Stamps, skip_unpaired: bool) -> dict[str, str]:
    times = [
        s if len(s) == len(images) else _time_numbers(images)
        for images, s in zip((color, depth), stamps, strict=True)
    ]
    for images, found in zip((color, depth), times, strict=True):
        if len(found) != len(images):
            unnamed = next(k for k in images if k not in found)
            raise errors.ToolkitError(
                "no time stamp in the name of this image, and in no list beside its folder",
                path=images[unnamed],
                field="--pair",
                value="time",
                hint="rgb.txt and depth.txt hold a time stamp and a name per line",
            )
    keys = list(color), list(depth)
    pairs = pair_stamps([times[0][k] for k in keys[0]], [times[1][k] for k in keys[1]])
    if not pairs:
        raise errors.ToolkitError(
            "no colour image has a depth image of the same time",
            path=next(iter(depth.values())).parent,
            hint="--pair index pairs them in their order",
        )
    lost = len(color) + len(depth) - 2 * len(pairs)
    if lost > 0.5 * (len(color) + len(depth)) and not skip_unpaired:
        raise errors.ToolkitError(
            f"only {len(pairs)} pairs of {len(color)} colour and {len(depth)} depth images have "
            "the same time",
            path=next(iter(depth.values())).parent,
            hint="--skip-unpaired leaves the others out; --pair index pairs them in their order",
        )
    if lost:
        log.logger.warning("%d images without a partner of the same time are left out", lost)
    return {keys[0][c]: keys[1][d] for c, d in pairs}


def _by_number(color: Images, depth: Images) -> dict[str, str]:
    """Pairs of equal last numbers, if all images have a partner: 7 and 0007."""
    numbers = []
    for images in (color, depth):
        found: dict[int, str] = {}
        for key in images:
            # Two numbers are an index and a time, or a date and an index: which one counts?
            parts = re.findall(r"\d+", key)
            if len(parts) != 1 or int(parts[0]) in found:
                return {}
            found[int(parts[0])] = key
        numbers.append(found)
    if set(numbers[0]) != set(numbers[1]):
        return {}
    return {key: numbers[1][n] for n, key in numbers[0].items()}


def _by_index_and_time(color: Images, depth: Images) -> dict[str, str]:
    """Pairs of equal first numbers, if the last ones as times do not contradict them.

    They do if some pair is farther apart than others, as after a lost frame, or nearer to another
    frame by more than `_UNDECIDED` of a period, as where each camera counts for itself.
    """
    numbers = [
        {key: [int(n) for n in re.findall(r"\d+", path.stem)] for key, path in images.items()}
        for images in (color, depth)
    ]
    if any(len(n) != 2 for found in numbers for n in found.values()):
        return {}
    index = [{n[0]: key for key, n in found.items()} for found in numbers]
    if index[0].keys() != index[1].keys() or len(index[0]) < max(map(len, numbers)):
        return {}
    joined = {key: index[1][n] for n, key in index[0].items()}
    times = sorted(n[1] for n in numbers[0].values())
    late = [numbers[1][d][1] - numbers[0][c][1] for c, d in joined.items()]
    period = median([b - a for a, b in pairwise(times)] or [0])
    apart, spread = max(map(abs, late)), max(late) - min(late)
    if period <= 0 or spread > _UNDECIDED * period or apart > (0.5 + _UNDECIDED) * period:
        return {}
    if apart > 0.5 * period:
        log.logger.warning(
            "depth is %.2f periods %s colour of the same index: --pair time pairs the nearest ones",
            apart / period, "after" if late[0] > 0 else "before",
        )  # fmt: skip
    return joined


def _by_list(color: Images, depth: Images) -> dict[str, str]:
    """Pairs of a list of TUM's associate.py: stamp, colour, stamp, depth per line."""
    folder = next(iter(color.values())).parent
    path = next((p / n for p in (folder.parent, folder) for n in _LISTS if (p / n).is_file()), None)
    if path is None:
        return {}
    names = [{p.name: k for k, p in images.items()} for images in (color, depth)]
    found: dict[str, str] = {}
    for row in _rows(path):
        files = [word for word in row if not re.fullmatch(r"[\d.]+", word)]
        if len(files) != 2:
            continue
        if "depth" in files[0].lower() and "depth" not in files[1].lower():
            files.reverse()
        c, d = (names[i].get(Path(file).name) for i, file in enumerate(files))
        if c is not None and d is not None and d not in found.values():
            found.setdefault(c, d)
    return found


def _by_stamps(color: Images, depth: Images) -> dict[str, str]:
    """Pairs of the nearest time, if every name is a time stamp."""
    times = [list(_named_times(images).values()) for images in (color, depth)]
    keys = list(color), list(depth)
    if not all(times) or len(set(map(_is_since_1970, (t for ts in times for t in ts)))) > 1:
        return {}
    return {keys[0][c]: keys[1][d] for c, d in pair_stamps(*times)}


def _named_times(images: Images) -> dict[str, float]:
    """Seconds by key where every name is a time stamp; else empty."""
    stems = [p.stem for p in images.values()]
    found = stamps_of(stems)
    is_index = all(map(_INDEX.fullmatch, stems))
    return {} if is_index or any(map(math.isnan, found)) else dict(zip(images, found, strict=True))


def _is_since_1970(seconds: float) -> bool:
    return seconds > _OF_1973


def _stamps(images: Images, name: str) -> dict[str, float]:
    """Seconds by key: those of a list beside the folder, else of names that are time stamps."""
    folder = next(iter(images.values())).parent
    names = (name, f"{folder.name}.txt")
    found: dict[str, float] = {}
    by_name = {p.name: k for k, p in images.items()}
    for path in (p / n for n in dict.fromkeys(names) for p in (folder.parent, folder)):
        if path.is_file() and not found:
            for row in _rows(path):
                key = by_name.get(Path(row[-1]).name)
                if len(row) == 2 and key is not None:
                    try:
                        found[key] = float(row[0])
                    except ValueError:
                        continue
    if found:
        return found
    return _named_times(images)


def _time_numbers(images: Images) -> dict[str, float]:
    """The last number of each name, a decimal one in seconds or a whole one of any unit."""
    found = {}
    for key, path in images.items():
        numbers = re.findall(r"\d+\.\d+|\d+", path.stem)
        if numbers:
            found[key] = float(numbers[-1])
    return found


def _rows(path: Path) -> list[list[str]]:
    text = read_text(path, "list of images", _LARGEST_LIST_BYTES)
    rows = [line.split("#")[0].replace(",", " ").split() for line in text.splitlines()]
    return [row for row in rows if row]
