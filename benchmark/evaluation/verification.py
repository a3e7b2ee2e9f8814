"""Documents of `std-bench verify`: what was checked of results, what holds, and the grade of a run.

A record names a run by the digest of its manifest and its table: it says nothing of a run that was
changed afterwards.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import msgspec

from benchmark.evaluation.manifest import Count, Name
from std_toolkit.io.documents import digest_file, digest_of, read_document

VERIFICATION = "verification.json"

# `reported`: by whoever sent the results. `recomputed`: from its predictions, with the data.
# `rerun`: by running the method again, with its weights. Truth that everybody holds can be copied
# into predictions, which only a rerun tells.
Grade = Literal["reported", "recomputed", "rerun"]
GRADES: tuple[Grade, ...] = ("reported", "recomputed", "rerun")
State = Literal["holds", "fails", "not checked"]


class Check(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One thing that was looked at.

    Attributes:
        name: such as "frames", "data", "weights", "rows".
        state: whether it holds.
        about: what was found, or why it was not checked.
    """

    name: Name
    state: State
    about: str = ""


class CheckedFigure(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A figure as it is printed, over the frames that were checked.

    Attributes:
        figure: heading and unit, such as "RMSE [mm]".
        subset: which pixels or objects.
        reported, found: texts of the stored rows, and of the ones made again.
        holds: whether they are equal.
    """

    figure: str
    subset: str
    reported: str
    found: str
    holds: bool


class VerifiedRun(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is known of one run.

    Attributes:
        title: of the run.
        folder: of the run, below the folder of results.
        digest: see `run_digest`.
        grade: what the run has earned; `reported` if anything fails.
        frames, of: frames that were made again, and those of the run.
        checks: all that was looked at.
        figures: of runs that were made again.
    """

    title: str
    folder: str
    digest: str
    grade: Grade
    frames: Count
    of: Count
    checks: list[Check]
    figures: list[CheckedFigure] = []

    @property
    def holds(self) -> bool:
        """Whether nothing fails."""
        return not any(c.state == "fails" for c in self.checks) and all(
            f.holds for f in self.figures
        )

    @property
    def graded(self) -> str:
        """The grade in words, with the sample if only a part of the frames was made again."""
        if self.grade == "reported" or self.frames == self.of:
            return self.grade
        return f"{self.grade} ({self.frames:,} of {self.of:,} frames)"

    def lines(self) -> list[str]:
        """Return lines for a terminal: the verdict, then what does not hold or was not checked."""
        verdict = "holds" if self.holds else "DOES NOT HOLD"
        found = [f"{self.title}: {verdict}; {self.graded}"]
        found += [f"  {c.name}: {c.state}{': ' if c.about else ''}{c.about}" for c in self.checks]
        wrong = [f for f in self.figures if not f.holds]
        right = len(self.figures) - len(wrong)
        if self.figures:
            found.append(f"  figures: {right} of {len(self.figures)} hold to the printed digit")
        for f in wrong:
            found.append(f"    {f.subset}, {f.figure}: {f.reported} reported, {f.found} found")
        return found


class Verification(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """verification.json: who checked what.

    Attributes:
        version_of_tool, packages, hardware: as in the manifest of a run.
        runs: one entry for each run.
    """

    version_of_tool: str
    packages: dict[str, str]
    hardware: dict[str, str]
    runs: list[VerifiedRun]


def run_digest(folder: Path, manifest: str, table: str) -> str:
    """Return the digest of a run: of its manifest and its table.

    Raises:
        ToolkitError: a file cannot be read.
    """
    return digest_of(*(digest_file(folder / name) for name in (manifest, table)), versioned=False)


def read_grades(paths: Iterable[Path]) -> dict[str, VerifiedRun]:
    """Return the best entry that holds for each run, by its digest.

    Args:
        paths: records that the reader trusts; one that comes with results is its author's word.

    Raises:
        ToolkitError: a record cannot be read.
    """
    found: dict[str, VerifiedRun] = {}
    for path in paths:
        for run in read_document(path, Verification).runs:
            best = found.get(run.digest)
            if run.holds and (best is None or _rank(run) > _rank(best)):
                found[run.digest] = run
    return found


def _rank(run: VerifiedRun) -> tuple[int, int]:
    return GRADES.index(run.grade), run.frames
