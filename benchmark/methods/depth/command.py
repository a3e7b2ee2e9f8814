"""A depth restorer that is a program: a list of frames in, files of depth out.

For methods that run in an environment of their own, such as a container. The program gets the path
of `frames.csv`, the list that `std-bench infer-list` writes too, and writes depth to the file `out`
of each row: one script serves both.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.data.predictions import read_prediction
from benchmark.methods.program import run_program, words_of_command
from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions
from std_toolkit.arrays import Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.io.atomic import write_csv_atomic
from std_toolkit.io.images import write_png
from std_toolkit.plugins import configured

COLUMNS = (
    "scene", "frame", "color", "raw", "raw_unit_m", "width", "height", "fx", "fy", "cx", "cy",
    "out",
)  # fmt: skip

# Further columns of a frame that has an infrared pair: T_color_left are 16 numbers, row-major.
INFRARED_COLUMNS = (
    "ir_left", "ir_right", "ir_width", "ir_height", "ir_fx", "ir_fy", "ir_cx", "ir_cy",
    "baseline_m", "T_color_left",
)  # fmt: skip

# 6.5 m at 0.1 mm: what a camera of tables measures.
RAW_UNIT_M = 1e-4
_LARGEST = 65535
_LIST = "{list}"


@dataclass(frozen=True, kw_only=True)
class CommandSettings:
    """Settings.

    Attributes:
        command: program and arguments, from the name of the method; `{list}` is the path of
            frames.csv, otherwise it is the last argument.
        timeout_s: seconds for a batch of frames after which the program is stopped.
    """

    command: str = ""
    timeout_s: float = 3600.0


def raw_units(depth: Floats) -> NDArray[np.uint16]:
    """Depth (h, w) in metres as whole numbers of `RAW_UNIT_M`, 0 beyond 6.5 m."""
    units = np.rint(depth.astype(np.float64) / RAW_UNIT_M)
    return np.where(units > _LARGEST, 0, units).astype(np.uint16)


def frame_row(
    scene: str, frame: str, color: Path, raw: Path, camera: Camera, out: Path
) -> dict[str, str]:
    """Return a row of the list.

    Args:
        scene, frame: names.
        color, raw: files of colour and of raw depth.
        camera: at the size of colour.
        out: file that the program is to write.
    """
    values = (
        scene, frame, color.resolve(), raw.resolve(), RAW_UNIT_M, camera.width, camera.height,
        camera.fx, camera.fy, camera.cx, camera.cy, out.resolve(),
    )  # fmt: skip
    return dict(zip(COLUMNS, map(str, values), strict=True))


def write_frame_list(path: Path, rows: Sequence[dict[str, str]]) -> None:
    """Write the list; cells that only other rows have are empty.

    Raises:
        ToolkitError: the file cannot be written.
    """
    infrared = INFRARED_COLUMNS if any(INFRARED_COLUMNS[0] in row for row in rows) else ()
    columns = COLUMNS + infrared
    write_csv_atomic(path, columns, [{name: row.get(name, "") for name in columns} for row in rows])


class CommandRestorer:
    """Runs the program once for each batch of frames.

    Args:
        options: settings are those of `CommandSettings`.

    Raises:
        ToolkitError: no program, or an unknown setting.
    """

    settings_type = CommandSettings

    input_size: tuple[int, int] | None = None
    needs_mask = False

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(CommandSettings(), options.settings)
        self.words = words_of_command(self.config.command, _LIST)

    def restore(self, views: Sequence[View]) -> list[Restored]:
        """See `Restorer`.

        Raises:
            ToolkitError: the program fails, is stopped, or leaves out a frame.
        """
        if not views:
            return []
        with tempfile.TemporaryDirectory(prefix="std-command-") as name:
            folder = Path(name) / "frames"
            rows = [_write(folder, f"{number:06d}", view) for number, view in enumerate(views)]
            path = folder / "frames.csv"
            write_frame_list(path, rows)
            words = [word.replace(_LIST, str(path)) for word in self.words]
            hint = "--set timeout_s=SECONDS, or a smaller --batch-size"
            run_program(words, Path(name), self.config.timeout_s, hint=hint)
            return [self._read(row, view) for row, view in zip(rows, views, strict=True)]

    def _read(self, row: dict[str, str], view: View) -> Restored:
        path = Path(row["out"])
        if not path.is_file():
            raise ToolkitError(
                "the command wrote no depth of a frame", value=f"{self.words[0]}: {path.name}"
            )
        depth = read_prediction(path)
        if depth.shape != view.depth.shape:
            raise ToolkitError(
                "the command's depth must have the size of colour",
                field=path.name,
                value="{1}x{0}".format(*depth.shape),
                hint="{1}x{0} is expected".format(*view.depth.shape),
            )
        return Restored(depth)


def _write(folder: Path, name: str, view: View) -> dict[str, str]:
    color, raw = folder / "color" / f"{name}.png", folder / "raw" / f"{name}.png"
    out = folder / "predictions" / f"{name}.npy"
    for path, picture in ((color, view.color), (raw, raw_units(view.depth))):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_png(path, picture)
    out.parent.mkdir(parents=True, exist_ok=True)
    return frame_row("frames", name, color, raw, view.camera, out)
