"""What `std-bench verify` looks at: the files of a run, and its rows beside those made again."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmark.data.identity import (
    CONTENT,
    DIGEST,
    are_answers,
    data_digest,
    tell_changes,
)
from benchmark.data.splits import FrameKey, names_digest
from benchmark.evaluation.recompute import Remade
from benchmark.evaluation.results import ERROR, FRAME, INDEX, SCENE, Result, check_columns
from benchmark.evaluation.tasks import depth_results, order_run, pose_results
from benchmark.evaluation.tasks.pose_table import KIND, TRUE
from benchmark.evaluation.verification import Check, CheckedFigure, State
from benchmark.methods.registry import JOINED, joined_digest, shipped_file
from benchmark.metrics.depth.figures import COVERAGE, FIGURES
from benchmark.metrics.pose import get_pose_protocol
from benchmark.metrics.protocols.protocol import get_protocol, protocols
from std_toolkit.io.documents import digest_file

# Sums in another order, on another processor, differ in their last bits.
_SAME = 1e-9
_PRINTED = (*(figure.column for figure in FIGURES), COVERAGE)
_LEADERBOARD = "leaderboard.csv"


def check(name: str, state: State | bool, about: str = "") -> Check:
    if isinstance(state, bool):
        state = "holds" if state else "fails"
    return Check(name=name, state=state, about=about)


def frame_keys(table: pd.DataFrame) -> list[FrameKey]:
    """Frames of a table in the order of the split."""
    rows = table.drop_duplicates(INDEX).sort_values(INDEX, kind="stable")
    return [FrameKey(*names) for names in zip(rows[SCENE], rows[FRAME], strict=True)]


def check_files(result: Result[Any]) -> Iterator[Check]:
    """What the files of a run say of each other."""
    table, setup = result.table, result.manifest.setup
    if FRAME not in table:  # rounds of table clearing
        return
    missing, failed = max(0, result.missing), result.failed
    about = f"{result.frames - missing:,} of {result.frames:,} have rows"
    if failed == result.frames - missing:
        about = "no frame was answered: the figures are empty"
    elif failed:
        about += f", {failed} failed"
    yield check("frames", not missing, about)
    digest = getattr(setup, "frames_sha256", "")
    if digest:
        yield check("names", digest == names_digest(frame_keys(table)), "frames_sha256 of the rows")
    known = result.data
    if known.record is None or known.content is None:
        yield check("data.json", "not checked", "the results do not say what data they are of")
        return
    right = data_digest(known.content) == known.record.digest
    yield check("data.json", right, "its digest is that of data.parquet")
    listed = {(s, f) for s, f in zip(known.content[SCENE], known.content[FRAME], strict=True)}
    lacking = [key for key in frame_keys(table) if tuple(key) not in listed]
    if lacking:
        yield check(
            "data.json", False, f"data.parquet lacks {len(lacking)} frames, as {lacking[0]}"
        )


def check_leaderboard(result: Result[Any], top: Path) -> Iterator[Check]:
    """Whether the figures of `leaderboard.csv` follow from the rows of a run."""
    path = top / _LEADERBOARD
    if not isinstance(result, depth_results.RunResult) or not path.is_file():
        return
    try:
        printed = pd.read_csv(path)
    except (OSError, ValueError) as error:
        yield check(_LEADERBOARD, False, f"cannot be read: {str(error)[:100]}")
        return
    names = ["split", "protocol", "method", "kind"]
    if absent := [
        n for n in (*names, "grid", "subset", *depth_results.OVER_ALL) if n not in printed
    ]:
        yield check(_LEADERBOARD, False, f"lacks columns: {', '.join(absent[:5])}")
        return
    check_columns(printed, depth_results.OVER_ALL, path)
    manifest = result.manifest
    own = pd.Series([result.named, manifest.setup.protocol, manifest.label, "measured"], names)
    mine = printed[(printed[names].astype(str) == own).all(axis=1)]
    if mine.empty:
        yield check(_LEADERBOARD, "not checked", "has no row of this run")
        return
    scored = result.table[result.table["grid"] != ""]
    means = depth_results.summarise(scored, by=("grid", "subset"))
    both = mine.merge(means, on=["grid", "subset"], suffixes=("", "_rows"))
    wrong = [
        f"{name} of {row['subset']}"
        for name in depth_results.OVER_ALL
        for _, row in both.iterrows()
        if not np.isclose(row[name], row[f"{name}_rows"], rtol=_SAME, atol=0, equal_nan=True)
    ]
    right = len(both) == len(mine) and not wrong
    about = f"{len(mine) * len(depth_results.OVER_ALL)} figures follow from the rows"
    yield check(_LEADERBOARD, right, about if right else f"differs: {', '.join(wrong[:3])}")


def check_weights(result: Result[Any], named: Mapping[str, Path]) -> Check:
    """Whether there is a file of weights with the digest that the run states."""
    setup = result.manifest.setup
    wanted = getattr(setup, "weights_sha256", "")
    if not wanted:
        return check("weights", "holds", "none")
    joined = [shipped_file(m, setup.preset) for m in JOINED.get(setup.method, ())]
    for files in (joined, joined[:1]):
        if files and all(f.is_file() for f in files) and joined_digest(files) == wanted:
            return check("weights", "holds", " and ".join(f.name for f in files))
    given = named.get(getattr(result.manifest, "label", "")) or named.get(setup.method)
    tried = [given] if given else [
        shipped_file(setup.method, setup.preset), Path(result.manifest.weights or "/nowhere")
    ]  # fmt: skip
    for path in tried:
        if path.is_file() and digest_file(path) == wanted:
            return check("weights", "holds", path.name)
    if given is not None:
        return check("weights", False, f"{given} has another digest")
    return check("weights", "not checked", f"--weights {setup.method}=FILE of digest {wanted}")


def check_content(result: Result[Any], remade: Remade, chosen: pd.DataFrame) -> Iterator[Check]:
    """Whether the data are those that the run read."""
    then = result.data.content
    if then is None:
        return
    then = then.merge(chosen, on=[SCENE, FRAME])
    answers = are_answers(then)
    for name, is_answer in (("data", False), ("predictions", True)):
        old = then[answers == is_answer]
        if old.empty:
            continue
        new = remade.content[are_answers(remade.content) == is_answer]
        if is_answer and new.empty:  # as poses, which are in the table
            yield check(name, "not checked", "their files were not read again")
            continue
        both = old.merge(new, on=[SCENE, FRAME, CONTENT], how="left", suffixes=("", "_now"))
        other = both[both[DIGEST] != both[f"{DIGEST}_now"].fillna("")]
        about = f"{len(old):,} files of {len(chosen):,} frames have the digests of the run"
        changed = f"{len(other)} files differ: {tell_changes(other)}"
        yield check(name, other.empty, about if other.empty else changed)


def check_rows(stored: pd.DataFrame, remade: Remade) -> Check:
    """Whether rows that were made again equal the stored ones."""
    if KIND in stored:
        stored = stored[stored[KIND] == TRUE]
    keys = list(remade.keys)
    both = stored.merge(remade.table, on=keys, how="outer", suffixes=("", "_now"), indicator=True)
    single = both[both["_merge"] != "both"]
    if len(single):
        row = single.iloc[0]
        whose = "reported alone" if row["_merge"] == "left_only" else "found alone"
        where = "/".join(str(row[k]) for k in keys)
        return check("rows", False, f"{len(single)} rows of {len(both)}: {where} is {whose}")
    failed = both[(both[ERROR] == "") != (both[f"{ERROR}_now"] == "")]
    if len(failed):
        row = failed.iloc[0]
        about = row[f"{ERROR}_now"] or f"reported to have failed: {row[ERROR]}"
        frames = failed.drop_duplicates([SCENE, FRAME])
        return check("rows", False, f"{len(frames)} frames, as {row[SCENE]}/{row[FRAME]}: {about}")
    then = both[list(remade.columns)].to_numpy(np.float64)
    now = both[[f"{c}_now" for c in remade.columns]].to_numpy(np.float64)
    exact = (then == now) | (np.isnan(then) & np.isnan(now))
    with np.errstate(invalid="ignore"):
        off = np.abs(then - now) / np.maximum(np.abs(then), 1e-12)
    off = np.where(exact, 0, np.where(np.isnan(off), np.inf, off))
    about = f"{exact.size:,} figures of {len(both):,} rows, made again from {remade.of}"
    if exact.all():
        return check("rows", True, f"{about}: equal to the last bit")
    place = np.unravel_index(int(off.argmax()), off.shape)
    worst, name = both.iloc[place[0]], remade.columns[place[1]]
    where = "/".join(str(worst[k]) for k in keys)
    at = f"{name} of {where}: {then[place]:.9g} reported, {now[place]:.9g} found"
    if (off <= _SAME).all():
        return check("rows", True, f"{about}: equal but for rounding")
    if remade.grade == "rerun":  # networks round differently on other hardware; figures decide
        return check("rows", True, f"{about}: not bit-equal; largest difference: {at}")
    return check("rows", False, f"{int((off > _SAME).sum()):,} of {about} differ, as {at}")


def check_setup(result: Result[Any], remade: Remade) -> Iterator[Check]:
    """Whether a rerun had the settings of the run."""
    if remade.setup is None:
        return
    then, now = result.manifest.setup, remade.setup
    own = ("frames", "frames_sha256", "device", "depth_from", "probes")
    wrong = [
        f"{name} {getattr(then, name)!r}, now {getattr(now, name)!r}"
        for name in then.__struct_fields__
        if name not in own and getattr(then, name) != getattr(now, name)
    ]
    yield check("settings", not wrong, "; ".join(wrong) or "those of the run")


def compare_figures(
    result: Result[Any], stored: pd.DataFrame, remade: Remade
) -> list[CheckedFigure]:
    """Figures as printed, of the stored rows and of those made again."""
    if isinstance(result, pose_results.PoseResult):
        return _pose_figures(result, stored, remade)
    if isinstance(result, order_run.OrderResult):
        return _order_figures(result, stored, remade)
    protocol = result.manifest.setup.protocol
    if protocol not in protocols.names():
        return []
    grid, _ = get_protocol(protocol).main
    means = [
        depth_results.summarise(table[table["grid"] == grid], by=("subset",)).set_index("subset")
        for table in (stored, remade.table)
    ]
    return [
        compare_figure(column.title, str(subset), *(
            column.text(mean[column.name].get(subset, float("nan"))) or "-" for mean in means
        ))
        for subset in means[0].index
        for column in _PRINTED
    ]  # fmt: skip


def _order_figures(
    result: order_run.OrderResult, stored: pd.DataFrame, remade: Remade
) -> list[CheckedFigure]:
    then, now = (
        {(s.tuples, s.layer): f"{100 * s.right / s.count:.2f}" for s in one.scores if s.count}
        for one in (replace(result, table=table) for table in (stored, remade.table))
    )
    return [
        compare_figure(f"{size} [%]", layer, text, now.get((size, layer), "-"))
        for (size, layer), text in then.items()
    ]


def _pose_figures(
    result: pose_results.PoseResult, stored: pd.DataFrame, remade: Remade
) -> list[CheckedFigure]:
    """The predictions of the table, scored against both truths."""
    protocol = get_pose_protocol("strict")
    others = stored[stored[KIND] != TRUE]
    again = pd.concat([others, remade.table], ignore_index=True)
    kept = [
        pose_results.PoseResult(result.folder, result.manifest, table, place=result.named)
        for table in (stored, again.sort_values(INDEX, kind="stable"))
    ]
    scored = [pose_results.score_run(r, protocol).figures for r in kept]
    return [
        compare_figure(pose_results.heading(c), "all", *(f"{100 * s[c]:.1f}" for s in scored))
        for c in protocol.columns
    ]


def compare_figure(figure: str, subset: str, reported: str, found: str) -> CheckedFigure:
    return CheckedFigure(
        figure=figure, subset=subset, reported=reported, found=found, holds=reported == found
    )
