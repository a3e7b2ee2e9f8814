"""Every text of every document below a folder, replaced by markup, and what a page makes of it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pandas as pd

from std_toolkit.errors import ToolkitError
from std_toolkit.html.templates import environment

MARKUP = "\"'><img src=x onerror=alert(1)></script><script>alert(1)</script>"
QUOTES = "x' onmouseover='alert(1)` style=`javascript:alert(1)\\u003c{{ 7 * 7 }}"
PAYLOADS = (MARKUP, QUOTES)
# Addresses of the page itself, and of pages and files beside it.
_OWN = r"#[\w-]+|data:,|(\.\./)?[\w-]+(/[\w-]+)*\.(html|csv|parquet|bib)(#[\w-]+)?"


@dataclass(frozen=True)
class Field:
    """A text of a document: a value, or a key of an object that is no structure."""

    path: Path
    keys: tuple[str | int, ...]

    def __str__(self) -> str:
        return f"{self.path.name}:{'.'.join(map(str, self.keys))}"

    def replace(self, text: str) -> None:
        """Write the document with this text."""
        if self.path.suffix == ".parquet":
            table = pd.read_parquet(self.path)
            table[self.keys[0]] = text
            table.to_parquet(self.path)
            return
        document = json.loads(self.path.read_text())
        place = document
        for key in self.keys[:-1]:
            place = place[key]
        place[self.keys[-1]] = text
        self.path.write_text(json.dumps(document))


def fields(folder: Path) -> list[Field]:
    """The texts of all JSON documents and Parquet tables below a folder."""
    found = []
    for path in sorted(folder.rglob("*.json")):
        found += [Field(path, keys) for keys in _texts(json.loads(path.read_text()))]
    for path in sorted(folder.rglob("*.parquet")):
        table = pd.read_parquet(path)
        found += [Field(path, (c,)) for c in table if not pd.api.types.is_numeric_dtype(table[c])]
    return found


def _texts(value: Any, at: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    if isinstance(value, str):
        yield at
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _texts(item, (*at, key))
    elif isinstance(value, list):
        for index, item in enumerate(value[:3]):
            yield from _texts(item, (*at, index))


@dataclass
class Tally:
    """What became of the fields: shown on a page without harm, or refused in one line."""

    shown: list[str]
    refused: list[str]


def attack(
    folder: Path,
    read: Callable[[], object],
    make: Callable[[], str],
    *,
    skip: Callable[[Field], bool],
) -> Tally:
    """Replace every text that `read` accepts; the page with all of them must be safe.

    Args:
        folder: documents that `read` and `make` read.
        read: reads the documents, and refuses what they must not have.
        make: makes the page.
        skip: fields that are refused later than on reading.
    """
    tally = Tally([], [])
    texts = [field for field in fields(folder) if not skip(field)]
    before = {field.path: field.path.read_bytes() for field in texts}
    for payload in PAYLOADS:
        for path, content in before.items():
            path.write_bytes(content)
        for field in texts:
            was = field.path.read_bytes()
            field.replace(payload)
            try:
                read()
            except ToolkitError as error:
                assert "\n" not in str(error)
                tally.refused.append(str(field))
                field.path.write_bytes(was)
            else:
                tally.shown.append(str(field))
        assert harm(make()) == []
    return tally


def harm(page: str) -> list[str]:
    """What a page must not have: foreign scripts, handlers, addresses, strange ids."""
    reader = _Reader()
    reader.feed(page)
    reader.close()
    return reader.finish()


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.policies = 0
        self.script: str | None = None
        self.program = environment().get_template("page.js").render()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.policies += given.get("http-equiv") == "Content-Security-Policy"
        for name, value in given.items():
            value = value or ""
            wrong = (
                name.startswith("on")
                or (name == "src" and not value.startswith("data:image/"))
                or (name == "href" and not re.fullmatch(_OWN, value))
                or (name in ("id", "data-plot") and not re.fullmatch(r"[\w-]+", value))
                or (name == "style" and re.search(r"url|expression|javascript|;.*;", value))
            )
            if wrong:
                self.found.append(f"<{tag} {name}={value[:60]!r}>")
        if tag in ("iframe", "object", "embed", "base", "form"):
            self.found.append(f"<{tag}>")
        self.script = "" if tag == "script" and "type" not in given else None
        if tag == "script" and given.get("type") not in (
            None,
            "application/json",
            "application/gzip",
        ):
            self.found.append(f"<script type={given['type']!r}>")

    def handle_data(self, data: str) -> None:
        if self.script is not None:
            self.script += data

    def handle_endtag(self, tag: str) -> None:
        if tag == "script" and self.script is not None:
            if self.script != self.program:
                self.found.append(f"<script>{self.script[:60]}")
            self.script = None

    def finish(self) -> list[str]:
        return [*self.found, *(["no policy"] if self.policies != 1 else [])]
