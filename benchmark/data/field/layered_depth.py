"""LayeredDepth: photos of glass, with the order of the depth of points on its layers.

<root>/[any/]0.image.png, 0.tuples.json        unpacked, or members of *.tar

Layers are 1, 3, 5 and 7: every surface that a ray enters or leaves, nearest first. There is no
depth, no camera and no raw depth: this set is no split, and `std-bench order` alone scores it.

Source: README and `evaluate.py` of github.com/princeton-vl/LayeredDepth. Not checked on the
authors' files.
"""

import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec

from benchmark.data.prediction_files import names_in
from std_toolkit.errors import ToolkitError
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.io.documents import decode_document, digest_bytes
from std_toolkit.io.image_header import header_of
from std_toolkit.io.regular import MIB, open_regular_file, read_regular

Subset = Literal["layer_first", "layer_all"]

PAGE = "https://huggingface.co/datasets/princeton-vl/LayeredDepth"
LAYERS = (1, 3, 5, 7)
SIZES = ("pairs", "trips", "quads")
_IMAGE, _TUPLES = ".image.png", ".tuples.json"
_LARGEST_FILE = 64 * MIB
_LARGEST_TAR = 2**40
_MOST_MEMBERS = 100_000

# Column, row and layer.
Point = tuple[int, int, int]


class OrderedPoints(msgspec.Struct, frozen=True):
    """Points from near to far; with `is_real` false, places whose layer does not exist."""

    p1: Point
    p2: Point | None = None
    p3: Point | None = None
    p4: Point | None = None
    is_real: bool = True

    @property
    def points(self) -> list[Point]:
        """The points that are given, in order."""
        return [p for p in (self.p1, self.p2, self.p3, self.p4) if p is not None]

    @property
    def layer(self) -> str:
        """The layer of all points, or "mixed"."""
        found = {layer for _, _, layer in self.points}
        return str(found.pop()) if len(found) == 1 else "mixed"


class _Sizes(msgspec.Struct, frozen=True):
    pairs: list[OrderedPoints] = []
    trips: list[OrderedPoints] = []
    quads: list[OrderedPoints] = []


class _Document(msgspec.Struct, frozen=True):
    layer_all: _Sizes | None = None
    layer_first: _Sizes | None = None


@dataclass(frozen=True)
class OrderedPhoto:
    """A photo and what is known of it.

    Attributes:
        key: name, a number in the published set.
        size: (width, height) of the photo.
        tuples: by "pairs", "trips" and "quads"; those with a point outside the photo, or of a layer
            that there is not, are left out, as in the authors' program.
        left_out: how many those are.
        digests: of the image and of the tuples, by content.
    """

    key: str
    size: tuple[int, int]
    tuples: dict[str, list[OrderedPoints]]
    left_out: int
    digests: dict[str, str]


def read_photos(root: Path, subset: Subset) -> list[OrderedPhoto]:
    """Read the order of points of all photos.

    Args:
        root: folder of the unpacked files or of the archives, or one above it.
        subset: first surfaces only, or all.

    Raises:
        ToolkitError: nothing is there, a file is damaged, or a photo lacks its image or its tuples.
    """
    sizes: dict[str, tuple[int, int]] = {}
    documents: dict[str, tuple[_Document, Path]] = {}
    digests: dict[str, dict[str, str]] = {}
    for name, data, path in _files(root):
        file = Path(name).name
        table: dict[str, Any]
        found: Any
        if file.endswith(_IMAGE):
            header = header_of(data, path)  # images themselves are not kept
            key, table, found = file.removesuffix(_IMAGE), sizes, (header.width, header.height)
        else:
            document = decode_document(data, _Document, path=path)
            key, table, found = file.removesuffix(_TUPLES), documents, (document, path)
        if key in table:  # of another part, whose photos have the same numbers
            raise ToolkitError(
                "two files of one photo", path=path, value=file,
                hint="give the folder of one part; keep the archives or the unpacked files",
            )  # fmt: skip
        table[key] = found
        kind = "image" if table is sizes else "tuples"
        digests.setdefault(key, {})[kind] = digest_bytes(data)
    if not (sizes or documents):
        raise ToolkitError(
            "no photo of LayeredDepth is here", path=root,
            hint=f"expected 0{_IMAGE} and 0{_TUPLES}, or *.tar of them; page: {PAGE}",
        )  # fmt: skip
    for ending, there in ((_IMAGE, sizes), (_TUPLES, documents)):
        lacking = sorted({*sizes, *documents} - set(there), key=natural_key)
        if lacking:
            raise ToolkitError("the photo lacks a file", path=root, value=f"{lacking[0]}{ending}")
    return [
        _photo(key, sizes[key], *documents[key], subset, digests[key])
        for key in sorted(sizes, key=natural_key)
    ]


def _photo(
    key: str,
    size: tuple[int, int],
    document: _Document,
    path: Path,
    subset: Subset,
    digests: dict[str, str],
) -> OrderedPhoto:
    filed: _Sizes | None = getattr(document, subset)
    if filed is None:
        raise ToolkitError("the field is missing", path=path, field=f"{key} {subset}")
    tuples: dict[str, list[OrderedPoints]] = {}
    left_out = 0
    for name in SIZES:
        listed: list[OrderedPoints] = getattr(filed, name)
        tuples[name] = [
            one for one in listed
            if all(0 <= x < size[0] and 0 <= y < size[1] and layer in LAYERS
                   for x, y, layer in one.points)
        ]  # fmt: skip
        left_out += len(listed) - len(tuples[name])
    return OrderedPhoto(key, size, tuples, left_out, digests)


def _files(root: Path) -> Iterator[tuple[str, bytes, Path]]:
    """Names, contents, and the files that they are in."""
    for place in (root, *sorted(p for p in map(root.joinpath, names_in(root)) if p.is_dir())):
        for path in (place / name for name in sorted(names_in(place), key=natural_key)):
            if path.name.endswith((_IMAGE, _TUPLES)):
                yield path.name, read_regular(path, "file", _LARGEST_FILE), path
            elif path.suffix == ".tar":
                yield from ((name, data, path) for name, data in _members(path))


def _members(path: Path) -> Iterator[tuple[str, bytes]]:
    """Members of an archive, read where they lie: nothing is unpacked to the disk."""
    try:
        with (
            open_regular_file(path, "archive", _LARGEST_TAR) as file,
            tarfile.open(fileobj=file, mode="r:") as archive,
        ):
            for count, member in enumerate(archive):
                if count >= _MOST_MEMBERS:
                    raise ToolkitError(f"more than {_MOST_MEMBERS} members", path=path)
                if not member.isfile() or not member.name.endswith((_IMAGE, _TUPLES)):
                    continue
                if member.size > _LARGEST_FILE:
                    problem = "a member is implausibly large"
                    raise ToolkitError(problem, path=path, value=member.name[:60])
                content = archive.extractfile(member)
                yield member.name, b"" if content is None else content.read()
    except (tarfile.TarError, OSError, ValueError) as error:
        if isinstance(error, ToolkitError):
            raise
        line = " ".join(str(error).split())[:160]
        raise ToolkitError(f"not a readable archive: {line}", path=path) from error
