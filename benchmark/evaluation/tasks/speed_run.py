"""`std-bench speed`: frames per second of networks without weights and without data."""

from __future__ import annotations

import math
from collections.abc import Iterator

import msgspec
import numpy as np

from benchmark.evaluation.manifest import hardware
from benchmark.evaluation.query_options import SpeedOptions
from benchmark.evaluation.tasks.depth_speed import Speed, measure_speed
from benchmark.methods.depth.full_size import sensor_view, working_size
from benchmark.methods.protocol import Restorer, View
from benchmark.methods.registry import MethodOptions, restorers
from benchmark.methods.weights import untrained
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.html.table import NONE, Cell, Column, Row, Table

# A table 0.7 m away, with a round hole of a fifth of the image where a glass stands.
_DISTANCE_M, _HOLE_PART = 0.7, 0.2


class MethodSpeed(msgspec.Struct, frozen=True, kw_only=True):
    """Cost of a method, see `Speed`; `error` says why there is none."""

    method: str
    speed: Speed | None = None
    error: str = ""


def measure_speeds(options: SpeedOptions) -> Iterator[MethodSpeed]:
    """Yield the cost of each method; one that cannot be made ends nothing."""
    for name in options.methods:
        try:
            yield MethodSpeed(method=name, speed=_speed(name, options))
        except ToolkitError as error:
            yield MethodSpeed(method=name, error=str(error))


def _speed(name: str, options: SpeedOptions) -> Speed:
    with untrained():
        restorer = restorers.make(
            name,
            MethodOptions(
                preset=options.preset,
                device=options.device,
                precision=options.precision,
                compile=options.compile,
            ),
        )
    where = hardware()
    shown = where["gpus" if options.device.startswith("cuda") else "processor"]
    views = [_view(restorer, options.size)] * options.batch_size
    return measure_speed(restorer, views, hardware=shown, repeats=options.repeats)


def _view(restorer: Restorer, size: tuple[int, int]) -> View:
    """A noisy frame at the size that the method works at.

    Raises:
        ToolkitError: the method needs infrared images.
    """
    if getattr(restorer, "needs_infrared", False):
        raise ToolkitError("needs infrared images, which no made-up frame has")
    width, height = size
    noise = np.random.default_rng(0)
    color = noise.integers(0, 256, (height, width, 3), dtype=np.uint8)
    depth = (_DISTANCE_M + noise.normal(0, 0.002, (height, width))).astype(np.float32)
    x, y = np.meshgrid(np.arange(width) - width / 2, np.arange(height) - height / 2)
    hole = x**2 + y**2 < _HOLE_PART * width * height / math.pi
    depth[hole] = 0
    camera = Camera(width, height, width, width, (width - 1) / 2, (height - 1) / 2)
    mask = hole if restorer.needs_mask else None
    own = working_size(restorer, size) or size
    return sensor_view(color, depth, camera, own, mask=mask)


def speed_table(found: list[MethodSpeed]) -> Table:
    """The table of methods, as they were asked for."""
    columns = (
        Column(heading="method", numeric=False),
        Column(heading="size", numeric=False),
        Column(heading="speed", unit="frames/s"),
        Column(heading="processor", unit="s/frame", digits=2),
        Column(heading="parameters", unit="M", factor=1e-6),
        Column(heading="cost", unit="GMAC"),
    )
    rows = []
    for row in found:
        speed = row.speed
        if speed is None:
            missing = [c.cell(None, missing=NONE) for c in columns[1:]]
            cells = [Cell(text=row.method), *missing]
        else:
            figures = (speed.frames_per_s, speed.processor_s, speed.parameters, speed.gmacs)
            own = f"{speed.width}x{speed.height}"
            cells = [Cell(text=row.method), Cell(text=own)]
            cells += [c.cell(f) for c, f in zip(columns[2:], figures, strict=True)]
        rows.append(Row(cells=cells))
    known = [row.speed for row in found if row.speed is not None]
    notes = [f"On {known[0].hardware}, {known[0].batch_size} frames at once."] if known else []
    return Table(columns=columns, rows=rows, title="Speed without weights", notes=notes)
