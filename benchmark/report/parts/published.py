"""Tables of published figures, one for each data set and protocol: never two in one ranking."""

from collections.abc import Iterable, Sequence
from math import isnan

import pandas as pd

from benchmark.metrics.depth.figures import COVERAGE, FIGURES
from benchmark.published.load import (
    GRADES,
    SPLIT_OF,
    SUBSETS_OF,
    cited,
    in_our_unit,
    printed_digits,
    published_rows,
    published_sources,
)
from std_toolkit.html.page import Paragraph, Section, Terms
from std_toolkit.html.table import NONE, Cell, Column, Row, Table, number

# Kinds of figures of each task of `std-bench`.
TASKS = {
    "depth": ("depth_restoration", "monocular_depth", "depth_order", "speed"),
    "pose": ("category_pose", "instance_pose"),
    "grasp": ("grasping",),
}
_SPEED = "speed"
# Figures without a column of their own elsewhere; the others are shares, shown in percent.
_COLUMNS = {figure.name: figure.column for figure in FIGURES} | {
    "coverage": COVERAGE,
    "d1118": Column(heading="δ1.118", unit="%", factor=100),
    "frames_per_s": Column(heading="speed", unit="frames/s"),
    "objects_grasped": Column(heading="grasped"),
    "attempts": Column(heading="attempts"),
}
NOTE = "Figures as printed, in the order of print; compare only rows of one table."


def published_tables(
    tasks: Iterable[str], *, dataset: str = "", without: Sequence[str] = (), only: str = ""
) -> list[Table]:
    """Return the published figures whose source a reader can open.

    Args:
        tasks: kinds of figures, see `TASKS`.
        dataset: only of this data set, as printed.
        without: protocols to leave out.
        only: the only protocol.

    Returns:
        A table for each kind, data set and protocol (of speed, one for each source), with source
        and grade in every row, and the addresses below the title.
    """
    rows = published_rows()
    rows = rows[rows["task"].isin(tuple(tasks)) & ~rows["protocol"].isin(without)]
    if dataset:
        rows = rows[rows["dataset"] == dataset]
    if only:
        rows = rows[rows["protocol"] == only]
    speed = rows["task"] == _SPEED
    place = rows["dataset"].where(~speed, rows["table"])
    keys = [rows["task"], place, rows["protocol"]]
    return [_table(block) for _, block in rows.groupby(keys, sort=False)]


def other_protocols(tasks: Iterable[str], split: str, shown: Sequence[str]) -> list[Table]:
    """Return what is published on a split by protocols that its leaderboards do not have.

    Args:
        tasks: kinds of figures, see `TASKS`.
        split: name of the split.
        shown: protocols of the leaderboards.
    """
    dataset = _printed_name(split)
    return published_tables(tasks, dataset=dataset, without=shown) if dataset else []


def beside_board(tasks: Iterable[str], split: str, protocol: str) -> list[Section]:
    """Return what is published on the frames of a leaderboard: by its protocol, then by others.

    Args:
        tasks: kinds of figures, see `TASKS`.
        split: name of the split, whose frames must be the published ones.
        protocol: of the leaderboard.
    """
    dataset = _printed_name(split)
    if not dataset:
        return []
    kinds = tuple(tasks)
    own = published_tables(kinds, dataset=dataset, only=protocol)
    others = other_protocols(kinds, split, (protocol,))
    told = Paragraph("Papers print these; nobody recomputed them here, and they are not ranked.")
    title = "Published by other protocols, not comparable with the rows above"
    sections = []
    if own:
        sections.append(Section("published", f"Published, protocol {protocol}", [told, *own]))
    if others:
        sections.append(Section("published-others", title, others))
    return sections


def published_sections() -> list[Section]:
    """Return all published figures, a section for each task, and what their grades mean."""
    sections = [
        Section(f"published-{task}", heading, published_tables(TASKS[task]))
        for task, heading in (("depth", "Depth"), ("pose", "Poses"), ("grasp", "Grasping"))
    ]
    return [*sections, Section("trust", "Grades of sources", [Terms(GRADES)])]


def _printed_name(split: str) -> str:
    return next((printed for printed, ours in SPLIT_OF.items() if ours == split), "")


def published_records(tasks: Iterable[str]) -> list[dict[str, object]]:
    """Return the published figures as records in our units, with source, grade and address.

    Args:
        tasks: kinds of figures, see `TASKS`.
    """
    rows = published_rows()
    found = []
    for row in rows[rows["task"].isin(tuple(tasks))].to_dict("records"):
        metric, value = in_our_unit(row["metric"], row["value"])
        printed = {"printed_metric": row["metric"], "printed_value": row["value"]}
        found.append(row | printed | {"metric": metric, "value": value})
    return found


def address_note(sources: Iterable[str]) -> str:
    """Return the sentence that says where sources can be opened.

    Args:
        sources: keys of `published_sources`, or several of them separated by `; `.
    """
    named = {key for text in sources for key in str(text).replace("; ", ";").split(";")}
    known = [key for key in published_sources()["source"] if key in named]
    return f"Published: {cited(known)}."


def _table(block: pd.DataFrame) -> Table:
    is_speed = (block["task"] == _SPEED).all()
    subsets = list(dict.fromkeys(block["subset"]))
    figures = list(
        dict.fromkeys(
            (in_our_unit(metric, "1")[0], subset)
            for metric, subset in zip(block["metric"], block["subset"], strict=True)
        )
    )
    several = len(subsets) > 1
    columns = [_column(name, subset if several else "") for name, subset in figures]
    heads = ["method", "trained on", *(["on"] if is_speed else []), "source"]
    made = []
    keys = ["method", "year", "training_data", "table", *(["dataset"] if is_speed else [])]
    for _, row in block.groupby(keys, sort=False):
        first = row.iloc[0]
        texts = [first["training_data"], *([first["dataset"]] if is_speed else [])]
        cells = [Cell(text=first["method"], note=first["year"])]
        cells += [Cell(text=text or NONE) for text in texts]
        cells.append(Cell(text=first["table"], note=first["trust"]))
        cells += [_cell(row, name, subset) for name, subset in figures]
        made.append(Row(cells, "published"))
    first = block.iloc[0]
    told = [f"Speed, {first['table']}" if is_speed else first["dataset"]]
    told += [f"protocol {first['protocol']}"] if first["protocol"] else []
    if len(subsets) == 1 and not is_speed:
        told.append(_pixels(subsets[0]))
    notes = [NOTE, address_note(block["source"]), *_remarks(block)]
    return Table(
        columns=[*(Column(heading=h, numeric=False) for h in heads), *columns],
        rows=made,
        title=", ".join(told),
        notes=notes,
    )


def _column(name: str, subset: str) -> Column:
    found = _COLUMNS.get(name) or Column(heading=name.replace("_", " "), unit="%", factor=100)
    heading = f"{found.heading}, {_pixels(subset)}" if subset else found.heading
    return Column(heading=heading, unit=found.unit, factor=found.factor)


def _pixels(subset: str) -> str:
    """Which pixels are compared, for people."""
    return subset if " " in subset else " and ".join(SUBSETS_OF.get(subset, (subset,)))


def _cell(rows: pd.DataFrame, name: str, subset: str) -> Cell:
    for row in rows.itertuples():
        ours, value = in_our_unit(row.metric, row.value)
        if (ours, row.subset) == (name, subset) and not isnan(value):
            factor = _column(name, "").factor
            digits = printed_digits(row.metric, row.value, factor)
            return Cell(text=number(value * factor, digits), value=value)
    return Cell(text=NONE)


def _remarks(block: pd.DataFrame) -> list[str]:
    noted = block[block["note"] != ""].drop_duplicates(["method", "note"])
    by_note = noted.groupby("note", sort=False)["method"].agg(list)
    return [f"{', '.join(methods)}: {note}." for note, methods in by_note.items()]
