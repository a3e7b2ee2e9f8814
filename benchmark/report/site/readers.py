"""Runs of every task as entries of a site."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmark.data.field.layered_depth import SIZES
from benchmark.evaluation import run_kinds
from benchmark.evaluation.known_data import KnownData, names_of_data, published_size
from benchmark.evaluation.manifest import BOP_MANIFEST, MANIFEST, BopManifest
from benchmark.evaluation.results import Result, read_known, read_table
from benchmark.evaluation.run_kinds import RunKind
from benchmark.evaluation.submission import Submission
from benchmark.evaluation.tasks import bop_results, depth_results, order_run, pose_results
from benchmark.evaluation.tasks.depth_speed import NOT_STATED
from benchmark.evaluation.tasks.grasp_dump import DumpResult
from benchmark.evaluation.verification import VerifiedRun
from benchmark.metrics.pose import get_pose_protocol
from benchmark.metrics.protocols.protocol import get_protocol, protocols
from benchmark.report.leaderboard import BOARD, RANKED_BY
from benchmark.report.parts import pose_board
from benchmark.report.parts.depth_tables import MAIN_SUBSETS
from benchmark.report.parts.published import TASKS
from benchmark.report.site.entries import (
    CITATION,
    NOTHING,
    BoardKey,
    Entry,
    Figure,
    named_apart,
    owners_of,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Column
from std_toolkit.io.documents import digest_of, read_document

# Bootstrap samples of scenes: a board of hundreds of runs is made in a minute.
SAMPLES = 500


def _shares(headings: Mapping[str, str]) -> tuple[Column, ...]:
    """Columns of fractions, shown in percent."""
    return tuple(
        Column(name=name, heading=heading, unit="%", factor=100, lower_is_better=False)
        for name, heading in headings.items()
    )


def _finished(folders: Iterable[Path], kind: RunKind) -> list[Path]:
    found: dict[Path, Path] = {}
    for folder in folders:
        for path in kind.folders(folder):
            found.setdefault(path.resolve(), path)
    return list(found.values())


def _read(folders: Iterable[Path], kind: RunKind) -> list[Any]:
    """Results with the names of their data sets, others for other content."""
    found = [kind.read(path) for path in _finished(folders, kind)]
    places = names_of_data([r.named for r in found], [r.data for r in found])
    return [result.at(place) for result, place in zip(found, places, strict=True)]


def _series(version: str) -> str:
    """The versions of the toolkit whose figures are comparable.

    >>> _series("0.2.1")
    '0.2'
    """
    return ".".join(version.split(".")[:2])


def _scored_frames(result: Result[Any], split: str) -> str:
    """How many frames a run is of, of how many there are."""
    known: KnownData = result.data
    there = published_size(split) if known.is_published else 0
    there = there or (known.record.frames if known.record else 0)
    count = f"{result.frames:,} frame{'' if result.frames == 1 else 's'}"
    return f"{result.frames:,} of {there:,} frames" if result.frames < there else count


def _board(result: Result[Any], task: str, split: str, protocol: str, selection: str) -> BoardKey:
    return BoardKey(
        task=task,
        data=result.place or split,
        protocol=protocol,
        frames=_scored_frames(result, split),
        selection=selection,
        version=_series(result.manifest.version_of_tool),
    )


def _facts(result: Result[Any]) -> dict[str, str]:
    """What is said of a run on frames."""
    manifest, setup, known = result.manifest, result.manifest.setup, result.data
    settings = ", ".join(f"{k}={v}" for k, v in sorted(setup.settings.items()))
    return {
        "method": setup.method,
        "preset": setup.preset,
        "settings": settings or "-",
        "weights (BLAKE2b-128)": setup.weights_sha256 or "-",
        "setup (BLAKE2b-128)": digest_of(setup, versioned=False),
        "precision": f"{setup.precision}, {setup.device}",
        "data (BLAKE2b-128)": known.record.digest if known.record else "not known",
        "frames come from": str(known.provenance),
        "scored on": _machine(manifest.hardware),
        "std-toolkit": manifest.version_of_tool,
        **_said(result),
    }


def _said(result: Result[Any]) -> dict[str, str]:
    """What the run or the author of predictions says of the method, unchecked."""
    said = result.said or Submission()
    size = f" at {said.width}x{said.height}" if said.width and said.height else ""
    machine = [said.hardware, said.device, f"{said.cores} cores" if said.cores else ""]
    seconds = said.seconds_per_frame
    facts = {
        "trained on": result.training_data,
        "predicted on, as its author says": ", ".join(filter(None, machine)),
        "time per frame, as its author says": f"{seconds:g} s{size}" if seconds else "",
        CITATION: said.citation,
    }
    return {name: text for name, text in facts.items() if text}


def _published(result: Result[Any], task: str) -> dict[str, Any]:
    """What says which published figures are of the same frames; nothing of a part of them."""
    split = result.manifest.setup.split
    if not result.data.is_published or result.frames < published_size(split):
        return {}
    return {"published_split": split, "published_tasks": TASKS[task]}


def _machine(hardware: Mapping[str, str]) -> str:
    return hardware.get("gpus") or hardware.get("processor", "")


def _depth(folders: Sequence[Path]) -> Iterator[Entry]:
    known = protocols.names()
    for result in _read(folders, run_kinds.DEPTH):
        setup = result.manifest.setup
        if setup.protocol not in known:
            raise ToolkitError(
                "is no protocol of this toolkit", path=result.folder / MANIFEST,
                field="setup.protocol", value=setup.protocol,
            )  # fmt: skip
        grid, first = get_protocol(setup.protocol).main
        rows = result.table[result.table["grid"] == grid]
        wanted = tuple(dict.fromkeys((first, *MAIN_SUBSETS)))
        means = depth_results.summarise(
            rows[rows["subset"].isin(wanted)], by=("subset",), samples=SAMPLES
        ).set_index("subset")
        means = means[means["frames"] > 0]
        figures = {s: _of_row(means.loc[s], BOARD) for s in wanted if s in means.index}
        said = {"depth from": setup.depth_from, "networks run by": setup.backend}
        extra = {name: text for name, text in said.items() if text}
        yield Entry(
            board=_board(result, "depth restoration", setup.split, setup.protocol,
                         setup.frames_sha256),
            method=result.manifest.label,
            columns=BOARD,
            ranked_by=RANKED_BY,
            figures=figures or {first: {}},
            unanswered=result.missing + result.failed,
            facts=_facts(result) | extra,
            uses=(setup.method, setup.split, setup.protocol),
            folder=result.folder,
            digest=run_kinds.DEPTH.digest(result.folder),
            frames=result.frames,
            scenes=int(rows["scene"].nunique()),
            speed_class=result.speed_class,
            speed=result.speed,
            **_published(result, "depth"),
        )  # fmt: skip


def _of_row(row: Any, columns: Sequence[Column]) -> dict[str, Figure]:
    return {
        c.name: (float(row[c.name]), float(row[f"{c.name}_low"]), float(row[f"{c.name}_high"]))
        for c in columns
    }


def _pose(folders: Sequence[Path]) -> Iterator[Entry]:
    for result in _read(folders, run_kinds.POSE):
        setup = result.manifest.setup
        method, depth, fit = result.name
        for name in pose_board.PROTOCOLS:
            protocol = get_pose_protocol(name)
            figures = {}
            scenes = 0
            for subset in pose_board.TABLES:
                scored = pose_results.score_run(result, protocol, subset, samples=SAMPLES)
                if scored.objects:
                    figures[subset] = {
                        c: (v, *scored.interval(c)) for c, v in scored.figures.items()
                    }
                scenes = max(scenes, scored.scene_count)
            yield Entry(
                board=_board(result, "object poses", setup.split, name, setup.frames_sha256),
                method=f"{method} on {depth} depth, {fit}",
                columns=[c for c in pose_board.FIGURES if c.name in protocol.columns],
                ranked_by=pose_board.MAIN,
                figures=figures or {pose_results.ALL: {}},
                unanswered=result.missing + result.failed,
                facts=_facts(result) | {"depth": setup.depth},
                uses=(setup.method, setup.split, name, setup.depth),
                folder=result.folder,
                digest=run_kinds.POSE.digest(result.folder),
                frames=result.frames,
                scenes=scenes,
                is_bound=result.given_truth or setup.depth == pose_board.TRUE,
                speed_class="gpu" if setup.device == "cuda" else NOT_STATED,
                **_published(result, "pose"),
            )


_BOP = _shares(bop_results.SHOWN)


def _bop(folders: Sequence[Path]) -> Iterator[Entry]:
    places = _finished(folders, run_kinds.BOP)
    read = [run_kinds.BOP.read(place) for place in places]
    known = [read_known(place) for place in places]
    names = names_of_data([r.place for r in read], known)
    for place, result, data, name in zip(places, read, known, names, strict=True):
        manifest = read_document(place / BOP_MANIFEST, BopManifest)
        setup = manifest.setup
        table = read_table(place / bop_results.ERRORS)
        figures = {
            c.name: (
                NOTHING[0] if (value := getattr(result, c.name)) is None else value,
                *result.intervals.get(c.name, NOTHING[1:]),
            )
            for c in _BOP
        }
        yield Entry(
            board=BoardKey("instance poses (BOP)", name, ", ".join(setup.errors),
                           f"{setup.targets:,} targets", setup.targets_sha256,
                           _series(manifest.version_of_tool)),
            method=setup.results,
            columns=_BOP,
            ranked_by="ar" if result.ar is not None else "ar_mssd",
            figures={"all": figures},
            unanswered=0,
            facts={
                "results (SHA-256)": setup.results_sha256,
                "setup (BLAKE2b-128)": digest_of(setup, versioned=False),
                "data (BLAKE2b-128)": data.record.digest if data.record else "not known",
                "frames come from": str(data.provenance),
                "seconds per image": f"{result.seconds_per_image or float('nan'):.2f}",
                "std-toolkit": manifest.version_of_tool,
            },
            uses=("bop",),
            folder=place,
            digest=run_kinds.BOP.digest(place),
            frames=int(table["index"].nunique()),
            scenes=int(table["scene"].nunique()),
        )  # fmt: skip


_GRASPS = _shares({
    "completion_objects": "completion per object", "completion_tables": "per table",
    "success_attempts": "success per attempt", "cleared": "tables cleared",
})  # fmt: skip


def _grasp(folders: Sequence[Path]) -> Iterator[Entry]:
    for result in _read(folders, run_kinds.GRASP):
        manifest, setup = result.manifest, result.manifest.setup
        shown, seed, planner, depth = result.name
        rates = {c.name: getattr(result.rates, c.name) for c in _GRASPS}
        tables = digest_of(setup.scenes_sha256, setup.meshes_sha256, setup.limits, setup.attempts,
                           setup.move, setup.depth_model_sha256, result.frames,
                           versioned=False)  # fmt: skip
        yield Entry(
            board=BoardKey("table clearing", f"{shown} camera, seed {seed}", setup.move,
                           f"{result.frames} tables", tables, _series(manifest.version_of_tool)),
            method=f"{planner} on {depth} depth",
            columns=_GRASPS,
            ranked_by=_GRASPS[0].name,
            figures={"all": {n: (r.value, r.low, r.high) for n, r in rates.items()}},
            unanswered=0,
            facts={
                "planner": f"{setup.planner}, {setup.planner_preset}",
                "weights (BLAKE2b-128)": setup.planner_weights_sha256 or "-",
                "depth": f"{setup.depth}, {setup.depth_preset}".rstrip(", "),
                "setup (BLAKE2b-128)": digest_of(setup, versioned=False),
                "frames come from": "simulated",
                "scored on": _machine(manifest.hardware),
                "std-toolkit": manifest.version_of_tool,
            },
            uses=(setup.planner, setup.depth),
            folder=result.folder,
            digest=run_kinds.GRASP.digest(result.folder),
            frames=result.frames,
            scenes=result.frames,
            is_bound=setup.depth == pose_board.TRUE or setup.planner == "oracle",
            speed_class="gpu" if setup.device == "cuda" else NOT_STATED,
        )  # fmt: skip


_DUMPS = tuple(
    Column(name=name, heading=heading, unit="%", digits=2, lower_is_better=False)
    for name, heading in (("ap", "AP"), ("ap08", "AP0.8"), ("ap04", "AP0.4"), ("seen", "seen"),
                          ("similar", "similar"), ("novel", "novel"))
)  # fmt: skip


def _dump(folders: Sequence[Path]) -> Iterator[Entry]:
    results: list[DumpResult] = _read(folders, run_kinds.DUMP)
    for result in results:
        manifest, setup = result.manifest, result.manifest.setup
        figures = result.figures
        selection = digest_of(setup.split, setup.camera, setup.frames, versioned=False)
        yield Entry(
            board=BoardKey("grasps in files", f"GraspNet {result.place}, {setup.camera}",
                           f"{setup.contacts} contacts", f"{setup.frames:,} images", selection,
                           _series(manifest.version_of_tool)),
            method=manifest.label,
            columns=_DUMPS,
            ranked_by="ap",
            figures={"all": {c.name: getattr(figures, c.name) or NOTHING for c in _DUMPS}},
            unanswered=figures.unanswered,
            facts={
                "setup (BLAKE2b-128)": digest_of(setup, versioned=False),
                "data (BLAKE2b-128)":
                    result.data.record.digest if result.data.record else "not known",
                "frames come from": str(result.data.provenance),
                "std-toolkit": manifest.version_of_tool,
                **_said(result),
            },
            uses=("graspnet",),
            folder=result.folder,
            digest=run_kinds.DUMP.digest(result.folder),
            frames=setup.frames,
            scenes=int(result.table["scene"].nunique()),
        )  # fmt: skip


_ORDERS = _shares({size: size for size in SIZES})


def _order(folders: Sequence[Path]) -> Iterator[Entry]:
    results: list[order_run.OrderResult] = _read(folders, run_kinds.ORDER)
    for result in results:
        manifest, setup = result.manifest, result.manifest.setup
        figures: dict[str, dict[str, Figure]] = {order_run.ALL: {}}
        for (size, layer), share in result.shares(SAMPLES).items():
            figures.setdefault(layer, {})[size] = share
        yield Entry(
            board=_board(result, "order of points", setup.split, setup.subset,
                         setup.frames_sha256),
            method=manifest.label,
            columns=_ORDERS,
            ranked_by="quads" if "quads" in figures[order_run.ALL] else "pairs",
            figures=figures,
            unanswered=result.missing + result.failed,
            facts={
                "files count layers": setup.layers,
                ".npy holds": setup.npy,
                "setup (BLAKE2b-128)": digest_of(setup, versioned=False),
                "data (BLAKE2b-128)":
                    result.data.record.digest if result.data.record else "not known",
                "std-toolkit": manifest.version_of_tool,
                **_said(result),
            },
            uses=("layered-depth",),
            folder=result.folder,
            digest=run_kinds.ORDER.digest(result.folder),
            frames=result.frames,
            scenes=int(result.table["scene"].nunique()),
        )  # fmt: skip


def collect(folders: Sequence[Path], grades: Mapping[str, VerifiedRun]) -> list[Entry]:
    """Read all finished runs below folders of results.

    Args:
        folders: of one or several people.
        grades: what is known of runs, by digest.

    Raises:
        ToolkitError: a folder has no finished run, or one that cannot be read.
    """
    found: list[Entry] = []
    for make in (_depth, _pose, _grasp, _dump, _order, _bop):
        found += make(folders)
    owners = owners_of(folders)
    entries = []
    for entry in found:
        top = next(f for f in folders if entry.folder.resolve().is_relative_to(f.resolve()))
        entries.append(replace(entry, owner=owners[top], verified=grades.get(entry.digest)))
    for folder in folders:
        if not any(entry.owner == owners[folder] for entry in entries):
            raise ToolkitError("no finished run of std-bench here", path=folder)
    return named_apart(entries)
