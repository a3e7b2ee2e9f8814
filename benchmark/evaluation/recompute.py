"""Rows of finished runs, made again: from saved predictions, or by running the method again.

What a result file names is never imported: only methods, splits and protocols of the toolkit, of
installed plug-ins, or that the user named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd

from benchmark.data.frame import DepthFrame
from benchmark.data.predictions import read_prediction
from benchmark.data.splits import DepthSource, FrameKey, open_split, saved_depth_path, splits
from benchmark.evaluation.depth_choice import DepthChoice
from benchmark.evaluation.engine import run_task
from benchmark.evaluation.frames import Base, error_line
from benchmark.evaluation.known_data import CONTENT_FILE
from benchmark.evaluation.results import ERROR, FRAME, NOT_FINITE, SCENE, UNREAD, read_table
from benchmark.evaluation.tasks.bop import BopRun, digest_of_results
from benchmark.evaluation.tasks.depth import Run
from benchmark.evaluation.tasks.depth_results import OVER_ALL, OVER_ANSWERED, RunResult
from benchmark.evaluation.tasks.order_run import (
    ASKED,
    LAYER,
    LEFT_OUT,
    RIGHT,
    TUPLES,
    OrderResult,
    OrderRun,
)
from benchmark.evaluation.tasks.pose import Methods, PoseFrame, PoseRun
from benchmark.evaluation.tasks.pose_results import PoseResult
from benchmark.evaluation.tasks.pose_table import (
    KIND,
    READ,
    RT_COLUMNS,
    SIZE_COLUMNS,
    TRUE,
    rows_of_frame,
)
from benchmark.evaluation.verification import Grade
from benchmark.methods.protocol import Restorer
from benchmark.methods.registry import MethodOptions, restorers
from benchmark.metrics.protocols.protocol import get_protocol, protocols
from benchmark.metrics.protocols.score import score_frame
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions

# Folder of saved depth beside the table of a run.
SAVED = "depth"

# Columns of the rows of a true object that data determine.
_OF_TRUTH = (
    "class_id", "material", "pixels", "handle_visible", "box_known", *RT_COLUMNS, *SIZE_COLUMNS
)  # fmt: skip


@dataclass(frozen=True)
class Source:
    """What the user gives to make results again.

    Attributes:
        root: folder of the data.
        predictions: folders and files of predictions by name, where they are not where they were.
        rerun: run depth methods again instead of reading their predictions.
        methods: methods outside of the toolkit that the user trusts.
        weights: files of weights by label or method.
        device: torch device of a rerun.
        jobs: engine and number of workers.
    """

    root: Path
    predictions: dict[str, Path] = field(default_factory=dict)
    rerun: bool = False
    methods: tuple[str, ...] = ()
    weights: dict[str, Path] = field(default_factory=dict)
    device: str = "cpu"
    jobs: JobOptions = field(default_factory=JobOptions)


@dataclass(frozen=True, eq=False)
class Remade:
    """Rows that were made again.

    Attributes:
        grade: what they earn if they equal the stored ones.
        of: what they were made of.
        table: the rows, as in the table of a run.
        keys, columns: columns that name a row, and those that are compared.
        content: what was read, see `benchmark.data.identity.content_table`.
        setup: of the run that made them, if it is the method itself.
    """

    grade: Grade
    of: str
    table: pd.DataFrame
    keys: tuple[str, ...]
    columns: tuple[str, ...]
    content: pd.DataFrame
    setup: Any = None


class CannotRemake(ToolkitError):
    """Rows of a run cannot be made again with what was given."""


@dataclass(frozen=True, kw_only=True)
class _Part(Run):
    """Some frames of a run again."""

    only: tuple[int, ...] = ()

    def chosen(self, data: DepthSource) -> list[int]:  # noqa: ARG002
        return list(self.only)


@dataclass(frozen=True, kw_only=True)
class _Saved(_Part):
    """Depth that `--save-depth` wrote, scored at the size that the method gave."""

    saved: Path = Path()

    def load(self, data: DepthSource, index: int) -> DepthFrame:
        return data.load(index, sensor=False)

    def rows(
        self,
        data: DepthSource,
        methods: Restorer,  # noqa: ARG002
        frames: Sequence[tuple[Base, DepthFrame | str]],
    ) -> list[dict[str, Any]]:
        protocol, rows = get_protocol(self.protocol), []
        for base, frame in frames:
            if isinstance(frame, str):
                rows.append(base | {ERROR: frame} | UNREAD)
                continue
            path = saved_depth_path(self.saved, data.name, FrameKey(base[SCENE], base[FRAME]))
            depth, error = None, ""
            try:
                depth = read_prediction(path)
            except ToolkitError as wrong:
                error = error_line(wrong)
            status = {ERROR: error, NOT_FINITE: 0}
            rows += [base | status | row.as_dict() for row in score_frame(depth, frame, protocol)]
        return rows


@dataclass(frozen=True, kw_only=True)
class _Truth(PoseRun):
    """True poses of some frames; the predictions are in the table of the run."""

    only: tuple[int, ...] = ()

    def chosen(self, data: DepthSource) -> list[int]:  # noqa: ARG002
        return list(self.only)

    def rows(
        self,
        data: DepthSource,  # noqa: ARG002
        methods: Methods,  # noqa: ARG002
        frames: Sequence[tuple[Base, PoseFrame | str]],
    ) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = []
        for base, frame in frames:
            failed = isinstance(frame, str)
            about = {ERROR: frame if isinstance(frame, str) else "", READ: not failed}
            truths = () if isinstance(frame, str) else frame.truths
            rows += rows_of_frame(base | about, truths, None)
        return rows


def frames_below(root: Path, split: str, keys: Sequence[FrameKey]) -> dict[FrameKey, int]:
    """Return the index below a folder of each frame of a run.

    Raises:
        ToolkitError: no split of the toolkit, or frames are not there.
    """
    if split not in splits.names():
        raise CannotRemake(
            "is no split of this toolkit, and what results name is not imported",
            field="split", value=split,
        )  # fmt: skip
    there = {key: i for i, key in enumerate(open_split(split, root).keys())}
    absent = [key for key in keys if key not in there]
    if absent:
        raise ToolkitError(
            f"{len(absent)} of {len(keys)} frames of the run are not below this folder",
            path=root,
            value=str(absent[0]),
        )
    return {key: there[key] for key in keys}


def remake_depth(result: RunResult, source: Source, keys: Sequence[FrameKey]) -> Remade:
    """Score some frames of a depth run again.

    Raises:
        CannotRemake: there are no saved predictions, or nothing to run.
        ToolkitError: data are missing or damaged.
    """
    setup, label = result.manifest.setup, result.manifest.label
    if setup.protocol not in protocols.names():
        raise CannotRemake("is no protocol of this toolkit", field="protocol", value=setup.protocol)
    places = frames_below(source.root, setup.split, keys)
    with TemporaryDirectory() as place:
        known: dict[str, Any] = {
            "split": setup.split,
            "root": source.root,
            "method": "raw",
            "options": MethodOptions(),
            "label": label,
            "out": Path(place),
            "batch_size": setup.batch_size,
            "gallery": False,
            "protocol": setup.protocol,
            "speed": False,
            "only": tuple(places.values()),
            "released_loader": setup.released_loader or None,
        }
        compared = (*OVER_ALL, *OVER_ANSWERED, "n_pixels", "n_answered")
        if setup.depth_from and setup.method == "raw":
            # Predictions of another program: it cannot be run here, whatever is asked for.
            folder = source.predictions.get(label, Path(setup.depth_from))
            if not folder.is_dir():
                raise CannotRemake(
                    "the folder of predictions is not there", path=folder,
                    hint=f"--predictions {label}=DIR",
                )  # fmt: skip
            run: Run = _Part(**known, depth_from=folder, depth_unit=setup.depth_unit or None)
            grade: Grade = "recomputed"
            of = f"predictions in {folder}"
        elif source.rerun:
            run = _rerun(result, source, known)
            # On saved depth of another program only a part was run again.
            grade = "recomputed" if setup.depth_from else "rerun"
            of = f"{setup.method}, run again on {source.device}"
        elif setup.depth_from:
            raise CannotRemake("the method ran on saved depth", value=setup.method, hint="--rerun")
        elif setup.method == "raw" and not setup.settings:
            run, grade, of = _Part(**known), "rerun", "the sensor's depth"
        else:
            folder = source.predictions.get(label, result.folder / SAVED)
            if not folder.is_dir():
                raise CannotRemake(
                    "no saved predictions", path=folder,
                    hint="std-bench --save-depth keeps them; --rerun runs the method again",
                )  # fmt: skip
            run = _Saved(**known, saved=folder)
            grade, of = "recomputed", "saved depth"
        found = run_task(run, source.jobs)
        content = read_table(run.folder / CONTENT_FILE)
        again = None
        if grade == "rerun" and source.rerun:
            again = run.manifest(run.open(), run.make(source.device)).setup
    return Remade(grade, of, found, (SCENE, FRAME, "grid", "subset"), compared, content, again)


def _rerun(result: RunResult, source: Source, known: dict[str, Any]) -> Run:
    setup = result.manifest.setup
    if setup.method not in (*restorers.names(), *source.methods):
        raise CannotRemake(
            "is code of somebody else, which is only run if you name it", field="method",
            value=setup.method, hint=f"--trust {setup.method}",
        )  # fmt: skip
    weights = source.weights.get(result.manifest.label) or source.weights.get(setup.method)
    options = MethodOptions(
        preset=setup.preset,
        weights=weights,
        precision=setup.precision,  # type: ignore[arg-type]
        compile=setup.compile,
        settings=setup.settings,
    )
    more: dict[str, Any] = {"method": setup.method, "options": options}
    if setup.depth_from:
        folder = source.predictions.get(result.manifest.label, Path(setup.depth_from))
        more |= {"depth_from": folder, "depth_unit": setup.depth_unit or None}
    return _Part(**known | more | {"devices": (source.device,)})


def remake_poses(result: PoseResult, source: Source, keys: Sequence[FrameKey]) -> Remade:
    """Compute the true poses of some frames of a pose run again.

    Raises:
        CannotRemake: the run asks for a rerun, or is of no split of the toolkit.
        ToolkitError: data are missing or damaged.
    """
    if source.rerun:
        raise CannotRemake("only depth methods are run again")
    setup = result.manifest.setup
    places = frames_below(source.root, setup.split, keys)
    with TemporaryDirectory() as place:
        run = _Truth(
            split=setup.split, root=source.root, method="gt-nocs", options=MethodOptions(),
            label="truth", out=Path(place), batch_size=setup.batch_size, gallery=False,
            depth=DepthChoice(name="gt"), only=tuple(places.values()),
        )  # fmt: skip
        found = run_task(run, source.jobs)
        content = read_table(run.folder / CONTENT_FILE)
    found = found[found[KIND] == TRUE]
    keys_of_row = (SCENE, FRAME, "mask_id")
    return Remade("recomputed", "predictions of the table", found, keys_of_row, _OF_TRUTH, content)


def remake_order(result: OrderResult, source: Source, keys: Sequence[FrameKey]) -> Remade:
    """Score predictions of some photos of LayeredDepth again.

    Raises:
        CannotRemake: the predictions are not there, or the run asks for a rerun.
        ToolkitError: data are missing or damaged.
    """
    manifest, setup = result.manifest, result.manifest.setup
    if source.rerun:
        raise CannotRemake("only depth methods are run again")
    folder = source.predictions.get(manifest.label, Path(manifest.predictions))
    if not folder.is_dir():
        raise CannotRemake(
            "the folder of predictions is not there", path=folder,
            hint=f"--predictions {manifest.label}=DIR",
        )  # fmt: skip
    with TemporaryDirectory() as place:
        run = OrderRun(
            data=source.root, predictions=folder, subset=setup.subset, layers=setup.layers,
            npy=setup.npy, label=manifest.label, out=Path(place),
            only=tuple(key.scene for key in keys),
        )  # fmt: skip
        found = run_task(run, source.jobs)
        content = read_table(run.folder / CONTENT_FILE)
    of = f"predictions in {folder}"
    keys_of_row = (SCENE, FRAME, TUPLES, LAYER)
    return Remade("recomputed", of, found, keys_of_row, (ASKED, RIGHT, LEFT_OUT), content)


def remake_bop(manifest: Any, source: Source) -> tuple[Remade, Any]:
    """Score a BOP result file again.

    Args:
        manifest: of the run.
        source: `predictions` has the file by the name of the results.

    Returns:
        The rows, and the figures.

    Raises:
        CannotRemake: the result file was not given.
        ToolkitError: it is another file, or data are missing.
    """
    setup = manifest.setup
    file = source.predictions.get(setup.results)
    if file is None:
        raise CannotRemake(
            "the result file is not with the results", value=f"{setup.results}.csv",
            hint=f"--predictions {setup.results}={setup.results}.csv",
        )  # fmt: skip
    if digest_of_results(file) != setup.results_sha256:
        raise ToolkitError("is not the result file that was scored: its SHA-256 differs", path=file)
    with TemporaryDirectory() as place:
        run = BopRun(
            data=source.root, split=setup.split, results=file, out=Path(place),
            sensors=setup.sensors, errors=setup.errors, symmetry_steps=setup.symmetry_steps,
            vsd_delta_mm=setup.vsd_delta_mm,
        )  # fmt: skip
        found = run_task(run, source.jobs)
        run.after()
        figures = run.read()
        content = read_table(run.folder / CONTENT_FILE)
    columns = tuple(c for c in found if c.startswith("found_") or c in ("n_valid", "n_estimates"))
    keys = (SCENE, FRAME, "obj_id")
    return Remade("recomputed", str(file), found, keys, columns, content), figures
