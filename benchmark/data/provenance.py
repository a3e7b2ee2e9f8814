"""Where the frames of a split come from: published, simulated, one's own, or not known."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from benchmark.data.splits import DepthSource, SceneFiles, get_split
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import decode_document, digest_of, read_document
from std_toolkit.scene.sidecar import SIDECAR_NAME

Kind = Literal["published", "simulated", "own recording", "unknown"]

# Document of a set of `std-sim`, and folder of the records of its scenes, above the scenes.
_SET, _RECORDS = "simulation.json", "parameters"
_LEVELS = 4
_MOST_CHANGES = 4  # of a preset, to be named
_MARK = "std-sim"
_SIMULATED = ("simulated:", "synthetic")
# Imports of other formats are of data sets.
_OWN = ("record:", "import:folder", "import:ros")


class Provenance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where frames come from.

    Attributes:
        kind: `published` only if the split has as many frames and scenes as published, none of
            their files is missing, and no mark of `std-sim` lies there.
        about: version, settings and seeds of simulated scenes; else a remark, or "".
    """

    kind: Kind = "unknown"
    about: str = ""

    def __str__(self) -> str:
        return f"{self.kind} ({self.about})" if self.about else self.kind


class _SimulatedScene(msgspec.Struct, frozen=True):
    """The part of a record of `std-sim` that is read."""

    format: Literal["std-sim-scene"]
    version_of_tool: str
    seed: int
    sensor: str
    parameters: dict[str, Any] = {}


class _Info(msgspec.Struct, frozen=True):
    source: str = ""


class _Sidecar(msgspec.Struct, frozen=True):
    scene: _Info


def provenance_of(source: DepthSource, split: str) -> Provenance:
    """Tell where the frames of a split come from.

    Args:
        source: all frames of the split in a root folder.
        split: its name.

    Raises:
        ToolkitError: unknown split, or a folder that cannot be read.
    """
    scenes = list(source.files())
    origins = [_origin(Path(scene.folder)) for scene in scenes]
    records = [o for o in origins if isinstance(o, _SimulatedScene)]
    texts = [o for o in origins if isinstance(o, str)]
    made = len(records) + sum(t.startswith(_SIMULATED) for t in texts)
    if made and made == len(scenes):
        return Provenance(
            kind="simulated", about=_settings(records) or ", ".join(sorted(set(texts)))
        )
    if made:
        return Provenance(about=f"{made} of {len(scenes)} scenes simulated")
    if _MARK in texts:
        return Provenance(about=f"{_SET} or {_RECORDS}/ of std-sim lies there")
    if scenes and len(texts) == len(scenes):
        about = ", ".join(sorted({t.partition(":")[2] or t for t in texts}))
        own = all(t.startswith(_OWN) for t in texts)
        return Provenance(kind="own recording" if own else "unknown", about=about)
    return Provenance(kind="published") if _is_whole(split, scenes) else Provenance()


def _is_whole(split: str, scenes: Sequence[SceneFiles]) -> bool:
    """Whether the counts are published ones, and every frame has its files."""
    frames = sum(scene.frames for scene in scenes)
    counts = [p for p in get_split(split).published if not p.of_more]
    same = any(p.frames == frames and p.scenes in (None, len(scenes)) for p in counts)
    return same and not any(scene.missing for scene in scenes)


def _origin(folder: Path) -> _SimulatedScene | str | None:
    """Record of the simulator, source of a scene of the toolkit, or None for other folders."""
    place = folder.resolve()
    if (place / "scene.json").is_file():
        info = _read(place / "scene.json", _Info)
        return _read(place / ".std" / _SET, _SimulatedScene) or (info.source if info else "")
    for top in (place, *list(place.parents)[:_LEVELS]):
        sidecar = _read(top / SIDECAR_NAME, _Sidecar)
        if sidecar is not None:
            return str(sidecar.scene.source)
        records = top / _RECORDS / place.parent.name
        record = _read(records / f"{place.name}.json", _SimulatedScene)
        if record is not None:
            return record
        if (top / _SET).is_file() or records.is_dir():
            return _MARK
    return None


def _read(path: Path, type_: type[Any]) -> Any:
    try:
        return read_document(path, type_) if path.is_file() else None
    except ToolkitError:
        return None


def _settings(every: Sequence[_SimulatedScene]) -> str:
    """Version, settings and seeds of simulated scenes in one line."""
    if not every:
        return ""
    tools = sorted({s.version_of_tool for s in every})
    sensors = sorted({s.sensor for s in every})
    options = sorted({_preset(s.parameters.get("options")) for s in every})
    seeds = _ranges(sorted({s.seed for s in every}))
    return (
        f"std-sim {', '.join(tools)}, {', '.join(sensors)}, {', '.join(options)}, "
        f"seeds {', '.join(seeds)}"
    )


def _preset(options: Any) -> str:
    """The preset of `std-sim` that options are nearest to, and what differs; else their digest."""
    from sensors.simulation.options import PRESETS

    found = []
    for name, preset in PRESETS.items():
        # Lists, as files have.
        usual = decode_document(msgspec.json.encode(preset.options), dict[str, Any])
        if not isinstance(options, dict) or options.keys() != usual.keys():
            continue
        other = [f"{k} {_word(v)}" for k, v in options.items() if usual[k] != v]
        found.append((len(other), f"preset {name}{' with ' if other else ''}{', '.join(other)}"))
    few = [text for count, text in sorted(found) if count <= _MOST_CHANGES]
    return few[0] if few else f"options {digest_of(options, versioned=False)[:8]}"


def _word(value: Any) -> str:
    """A value of a record of somebody else, as a word."""
    text = str(value)
    return text if re.fullmatch(r"[\w.-]{1,24}", text) else "other"


def _ranges(numbers: Sequence[int]) -> Iterator[str]:
    """Yield runs of numbers.

    >>> list(_ranges([1, 2, 3, 7]))
    ['1 to 3', '7']
    """
    first = last = None
    for number in [*numbers, None]:
        if last is not None and number == last + 1:
            last = number
            continue
        if last is not None:
            yield str(first) if first == last else f"{first} to {last}"
        first = last = number
