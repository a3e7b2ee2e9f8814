"""All objects of a recording: a folder with a model for each, an overview, and `library.json`."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.html.page import (
    Block,
    Bullets,
    Figure,
    Gallery,
    Links,
    Page,
    Paragraph,
    Picture,
    Section,
    Verdict,
)
from std_toolkit.html.table import text_table
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import digest_of, write_document
from std_toolkit.io.images import write_color
from std_toolkit.jobs.artefact import read_record
from std_toolkit.jobs.door import check_own, output, own_files
from std_toolkit.jobs.outcome import error_of
from std_toolkit.log import logger
from std_toolkit.scanning.clock import STAGES, Clock
from std_toolkit.scanning.masks.object_masks import Things
from std_toolkit.scanning.masks.outlines import candidate_picture
from std_toolkit.scanning.masks.standing import choose_candidate
from std_toolkit.scanning.model.report import mesh_panels
from std_toolkit.scanning.model.write_model import Scan, file_names
from std_toolkit.scanning.options import LIMITS, MODEL_FOLDER, ScanOptions
from std_toolkit.scanning.preview import PREVIEW, remove_preview
from std_toolkit.scanning.scan_step import pose_step, prepare, scan_object
from std_toolkit.scanning.surface.depth_maps import depth_engine
from std_toolkit.settings import changed

LIBRARY = "library.json"

# Stages of the whole recording, and of each object; usual seconds as in `STAGES`.
_SHARED = {"poses": STAGES["poses"], "objects": 8.0}
_OF_EACH = {name: seconds for name, seconds in STAGES.items() if name != "poses"}

# Options that change a model.
_DECIDING = ("faces", "texture", "voxels", "neighbours", "depth")


class LibraryObject(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An object of a library.

    Attributes:
        name: of its folder and its model.
        mesh: OBJ file, relative to the library; "" if there is none.
        pick: photo and pixel that `std-scan --pick` scans it alone by.
        status: "waiting": it was not scanned yet; "done"; "unusable": the mesh is there to look at
            and must not be used; "failed": there is no mesh.
        problem: why it is unusable or failed.
        warnings: what to photograph again.
        digest: of all that determines the model.
    """

    name: str
    mesh: str
    pick: str
    status: Literal["waiting", "done", "unusable", "failed"]
    problem: str = ""
    warnings: list[str] = []
    digest: str = ""


class Library(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`library.json`.

    Attributes:
        tool: program and version.
        objects: largest first.
    """

    tool: str
    objects: list[LibraryObject]


def scan_all(options: ScanOptions) -> Library:
    """Make models of all objects on the board, as `std-scan --all` does.

    Photos, poses and the comparison with the table are shared. An object that fails does not stop
    the others. What is finished is kept by a run that resumes.

    Args:
        options: with `all_objects`; `out` is the folder of the library.

    Returns:
        What became of each object; all are written to `library.json` and `report.html`.

    Raises:
        ToolkitError: the photos do not suffice, nothing stands on the board, `names` are not as
            many as there are objects, or a file of the user is in the way.
    """
    with output(options.out, MODEL_FOLDER, "std-scan photos"):
        if (options.out / "scan.json").exists():
            raise ToolkitError(
                "holds the model of one object", path=options.out,
                hint="choose another folder, or leave --all out",
            )  # fmt: skip
        check_own(options.out, (LIBRARY, "report.html", PREVIEW))
        work = options.out / ".scan"
        work.mkdir(exist_ok=True)
        return _scan_all(options, work)


def _scan_all(options: ScanOptions, work: Path) -> Library:
    # Unknown engines are refused before minutes are spent.
    depth_engine(options.depth)
    clock = Clock(work, _SHARED)
    posed = pose_step(options, work, clock.lap)
    things = Things(posed, options.jobs.worker_count)
    count = len(things.standing.candidates)
    if not count:
        choose_candidate([], posed.views)
    names = _names(options, count)
    clock.more = count * sum(_OF_EACH.values())
    parts = [
        replace(options, all_objects=False, names=(), pick=pick, out=options.out / name)
        for name, pick in zip(names, things.picks(), strict=True)
    ]
    for part in parts:
        # A file of the user in one of the folders is found before minutes are spent.
        with output(part.out, MODEL_FOLDER, "std-scan photos"):
            prepare(part)
    things.draw(options.out / "candidates.jpg", names)
    clock.lap("objects")
    digests = [
        digest_of(posed.digest, part.pick, [getattr(part, name) for name in _DECIDING],
                  changed(*LIMITS), __version__)
        for part in parts
    ]  # fmt: skip
    rows = [
        LibraryObject(name=name, mesh="", pick=str(part.pick), status="waiting")
        for name, part in zip(names, parts, strict=True)
    ]
    before = {one.digest: one for one in _finished(options.out)}
    for n, (part, digest) in enumerate(zip(parts, digests, strict=True)):
        kept = before.get(digest)
        if kept is not None and kept.name == rows[n].name:
            logger.info("%s: kept", kept.name)
            rows[n] = kept
            continue
        more = (count - n - 1) * sum(_OF_EACH.values())
        logger.info("%s: object %d of %d", rows[n].name, n + 1, count)
        _write(options.out, rows)
        rows[n] = _one(
            part, things, n, rows[n], Clock(part.out / ".scan", _OF_EACH, more=more), digest
        )
    remove_preview(options)
    return _write(options.out, rows)


def _names(options: ScanOptions, count: int) -> list[str]:
    if not options.names:
        return [f"object_{n}" for n in range(1, count + 1)]
    if len(options.names) != count:
        raise ToolkitError(
            f"{len(options.names)} names for {count} objects", field="--names",
            value=" ".join(options.names),
            hint="run without --names to see the objects; candidates.jpg numbers them",
        )  # fmt: skip
    return list(options.names)


def _finished(folder: Path) -> Iterable[LibraryObject]:
    """Objects of an earlier run whose models are complete."""
    library = read_record(folder / LIBRARY, Library)
    for one in [] if library is None else library.objects:
        files = [folder / one.name / name for name in file_names(one.name)]
        if one.status in ("done", "unusable") and all(
            path.is_file() for path in [*files, _picture(folder, one.name)]
        ):
            yield one


def _picture(folder: Path, name: str) -> Path:
    return folder / ".scan" / f"{name}.jpg"


def _one(
    part: ScanOptions, things: Things, number: int, row: LibraryObject, clock: Clock, digest: str
) -> LibraryObject:
    """Scan one object; its errors are those of this object."""
    shown = things.shown[number]
    view = things.posed.views[shown.photo]
    own = replace(
        things.posed, facts=dict(things.posed.facts), warnings=list(things.posed.warnings)
    )
    tile = candidate_picture(shown, view, "")
    try:
        with output(part.out, MODEL_FOLDER, "std-scan photos"):
            work, known = prepare(part)
            scan = scan_object(part, own, work, known, clock, things)
            tile = _beside(tile, scan, view.name)
    except Exception as error:
        logger.debug("%s", row.name, exc_info=True)
        problem = str(error_of(error).error)
        logger.error("%s: failed: %s", row.name, problem)
        row = msgspec.structs.replace(row, status="failed", problem=problem)
    else:
        row = msgspec.structs.replace(
            row, mesh=f"{row.name}/{row.name}.obj", digest=digest, warnings=list(scan.warnings),
            status="unusable" if scan.faults else "done", problem="; ".join(scan.faults),
        )  # fmt: skip
    write_color(_picture(part.out.parent, row.name), tile)
    return row


def _beside(tile: NDArray[np.uint8], scan: Scan, photo: str) -> NDArray[np.uint8]:
    """The candidate in its photo, and the mesh from there, with its texture and without."""
    import cv2

    height = tile.shape[0]
    panels = [
        cv2.resize(p, (max(1, round(height * p.shape[1] / p.shape[0])), height))
        for p in mesh_panels(scan, photo)
    ]
    return np.hstack([tile, *panels]).astype(np.uint8)


def _write(folder: Path, rows: Sequence[LibraryObject]) -> Library:
    """Write `library.json` and the overview."""
    library = Library(tool=f"std-toolkit {__version__}", objects=list(rows))
    with own_files(folder, (LIBRARY, "report.html")):
        write_document(folder / LIBRARY, library)
        write_bytes_atomic(folder / "report.html", _page(folder, rows).html().encode())
    return library


_STATES: Mapping[str, Literal["pass", "fail", ""]] = {
    "done": "pass", "unusable": "fail", "failed": "fail", "waiting": "",
}  # fmt: skip


def _page(folder: Path, rows: Sequence[LibraryObject]) -> Page:
    """The overview."""
    sections = []
    for row in rows:
        blocks: list[Block] = []
        if row.mesh:
            blocks.append(Links([(f"report of {row.name}", f"{row.name}/report.html")]))
        picture = _picture(folder, row.name)
        if row.status != "waiting" and picture.is_file():
            blocks.append(Gallery([Figure(Picture.read(picture.parent, picture.name))]))
        told = [Paragraph(row.problem, lead=row.status, tone="bad")] if row.problem else []
        blocks.append(Bullets([*told, *(Paragraph(w) for w in row.warnings)]))
        blocks.append(Paragraph(f"Alone: --pick {row.pick}"))
        sections.append(Section(row.name, row.name, blocks))
    table: list[Any] = [[row.name, row.status, row.mesh or "-", row.pick] for row in rows]
    return Page(
        kind="Scan",
        title=folder.resolve().name,
        footer=f"std-scan --all, std-toolkit {__version__}",
        verdicts=[Verdict(f"{r.name}: {r.status}", r.status, _STATES[r.status]) for r in rows],
        intro=[
            Paragraph(
                "All objects that stand on the board, largest first. Label the recording with "
                "them: std-annotate SCENE --meshes and this folder."
            ),
            text_table(["object", "status", "mesh", "pick"], table, texts=4),
        ],
        sections=sections,
    )


def in_total(library: Library) -> str:
    """What became of all objects, in one line."""
    count = {state: sum(o.status == state for o in library.objects) for state in _STATES}
    return ", ".join(f"{n} {state}" for state, n in count.items() if n)
