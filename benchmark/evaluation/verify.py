"""`std-bench verify`: which figures of results hold, by their files alone and with the data."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from benchmark.data.identity import data_digest
from benchmark.evaluation import recompute
from benchmark.evaluation.batches import chosen_frames
from benchmark.evaluation.manifest import (
    BOP_FILE,
    BOP_MANIFEST,
    DUMP_MANIFEST,
    GRASP_MANIFEST,
    MANIFEST,
    POSE_MANIFEST,
    BopManifest,
    circumstances,
)
from benchmark.evaluation.query_options import VerifyOptions
from benchmark.evaluation.results import (
    FRAME,
    INDEX,
    SCENE,
    TABLE,
    Result,
    finished_folders,
    read_known,
    read_table,
)
from benchmark.evaluation.tasks import bop_results, depth_results, grasp_results, pose_results
from benchmark.evaluation.tasks.grasp_dump import PRECISIONS, read_dump_run
from benchmark.evaluation.tasks.grasp_table import ATTEMPTS
from benchmark.evaluation.tasks.pose_table import POSES
from benchmark.evaluation.values import data_of, roots_of
from benchmark.evaluation.verification import (
    Check,
    CheckedFigure,
    Grade,
    Verification,
    VerifiedRun,
    run_digest,
)
from benchmark.evaluation.verify_checks import (
    check,
    check_content,
    check_files,
    check_leaderboard,
    check_rows,
    check_setup,
    check_weights,
    compare_figure,
    compare_figures,
    frame_keys,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document
from std_toolkit.log import logger


@dataclass(frozen=True)
class _Kind:
    """A kind of run: its files, how it is read, and how its rows are made again."""

    manifest: str
    table: str
    read: Callable[[Path], Any]


_KINDS = (
    _Kind(MANIFEST, TABLE, depth_results.read_run),
    _Kind(POSE_MANIFEST, POSES, pose_results.read_pose_run),
    _Kind(GRASP_MANIFEST, ATTEMPTS, grasp_results.read_grasp_run),
    _Kind(DUMP_MANIFEST, PRECISIONS, read_dump_run),
)


def verify(options: VerifyOptions) -> Verification:
    """Check every run below some folders of results.

    Without data, a run is checked by its own files: whether it is complete, whether names and
    digests agree, and whether the figures beside it follow from its rows.

    Raises:
        ToolkitError: a folder has no run, or a run that cannot be read.
    """
    found = []
    for top in options.results:
        runs = list(_runs(top))
        if not runs:
            raise ToolkitError("no finished run of std-bench here", path=top)
        for kind, folder in runs:
            done = _verify_bop(folder, top, options) if kind is None else None
            found.append(done or _verify_run(kind, folder, top, options))  # type: ignore[arg-type]
            logger.info("%s", found[-1].lines()[0])
    return Verification(runs=found, **circumstances())


def _runs(top: Path) -> Iterator[tuple[_Kind | None, Path]]:
    for kind in _KINDS:
        for folder in finished_folders(top, kind.manifest, kind.table):
            yield kind, folder
    for path in sorted(top.rglob(BOP_MANIFEST)):
        yield None, path.parent


def _verify_run(kind: _Kind, folder: Path, top: Path, options: VerifyOptions) -> VerifiedRun:
    result = kind.read(folder)
    checks = [*check_files(result), *check_leaderboard(result, top)]
    figures: list[CheckedFigure] = []
    grade: Grade = "reported"
    frames = 0
    if options.data:
        checks.append(check_weights(result, options.weight_files))
        try:
            remade, chosen = _remake(result, options)
        except recompute.CannotRemake as why:
            checks.append(check("rows", "not checked", str(why)))
        except ToolkitError as error:
            checks.append(check("rows", "fails", str(error)))
        else:
            stored = result.table.merge(chosen, on=[SCENE, FRAME])
            frames = len(chosen)
            checks += check_content(result, remade, chosen)
            checks.append(check_rows(stored, remade))
            checks += check_setup(result, remade)
            figures = compare_figures(result, stored, remade)
            grade = remade.grade
    return _verified(result.title, folder, top, kind.manifest, kind.table, checks,
                     figures=figures, grade=grade, frames=frames, of=result.frames)  # fmt: skip


def _verified(
    title: str,
    folder: Path,
    top: Path,
    manifest: str,
    table: str,
    checks: list[Check],
    *,
    figures: list[CheckedFigure],
    grade: Grade,
    frames: int,
    of: int,
) -> VerifiedRun:
    holds = all(c.state != "fails" for c in checks) and all(f.holds for f in figures)
    return VerifiedRun(
        title=title,
        folder=str(folder.relative_to(top)),
        digest=run_digest(folder, manifest, table),
        grade=grade if holds else "reported",
        frames=frames,
        of=of,
        checks=checks,
        figures=figures,
    )


def _remake(result: Result[Any], options: VerifyOptions) -> tuple[recompute.Remade, pd.DataFrame]:
    """Rows made again, and the frames that they are of."""
    setup = result.manifest.setup
    split = getattr(setup, "split", "")
    if not isinstance(result, depth_results.RunResult | pose_results.PoseResult):
        raise recompute.CannotRemake("grasps are not scored again")
    keys = frame_keys(result.table)
    keys = [keys[i] for i in chosen_frames(len(keys), options.sample)]
    source = _source(split, options)
    if isinstance(result, depth_results.RunResult):
        remade = recompute.remake_depth(result, source, keys)
    else:
        remade = recompute.remake_poses(result, source, keys)
    return remade, pd.DataFrame(keys, columns=[SCENE, FRAME])


def _source(data: str, options: VerifyOptions) -> recompute.Source:
    try:
        root = data_of(data, roots_of(options.data))
    except ToolkitError as error:
        raise recompute.CannotRemake(error.problem, value=data, hint=error.hint) from error
    return recompute.Source(
        root=root,
        predictions=options.prediction_files,
        rerun=options.rerun,
        methods=options.trust,
        weights=options.weight_files,
        device=options.device,
        jobs=options.jobs,
    )


def _verify_bop(folder: Path, top: Path, options: VerifyOptions) -> VerifiedRun:
    """Check a BOP result file: figures from rows, and rows from the file of poses."""
    manifest = read_document(folder / BOP_MANIFEST, BopManifest)
    setup = manifest.setup
    table = read_table(folder / bop_results.ERRORS)
    printed = read_document(folder / BOP_FILE, bop_results.BopResult)
    again = bop_results.summarise(
        table, results=printed.results, data=printed.data, split=printed.split,
        estimates=printed.estimates, seconds_per_image=printed.seconds_per_image,
    )  # fmt: skip
    known = read_known(folder)
    checks = [check("bop.json", printed == again, "its figures follow from the rows")]
    if known.record is not None and known.content is not None:
        right = data_digest(known.content) == known.record.digest
        checks.append(check("data.json", right, "its digest is that of data.parquet"))
    images = int(table[INDEX].nunique())
    figures: list[CheckedFigure] = []
    grade: Grade = "reported"
    if options.data:
        try:
            source = _source(setup.data, options)
            remade, found = recompute.remake_bop(manifest, source)
        except recompute.CannotRemake as why:
            checks.append(check("rows", "not checked", str(why)))
        except ToolkitError as error:
            checks.append(check("rows", "fails", str(error)))
        else:
            checks.append(check_rows(table, remade))
            grade = remade.grade
            figures = [
                compare_figure(name, "all", *(_percent(getattr(r, name)) for r in (printed, found)))
                for name in ("ar", "ar_vsd", "ar_mssd", "ar_mspd", "ap")
            ]
    title = f"{setup.results} on {setup.data}, {setup.split}"
    return _verified(title, folder, top, BOP_MANIFEST, bop_results.ERRORS, checks,
                     figures=figures, grade=grade, frames=images if figures else 0,
                     of=images)  # fmt: skip


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"


def summary(done: Verification) -> Sequence[str]:
    """Return the lines of all runs, and a last one with the verdict."""
    right = sum(run.holds for run in done.runs)
    lines = [line for run in done.runs for line in run.lines()]
    return [*lines, f"{right} of {len(done.runs)} runs hold"]
