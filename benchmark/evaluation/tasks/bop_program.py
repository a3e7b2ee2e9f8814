"""Poses of a program, run on a BOP data set with the default detections.

The program gets a folder with the images to look at (`targets.json`), the views to use together
(`groups.json`, multi-view targets alone) and the detections in them (`detections.json`), and writes
`results.csv` into it. docs/bop.md describes them.
"""

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import msgspec

from benchmark.methods.pose.command import RESULTS
from benchmark.methods.program import run_program
from benchmark.metrics.bop import BopDataset, read_bop_results
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import (
    decode_document,
    digest_file,
    digest_of,
    read_document,
    write_document,
)
from std_toolkit.io.regular import MIB, read_regular
from std_toolkit.log import logger

FOLDER = "programs"
_RECORD, _TARGETS, _GROUPS, _DETECTIONS = (
    "record.json", "targets.json", "groups.json", "detections.json",
)  # fmt: skip
# Those of a whole data set with masks are large.
_LARGEST_BYTES = 2048 * MIB
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*")
_Number = Annotated[int, msgspec.Meta(ge=0, le=999_999)]


class Detection(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """An entry of a detection file of the BOP Challenge, as its servers give them.

    Attributes:
        scene_id, image_id, category_id: numbers of the scene, the image and the object.
        score: confidence.
        bbox: x, y of the upper left corner, width and height, pixels.
        segmentation: mask in COCO's run lengths, passed on as it is.
        time: seconds that the whole image took.
    """

    scene_id: _Number
    image_id: _Number
    category_id: _Number
    score: float
    bbox: Annotated[list[float], msgspec.Meta(min_length=4, max_length=4)]
    segmentation: msgspec.Raw = msgspec.Raw(b"null")
    time: float = -1.0


class _Record(msgspec.Struct, frozen=True, kw_only=True):
    """What the results of a program were made from."""

    digest: str


def read_detections(path: Path) -> list[Detection]:
    """Read a detection file.

    Args:
        path: of the JSON file.

    Returns:
        The detections in the order of the file.

    Raises:
        ToolkitError: it cannot be read, or an entry breaks the format.
    """
    data = read_regular(path, "detections", _LARGEST_BYTES)
    found = decode_document(data, list[Detection], path=path)
    for k, d in enumerate(found):
        if not (d.bbox[2] > 0 and d.bbox[3] > 0):
            raise ToolkitError("a box needs a width and a height", path=path,
                               field=f"[{k}].bbox", value=d.bbox)  # fmt: skip
    return found


def run_on(
    dataset: BopDataset,
    program: str,
    out: Path,
    *,
    detections: Path | None,
    timeout_s: float,
) -> Path:
    """Run a program on the images that are scored, unless it has answered the same before.

    Args:
        dataset: the data set.
        program: NAME=COMMAND; `{folder}` and `{data}` in it are the folder of the exchange, which
            is otherwise the last argument, and the data set.
        out: folder of results.
        detections: file of detections of the data set; those of other images are left out.
        timeout_s: seconds after which the program is stopped.

    Returns:
        The result file, `NAME_DATA-SPLIT.csv`.

    Raises:
        ToolkitError: the command cannot be run, fails or writes no results, or a file is damaged.
    """
    name, words = _parsed(program)
    images = sorted({*dataset.images, *((t.scene_id, t.im_id) for t in dataset.targets)})
    title = f"{name}_{dataset.root.resolve().name}-{dataset.split}"
    results, folder = out / FOLDER / f"{title}.csv", (out / FOLDER / title).resolve()
    given = None if detections is None else digest_file(detections)
    groups = msgspec.to_builtins(dataset.groups)
    scripts = [digest_file(Path(word)) for word in words if Path(word).is_file()]
    pictures = _pictures(dataset, images)
    record = _Record(digest=digest_of(words, scripts, images, groups, given, pictures))
    old = folder / _RECORD
    if results.is_file() and old.is_file() and read_document(old, _Record) == record:
        logger.info("%s: kept, the program has answered the same before", results)
        return results
    folder.mkdir(parents=True, exist_ok=True)
    for earlier in (_RECORD, _GROUPS, _DETECTIONS, RESULTS):
        (folder / earlier).unlink(missing_ok=True)
    write_document(folder / _TARGETS, [{"scene_id": s, "im_id": i} for s, i in images])
    if groups:
        write_document(folder / _GROUPS, groups)
    if detections is not None:
        _hand_over(detections, folder / _DETECTIONS, set(images), dataset)
    filled = [
        word.replace("{folder}", str(folder)).replace("{data}", str(dataset.root.resolve()))
        for word in words
    ]
    with TemporaryDirectory(prefix="std-program-") as logs:
        run_program(filled, Path(logs), timeout_s, hint="--timeout-s SECONDS", option="--program")
    if not (folder / RESULTS).is_file():
        raise ToolkitError(f"the program wrote no {RESULTS}", path=folder, value=words[0])
    read_bop_results(folder / RESULTS)
    (folder / RESULTS).replace(results)
    write_document(folder / _RECORD, record)
    return results


def _parsed(program: str) -> tuple[str, list[str]]:
    name, equals, command = program.partition("=")
    if not equals or not _NAME.fullmatch(name):
        raise ToolkitError(
            "must be NAME=COMMAND", field="--program", value=program,
            hint="letters, digits, '.', '+' and '-' make a name, as in mine='python poses.py'",
        )  # fmt: skip
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ToolkitError(f"not a command: {error}", field="--program", value=command) from error
    if not words:
        raise ToolkitError("needs a command", field="--program", value=program)
    return name, words if any("{folder}" in word for word in words) else [*words, "{folder}"]


def _pictures(dataset: BopDataset, images: Sequence[tuple[int, int]]) -> dict[str, str]:
    """Digests of what the program may look at: the images of all sensors, and their cameras."""
    by_scene: dict[int, set[str]] = {}
    for scene, image in images:
        by_scene.setdefault(scene, set()).add(f"{image:06d}")
    found: dict[str, str] = {}
    for scene, names in by_scene.items():
        folder = dataset.folder(scene)
        paths = [*folder.glob("scene_camera*.json")]
        paths += [p for p in folder.glob("*/*") if p.stem in names and "mask" not in p.parent.name]
        found |= {str(p.relative_to(dataset.root)): digest_file(p) for p in sorted(paths)}
    return found


def _hand_over(
    source: Path, target: Path, images: set[tuple[int, int]], dataset: BopDataset
) -> None:
    """Write the detections of the images that are scored."""
    found = read_detections(source)
    kept: Sequence[Detection] = [d for d in found if (d.scene_id, d.image_id) in images]
    if not kept:
        raise ToolkitError(
            "no detection is of an image that is scored", path=source, value=len(found),
            hint=f"are they of {dataset.root.name}, {dataset.split}?",
        )  # fmt: skip
    with_one = len({(d.scene_id, d.image_id) for d in kept})
    logger.info(
        "%s: %d of %d detections are of the %d images that are scored; %d of these have none",
        source, len(kept), len(found), len(images), len(images) - with_one,
    )  # fmt: skip
    target.write_bytes(msgspec.json.encode(kept))
