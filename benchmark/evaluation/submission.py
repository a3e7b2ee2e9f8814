"""`submission.json` in a folder of predictions: what their author says of them."""

from pathlib import Path
from typing import Annotated, Literal

import msgspec

from std_toolkit.io.documents import read_document, write_document

SUBMISSION = "submission.json"

# Shown on pages: markup and control characters are refused.
Text = Annotated[str, msgspec.Meta(max_length=2000, pattern=r"^[^\x00-\x1f\x7f<>]*$")]
# BibTeX has lines.
Citation = Annotated[
    str, msgspec.Meta(max_length=10_000, pattern=r"^[^\x00-\x09\x0b-\x1f\x7f<>]*$")
]


class Submission(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What an author says of predictions; nothing of it is checked, and all is optional.

    Attributes:
        training_data: what the method was trained on.
        hardware: the machine that predicted.
        device: "cpu" or "gpu" of that machine.
        cores: number of its processor cores in use.
        seconds_per_frame: time of a frame, seconds.
        width, height: size of the images in that time, pixels.
        citation: BibTeX, or a line.
    """

    training_data: Text = ""
    hardware: Text = ""
    device: Literal["", "cpu", "gpu"] = ""
    cores: Annotated[int, msgspec.Meta(ge=1)] | None = None
    seconds_per_frame: Annotated[float, msgspec.Meta(gt=0, lt=1e6)] | None = None
    width: Annotated[int, msgspec.Meta(ge=1)] | None = None
    height: Annotated[int, msgspec.Meta(ge=1)] | None = None
    citation: Citation = ""


def read_submission(folder: Path) -> Submission | None:
    """Read `submission.json` of a folder; None if there is none.

    Raises:
        ToolkitError: it is damaged, or a field is unknown or of the wrong type.
    """
    path = folder / SUBMISSION
    return read_document(path, Submission) if path.is_file() else None


def keep_submission(predictions: Path | None, folder: Path) -> None:
    """Copy what an author says of predictions to the folder of a run, or remove what was there.

    Raises:
        ToolkitError: see `read_submission`.
    """
    said = None if predictions is None else read_submission(predictions)
    if said is None:
        (folder / SUBMISSION).unlink(missing_ok=True)
    else:
        write_document(folder / SUBMISSION, said)
