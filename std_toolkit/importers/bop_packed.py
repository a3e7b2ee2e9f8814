"""BOP data sets whose images are files of their own names: BOP-imagewise and BOP-webdataset.

Image-wise, a folder has `KEY.rgb.jpg`, `KEY.depth.png`, `KEY.camera.json`, `KEY.gt.json` and
`KEY.gt_info.json` of each image, with KEY = `SCENE_IMAGE`. A WebDataset has the same files in
`shard-*.tar`. Both are laid out as scene folders, which all else reads; masks are left out.

Source: bop_toolkit, docs/bop_datasets_format.md and the converters it names.
"""

import os
import re
import shutil
import tarfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.bop_documents import PICTURE_SUFFIXES
from std_toolkit.io.documents import decode_document, write_document
from std_toolkit.io.regular import MIB, read_regular

_NAME = re.compile(r"(?P<scene>\d{1,6})_(?P<image>\d{1,6})\.(?P<part>[a-z_]+)(?P<suffix>\.[a-z]+)")
_DOCUMENTS = {"camera": "scene_camera", "gt": "scene_gt", "gt_info": "scene_gt_info"}
_PICTURES = ("rgb", "gray", "depth")
_LARGEST_DOCUMENT_BYTES = 16 * MIB
_LARGEST_PICTURE_BYTES = 256 * MIB


def is_packed(folder: Path) -> bool:
    """Whether a folder has image-wise files or shards of a WebDataset, by its names.

    >>> is_packed(Path("/nowhere"))
    False
    """
    try:
        with os.scandir(folder) as entries:
            return any(_is_shard(e.name) or e.name.endswith(".camera.json") for e in entries)
    except OSError:
        return False


def packed_split(source: Path) -> tuple[Path, int | None] | None:
    """The packed folder that a source names, and the scene.

    Args:
        source: such a folder, a data set with one of them, or SOURCE/SCENE with a number.

    Returns:
        The folder, and the scene where the source names one; None if there is none, or if there
        are scene folders beside it.

    Raises:
        ToolkitError: the data set has several.
    """
    if is_packed(source):
        return source, None
    if source.name.isdigit() and not source.exists() and is_packed(source.parent):
        return source.parent, int(source.name)
    if not source.is_dir() or next(source.glob("*/*/scene_camera*.json"), None) is not None:
        return None
    below = [f for f in sorted(source.iterdir()) if is_packed(f)]
    if len(below) > 1:
        names = ", ".join(f.name for f in below)
        raise ToolkitError("several folders of BOP images here", path=source, hint=f"give {names}")
    return (below[0], None) if below else None


def unpack_data_set(split: Path, into: Path, *, scene: int | None = None) -> Path:
    """Lay out a packed split as scene folders, beside links to the rest of its data set.

    Args:
        split: folder of the images or shards.
        into: folder of the new data set, which must not exist.
        scene: only this one.

    Returns:
        The new folder of the split. Image-wise pictures are links to their files.

    Raises:
        ToolkitError: a name, an archive or a document breaks the format, an image comes twice or
            lacks its camera, or there is no such scene.
    """
    into.mkdir(parents=True)
    for entry in split.resolve().parent.iterdir():
        if entry.name.startswith("models") or entry.suffix == ".json":
            (into / entry.name).symlink_to(entry)
    found = into / split.name
    documents: dict[tuple[int, str], dict[str, Any]] = defaultdict(dict)
    seen: set[tuple[int, int, str]] = set()
    for path, match, file in _files(split):
        number, image = int(match["scene"]), int(match["image"])
        if scene is not None and number != scene:
            continue
        part, suffix = match["part"], match["suffix"]
        if (number, image, part) in seen:
            raise ToolkitError("an image comes twice", path=path, value=match.group())
        seen.add((number, image, part))
        if part in _DOCUMENTS and suffix == ".json":
            data = _bytes(file, path, match.group())
            row = decode_document(data, object, path=f"{path}: {match.group()}")
            documents[number, part][str(image)] = row
        elif part in _PICTURES and suffix in PICTURE_SUFFIXES:
            target = found / f"{number:06d}" / part / f"{image:06d}{suffix}"
            _place(file, target)
    _write(documents, found, split, scene)
    return found


def _write(
    documents: dict[tuple[int, str], dict[str, Any]], found: Path, split: Path, scene: int | None
) -> None:
    numbers = sorted({number for number, _ in documents})
    if not numbers:
        raise ToolkitError("no such scene in these files", path=split, value=scene)
    for number in numbers:
        cameras = documents.get((number, "camera"), {})
        for part, name in _DOCUMENTS.items():
            rows = documents.get((number, part))
            if rows is None:
                continue
            alone = next((image for image in rows if image not in cameras), None)
            if alone is not None:
                key = f"{number:06d}_{int(alone):06d}"
                raise ToolkitError("an image lacks its camera", path=split, value=key)
            folder = found / f"{number:06d}"
            folder.mkdir(parents=True, exist_ok=True)
            ordered = sorted(rows.items(), key=lambda row: int(row[0]))
            write_document(folder / f"{name}.json", dict(ordered))


def _is_shard(name: str) -> bool:
    return name.startswith("shard-") and name.endswith(".tar")


def _files(split: Path) -> Iterator[tuple[Path, re.Match[str], Path | IO[bytes]]]:
    """Files of images: where they lie, their names taken apart, and the file or its content."""
    shards = []
    with os.scandir(split) as entries:
        for entry in entries:
            if _is_shard(entry.name):
                shards.append(Path(entry.path))
            elif (match := _NAME.fullmatch(entry.name)) is not None:
                yield split, match, Path(entry.path)
    for shard in sorted(shards):
        yield from _members(shard)


def _members(shard: Path) -> Iterator[tuple[Path, re.Match[str], IO[bytes]]]:
    try:
        with tarfile.open(shard, "r:") as archive:
            for member in archive:
                match = _NAME.fullmatch(member.name)
                if match is None or not member.isfile():
                    raise ToolkitError(
                        "is no file of an image of BOP", path=shard, value=member.name[:80],
                        hint="names are SCENE_IMAGE.PART, such as 000003_000010.rgb.jpg",
                    )  # fmt: skip
                if member.size > _LARGEST_PICTURE_BYTES:
                    raise ToolkitError("too large a file", path=shard, value=member.name)
                file = archive.extractfile(member)
                assert file is not None
                yield shard, match, file
    except (tarfile.TarError, OSError, EOFError) as error:
        raise ToolkitError(f"cannot read the archive: {error}", path=shard) from error


def _bytes(file: Path | IO[bytes], path: Path, name: str) -> bytes:
    if isinstance(file, Path):
        return read_regular(file, "document", _LARGEST_DOCUMENT_BYTES)
    data = file.read(_LARGEST_DOCUMENT_BYTES + 1)
    if len(data) > _LARGEST_DOCUMENT_BYTES:
        raise ToolkitError("too large a document", path=path, value=name)
    return data


def _place(file: Path | IO[bytes], target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(file, Path):
        target.symlink_to(file.resolve())
        return
    with target.open("wb") as copy:
        shutil.copyfileobj(file, copy)
