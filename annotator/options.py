"""Options of `std-annotate`, without expensive imports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError, check_options
from std_toolkit.jobs.door import Writes
from std_toolkit.labels.agreement.options import CompareOptions

# The secret that a browser must send, and the address of the board of a project that started this
# process for one of its scenes: it then ends with its standard input.
TOKEN_VARIABLE, HOME_VARIABLE = "STD_ANNOTATE_TOKEN", "STD_ANNOTATE_HOME"


@dataclass(frozen=True, kw_only=True)
class AnnotateOptions:
    """Align the CAD meshes of objects to a recorded scene, or show the board of a project.

    Opens a window, serves a browser (--web) or runs a script (--script). Every edit is written to
    disk immediately; unsaved edits are offered for recovery when the scene is opened again.
    """

    scene: Path | None = field(default=None, metadata={"option": "", "writes": Writes("scene")})
    """scene folder (the window asks for one), or folder of a project"""
    annotator: str | None = None
    """who annotates (the user of this computer)"""
    read_only: bool = False
    """open read-only: nothing can be edited or saved"""
    recover: Literal["ask", "yes", "no"] = "ask"
    """unsaved edits of an earlier session: restore them (yes), set them aside (no) or ask; a script
    with such edits needs yes or no"""
    take_over: bool = False
    """open a scene that another computer has open which is not heard of any more, because it is off
    or without network"""
    meshes: str | None = None
    """folder of meshes to show in the library beside those of the scene; remembered for later
    starts, "none" forgets it"""
    script: Path | None = None
    """carry out the edits in a JSON file; data_spec.md describes it"""
    web: Annotated[int | None, msgspec.Meta(ge=0, le=65535)] = None
    """serve a browser on this port; 0 for any free one"""
    host: str = "127.0.0.1"
    """address to listen on"""
    token: str | None = None
    """secret that a browser must send; required for addresses other than 127.0.0.1
    ($STD_ANNOTATE_TOKEN, which other users of this computer cannot see). In a project, each person
    has one: `std-curate project people`"""

    def __post_init__(self) -> None:
        check_options(self)
        if self.script is not None and self.web is not None:
            raise ToolkitError("--script and --web exclude each other")
        if self.script is not None and self.read_only:
            raise ToolkitError("a script edits the scene and cannot be run with --read-only")
        if self.take_over and (self.script is not None or self.read_only):
            raise ToolkitError("--take-over is for editing by hand, without --script, --read-only")
        if self.script is not None and self.meshes is not None:
            raise ToolkitError(
                "--meshes needs a window or --web", hint="a script names its mesh files"
            )
        if self.web is None and (self.host != "127.0.0.1" or self.token is not None):
            raise ToolkitError("--host and --token need --web")
        if self.scene is None and (self.script is not None or self.web is not None):
            raise ToolkitError("--script and --web need SCENE")


@dataclass(frozen=True, kw_only=True)
class MergeOptions(CompareOptions):
    """Options for objects on which annotators disagree."""

    prefer: str | None = None
    """where they disagree, take the label of this annotator: A, B, ..."""
    take: Mapping[str, str] = field(default_factory=dict, metadata={"repeat": True})
    """OBJECT=ANNOTATOR: take this annotator's label of the object; may be repeated"""
    single: bool = False
    """take labels that only one annotator made"""
    majority: bool = False
    """with three or more annotators, take the label on which more than half agree"""


@dataclass(frozen=True, kw_only=True)
class CompareCommand:
    """Compare the labels of two annotators of one recording, or of one annotator at two times.

    Reports the symmetry-aware surface distance (MSSD), rotation, and translation along and across
    the viewing ray. Disagreements are listed first, with the main difference. Changes neither
    scene. Exit status 0 if all objects labelled by both agree, 1 if some do not.
    """

    a: Path
    """scene folder of one annotator"""
    b: Path
    """scene folder of the other"""
    options: CompareOptions = field(default_factory=CompareOptions)
    out: Path | None = field(default=None, metadata={"writes": Writes("files")})
    """folder for agreement.csv, frames.csv, agreement.json and an image of every disagreement"""
    csv: Path | None = field(default=None, metadata={"writes": Writes("file", suffix=".csv")})
    """file for the table of objects"""
    json: bool = False
    """print JSON"""


@dataclass(frozen=True, kw_only=True)
class MergeCommand:
    """Merge the labels of two or more annotators of one recording.

    Annotators are named A, B, C, ... in the order of the folders. If they agree, the object gets
    the mean of their poses; otherwise it gets no label unless an option resolves it. The input
    folders are not changed. Exit status 0 if every object has a label, 1 otherwise.
    """

    scenes: tuple[Path, ...]
    """scene folder of each annotator"""
    out: Path | None = field(default=None, metadata={"writes": Writes("new")})
    """new scene folder: a copy of the first one's recording and camera poses"""
    into: Path | None = field(default=None, metadata={"writes": Writes("scene")})
    """another scene of the recording to write the labels into"""
    overwrite: bool = False
    """with --into: replace all existing labels"""
    options: MergeOptions = field(default_factory=MergeOptions)

    def __post_init__(self) -> None:
        if (self.out is None) == (self.into is None):
            raise ToolkitError("give either --out or --into")
        if self.overwrite and self.into is None:
            raise ToolkitError("--overwrite needs --into; a new scene replaces nothing")
