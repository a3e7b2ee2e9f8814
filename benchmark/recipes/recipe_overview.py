"""One page with the tables of all recipes that ran at a scale, what they took and what they say.

It is made from the files of the recipes (`table.md`, `differences.csv`, `costs.json`) alone.
"""

import re
from pathlib import Path

import msgspec
import pandas as pd

from benchmark.recipes.recipe import Scale, get_scale, recipe_names
from benchmark.recipes.recipe_compare import (
    AS_PUBLISHED,
    OPPOSITE,
    UNDECIDED,
    difference_row,
    heads_of_differences,
)
from benchmark.recipes.recipe_run import COSTS
from std_toolkit.html.table import NONE, Cell, Column, Row, Table, text_table
from std_toolkit.io.documents import read_document

MARKDOWN, DIFFERENCES_CSV = "table.md", "differences.csv"
NOTE = (
    "Figures are means over frames. `paper` is the released evaluation, which the published "
    "figures were made by; under `strict` a missing pixel counts with its whole depth. Published "
    "rows are as printed: with the full data and training, and the paper's own networks. Intervals "
    "are 95 %, over scenes."
)
# What the steps in `COSTS` are, in the order of a run.
_KINDS = {"set": "simulated set", "pack": "pack", "training": "training", "scores": "scores"}


class _Precision(msgspec.Struct, frozen=True, kw_only=True):
    """What is told of the configuration of a training."""

    precision: str = ""


def all_tables(out: Path, scale: str) -> str:
    """The tables of all recipes that ran at a scale, as one page of Markdown.

    Args:
        out: folder of the scale, with a folder for each recipe.
        scale: its name.

    Raises:
        ToolkitError: no such scale, or a file there cannot be read.
    """
    found = {path.parent.name: path for path in out.glob(f"*/{MARKDOWN}")}
    order = [name for name in recipe_names() if name in found]
    order += sorted(found.keys() - set(order))
    lines = [f"# All recipes at scale `{scale}`", "", *_about(get_scale(scale), scale, out)]
    lines += _readings(out, order)
    lines += _costs(out)
    for name in order:
        # A level below the title of this page.
        text = found[name].read_text(encoding="utf-8")
        title, _, rest = re.sub("^#", "##", text, flags=re.MULTILINE).partition("\n")
        # What holds for all recipes stands once.
        kept = [line for line in rest.splitlines() if line != NOTE and line[:9] != "**Scale: "]
        body = re.sub("\n{3,}", "\n\n", "\n".join(kept)).strip()
        lines += [title, "", f"`std-train recipe {name} --scale {scale}`", "", body, ""]
    return "\n".join([*lines, NOTE]) + "\n"


def _about(scale: Scale, name: str, out: Path) -> list[str]:
    """What the scale is and what its numbers are worth."""
    from benchmark.training.config import CONFIG  # torch, which a list of recipes does without

    sizes = []
    for part, title in (("train", "Training"), ("test", "Simulated test")):
        size = scale.sets[part]
        options = size.options
        pixels = f"{options.get('width', 640)}x{options.get('height', 360)}"
        sizes.append(
            f"- {title} set: {size.scenes} scenes of {options['views']} views, {pixels} pixels, "
            f"quality `{options.get('quality', 'draft')}`."
        )
    steps, batch = scale.training.steps, scale.training.batch_size
    long = "as published" if steps is None else f"{steps} steps"
    of = "" if batch is None else f" of {batch} frames"
    others = [
        f"{method} {own.steps or steps or 'published'} of {own.batch_size or batch or 'published'}"
        for method, own in scale.methods.items()
        if own.steps or own.batch_size
    ]
    more = f"; {', '.join(others)}" if others else ""
    configs = [read_document(file, _Precision) for file in out.glob(f"training/*/{CONFIG}")]
    precisions = sorted({config.precision for config in configs if config.precision})
    told = f", --precision {', '.join(precisions)}" if precisions else ""
    return [
        f"**Scale: {name} ({scale.about})**",
        "",
        "docs/recipes.md describes recipes, scales and the columns of the tables.",
        "",
        *sizes,
        f"- Networks: `{scale.preset}`, {long}{of}{more}{told}.",
        "",
    ]


def _readings(out: Path, recipes: list[str]) -> list[str]:
    """The differences that the paper prints, too, in one table."""
    files = [out / name / DIFFERENCES_CSV for name in recipes]
    texts = {"reading": str, "published_on": str}
    tables = [pd.read_csv(file, dtype=texts) for file in files if file.is_file()]
    full = [table for table in tables if len(table)]
    if not full:
        return []
    rows = pd.concat(full, ignore_index=True)
    rows["reading"] = rows["reading"].fillna("")
    rows = rows[rows["reading"] != ""]
    if rows.empty:
        return []
    counts = rows["reading"].value_counts()
    said = ", ".join(f"{counts.get(r, 0)} {r}" for r in (AS_PUBLISHED, OPPOSITE, UNDECIDED))
    columns = [Column(heading=h, numeric=False) for h in ("recipe", "test")]
    made = [
        Row([Cell(text=row["recipe"]), Cell(text=row["test"]), *difference_row(row).cells])
        for row in rows.to_dict("records")
    ]
    table = Table(columns=[*columns, *heads_of_differences()], rows=made)
    return [
        "## Beside the paper",
        "",
        f"Differences that the paper prints, too, by its protocol: {said}. A difference is "
        "undecided if its interval holds zero or p is above 0.05. The published difference is of "
        "the data set in brackets; `dreds-catknown-test` is simulated anew. Agreement and "
        "disagreement are of networks trained as above, and weigh no more than that: intervals and "
        "p-values are over test scenes, of one training each, and another `--seed` moves the "
        "differences.",
        "",
        table.markdown(),
        "",
    ]


def _costs(out: Path) -> list[str]:
    """Processor time of all steps, each once."""
    file = out / COSTS
    if not file.is_file():
        return []
    seconds = read_document(file, dict[str, float])
    rows = []
    for kind, title in _KINDS.items():
        mine = {k.partition(" ")[2]: s for k, s in seconds.items() if k.partition(" ")[0] == kind}
        if kind == "set":
            # Sets that were there before, or made by a killed command, have no time of their own.
            mine |= {p.name: mine.get(p.name, 0.0) for p in sorted(out.glob("data/*"))}
        if kind in ("pack", "scores"):
            rows.append([f"all {title.rstrip('s')}s ({len(mine)})", _minutes(sum(mine.values()))])
        else:
            rows += [[f"{title} `{name}`", _minutes(s)] for name, s in mine.items()]
    rows.append(["all of these", _minutes(sum(seconds.values()))])
    table = text_table(["step", "processor minutes"], rows, texts=1)
    return [
        "## Processor time",
        "",
        "Each step is done once for all recipes. Shapes that one set has decomposed into convex "
        f"parts are not decomposed again. {NONE}: made before, by another command.",
        "",
        table.markdown(),
        "",
    ]


def _minutes(seconds: float) -> str:
    # Looking whether a step is done takes less than this.
    return f"{seconds / 60:.1f}" if seconds >= 0.5 else NONE
