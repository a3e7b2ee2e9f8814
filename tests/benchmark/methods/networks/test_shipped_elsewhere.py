"""What shipped weights do where nothing is wrong, and whether they look at the colour.

Wanted of a restorer: the table in a hole of a table, within 5 mm, and a true colour that beats
noise and another frame's by 30 % where glass has no depth. CompactDR reaches both; the others miss
both: what they do is held here, and stated on their cards. Mended weights need the wanted value in
place of the held one.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmark import Restorer
from benchmark.methods.depth.full_size import sensor_view, working_size
from benchmark.methods.registry import MethodOptions, make_restorer
from std_toolkit.geometry.camera import Camera

WANTED_MM, WANTED_GAIN = 5.0, 0.30

# Median error in one round hole of a bare table, mm, by the diameter in shares of the width.
HOLES = {0.04: (-62, -19, -6, 0), 0.09: (-64, -40, -42, 0), 0.2: (-80, -57, -90, 0)}
# By how much the true colour beats noise and another frame's on glass without depth.
GAINS = {"noise": (0.18, 0.19, 0.35, 0.37), "other": (-0.16, 0.05, -0.06, 0.37)}
METHODS = ("swindrnet", "dfnet", "nlspn", "compactdr")

W, H, F = 640, 480, 613.0
CAMERA = Camera(W, H, F, F, 319.5, 239.5)


def bare_table() -> tuple[np.ndarray, np.ndarray]:
    """Colour and (H, W) metres of wood, 0.75 m away and seen 45 degrees from above."""
    y = (np.arange(H)[:, None] - CAMERA.cy) / F
    tilt = np.deg2rad(45)
    depth = 0.75 * np.cos(tilt) / (np.sin(tilt) * y + np.cos(tilt))
    rng = np.random.default_rng(0)
    grain = 110 + 25 * np.sin(np.arange(W) / 7)[None, :, None] + rng.normal(0, 6, (H, W, 3))
    color = np.clip(grain * [1.0, 0.8, 0.6], 0, 255).astype(np.uint8)
    return color, np.tile(depth, (1, W)).astype(np.float32)


def with_a_glass(at: tuple[int, int], seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The table with a standing clear beaker: colour, true depth, pixels of the glass."""
    color, depth = bare_table()
    rng = np.random.default_rng(seed)
    color = np.roll(color, int(rng.integers(W)), axis=1)
    glass = np.zeros((H, W), np.uint8)
    x, foot = at
    top, half = foot - 150, 45
    cv2.rectangle(glass, (x - half, top), (x + half, foot), 1, -1)
    cv2.ellipse(glass, (x, foot), (half, 14), 0, 0, 360, 1, -1)
    true = np.where(glass > 0, depth[foot, x] - 0.01, depth).astype(np.float32)
    shown = color.astype(np.float32)
    across = np.abs(np.arange(W) - x) / half
    shade = np.where(across < 1, 1 - 0.5 * across**6, 1)[None, :, None]  # walls are darker
    shown = np.where(glass[..., None] > 0, 0.9 * shown * shade + 12, shown)
    cv2.ellipse(shown, (x, top), (half, 14), 0, 0, 360, (230, 230, 230), 2)
    cv2.line(shown, (x - 22, top + 20), (x - 22, foot - 20), (250, 250, 250), 5)
    return np.clip(shown, 0, 255).astype(np.uint8), true, glass > 0


@pytest.mark.slow
@pytest.mark.parametrize("method", [*METHODS, "nearest"])
def test_what_stands_in_a_hole_of_a_bare_table(method: str) -> None:
    restorer = Restorer.load(method, where="everywhere")
    color, table = bare_table()
    rng = np.random.default_rng(0)
    noisy = table + rng.normal(0, 0.001, table.shape).astype(np.float32)
    K = np.array([[F, 0, CAMERA.cx], [0, F, CAMERA.cy], [0, 0, 1]])
    for share, held in HOLES.items():
        columns, rows = np.meshgrid(np.arange(W) - 330, np.arange(H) - 290)
        hole = columns**2 + rows**2 < (share * W / 2) ** 2
        answer = restorer.restore(color, np.where(hole, 0, noisy), K).depth
        error = 1e3 * float(np.median((answer - table)[hole]))
        if method not in METHODS or held[METHODS.index(method)] == 0:
            assert abs(error) < WANTED_MM, share
            continue
        assert error == pytest.approx(held[METHODS.index(method)], abs=5), share
        rest = np.abs(answer - table)[~hole] > 0.01
        assert rest.mean() < 0.005, share


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_whether_colour_decides_on_glass_without_depth(method: str) -> None:
    restorer = make_restorer(method, MethodOptions(preset="compact"))
    scenes = [with_a_glass(at, i) for i, at in enumerate(((200, 330), (330, 380), (450, 300)))]
    rng = np.random.default_rng(0)
    colors = {
        "true": [color for color, _, _ in scenes],
        "noise": [rng.integers(0, 256, (126, 224, 3), dtype=np.uint8) for _ in scenes],
        "other": [scenes[i - 1][0] for i in range(len(scenes))],
    }
    error = {}
    for name, seen in colors.items():
        found = []
        for color, (_, true, glass) in zip(seen, scenes, strict=True):
            size = working_size(restorer, (W, H))
            view = sensor_view(color, np.where(glass, 0, true), CAMERA, size)
            (answer,) = restorer.restore([view])
            whole = cv2.resize(answer.depth, (W, H), interpolation=cv2.INTER_NEAREST)
            found.append(float(np.sqrt(((whole - true)[glass] ** 2).mean())))
        error[name] = np.mean(found)
    gains = {name: 1 - error["true"] / error[name] for name in GAINS}
    for name, held in GAINS.items():
        assert gains[name] == pytest.approx(held[METHODS.index(method)], abs=0.05), name
    reached = min(gains.values()) >= WANTED_GAIN
    assert reached == (method == "compactdr"), "hold the wanted value now, and change the card"
