"""What each command of `std-curate project` takes.

The command lines are generated from these dataclasses (see `std_toolkit.cli.command_options`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from std_toolkit.commands import RunBasics
from std_toolkit.jobs.door import Writes
from std_toolkit.labels.agreement.options import CompareOptions
from std_toolkit.options import ExportBasics, JobOptions, Whole


@dataclass(frozen=True, kw_only=True)
class ProjectOptions:
    """The project that a command is about."""

    project: Path = field(metadata={"writes": Writes("scene")})
    """folder of the project"""


@dataclass(frozen=True, kw_only=True)
class CreateCommand(ProjectOptions):
    """Make a project of scenes: write PROJECT/project.json.

    Scenes stay where they are and can be used without the project. Every --twice-every'th scene is
    labelled a second time, blind; who labelled a scene may not review it; a scene is accepted when
    a person reviewed it, the check calls no label wrong, and each doubtful or unknown label has
    that person's reason.
    """

    scenes: tuple[Path, ...] = ()
    """folders of scenes"""
    people: tuple[str, ...] = ()
    """names or initials, as in the labels (--annotator)"""
    twice_every: Whole = 10
    """label every k-th scene twice, blind; 0 for none"""


@dataclass(frozen=True, kw_only=True)
class AddCommand(ProjectOptions):
    """Add scenes and people to a project, or change its rule of second labels."""

    scenes: tuple[Path, ...] = ()
    """folders of scenes"""
    people: tuple[str, ...] = ()
    """names or initials"""
    twice_every: Whole | None = None
    """label every k-th scene twice, blind; 0 for none (default: as it is)"""


@dataclass(frozen=True, kw_only=True)
class PeopleCommand(ProjectOptions):
    """List the people of a project, make a token of a person, or revoke it.

    `std-annotate PROJECT --web PORT` asks for a token: it decides in whose name a browser labels
    and reviews. The token is printed once; the project stores its digest only.
    """

    token: str | None = None
    """make a token of this person; an earlier one is worthless then"""
    revoke: str | None = None
    """revoke the token of this person"""


@dataclass(frozen=True, kw_only=True)
class StatusCommand(ProjectOptions):
    """Print the board of a project: what each scene waits for, verdicts, people, minutes.

    With --for, print what is due for a person, the first task first. The exit status is 1 if a
    scene cannot be read.
    """

    person: str | None = field(default=None, metadata={"option": "for"})
    """print what is due for this person"""
    objects: bool = False
    """print a row per object"""
    json: bool = False
    """print JSON"""


@dataclass(frozen=True, kw_only=True)
class ReviewCommand(ProjectOptions):
    """Accept the labels of a scene, send it back, give the reason of a label, or comment.

    The review is stored in the scene (review.json). It holds until a label changes. The exit
    status is 1 if something stands against the acceptance.
    """

    # Here, too: positional arguments of a class precede those of its base.
    project: Path = field(metadata={"writes": Writes("scene")})
    """folder of the project"""
    scene: str = field(metadata={"option": ""})
    """name or folder of the scene"""
    by: str = field(metadata={"option": "by"})
    """the reviewer; who labelled the scene may not review it, only comment"""
    accept: bool = False
    """accept all labels as they are"""
    send_back: str | None = None
    """send the scene back, with this reason"""
    reason: Mapping[str, str] = field(default_factory=dict, metadata={"repeat": True})
    """why the label of this object is kept although it is doubtful or unknown; with --send-back,
    what is wrong with it; may be repeated"""
    comment: str | None = None
    """only say something about the scene; anybody of the project may"""


@dataclass(frozen=True, kw_only=True)
class RunCommand(ProjectOptions, RunBasics):
    """Take every scene through the steps that are due: poses, propagate, render, check.

    Scenes are worked on in parallel; one that fails does not stop the others. Completed steps are
    kept: run the command again after an interruption. Scenes that wait for a person are left
    alone. Copies for second, blind labels are made when the first labels are complete. Doubtful
    labels are left to the reviewers. The exit status is 1 if a step failed or a label is wrong.
    """


@dataclass(frozen=True, kw_only=True)
class ExportCommand(ProjectOptions):
    """Write one data set of all accepted scenes.

    Splits consist of whole scenes, never of frames. README.md and dataset.json have licence,
    splits, and statistics of objects, poses, materials, viewpoints and label deviations. No names
    of people are written.
    """

    format: str = field(metadata={"option": "format"})
    """std, bop, nocs or a plug-in"""
    out: Path = field(metadata={"option": "out", "writes": Writes("place")})
    """new folder of the data set"""
    licence: str = field(metadata={"option": "licence"})
    """licence of images, labels and meshes, such as CC-BY-4.0"""
    split: Mapping[str, float] = field(default_factory=lambda: {"test": 1.0})
    """fraction of the scenes of each split (train, val, test); their sum is 1"""
    split_by: Literal["name", "order"] = "name"
    """assign scenes by a digest of their names, so that none changes its split when scenes are
    added, or in their order in the project, which meets the fractions best"""
    shards: Whole = 0
    """BOP: also write WebDataset shards of up to this many images beside each split; 0 for none,
    1000 is usual"""
    options: ExportBasics = field(default_factory=ExportBasics)
    jobs: JobOptions = field(default_factory=JobOptions)


@dataclass(frozen=True, kw_only=True)
class AgreementCommand(ProjectOptions):
    """Compare the scenes that were labelled twice: shift and turn between the labels of two people.

    Symmetric poses count as equal. Prints median and 95 % by model and by two people, and each
    disagreement. The exit status is 1 if labels disagree or a scene cannot be compared.
    """

    names: bool = False
    """name the people instead of A, B, ..."""
    options: CompareOptions = field(default_factory=CompareOptions)
    json: bool = False
    """print JSON"""
