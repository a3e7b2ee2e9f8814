"""Derived files and folders: what made them, and whether they are still right.

An artefact has a name, inputs and options. Its files are written first, each atomically, and then
a record of all three and of the content of the files. A run that finds the record unchanged keeps
the files; after a change, an interruption or a damaged record it makes them again, and says why.
Inputs are known by the digest of their content, never by name alone.
"""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError, listed
from std_toolkit.io.atomic import atomic_path
from std_toolkit.io.documents import (
    digest_file,
    digest_of,
    read_document,
    write_document,
)
from std_toolkit.log import logger
from std_toolkit.settings import changed

D = TypeVar("D")

R = TypeVar("R", bound="Record")

# As many changes are named; the others are counted.
_NAMED = 3


class Record(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What made the files of an artefact. A document of these files may have more fields.

    Attributes:
        name: name of the artefact, such as that of a step.
        version: version of the toolkit that made it.
        inputs: digest of the content by name of the input.
        options: options that determine the result, and limits that differ from the defaults.
        outputs: digest of the content by path of the file.
    """

    name: str
    version: str
    inputs: dict[str, str]
    options: dict[str, Any]
    outputs: dict[str, str]


@dataclass(frozen=True)
class Artefact:
    """Something that is derived from inputs by options.

    Attributes:
        root: folder that paths of outputs are relative to.
        name: what it is called in messages and in its record.
        inputs: digest of the content by name; a changed name is a change, too.
        options: plain values that determine the result.
        limits: groups of limits that decide it, such as "poses."; those that a file of settings
            changes count as options.
    """

    root: Path
    name: str
    inputs: Mapping[str, str]
    options: Mapping[str, Any] = field(default_factory=dict)
    limits: tuple[str, ...] = ()

    @property
    def digest(self) -> str:
        """Digest of everything that determines the result, version and limits included."""
        return digest_of(self.name, self.inputs, self.options, self._limits())

    def _limits(self) -> dict[str, float]:
        return changed(*self.limits) if self.limits else {}

    def record(self, outputs: Iterable[Path] = ()) -> Record:
        """The record of the finished files, whose content is read."""
        return Record(
            name=self.name,
            version=__version__,
            inputs=dict(self.inputs),
            options=msgspec.json.decode(msgspec.json.encode({**self.options, **self._limits()})),
            outputs={p.relative_to(self.root).as_posix(): digest_file(p) for p in sorted(outputs)},
        )

    def write(self, outputs: Iterable[Path]) -> None:
        """Write the record of a step of a scene, after its outputs."""
        write_document(record_path(self.root, self.name), self.record(outputs))

    def is_kept(self) -> bool:
        """Whether a step of a scene need not run again; logs why it must."""
        return self.find(record_path(self.root, self.name), Record, logging.INFO) is not None

    def find(self, path: Path, type_: type[R], level: int = logging.DEBUG) -> R | None:
        """The record at `path` if the files need not be made again.

        Args:
            path: a record, or a document of a subclass of it.
            type_: type of the document.
            level: of the message that says that the files are kept, or why they are stale.

        Returns:
            None if there is no record, the record is damaged or differs, or an output is changed.
        """
        record = read_record(path, type_, level)
        if record is None:
            return None
        reason = self.change(record)
        logger.log(level, "%s: %s", self.name, f"stale because {reason}" if reason else "kept")
        return None if reason else record

    def arrays(self, make: Callable[[], Mapping[str, Any]]) -> Mapping[str, Any]:
        """Arrays of `NAME.npz` in the folder, made and written if they are stale.

        Args:
            make: computes the arrays, by name.
        """
        import numpy as np

        path, record = (self.root / f"{self.name}{suffix}" for suffix in (".npz", ".json"))
        if self.find(record, Record, logging.INFO) is not None:
            with np.load(path, allow_pickle=False) as data:
                return {key: data[key] for key in data.files}
        made = make()
        with atomic_path(path) as temporary:
            np.savez(temporary, **made)
        write_document(record, self.record([path]))
        return made

    def change(self, then: Record) -> str:
        """What changed since a record was written, for people; "" for nothing."""
        now = self.record()
        if then.version != now.version:
            return f"it was made by version {then.version}"
        found = [f"the {name} changed" for name in differences(then.inputs, now.inputs)]
        found += [
            f"{name} was {repr(then.options[name]) if name in then.options else 'the default'}"
            for name in differences(then.options, now.options)
        ]
        found = found or changed_files(self.root, then.outputs)
        return listed(found, _NAMED)


def record_path(root: Path, name: str) -> Path:
    """Path of the record of a step of a scene."""
    return root / ".std" / "records" / f"{name}.json"


def read_record(path: Path, type_: type[D], level: int = logging.INFO) -> D | None:
    """The record of a finished artefact; None, with a message, if it cannot be read."""
    if not path.exists():
        return None
    try:
        return read_document(path, type_)
    except ToolkitError as error:
        # Only a cache is lost: making the files again is always right.
        logger.log(level, "%s; made again", error)
        return None


def differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Keys whose value differs, or that only one of the two has."""
    missing = object()
    return [k for k in {**then, **now} if then.get(k, missing) != now.get(k, missing)]


def changed_files(root: Path, outputs: Mapping[str, str]) -> list[str]:
    """Which of the files do not have the recorded content, for people."""
    return [
        f"{name} changed" if (root / name).is_file() else f"{name} is missing"
        for name, content in outputs.items()
        if not (root / name).is_file() or digest_file(root / name) != content
    ]


def begin(
    path: Path,
    document: Any,
    *,
    within: Sequence[str] = (),
    what: str = "",
    hint: str,
    beside: Sequence[str] = (),
) -> None:
    """Write the document that identifies a folder of results, or check that it is the same.

    Args:
        path: path of the document.
        document: structure or dataclass that describes the folder.
        within: fields that decide; the others only inform. All decide by default.
        what: subject of the message, such as "this pack was".
        hint: what to do about a folder of other content.
        beside: names of files that may already exist without the document.

    Raises:
        ToolkitError: the folder contains files, except hidden ones, but not this document; or it
            was begun with other values, which the message lists.
    """
    check_begun(path, hint=hint, beside=beside)
    if not path.exists():
        write_document(path, document)
        return
    begun = read_document(path, type(document))
    then, now = (
        _flat({name: getattr(d, name) for name in within} if within else d)
        for d in (begun, document)
    )
    changed = differences(then, now)
    if changed:
        first, *others = changed
        more = "".join(f"; {n}: {then.get(n)!r} then, {now.get(n)!r} now" for n in others)
        raise ToolkitError(
            f"{what} begun with {then.get(first)!r}".lstrip(),
            path=path,
            field=first,
            value=now.get(first),
            hint=hint + more,
        )


def check_begun(path: Path, *, hint: str, beside: Sequence[str] = ()) -> None:
    """Look at a folder of results before it is walked or locked; see `begin`.

    Raises:
        ToolkitError: the folder contains files, except hidden ones, but not this document.
    """
    there = path.parent.iterdir() if path.parent.is_dir() and not path.exists() else ()
    if any(p.name[0] != "." and p.name not in beside for p in there):
        raise ToolkitError(
            f"the folder contains files but no {path.name}", path=path.parent, hint=hint
        )


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Fields of nested structures and mappings by their paths."""
    items = msgspec.to_builtins(value)
    if not isinstance(items, dict):
        return {prefix: items}
    found: dict[str, Any] = {}
    for name, item in items.items():
        found |= _flat(item, f"{prefix}.{name}" if prefix else str(name))
    return found
