"""`std-bench infer-list`: the frames of a split as a table, for programs of other environments.

A program reads `frames.csv`, and for each row colour, raw depth and intrinsics; it writes depth to
`out`. Colour is named where it lies, and so is the infrared pair where there is one. Raw depth is
written anew, as 16-bit PNG of 0.1 mm, whatever the data set's own form: every library reads it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from benchmark.data.frame import DepthFrame
from benchmark.data.infrared import InfraredSource
from benchmark.data.splits import DepthSource, FrameKey, inputs_of, open_split
from benchmark.evaluation.batches import chosen_frames
from benchmark.evaluation.query_options import FRAME_LIST, InferListOptions
from benchmark.methods.depth.command import INFRARED_COLUMNS, frame_row, raw_units, write_frame_list
from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import write_color, write_png
from std_toolkit.jobs import run_jobs

_ORDINARY = (".png", ".jpg", ".jpeg")


@cache
def _source(split: str, root: Path) -> DepthSource:
    """The split, listed once in a process."""
    return open_split(split, root)


@dataclass(frozen=True)
class _Writer:
    """Writes the files of a frame."""

    options: InferListOptions

    def __call__(self, index: int) -> dict[str, Any]:
        source = _source(self.options.split, self.options.data)
        frame = source.load(index)
        key = FrameKey(frame.scene, frame.name)
        found = inputs_of(source, index).get("colour")
        color = _color_file(self.options.out, key, frame, found)
        raw = self.options.out / "raw" / key.scene / f"{key.name}.png"
        raw.parent.mkdir(parents=True, exist_ok=True)
        write_png(raw, raw_units(frame.depth_raw))
        out = self.options.out / "predictions" / key.scene / f"{key.name}.npy"
        camera = frame.camera.resized(frame.color.shape[1], frame.color.shape[0])
        row = frame_row(key.scene, key.name, color, raw, camera, out)
        return row | (_infrared(source, index) if isinstance(source, InfraredSource) else {})


def _infrared(source: InfraredSource, index: int) -> dict[str, str]:
    """Cells of `INFRARED_COLUMNS`; none for a frame that has no calibrated pair."""
    files = source.infrared_files(index)
    known = "infrared calibration" in files or getattr(source, "infrared_is_known", False)
    if not (known and all(path.is_file() for path in files.values())):
        return {}
    pair = source.infrared(index)
    images = (files["left infrared image"], files["right infrared image"])
    camera = pair.camera
    values = (
        *(image.resolve() for image in images), camera.width, camera.height,
        camera.fx, camera.fy, camera.cx, camera.cy, pair.baseline_m,
        " ".join(map(str, pair.T_color_left.flat())),
    )  # fmt: skip
    return dict(zip(INFRARED_COLUMNS, map(str, values), strict=True))


def _color_file(out: Path, key: FrameKey, frame: DepthFrame, found: object) -> Path:
    """The colour image where it lies; a copy of one that not every library reads."""
    if isinstance(found, Path) and found.suffix.lower() in _ORDINARY:
        return found
    path = out / "color" / key.scene / f"{key.name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_color(path, frame.color)
    return path


def write_infer_list(options: InferListOptions) -> Path:
    """Write the list, and the raw depth of every frame.

    Returns:
        The list.

    Raises:
        ToolkitError: no data, a frame that cannot be read, or a folder that cannot be written.
    """
    source = open_split(options.split, options.data)
    chosen = chosen_frames(len(source), options.limit)
    if not chosen:
        raise ToolkitError("the split has no frame here", path=options.data, value=options.split)
    keys = source.keys()
    report = run_jobs(
        _Writer(options),
        chosen,
        name="infer-list",
        key=lambda index: str(keys[index]),
        options=options.jobs,
    )
    if report.failed:
        where, why = next(iter(report.failed.items()))
        raise ToolkitError(f"{len(report.failed)} frames cannot be listed; {where}: {why}")
    rows = [report.results[str(keys[index])] for index in chosen]
    path = options.out / FRAME_LIST
    write_frame_list(path, rows)
    return path
