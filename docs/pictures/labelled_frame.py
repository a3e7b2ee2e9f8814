"""Draw docs/pictures/labelled_frame.jpg from the demo: python docs/pictures/labelled_frame.py.

Needs the scene that `make demo` leaves in build/demo/scene. The demo is simulated; pictures of
the real recordings may not be distributed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.html.plots import object_color
from std_toolkit.io.images import write_color
from std_toolkit.rendering.ground_truth import read_ground_truth
from std_toolkit.scene import Scene

Image = NDArray[np.uint8]
NEAR_M, FAR_M = 0.4, 1.0
GAP = 8


def main() -> None:
    """Six panels: labels, sensor depth, true depth; instance mask, NOCS, normals."""
    root = Path(sys.argv[1] if len(sys.argv) > 1 else "build/demo/scene")
    scene = Scene.open(root)
    frame = scene.frames[len(scene.frames) // 3]
    truth = read_ground_truth(scene, frame.id)
    sensor = scene.read_depth(frame)
    color = scene.read_color(frame)
    assert sensor is not None, "the demo records depth"
    inside = truth.mask > 0
    panels = {
        "colour with labels": _outlined(color, truth.mask, scene),
        "sensor depth": _depth(sensor),
        "ground-truth depth": np.where(inside[..., None], _depth(truth.depth), 255),
        "instance mask": _painted(truth.mask, scene),
        "NOCS": np.where(inside[..., None], (truth.nocs * 255).astype(np.uint8), 255),
        "normals": np.where(inside[..., None], ((1 - truth.normals) * 127.5).astype(np.uint8), 255),
    }
    tiles = [_titled(image.astype(np.uint8), name) for name, image in panels.items()]
    write_color(
        Path(__file__).with_suffix(".jpg"),
        np.concatenate([_row(tiles[:3]), _row(tiles[3:])]),
        quality=88,
    )


def _outlined(color: Image, mask: NDArray[np.integer], scene: Scene) -> Image:
    image = np.ascontiguousarray(color)
    for item, ink in _inks(scene):
        loops, _ = cv2.findContours(
            (mask == item).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE
        )
        cv2.drawContours(image, loops, -1, (255, 255, 255), 4, cv2.LINE_AA)
        cv2.drawContours(image, loops, -1, ink, 2, cv2.LINE_AA)
    return image


def _painted(mask: NDArray[np.integer], scene: Scene) -> Image:
    image = np.full((*mask.shape, 3), 255, np.uint8)
    for item, ink in _inks(scene):
        image[mask == item] = ink
    return image


def _inks(scene: Scene) -> list[tuple[int, tuple[int, int, int]]]:
    ids = [o.id for o in scene.objects.objects]
    inks = []
    for i in ids:
        code = object_color(ids, i)
        inks.append((i, (int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16))))
    return inks


def _depth(depth: NDArray[np.floating]) -> Image:
    level = np.clip((depth - NEAR_M) / (FAR_M - NEAR_M), 0, 1) * 255
    image = cv2.cvtColor(
        cv2.applyColorMap(level.astype(np.uint8), cv2.COLORMAP_VIRIDIS), cv2.COLOR_BGR2RGB
    )
    image[depth <= 0] = (30, 30, 34)
    return np.asarray(image, dtype=np.uint8)


def _titled(image: Image, title: str) -> Image:
    height = round(480 * image.shape[0] / image.shape[1])
    small = np.asarray(cv2.resize(image, (480, height), interpolation=cv2.INTER_AREA), np.uint8)
    bar = np.full((30, 480, 3), 255, np.uint8)
    cv2.putText(bar, title, (2, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (31, 41, 51), 1, cv2.LINE_AA)
    return np.concatenate([bar, small])


def _row(tiles: list[Image]) -> Image:
    gap = np.full((tiles[0].shape[0], GAP, 3), 255, np.uint8)
    return np.concatenate([tiles[0], gap, tiles[1], gap, tiles[2]], axis=1)


if __name__ == "__main__":
    main()
