"""Draw docs/pictures/material_twins.jpg: python docs/pictures/material_twins.py build/demo/scene.

The scene is that of `make demo`; the twins are rendered in a temporary folder.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.simulation.options import SimulationOptions, TwinName
from sensors.simulation.twins import simulate_twins
from std_toolkit.io.images import write_color
from std_toolkit.jobs import JobOptions
from std_toolkit.scene.scene import Scene

Image = NDArray[np.uint8]
TITLES: dict[TwinName, str] = {
    "original": "original",
    "matt": "matt",
    "steel": "steel",
    "glass": "glass",
}
SIZE, GAP, HEADING = (400, 225), 6, 26


def main(scene: Path) -> None:
    """A column for each twin: colour and the sensor's depth."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        simulate_twins(
            out,
            scene,
            get_args(TwinName),
            SimulationOptions(views=1),
            jobs=JobOptions(engine="serial"),
        ).raise_if_failed()
        columns: list[Image] = []
        for twin, title in TITLES.items():
            found = Scene.open(out / "scenes" / twin / scene.resolve().name)
            (frame,) = found.frames
            depth = found.read_depth(frame)
            assert depth is not None
            columns += [_column(title, found.read_color(frame), depth), _gap()]
    picture = np.concatenate(columns[:-1], axis=1)
    target = Path(__file__).with_name("material_twins.jpg")
    write_color(target, picture)
    print(f"{target}: {picture.shape[1]}x{picture.shape[0]}")


def _column(title: str, color: Image, depth: NDArray[np.float32]) -> Image:
    heading = np.full((HEADING, SIZE[0], 3), 255, np.uint8)
    cv2.putText(
        heading, title, (4, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (30, 30, 30), 1, cv2.LINE_AA
    )
    low, high = np.percentile(depth[depth > 0], [1, 99])
    grey = (255 * np.clip((depth - low) / (high - low), 0, 1)).astype(np.uint8)
    shown = np.ascontiguousarray(cv2.applyColorMap(grey, cv2.COLORMAP_TURBO)[..., ::-1])
    shown[depth <= 0] = (24, 24, 28)
    panels = [cv2.resize(p, SIZE, interpolation=cv2.INTER_AREA) for p in (color, shown)]
    line = np.full((GAP, SIZE[0], 3), 255, np.uint8)
    return np.concatenate([heading, panels[0], line, panels[1]])


def _gap() -> Image:
    return np.full((HEADING + 2 * SIZE[1] + GAP, GAP, 3), 255, np.uint8)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
