"""The Jinja2 environment of reports, which escapes every text and makes element ids safe."""

from __future__ import annotations

import base64
import re
import zlib
from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Environment


def slug(name: str) -> str:
    """An element id for any name; different names give different ids.

    >>> slug("std-catknown")
    'std-catknown'
    >>> slug("a b")
    'a-b-806c5cd3'
    """
    safe = re.sub(r"[^A-Za-z0-9_-]+", "-", name)
    return safe if safe == name else f"{safe}-{zlib.crc32(name.encode()):08x}"


def relative(href: str) -> str:
    """Check that an address leads to a file of the same site.

    Raises:
        ValueError: it leads elsewhere.

    >>> relative("methods/nearest-1a2b3c4d.html#s-board")
    'methods/nearest-1a2b3c4d.html#s-board'
    """
    if not re.fullmatch(r"(\.\./)?[\w-]+(/[\w-]+)*\.(html|csv|parquet|bib)(#[\w-]+)?", href, re.A):
        raise ValueError(f"no page of this site: {href}")
    return href


@lru_cache(maxsize=1)
def environment() -> Environment:
    """Templates of the folder `templates`, with the filters that they use."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup, escape

    def words(text: str) -> Markup:
        """Escaped text with commands between backticks marked up as code."""
        parts = str(escape(text)).split("`")
        return Markup("").join(
            Markup(f"<code>{part}</code>" if i % 2 else part) for i, part in enumerate(parts)
        )

    found = Environment(
        loader=PackageLoader("std_toolkit.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters["words"] = words
    found.filters["slug"] = slug
    found.filters["relative"] = relative
    found.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    return found
