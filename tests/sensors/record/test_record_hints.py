"""Hints: exposure, blur, motion, views."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sensors.record.hints import HintMaker, ViewChange, exposure_shares, sharpness
from sensors.record.recording_document import CapturedFrame


def texture(width: int, height: int, seed: int = 0) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    coarse = rng.integers(30, 226, (height // 8, width // 8, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)


WALL = texture(4096, 360)


def frame(
    start: float, number: int, *, exposure_s: float | None = 0.01, blur: float = 0.0
) -> CapturedFrame:
    """640x360 of the wall from column `start` on."""
    move = np.array([[1, 0, -start], [0, 1, 0]], dtype=np.float64)
    color = cv2.warpAffine(WALL, move, (640, 360), flags=cv2.INTER_LINEAR)
    if blur:
        color = cv2.GaussianBlur(color, (0, 0), blur)
    depth = np.full((360, 640), 700, dtype=np.uint16)
    return CapturedFrame(
        color=np.asarray(color, np.uint8), depth=depth, timestamp=number / 30, exposure_s=exposure_s
    )


def test_exposure_shares() -> None:
    image = np.full((100, 100, 3), 128, dtype=np.uint8)
    image[:20] = 3
    image[90:, :, 1] = 255  # one saturated channel is enough
    assert exposure_shares(image) == (0.2, 0.1)


def test_sharpness_falls_with_blur() -> None:
    grey = cv2.cvtColor(texture(1280, 720)[::4, ::4], cv2.COLOR_RGB2GRAY)
    values = [sharpness(np.asarray(grey, np.uint8))]
    values += [
        sharpness(np.asarray(cv2.GaussianBlur(grey, (0, 0), s), np.uint8)) for s in (0.6, 1, 2)
    ]
    assert values == sorted(values, reverse=True)
    assert values[2] < 0.6 * values[0]


def test_a_blurred_frame_among_sharp_ones() -> None:
    maker = HintMaker(30)
    for number in range(20):
        assert not maker.look(frame(2 * number, number)).advice
    hints = maker.look(frame(40, 20, blur=4))
    assert hints.sharpness < 0.5 and "blurred: move slower" in hints.advice
    assert not maker.look(frame(42, 21)).advice


def test_smear_is_motion_during_the_exposure() -> None:
    maker = HintMaker(30)
    maker.look(frame(0, 0))
    hints = maker.look(frame(12, 1))
    # 12 px in 1/30 s, of which 10 ms were exposed.
    assert hints.smear_px == pytest.approx(12 * 0.01 * 30, rel=0.1)
    assert "blurred: move slower" in hints.advice
    hints = maker.look(frame(14, 2))
    assert hints.smear_px == pytest.approx(2 * 0.01 * 30, rel=0.2)
    assert not hints.advice
    assert maker.look(frame(16, 3, exposure_s=None)).smear_px is None


def test_dark_bright_and_no_depth() -> None:
    base = frame(0, 0)
    for change, advice in ((-200, "too dark"), (200, "too bright")):
        color = np.clip(base.color.astype(int) + change, 0, 255).astype(np.uint8)
        hints = HintMaker(30).look(CapturedFrame(color=color, depth=base.depth, timestamp=0))
        assert any(advice in a for a in hints.advice), hints
    empty = CapturedFrame(color=base.color, depth=np.zeros_like(base.depth), timestamp=0)
    hints = HintMaker(30).look(empty)
    assert hints.depth == 0 and any("little depth" in a for a in hints.advice)
    assert "views 1" in hints.line() and "<<" in hints.line()


def grey_view(start: float) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(frame(start, 0).color, cv2.COLOR_RGB2GRAY), np.uint8)[::2, ::2]


def test_views_are_counted_by_overlap() -> None:
    """Moving by 35 % of the width is another view: 7 times over 800 px, of images 320 wide."""
    views = ViewChange()
    changes = [views.look(np.ascontiguousarray(grey_view(20 * n))) for n in range(81)]
    assert changes[0].views == 1
    assert 6 <= changes[-1].views <= 10
    assert changes[-1].broken == 0
    shifts = [c.shift_px for c in changes[1:]]
    assert np.median(shifts) == pytest.approx(10, abs=0.3)


def test_standing_still_is_one_view() -> None:
    views = ViewChange()
    changes = [views.look(np.ascontiguousarray(grey_view(100))) for _ in range(30)]
    assert {c.views for c in changes} == {1}
    assert changes[-1].overlap > 0.95 and changes[-1].shift_px < 0.05


def test_a_jump_is_told() -> None:
    views = ViewChange()
    for n in range(5):
        views.look(np.ascontiguousarray(grey_view(4 * n)))
    change = views.look(np.ascontiguousarray(grey_view(2500)))
    assert change.lost and change.broken == 1 and change.views == 2


def test_an_empty_wall_gives_no_view() -> None:
    views = ViewChange()
    blank = np.full((180, 320), 128, dtype=np.uint8)
    changes = [views.look(blank) for _ in range(5)]
    assert {c.views for c in changes} == {0}
