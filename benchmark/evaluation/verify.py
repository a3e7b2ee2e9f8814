"""`std-bench verify`: which figures of results hold, by their files alone and with the data."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from benchmark.data.identity import data_digest
from benchmark.evaluation import recompute
from benchmark.evaluation.batches import chosen_frames
from benchmark.evaluation.manifest import (
    BOP_FILE,
    BOP_MANIFEST,
    BopManifest,
    circumstances,
)
from benchmark.evaluation.query_options import VerifyOptions
from benchmark.evaluation.results import (
    FRAME,
    INDEX,
    SCENE,
    Result,
    read_known,
    read_table,
)
from benchmark.evaluation.run_kinds import BOP, KINDS, RunKind
from benchmark.evaluation.tasks import bop_results, depth_results, pose_results
from benchmark.evaluation.tasks.order_run import OrderResult
from benchmark.evaluation.values import data_of, roots_of
from benchmark.evaluation.verification import (
    Check,
    CheckedFigure,
    Grade,
    Verification,
    VerifiedRun,
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


def verify(options: VerifyOptions) -> Verification:
    """Check every run below some folders of results.

    Without data, a run is checked by its own files: whether it is complete, whether names and
    digests agree, and whether the figures beside it follow from its rows.

    Raises:
        ToolkitError: a folder has no run, or a run that cannot be read.
    """
    found = []
    for top in options.results:
        runs = [(kind, folder) for kind in KINDS for folder in kind.folders(top)]
        if not runs:
            raise ToolkitError("no finished run of std-bench here", path=top)
        for kind, folder in runs:
            if kind is BOP:
                found.append(_verify_bop(folder, top, options))
            else:
                found.append(_verify_run(kind, folder, top, options))
            logger.info("%s", found[-1].lines()[0])
    return Verification(runs=found, **circumstances())


def _verify_run(kind: RunKind, folder: Path, top: Path, options: VerifyOptions) -> VerifiedRun:
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
    return _verified(result.title, kind, folder, top, checks, figures=figures, grade=grade,
                     frames=frames, of=result.frames)  # fmt: skip


def _verified(
    title: str,
    kind: RunKind,
    folder: Path,
    top: Path,
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
        digest=kind.digest(folder),
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
    remakes: dict[type, Callable[..., recompute.Remade]] = {
        depth_results.RunResult: recompute.remake_depth,
        pose_results.PoseResult: recompute.remake_poses,
        OrderResult: recompute.remake_order,
    }
    remake = remakes.get(type(result))
    if remake is None:
        raise recompute.CannotRemake("grasps are not scored again")
    keys = frame_keys(result.table)
    keys = [keys[i] for i in chosen_frames(len(keys), options.sample)]
    remade = remake(result, _source(split, options), keys)
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
                for name in bop_results.SHOWN
            ]
    title = f"{setup.results} on {setup.data}, {setup.split}"
    return _verified(title, BOP, folder, top, checks, figures=figures, grade=grade,
                     frames=images if figures else 0, of=images)  # fmt: skip


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"


def summary(done: Verification) -> Sequence[str]:
    """Return the lines of all runs, and a last one with the verdict."""
    right = sum(run.holds for run in done.runs)
    lines = [line for run in done.runs for line in run.lines()]
    return [*lines, f"{right} of {len(done.runs)} runs hold"]
