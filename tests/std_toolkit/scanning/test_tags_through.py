"""Tags seen through glass are displaced; opaque, mirroring and textured objects show none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("manifold3d")

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from std_toolkit.poses.board_sheet import DICTIONARY, make_board_sheet
from std_toolkit.scanning.board.tags_through import (
    FoundTag,
    check_tags,
    displaced_tags,
    tags_through,
)
from std_toolkit.scanning.photos.views import View
from tests.std_toolkit.scanning.ball import look_at
from tests.std_toolkit.scanning.vessels import WHISKY, WHISKY_INSIDE, turned

CAMERA = Camera(480, 360, 430, 430, 239.5, 179.5)
SHEET = make_board_sheet("a4")
PX_MM = 3.0


def tags() -> dict[int, np.ndarray]:
    return {int(k): np.array(v) / 1000 for k, v in SHEET.document().items() if k.isdecimal()}


def drawn_sheet() -> np.ndarray:
    """The sheet from above, `PX_MM` pixels a millimetre, y up the sheet."""
    width, height = SHEET.paper_mm
    image = np.full((round(height * PX_MM), round(width * PX_MM)), 225, np.uint8)
    for x, y, w, h in SHEET.cells():
        a, b = np.rint([(x + width / 2) * PX_MM, (height / 2 - y - h) * PX_MM]).astype(int)
        image[b : b + round(h * PX_MM), a : a + round(w * PX_MM)] = 25
    return image


def bare_views(count: int = 8) -> list[View]:
    """Photos of the sheet alone, from two heights."""
    sheet = drawn_sheet()
    views = []
    for n in range(count):
        angle, e = 2 * np.pi * (n + 0.3) / count, np.deg2rad((24, 48)[n % 2])
        away = np.array([np.cos(e) * np.cos(angle), np.cos(e) * np.sin(angle), np.sin(e)])
        T = look_at(0.42 * away, np.array([0, 0, 0.03]))
        width, height = np.array(SHEET.paper_mm) / 2000
        corners = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * [width, height, 0]
        uv = CAMERA.project(T.inverse() @ corners).astype(np.float32)
        h, w = sheet.shape
        H = cv2.getPerspectiveTransform(
            np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32) - 0.5, uv
        )
        # Larger, then reduced: pixels are the mean of what they show.
        up = np.diag([3.0, 3.0, 1.0])
        big = cv2.warpPerspective(sheet, up @ H, (3 * 480, 3 * 360), borderValue=110)
        image = cv2.resize(big, (480, 360), interpolation=cv2.INTER_AREA)
        image = np.random.default_rng(n).normal(image, 1.5).clip(0, 255).astype(np.uint8)
        views.append(View(f"{n}.png", np.dstack([image] * 3), CAMERA, T))
    return views


def outline(view: View) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 of an upright vessel of 80 x 95 mm in the middle of the sheet."""
    rim = np.array([[0.04 * np.cos(a), 0.04 * np.sin(a), z]
                    for a in np.arange(0, 6.3, 0.2) for z in (0, 0.095)])  # fmt: skip
    uv, _ = view.project(rim)
    x0, y0 = np.floor(uv.min(axis=0)).astype(int)
    x1, y1 = np.ceil(uv.max(axis=0)).astype(int)
    return max(x0, 0), max(y0, 0), min(x1, 479), min(y1, 359)


def with_object(view: View, kind: str) -> View:
    """The photo with something that stands on the sheet."""
    x0, y0, x1, y1 = outline(view)
    image = view.image.copy()
    part = image[y0:y1, x0:x1].copy()
    if kind == "glass":
        # As walls of a cylinder do: what is behind is squeezed to the middle and raised a little.
        h, w = part.shape[:2]
        x, y = np.meshgrid(np.linspace(-1, 1, w), np.arange(h))
        from_x = (x * (1 + 0.25 * x**2) / 1.25 * 1.2 * w / 2 + w / 2).clip(0, w - 1)
        from_y = (y + 3).clip(0, h - 1)
        part = cv2.remap(part, from_x.astype(np.float32), from_y.astype(np.float32),
                         cv2.INTER_LINEAR)  # fmt: skip
        part = (0.9 * part + 12).astype(np.uint8)
    elif kind == "steel":
        # It mirrors what is before it.
        size = y1 - y0
        before = view.image[min(y1, 359 - size) : min(y1, 359 - size) + size, x0:x1]
        part = before[:size][::-1].copy()
    elif kind == "checks":
        y, x = np.mgrid[: part.shape[0], : part.shape[1]] // 4
        noise = np.random.default_rng(5).integers(0, 2, (200, 200))
        part[:] = (30 + 190 * noise[y % 200, x % 200])[..., None]
    elif kind == "black":
        part[:] = 20
    image[y0:y1, x0:x1] = part
    return replace(view, image=image)


@pytest.mark.parametrize("kind", ["nothing", "black", "checks", "steel"])
def test_opaque_objects_are_not_refused(kind: str) -> None:
    views = [with_object(v, kind) for v in bare_views()]
    check_tags(tags_through(views, tags(), DICTIONARY, threads=1), tags())


def test_glass_is_refused_with_the_photos_and_the_way_out() -> None:
    views = [with_object(v, "glass") for v in bare_views()]
    with pytest.raises(ToolkitError, match=r"transparent: \d photos show \d+ tags.*--revolve"):
        check_tags(tags_through(views, tags(), DICTIONARY, threads=1), tags())


def test_a_sheet_with_a_tag_elsewhere_is_not_glass() -> None:
    """As where a corner of the sheet is bent: displaced in every photo."""
    moved = tags()
    for tag in (0, 1, 5):
        moved[tag] = moved[tag] + [0.004, 0.004, 0]
    views = [with_object(v, "black") for v in bare_views()]
    check_tags(tags_through(views, moved, DICTIONARY, threads=1), moved)


def test_few_displaced_tags_are_told_from_many_that_lie_elsewhere() -> None:
    rest = [[FoundTag(t, 0.2, 1.0) for t in range(9)] for _ in range(6)]
    rest[2][4] = FoundTag(4, 5.0, 0.95)
    for photo in rest:
        photo[7] = FoundTag(7, 3.0, 1.0)
    assert displaced_tags(rest) == [[], [], [4], [], [], []]


@pytest.mark.long
def test_a_rendered_tumbler_is_refused_before_masks_and_depth(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    from sensors.simulation.cli import main as simulate
    from std_toolkit.cli.scanning import main

    turned(WHISKY, WHISKY_INSIDE).export(tmp_path / "whisky.ply")
    words = f"turntable --mesh {tmp_path}/whisky.ply --material glass --views 10 --samples 4"
    sizes = f"--width 640 --height 480 --seed 21 --out {tmp_path}/table"
    assert simulate([*words.split(), *sizes.split()]) in (0, None)
    table, out = tmp_path / "table", tmp_path / "model"
    words = f"{table}/photos --board {table}/board.json --out {out} --engine serial"
    assert main(words.split()) == 1
    assert not list((out / ".scan").glob("*masks*"))
    assert not (out / "report.html").exists()
