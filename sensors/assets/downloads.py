"""Free images for floors and light, which are downloaded only where the user asks for it.

`cc0.json` lists them with their checksums. A file whose bytes differ is refused.
"""

import hashlib
import urllib.error
import urllib.request
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import read_document
from std_toolkit.log import logger
from std_toolkit.scene.document import Document

BUILT_IN = Path(__file__).with_name("cc0.json")

_TIMEOUT_S = 60.0


class Download(Document, frozen=True, kw_only=True):
    """A file.

    Attributes:
        name: of the file.
        folder: environments or floors, as the options of the simulator are called.
        url: where it is.
        bytes: its size.
        sha256: of its content, hexadecimal.
        licence: SPDX identifier.
        page: of its author.
    """

    name: Annotated[str, msgspec.Meta(pattern=r"^[\w.-]+$")]
    folder: Literal["environments", "floors"]
    url: str
    bytes: Annotated[int, msgspec.Meta(ge=1)]
    sha256: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
    licence: str
    page: str


class DownloadList(Document, frozen=True, kw_only=True):
    """A list of files, as `cc0.json`."""

    format: Literal["std-sim-assets"] = "std-sim-assets"
    version: Literal[1] = 1
    assets: list[Download]


def load_list(path: Path | None = None) -> list[Download]:
    """The built-in list, or a file of the same form.

    Raises:
        ToolkitError: unreadable; names the file and the field.
    """
    return read_document(path or BUILT_IN, DownloadList).assets


def fetch(out: Path, assets: list[Download]) -> int:
    """Download the files that are not there yet, into OUT/environments and OUT/floors.

    Args:
        out: top folder.
        assets: files of a list.

    Returns:
        The number of new files.

    Raises:
        ToolkitError: a file cannot be downloaded, or has another content than the list says.
    """
    made = 0
    for item in assets:
        path = out / item.folder / item.name
        if path.is_file() and _sum(path.read_bytes()) == item.sha256:
            continue
        data = _download(item)
        if _sum(data) != item.sha256:
            raise ToolkitError(
                f"has another content than the list says ({len(data)} bytes of {item.bytes})",
                field=item.name,
                value=item.url,
                hint="the file has changed since the list was made; nothing was written",
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes_atomic(path, data)
        logger.info("%s (%s, %s)", path, item.licence, item.page)
        made += 1
    return made


def _download(item: Download) -> bytes:
    try:
        with urllib.request.urlopen(item.url, timeout=_TIMEOUT_S) as answer:
            # One byte more than expected tells that it is another file.
            return bytes(answer.read(item.bytes + 1))
    except (urllib.error.URLError, OSError, ValueError) as error:
        raise ToolkitError(
            f"cannot be downloaded: {error}",
            field=item.name,
            value=item.url,
            hint="the simulator works without it: its own maps and floors are procedural",
        ) from error


def _sum(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
