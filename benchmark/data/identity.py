"""What a run reads, by content: digests of the files of every frame, and what of them changed.

Names of frames say nothing about data: raw depth, truth or a mask may change under them. A table of
digests is kept beside the results; see data_spec.md.
"""

import os
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd

from benchmark.data.splits import FrameKey, Inputs
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import decode_document, digest_file, digest_of
from std_toolkit.options import usable_cores

# Columns of a table of content: index in the split, names of the frame, what was read, its digest.
INDEX, SCENE, FRAME, CONTENT, DIGEST = "index", "scene", "frame", "content", "digest"
COLUMNS = (INDEX, SCENE, FRAME, CONTENT, DIGEST)

# Content that is the answer of a method and no part of the data set begins with this word.
_SAVED = "saved "
SAVED_DEPTH, SAVED_SPREAD = f"{_SAVED}depth", f"{_SAVED}spread"
SAVED_POSES, SAVED_GRASPS = f"{_SAVED}poses", f"{_SAVED}grasps"

# Clocks of file systems tick; what changed just now may change again within the same tick.
_SETTLED_S = 2.0


class _Kept(msgspec.Struct, frozen=True, array_like=True):
    """State of a file when it was read, and the digest of its content."""

    state: tuple[int, int, int, int, int]
    digest: str


class Digests:
    """Digests of files, kept between runs.

    A file is read again only if its device, inode, size, or times of change differ.

    Attributes:
        path: file that keeps them; one that is damaged or missing is an empty one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._new = False
        try:
            self._kept = decode_document(path.read_bytes(), dict[str, _Kept], path=path)
        except (OSError, ToolkitError):
            self._kept = {}

    def of(self, paths: Iterable[Path]) -> dict[Path, str]:
        """Return the digest of each file; "" for one that is not there or cannot be read."""
        wanted = list(dict.fromkeys(paths))
        with ThreadPoolExecutor(usable_cores()) as pool:
            return dict(zip(wanted, pool.map(self._one, wanted), strict=True))

    def _one(self, path: Path) -> str:
        name = os.path.abspath(path)  # noqa: PTH100 - a link keeps its own name
        try:
            status = path.stat()
            state = (
                status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
            )  # fmt: skip
            kept = self._kept.get(name)
            if kept is not None and kept.state == state:
                return kept.digest
            digest = digest_file(path)
        except (OSError, ToolkitError):
            return ""
        if time.time() - max(status.st_mtime, status.st_ctime) > _SETTLED_S:
            self._kept[name] = _Kept(state, digest)
            self._new = True
        return digest

    def keep(self) -> None:
        """Write what was read since; without room for it the next run reads the files again."""
        if self._new:
            write_bytes_atomic(self.path, msgspec.json.encode(self._kept))
            self._new = False


def content_table(frames: Iterable[tuple[int, FrameKey, Inputs]], digests: Digests) -> pd.DataFrame:
    """Return a row for each frame and content, with the columns `COLUMNS`.

    Args:
        frames: index, names and inputs of each frame.
        digests: of files; kept afterwards.
    """
    listed = [(i, *key, what, value) for i, key, inputs in frames for what, value in inputs.items()]
    found = digests.of(value for *_, value in listed if isinstance(value, Path))
    digests.keep()
    rows = [
        (*names, found[value] if isinstance(value, Path) else value) for *names, value in listed
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def data_digest(content: pd.DataFrame) -> str:
    """Return one digest of all content of a data set; answers of methods are no part of it."""
    rows = _of_data(content)[[SCENE, FRAME, CONTENT, DIGEST]]
    return digest_of(rows.to_numpy().tolist(), versioned=False)


def answers_digest(content: pd.DataFrame) -> str:
    """Return one digest of all saved answers that were read; "" without any."""
    rows = content[are_answers(content) & (content[DIGEST] != "")]
    values = rows[[SCENE, FRAME, CONTENT, DIGEST]].to_numpy().tolist()
    return digest_of(values, versioned=False) if values else ""


def changed_content(then: pd.DataFrame, now: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of `now` whose content is not that of `then`, and those that only one has."""
    keys = [INDEX, SCENE, FRAME, CONTENT]
    both = then.merge(now, on=keys, how="outer", suffixes=("_then", "_now"))
    other = both[f"{DIGEST}_then"].fillna("-") != both[f"{DIGEST}_now"].fillna("-")
    return both.loc[other, keys].sort_values(INDEX, kind="stable", ignore_index=True)


def tell_changes(changed: pd.DataFrame, most: int = 3) -> str:
    """Return the names of changed content, for people.

    >>> rows = [(0, "a", "0000", "mask", ""), (1, "a", "0001", "mask", "")]
    >>> tell_changes(pd.DataFrame(rows, columns=list(COLUMNS)))
    'mask of a/0000, a/0001'
    """
    parts = []
    for what, rows in changed.groupby(CONTENT, sort=False):
        names = [f"{scene}/{name}" for scene, name in zip(rows[SCENE], rows[FRAME], strict=True)]
        more = f" and {len(names) - most} more frames" if len(names) > most else ""
        parts.append(f"{what} of {', '.join(names[:most])}{more}")
    return "; ".join(parts)


def is_same_data(one: pd.DataFrame, two: pd.DataFrame) -> bool:
    """Whether two tables have frames in common, and everything that both have is equal."""
    keys = [SCENE, FRAME, CONTENT]
    both = _of_data(one).merge(_of_data(two), on=keys, suffixes=("_one", "_two"))
    return bool(len(both) and (both[f"{DIGEST}_one"] == both[f"{DIGEST}_two"]).all())


def are_answers(content: pd.DataFrame) -> pd.Series:
    """Return whether each row is an answer of a method, and no part of the data set."""
    return content[CONTENT].str.startswith(_SAVED)


def _of_data(content: pd.DataFrame) -> pd.DataFrame:
    return content[~are_answers(content)]


def groups_of(tables: Sequence[pd.DataFrame | None]) -> list[int]:
    """Return the data set of each table of content, by number.

    Args:
        tables: None for results that do not say what they were made of: a data set of their own.
    """
    firsts: list[Any] = []
    found = []
    for table in tables:
        place = next((i for i, first in enumerate(firsts) if _alike(first, table)), len(firsts))
        if place == len(firsts):
            firsts.append(table)
        found.append(place)
    return found


def _alike(one: pd.DataFrame | None, two: pd.DataFrame | None) -> bool:
    if one is None or two is None:
        return one is two
    return is_same_data(one, two)
