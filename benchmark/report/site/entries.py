"""Entries of a site: every run with its figures, and the board that it competes on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmark.evaluation.tasks.depth_speed import NOT_STATED, Speed
from benchmark.evaluation.verification import VerifiedRun
from std_toolkit.html.table import Column

# Value and ends of its 95 % interval over scenes.
Figure = tuple[float, float, float]
# Fact of predictions with a citation in their `submission.json`.
CITATION = "to cite, as its author says"
NOTHING: Figure = (float("nan"),) * 3


@dataclass(frozen=True, order=True)
class BoardKey:
    """What results must have in common to be ranked together.

    Attributes:
        task: such as "depth restoration".
        data: name of the data set on pages, another one for other content.
        protocol: how it was scored.
        frames: what was scored, in words.
        selection: digest of the scored frames: another part of a set is another board.
        version: series of the toolkit that scored.
    """

    task: str
    data: str
    protocol: str
    frames: str
    selection: str
    version: str

    @property
    def title(self) -> str:
        """Name of the board."""
        return f"{self.data}, protocol {self.protocol}: {self.frames}"


@dataclass(frozen=True, eq=False)
class Entry:
    """A run on its board.

    Attributes:
        board: its board.
        method: name in tables.
        columns: figures of the task.
        ranked_by: name of the column that ranks.
        figures: by subset and name of the column.
        unanswered: frames without an answer: the run is then not ranked.
        is_bound: whether it got ground truth: it is then not ranked.
        speed_class: `cpu`, `gpu` or `not stated`.
        facts: what a page of the method says, by heading.
        uses: names of methods, splits and protocols to cite.
        folder: of the run.
        digest: of manifest and table.
        verified: what is known of the figures; None: only reported.
        published_split: name of the split if the frames are the published ones.
        published_tasks: kinds of published figures of the task.
        frames, scenes: numbers of those scored.
        speed: None if not measured.
    """

    board: BoardKey
    method: str
    columns: Sequence[Column]
    ranked_by: str
    figures: Mapping[str, Mapping[str, Figure]]
    unanswered: int
    facts: Mapping[str, str]
    uses: Sequence[str]
    folder: Path
    digest: str
    frames: int
    scenes: int
    is_bound: bool = False
    speed_class: str = NOT_STATED
    speed: Speed | None = None
    verified: VerifiedRun | None = None
    published_split: str = ""
    published_tasks: Sequence[str] = ()
    owner: str = field(default="", compare=False)

    @property
    def main(self) -> str:
        """The subset by which methods are ranked: the first."""
        return next(iter(self.figures), "")

    @property
    def score(self) -> float:
        """The figure that ranks."""
        return self.figures.get(self.main, {}).get(self.ranked_by, NOTHING)[0]

    @property
    def is_ranked(self) -> bool:
        """Whether it competes."""
        return not (self.unanswered or self.is_bound or np.isnan(self.score))

    @property
    def grade(self) -> str:
        """Reported, recomputed or rerun."""
        return "reported" if self.verified is None else self.verified.grade

    @property
    def provenance(self) -> str:
        """Where the frames come from."""
        return self.facts.get("frames come from", "")


def owners_of(folders: Sequence[Path]) -> dict[Path, str]:
    """A short name for each folder of results."""
    names = {}
    for folder in folders:
        parts = folder.resolve().parts
        deep = 1
        while deep < len(parts) and any(
            other.resolve() != folder.resolve() and other.resolve().parts[-deep:] == parts[-deep:]
            for other in folders
        ):
            deep += 1
        names[folder] = "/".join(parts[-deep:]).replace("<", "").replace(">", "")
    return names


def named_apart(entries: Sequence[Entry]) -> list[Entry]:
    """Add the folder of results to methods of one name that come from several."""
    owners: dict[str, set[str]] = {}
    for entry in entries:
        owners.setdefault(entry.method, set()).add(entry.owner)
    return [
        replace(e, method=f"{e.method} ({e.owner})") if len(owners[e.method]) > 1 else e
        for e in entries
    ]
