"""Runs beside each other in every report: means over training seeds, and p of all pairs."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any, Literal

import msgspec
import numpy as np
import pandas as pd

from benchmark.evaluation.results import Result
from benchmark.metrics.significance import holm
from benchmark.report.leaderboard import SIGNIFICANT
from std_toolkit.html.table import NONE, Cell, Column, Row, Table

# Weights of a run, and the seed that they were trained with, in any manifest.
_SEEDED = (
    ("weights_sha256", "training_seed"),
    ("depth_weights_sha256", "depth_training_seed"),
    ("planner_weights_sha256", "planner_training_seed"),
)
# What a label ends with that only counts trainings.
_COUNTED = re.compile(r"(?:[-._+](?:seed|s))?[-._+]*\d*$")

# Methods in a table of all pairs, the best ones: 66 pairs leave a corrected p some power.
MOST_COMPARED = 12

Paired = Literal["scenes", "frames"]


@dataclass(frozen=True)
class SeedGroup:
    """Runs that differ only in the seed of a training.

    Attributes:
        label: what their names have in common.
        seeds: of each run; several numbers where several networks were trained.
        runs: by ascending seed.
    """

    label: str
    seeds: tuple[tuple[int, ...], ...]
    runs: tuple[Result[Any], ...]


def seed_groups(results: Sequence[Result[Any]]) -> list[SeedGroup]:
    """Return the groups of two or more trainings, in the order of their first runs.

    Setup, data and what the networks were trained on must be the same, and the seed of every
    training known. Of runs with the same seed the first one counts.
    """
    groups: dict[bytes, dict[tuple[int, ...], Result[Any]]] = {}
    for result in results:
        manifest = result.manifest
        setup: dict[str, Any] = msgspec.to_builtins(manifest.setup)
        seeds = []
        for weights, seed in _SEEDED:
            known = getattr(manifest, seed, None)
            if setup.get(weights) and known is not None:
                del setup[weights]
                seeds.append(int(known))
        if seeds:
            trained = [
                getattr(manifest, f"{w}training_data", "") for w in ("", "depth_", "planner_")
            ]
            key = msgspec.json.encode([result.place, setup, trained], order="sorted")
            groups.setdefault(key, {}).setdefault(tuple(seeds), result)
    found = []
    for mine in groups.values():
        if len(mine) > 1:
            every = sorted(mine.items())
            names = [_name_of(r) for _, r in every]
            own = getattr(every[0][1].manifest.setup, "method", "") or names[0]
            label = common_label(names) or own
            found.append(SeedGroup(label, tuple(s for s, _ in every), tuple(r for _, r in every)))
    return found


def common_label(labels: Sequence[str]) -> str:
    """Return what labels of trainings begin with, without what counts the trainings.

    >>> common_label(["net.seed-0", "net.seed-1"]), common_label(["net-s1", "net-s12"])
    ('net', 'net')
    """
    if len(set(labels)) == 1:
        return labels[0]
    alike = takewhile(lambda letters: len(set(letters)) == 1, zip(*labels, strict=False))
    return _COUNTED.sub("", "".join(letters[0] for letters in alike))


def _name_of(result: Result[Any]) -> str:
    manifest = result.manifest
    parts = [getattr(manifest, n, "") for n in ("label", "planner_label", "depth_label")]
    return " on ".join(p for p in parts if p)


def seed_rows(
    groups: Sequence[SeedGroup],
    row_of: Callable[[Result[Any]], Mapping[str, Any] | None],
    names: Sequence[str],
) -> pd.DataFrame:
    """Return mean and standard deviation of figures over the trainings of each group.

    Args:
        groups: see `seed_groups`.
        row_of: the figures of a run; None if it has none or is not ranked.
        names: of the figures.

    Returns:
        A row for each group of which two or more runs have figures: `method`, `trainings`, `seeds`,
        and for each figure the mean and `NAME_sd`, the sample standard deviation.
    """
    made = []
    for group in groups:
        pairs = zip(group.seeds, map(row_of, group.runs), strict=True)
        found = [(seed, row) for seed, row in pairs if row is not None]
        if len(found) < 2:
            continue
        told = ", ".join("+".join(map(str, seed)) for seed, _ in found)
        entry: dict[str, object] = {
            "method": group.label, "trainings": len(found), "seeds": told,
        }  # fmt: skip
        for name in names:
            values = np.array([float(row[name]) for _, row in found])
            entry |= {name: values.mean(), f"{name}_sd": values.std(ddof=1)}
        made.append(entry)
    ends = [f"{name}{end}" for name in names for end in ("", "_sd")]
    return pd.DataFrame(made, columns=["method", "trainings", "seeds", *ends])


def seed_table(rows: pd.DataFrame, columns: Sequence[Column], title: str) -> list[Table]:
    """Return the table of `seed_rows`; none without rows."""
    if rows.empty:
        return []
    made = []
    for row in rows.to_dict("records"):
        cells = [
            Cell(text=row["method"]),
            Cell(text=str(row["trainings"])),
            Cell(text=row["seeds"]),
        ]
        for column in columns:
            mean, sd = (row[f"{column.name}{end}"] for end in ("", "_sd"))
            text = f"{column.text(mean)} ± {column.text(sd)}" if math.isfinite(mean) else NONE
            cells.append(Cell(text=text, value=mean))
        made.append(Row(cells))
    heads = [
        Column(heading="method", numeric=False),
        Column(heading="trainings", digits=0),
        Column(heading="seeds", numeric=False),
    ]
    notes = [
        "Mean ± standard deviation over trainings that differ in their seed alone; each figure is "
        "the mean over all frames."
    ]
    return [Table(columns=[*heads, *columns], rows=made, title=title, notes=notes)]


def pair_table(
    names: Sequence[str],
    differences: Sequence[tuple[float, float] | None],
    column: Column,
    *,
    title: str,
    test: str,
) -> list[Table]:
    """Return the table of p of all pairs; none for fewer than two names.

    Args:
        names: best first.
        differences: for each pair in the order of `itertools.combinations`: first minus second in
            the stored unit, and p; None if the two cannot be compared.
        column: the figure compared.
        title: title of the table.
        test: what p is of, a sentence.
    """
    if len(names) < 2:
        return []
    corrected = holm([math.nan if d is None else d[1] for d in differences])
    at = iter(zip(differences, corrected, strict=True))
    cells = [[Cell(text="") for _ in names] for _ in names]
    signed = replace(column, signed=True)
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            difference, p = next(at)
            if difference is None or math.isnan(p):
                cells[i][j] = cells[j][i] = Cell(text=NONE, mark="none")
                continue
            sure: Literal["best", ""] = "best" if p < SIGNIFICANT else ""
            cells[i][j] = Cell(text=signed.text(difference[0]), value=difference[0], mark=sure)
            cells[j][i] = Cell(text=p_text(float(p)), value=float(p), mark=sure)
    heads = [Column(heading="method", numeric=False), *(Column(heading=n) for n in names)]
    made = [Row([Cell(text=name), *row]) for name, row in zip(names, cells, strict=True)]
    notes = [
        f"Above the diagonal: {column.title}, row minus column. Below: p. {test} Corrected for all "
        f"{len(differences)} pairs (Holm). Bold: p below {SIGNIFICANT:g}."
    ]
    return [Table(columns=heads, rows=made, title=title, notes=notes)]


def p_text(p: float) -> str:
    """A probability.

    >>> p_text(0.0004), p_text(0.25)
    ('<0.001', '0.250')
    """
    return "<0.001" if p < 0.001 else f"{p:.3f}"
