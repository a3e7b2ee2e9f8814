"""Draw docs/pictures/simulated_depth.jpg: python docs/pictures/simulated_depth.py.

Simulated images only: the real captures that docs/simulation.md compares with may not be spread.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from perf.trial import TrialView, render_view, tiles, vessels
from sensors.materials.material_library import MaterialClass
from sensors.render.mitsuba_renderer import MitsubaRenderer
from sensors.render.sim_renderer import DRAFT_INFRARED
from sensors.specs import load_sensor
from std_toolkit.io.images import write_color

Image = NDArray[np.uint8]
VESSELS: tuple[tuple[MaterialClass, str, str], ...] = (
    ("transparent", "glass_clear", "bottle"),
    ("specular", "chrome", "bowl"),
    ("diffuse", "paper_white", "mug"),
    ("transparent", "glass_refractive", "mug"),
    ("specular", "porcelain_cobalt", "bottle"),
    ("diffuse", "fabric_denim", "bowl"),
)
SIZE, GAP, HEADING = (480, 270), 6, 26


def main() -> None:
    """A row for the board of tiles, one for vessels."""
    sensor = load_sensor("d415")
    camera = sensor.infrared_camera(640, 360)
    renderer = MitsubaRenderer()
    rows = []
    for trial, largest_m in ((tiles(camera, 1), 0.005), (vessels(VESSELS, 3), 0.02)):
        view = render_view(trial, sensor, camera, renderer, options=DRAFT_INFRARED, seed=1)
        rows.append(_row(view, largest_m))
    gap = np.full((GAP, rows[0].shape[1], 3), 255, np.uint8)
    picture = np.concatenate([rows[0], gap, rows[1]])
    target = Path(__file__).with_name("simulated_depth.jpg")
    write_color(target, picture)
    print(f"{target}: {picture.shape[1]}x{picture.shape[0]}")


def _row(view: TrialView, largest_m: float) -> Image:
    low, high = np.percentile(view.exact[view.exact > 0], [1, 99])
    missing = view.depth <= 0
    depth = _colored((view.depth - low) / (high - low), cv2.COLORMAP_TURBO)
    depth[missing] = (24, 24, 28)
    error = _colored(np.abs(view.depth - view.exact) / largest_m, cv2.COLORMAP_VIRIDIS)
    error[missing] = (255, 255, 255)
    panels = {
        "left infrared": np.repeat(view.left[..., None], 3, axis=2),
        "raw depth": depth,
        f"error, 0 to {1000 * largest_m:.0f} mm": error,
    }
    columns: list[Image] = []
    for title, panel in panels.items():
        heading = np.full((HEADING, SIZE[0], 3), 255, np.uint8)
        cv2.putText(
            heading, title, (4, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (30, 30, 30), 1, cv2.LINE_AA
        )
        small = np.asarray(cv2.resize(panel, SIZE, interpolation=cv2.INTER_AREA), np.uint8)
        gap = np.full((HEADING + SIZE[1], GAP, 3), 255, np.uint8)
        columns += [np.concatenate([heading, small]), gap]
    return np.concatenate(columns[:-1], axis=1)


def _colored(values: NDArray[np.floating], scale: int) -> Image:
    grey = (255 * np.clip(values, 0, 1)).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(grey, scale)[..., ::-1])


if __name__ == "__main__":
    main()
