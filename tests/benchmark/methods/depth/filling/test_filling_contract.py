"""What every filling method promises, whatever it does inside a hole."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from filling_scenes import CAMERA, FILLINGS, disc, grey, plane_depth, restored, view_of

from benchmark.methods.protocol import View
from benchmark.methods.registry import MethodOptions, make_restorer, restorers
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

HIDDEN = disc(50, 60, 18) | disc(100, 150, 20) | disc(0, 0, 25) | disc(80, 90, 1.5)


def bumpy() -> np.ndarray:
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    return 0.8 + 0.1 * np.sin(u / 13) * np.cos(v / 17) + 0.5 * (u > 110)


def textured(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.integers(0, 256, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)


@pytest.mark.parametrize("method", FILLINGS)
def test_every_hole_is_filled_with_plausible_depth(method: str) -> None:
    depth = bumpy()
    filled = restored(method, view_of(depth, HIDDEN, textured()))
    assert filled.dtype == np.float32
    assert filled.shape == depth.shape
    assert np.isfinite(filled).all()
    assert filled.min() > 0.5 * depth.min()
    assert filled.max() < 2 * depth.max()


@pytest.mark.parametrize("method", ["raw", *FILLINGS])
def test_measurements_are_kept_to_the_bit_and_the_view_is_not_touched(method: str) -> None:
    view = view_of(bumpy(), HIDDEN, textured())
    before = view.depth.copy(), view.color.copy()
    filled = restored(method, view)
    assert np.array_equal(filled[~HIDDEN], before[0][~HIDDEN])
    assert np.array_equal(view.depth, before[0])
    assert np.array_equal(view.color, before[1])


@pytest.mark.parametrize("method", ["raw", *FILLINGS])
@pytest.mark.parametrize("factor", [2.0**-7, 2.0**10])
def test_the_unit_of_depth_does_not_matter(method: str, factor: float) -> None:
    # Powers of two, which change no rounding: inpainting's order of visits hangs on it.
    view = view_of(bumpy(), HIDDEN, textured())
    scaled = View(view.color, (view.depth * factor).astype(np.float32), CAMERA)
    expected = restored(method, view).astype(np.float64) * factor
    assert np.allclose(restored(method, scaled), expected, rtol=1e-6, atol=0)


@pytest.mark.parametrize("method", FILLINGS)
def test_the_same_view_gives_the_same_answer_alone_and_in_a_batch(method: str) -> None:
    views = [view_of(bumpy(), HIDDEN, textured(k)) for k in range(2)]
    restorer = make_restorer(method)
    together = restorer.restore(views)
    for view, answer in zip(views, together, strict=True):
        assert np.array_equal(make_restorer(method).restore([view])[0].depth, answer.depth)


@pytest.mark.parametrize("method", ["raw", *FILLINGS])
def test_a_view_without_any_measurement_stays_without_answer(method: str) -> None:
    nothing = np.zeros((CAMERA.height, CAMERA.width))
    assert not restored(method, view_of(nothing, nothing > 0)).any()


@pytest.mark.parametrize("method", ["raw", *FILLINGS])
def test_no_views_no_answers(method: str) -> None:
    assert make_restorer(method).restore([]) == []


@pytest.mark.parametrize("method", FILLINGS)
def test_one_measured_pixel_fills_the_whole_image(method: str) -> None:
    only = np.ones((CAMERA.height, CAMERA.width), dtype=bool)
    only[37, 91] = False
    filled = restored(method, view_of(np.full(only.shape, 0.7), only, textured()))
    assert np.allclose(filled, 0.7, rtol=1e-5)


@pytest.mark.parametrize("method", FILLINGS)
def test_a_constant_depth_stays_constant_up_to_the_border_of_the_image(method: str) -> None:
    # OpenCV's inpainting has been wrong beside the border and for holes of one pixel.
    hidden = HIDDEN.copy()
    hidden[:, :3] = hidden[-2:] = True
    for v, u in ((0, 70), (1, 75), (60, 158), (60, 120)):
        hidden[v, u] = True
    filled = restored(method, view_of(np.full(hidden.shape, 0.9), hidden, textured()))
    assert np.allclose(filled, 0.9, rtol=1e-5)


@pytest.mark.parametrize("method", ["raw", *FILLINGS])
def test_what_is_no_depth_counts_as_missing(method: str) -> None:
    depth = np.full((CAMERA.height, CAMERA.width), 0.8, dtype=np.float32)
    depth[10, 10], depth[20, 20], depth[30, 30] = np.nan, np.inf, -1
    answer = restored(method, View(grey(), depth, CAMERA))
    expected = 0 if method == "raw" else 0.8
    assert np.allclose(answer[[10, 20, 30], [10, 20, 30]], expected, rtol=1e-5)
    assert np.isfinite(answer).all()


@pytest.mark.parametrize("method", FILLINGS)
@pytest.mark.parametrize(("width", "height"), [(1, 1), (2, 1), (1, 7), (5, 3)])
def test_tiny_images(method: str, width: int, height: int) -> None:
    camera = Camera(width, height, width, height, (width - 1) / 2, (height - 1) / 2)
    depth = np.zeros((height, width), dtype=np.float32)
    depth[0, 0] = 1.25
    answer = restored(method, View(np.zeros((height, width, 3), np.uint8), depth, camera))
    assert np.allclose(answer, 1.25, rtol=1e-5)


@pytest.mark.parametrize("method", FILLINGS)
def test_objects_are_dropped_before_filling_where_asked(method: str) -> None:
    wall = plane_depth((0, 0, 1), 1.0)
    mask = disc(60, 80, 15)
    view = view_of(np.where(mask, 0.6, wall), np.zeros_like(mask), mask=mask)
    assert np.array_equal(restored(method, view), view.depth)
    filled = restored(method, view, mask="objects")
    assert np.allclose(filled, 1.0, rtol=1e-5)


def test_the_mask_is_widened_where_asked() -> None:
    wall = np.ones((CAMERA.height, CAMERA.width))
    wrong = disc(60, 80, 19)
    view = view_of(np.where(wrong, 0.6, wall), np.zeros_like(wrong), mask=disc(60, 80, 15))
    assert restored("nearest", view, mask="objects").min() == np.float32(0.6)
    assert restored("nearest", view, mask="objects", grow_px="6").min() == 1


def test_a_mask_is_asked_for_only_where_it_is_needed() -> None:
    assert not make_restorer("nearest").needs_mask
    options = MethodOptions(settings={"mask": "objects"})
    assert make_restorer("nearest", options).needs_mask
    with pytest.raises(ToolkitError, match="this view has no mask"):
        make_restorer("nearest", options).restore([view_of(bumpy(), HIDDEN)])


def test_speckles_fill_nothing_where_asked() -> None:
    hidden = disc(60, 80, 30)
    hidden[58:62, 78:82] = False
    depth = np.where(disc(60, 80, 10), 5.0, 1.0)
    view = view_of(depth, hidden)
    assert (restored("nearest", view) == 5).sum() > 100
    answer = restored("nearest", view, speckle_px="17")
    assert (answer == 5).sum() == 16  # kept, as every measurement
    assert (restored("nearest", view, speckle_px="16") == 5).sum() > 100


def test_an_image_of_speckles_alone_stays_as_it_is() -> None:
    hidden = ~disc(60, 80, 3)
    view = view_of(np.ones(hidden.shape), hidden)
    assert np.array_equal(restored("telea", view, speckle_px="1000"), view.depth)


@pytest.mark.parametrize(
    ("method", "settings", "problem"),
    [
        ("nearest", {"radius": "3"}, "radius: .*no such setting.*mask, grow_px, speckle_px"),
        ("telea", {"radius_px": "wide"}, r"radius_px: expected a number \(got 'wide'\)"),
        ("telea", {"radius_px": "0"}, "radius_px: must be from 1 to 100"),
        ("telea", {"radius_px": "nan"}, "radius_px: must be from 1 to 100"),
        ("planes", {"mask": "everything"}, "mask: expected one of holes, objects"),
        ("planes", {"least_cells": "2.5"}, "least_cells: expected a whole number"),
        ("planes", {"cell_px": "1"}, "cell_px: must be from 3 to 200"),
        ("joint-bilateral", {"width": "inf"}, "width: must be from 0.3 to 3"),
        ("colorization", {"grow_px": "-1"}, "grow_px: must be from 0 to 200"),
        ("raw", {"mask": "objects"}, "mask: method `raw` has no settings"),
    ],
)
def test_wrong_settings_are_refused_by_name(
    method: str, settings: dict[str, str], problem: str
) -> None:
    with pytest.raises(ToolkitError, match=problem):
        make_restorer(method, MethodOptions(settings=settings))


@pytest.mark.parametrize("field", ["color", "depth", "mask"])
def test_views_of_mixed_sizes_are_refused(field: str) -> None:
    view = view_of(bumpy(), HIDDEN, mask=HIDDEN)
    parts = {"color": view.color, "depth": view.depth, "mask": view.mask}
    parts[field] = parts[field][:-1]
    with pytest.raises(ToolkitError, match=f"{field}: is not of the camera's size 160x120"):
        make_restorer("nearest").restore([View(camera=CAMERA, **parts)])


def test_no_method_here_needs_torch() -> None:
    program = (
        "import sys\n"
        "from benchmark.methods.registry import make_restorer\n"
        f"for name in {('raw', *FILLINGS)!r}: make_restorer(name)\n"
        "import benchmark.methods.depth.cleargrasp.global_optimization\n"
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_all_of_them_are_registered() -> None:
    assert {"raw", *FILLINGS} <= set(restorers.names())
