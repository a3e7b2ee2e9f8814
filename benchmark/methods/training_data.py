"""What weights were trained on and with which seed, as the files beside them say: a run of
`std-train`, or a card."""

import re
from pathlib import Path
from typing import Any

import msgspec

from benchmark.methods.registry import MethodOptions, shipped_file
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document
from std_toolkit.io.regular import read_text

# What `std-train` leaves beside weights.
RUN_NOTE, TRAIN_CONFIG = "run.json", "config.json"

# Rows of a card, as `std-train export` writes it.
_PART = re.compile(r"^\| ([^|]+?) \| ([\d,]+) frames of (\d+) scenes", re.MULTILINE)
_SEED = re.compile(r"^\| seed \| (\d{1,10}) \|", re.MULTILINE)
_SECTION = re.compile(r"^## Trained on\n(.*?)^## ", re.MULTILINE | re.DOTALL)
_LARGEST_CARD = 2**20


class _Part(msgspec.Struct, frozen=True):
    split: str
    frames: int
    scenes: list[str] = []
    simulation: dict[str, Any] = {}


class _Note(msgspec.Struct, frozen=True):
    training: list[_Part]


class _Config(msgspec.Struct, frozen=True):
    seed: int


def training_data(name: str, method: object, options: MethodOptions) -> str:
    """Return what the weights of a method were trained on, in one line.

    Args:
        name: name of the method.
        method: the method; None if there is none.
        options: options that the method was created with.

    Returns:
        Data sets with numbers of frames and scenes, of the record of `std-train` or the card beside
        the weights; "" without weights, or where neither lies there.
    """
    said = dict.fromkeys(_said(f) for f in _files(name, method, options))
    return "; ".join(filter(None, said))


def training_seed(name: str, method: object, options: MethodOptions) -> int | None:
    """Return the seed that the weights of a method were trained with.

    Args:
        name, method, options: see `training_data`.

    Returns:
        The seed in the configuration of `std-train` or on the card beside the weights; None without
        weights, where neither says it, and of methods that join several networks.
    """
    files = _files(name, method, options)
    if len(files) != 1:
        return None
    config, card = files[0].parent / TRAIN_CONFIG, files[0].with_suffix(".md")
    try:
        if config.is_file():
            return read_document(config, _Config).seed
        found = _SEED.search(read_text(card, "card", _LARGEST_CARD)) if card.is_file() else None
    except ToolkitError:  # a courtesy: the weights themselves were read
        return None
    return None if found is None else int(found[1])


def _files(name: str, method: object, options: MethodOptions) -> list[Path]:
    """Weight files of a method."""
    weights = getattr(method, "weights", None) or options.weights
    if method is None:
        return []
    if weights is None:
        weights = shipped_file(name, options.preset)
    files = weights if isinstance(weights, tuple) else (weights,)  # a method may join networks
    return [f for f in files if isinstance(f, Path) and f.is_file()]


def _said(weights: Path) -> str:
    try:
        return _of_run(weights.parent / RUN_NOTE) or _of_card(weights.with_suffix(".md"))
    except ToolkitError:  # a courtesy: the weights themselves were read
        return ""


def _of_run(path: Path) -> str:
    if not path.is_file():
        return ""
    parts = read_document(path, _Note).training
    simulated = any(part.simulation for part in parts)
    return _told([(p.split, p.frames, len(p.scenes)) for p in parts], simulated=simulated)


def _of_card(path: Path) -> str:
    if not path.is_file():
        return ""
    section = _SECTION.search(read_text(path, "card", _LARGEST_CARD))
    if section is None:
        return ""
    found = _PART.findall(section[1])
    parts = [(name, int(n.replace(",", "")), int(scenes)) for name, n, scenes in found]
    return _told(parts, simulated="| simulated by std-sim |" in section[1])


def _told(parts: list[tuple[str, int, int]], *, simulated: bool) -> str:
    """Parts of one split together.

    >>> _told([("a", 1000, 3), ("a", 500, 2)], simulated=True)
    'std-sim:a (1,500 frames of 5 scenes)'
    """
    sums: dict[str, list[int]] = {}
    for name, frames, scenes in parts:
        both = sums.setdefault(name, [0, 0])
        both[0] += frames
        both[1] += scenes
    mark = "std-sim:" if simulated else ""
    return ", ".join(f"{mark}{n} ({f:,} frames of {s} scenes)" for n, (f, s) in sums.items())
