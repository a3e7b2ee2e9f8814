"""Options of `std-annotate`; they import nothing heavy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError, check_options


@dataclass(frozen=True, kw_only=True)
class AnnotateOptions:
    """Align the CAD meshes of objects to a recorded scene.

    It happens in a window, in a browser (--web), or by a script (--script). Every edit is on disk
    at once; what was not saved is offered for recovery when the scene is opened again.
    """

    scene: Path | None = field(default=None, metadata={"option": ""})
    """scene folder (the window asks for one)"""
    annotator: str | None = None
    """who annotates (the user of this computer)"""
    read_only: bool = False
    """look only: nothing can be edited or saved"""
    recover: Literal["ask", "yes", "no"] = "ask"
    """edits of an earlier session that were not saved: restore them, or keep them aside; a script
    needs yes or no then"""
    script: Path | None = None
    """carry out the edits in a JSON file; data_spec.md describes it"""
    web: Annotated[int | None, msgspec.Meta(ge=0, le=65535)] = None
    """serve a browser on this port; 0 for any free one"""
    host: str = "127.0.0.1"
    """address to listen on"""
    token: str | None = None
    """secret that a browser must give; needed beyond 127.0.0.1 ($STD_ANNOTATE_TOKEN, which other
    users of this computer cannot see)"""

    def __post_init__(self) -> None:
        check_options(self)
        if self.script is not None and self.web is not None:
            raise ToolkitError("--script and --web exclude each other")
        if self.script is not None and self.read_only:
            raise ToolkitError("a script edits: it cannot be run with --read-only")
        if self.web is None and (self.host != "127.0.0.1" or self.token is not None):
            raise ToolkitError("--host and --token go with --web")
        if self.scene is None and (self.script is not None or self.web is not None):
            raise ToolkitError("--script and --web need SCENE")


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """How labels are compared."""

    threshold_mm: Annotated[float, msgspec.Meta(gt=0)] = 5.0
    """largest MSSD of two labels that agree, in the annotated frame and in the median over all
    common frames"""
    as_annotated: bool = False
    """take the poses as set by hand, before any refinement over several frames"""

    def __post_init__(self) -> None:
        check_options(self)
        if not isfinite(self.threshold_mm):
            raise ToolkitError("must be finite", field="threshold_mm", value=self.threshold_mm)


@dataclass(frozen=True, kw_only=True)
class MergeOptions(CompareOptions):
    """What becomes of objects on which annotators do not agree."""

    prefer: str | None = None
    """where they disagree, take the label of this annotator: A, B, ..."""
    take: Mapping[str, str] = field(default_factory=dict, metadata={"repeat": True})
    """OBJECT=ANNOTATOR: take this annotator's label of the object; may be repeated"""
    single: bool = False
    """take labels that only one annotator made"""
    majority: bool = False
    """of three or more, more than half that agree outvote the others"""


@dataclass(frozen=True, kw_only=True)
class CompareCommand:
    """Compare the labels of two annotators of one recording, or of one annotator at two times.

    Distance of the surfaces (MSSD), rotation, shift along the viewing ray and across it, symmetry
    aware. Disagreements come first, with what differs mostly. Changes neither scene. Exit status 0
    if all objects labelled by both agree, 1 if some do not.
    """

    a: Path
    """scene folder of one annotator"""
    b: Path
    """scene folder of the other"""
    options: CompareOptions = field(default_factory=CompareOptions)
    out: Path | None = None
    """folder for agreement.csv, frames.csv, agreement.json and a picture of every disagreement"""
    csv: Path | None = None
    """file for the table of objects"""
    json: bool = False
    """print JSON"""


@dataclass(frozen=True, kw_only=True)
class MergeCommand:
    """Merge the labels of two or more annotators of one recording.

    They are called A, B, C, ... in the order of the folders. Where they agree, the object gets the
    mean of their poses; where they do not, it stays without a label, unless an option decides. The
    merged folders are not changed. Exit status 0 if every object has a label, 1 if some were left
    open.
    """

    scenes: tuple[Path, ...]
    """scene folder of each annotator"""
    out: Path | None = None
    """new scene folder: a copy of the first one's recording and camera poses"""
    into: Path | None = None
    """another scene of the recording to write the labels into"""
    overwrite: bool = False
    """with --into: replace all labels that are there"""
    options: MergeOptions = field(default_factory=MergeOptions)

    def __post_init__(self) -> None:
        if (self.out is None) == (self.into is None):
            raise ToolkitError("give either --out or --into")
        if self.overwrite and self.into is None:
            raise ToolkitError("--overwrite goes with --into; a new scene replaces nothing")
