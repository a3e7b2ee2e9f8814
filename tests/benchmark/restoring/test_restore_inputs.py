"""`std-restore` reads depth, lenses and layouts as `std-curate import` does."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark.restoring.outputs import paths_of
from benchmark.restoring.recordings import FrameFiles, open_recordings
from std_toolkit.errors import ToolkitError
from std_toolkit.importers.depth_survey import GuessedUnit
from std_toolkit.importers.options import ImageOptions
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_color, write_png

W, H = 64, 48
MILLIMETRES = np.linspace(500, 800, W * H).reshape(H, W)


def record(folder: Path, depth: NDArray[Any]) -> Path:
    for i in range(2):
        write_color(folder / f"color/{i}.png", np.full((H, W, 3), 90, np.uint8))
        if depth.dtype == np.uint16:
            write_png(folder / f"depth/{i}.png", depth)
        else:
            write_exr(folder / f"depth/{i}.exr", {"Y": depth})
    return folder


def first(folder: Path, **options: Any) -> FrameFiles:
    images = ImageOptions(**{"intrinsics": "60,60,31.5,23.5", **options})
    return open_recordings([folder], images, folder / "out")[0].frames[0]


@pytest.mark.parametrize("mark", [65000, 10000, 1])
def test_marks_of_missing_depth(mark: int, tmp_path: Path) -> None:
    depth = MILLIMETRES.astype(np.uint16)
    depth[:4] = mark
    _, found = first(record(tmp_path, depth)).read()
    assert (found[:4] == 0).all() and np.allclose(found[4:], depth[4:] / 1000)


def test_marks_in_an_exr(tmp_path: Path) -> None:
    depth = (MILLIMETRES / 1000).astype(np.float32)
    depth[:4] = 1e10
    _, found = first(record(tmp_path, depth)).read()
    assert (found[:4] == 0).all() and (found[4:] == depth[4:]).all()


def test_a_mark_that_the_user_names_and_what_it_changes(tmp_path: Path) -> None:
    depth = MILLIMETRES.astype(np.uint16)
    depth[:4] = 2500
    plain, named = first(record(tmp_path, depth)), first(tmp_path, missing="2500")
    assert plain.read()[1][0, 0] == np.float32(2.5) and named.read()[1][0, 0] == 0
    # What was restored with another reading is not kept.
    paths = paths_of(tmp_path, plain, "same")
    assert paths.artefact(plain).inputs != paths.artefact(named).inputs
    assert paths.artefact(plain).inputs != paths.artefact(replace(plain, scale=0.002)).inputs


def test_a_guessed_unit(tmp_path: Path) -> None:
    record(tmp_path, (MILLIMETRES * 8).astype(np.uint16))
    with pytest.raises(GuessedUnit, match=r"--depth-scale .*0.000125"):
        first(tmp_path)
    _, found = first(tmp_path, depth_scale=0.000125).read()
    assert found.max() == pytest.approx(0.8, abs=1e-3)


def test_the_lens_and_the_unit_of_an_intrinsics_file(tmp_path: Path) -> None:
    record(tmp_path, (MILLIMETRES * 5).astype(np.uint16))
    lens = {"fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "k1": -0.1, "DepthMapFactor": 5000.0}
    (tmp_path / "intrinsics.json").write_text(json.dumps(lens))
    frame = first(tmp_path, intrinsics=None)
    assert frame.camera.distortion[0] == -0.1
    assert frame.read()[1].max() == pytest.approx(0.8, abs=1e-3)
    (tmp_path / "intrinsics.json").write_text(json.dumps({**lens, "xi": 0.2}))
    with pytest.raises(ToolkitError, match="xi"):
        first(tmp_path, intrinsics=None)


def test_a_layout_of_a_data_set(tmp_path: Path) -> None:
    depth = (MILLIMETRES * 5).astype(np.uint16)
    for name in ("1305031102.175304", "1305031102.208637"):
        write_color(tmp_path / f"rgb/{name}.png", np.full((H, W, 3), 90, np.uint8))
        write_png(tmp_path / f"depth/{name}.png", depth)
    for kind in ("rgb", "depth"):
        (tmp_path / f"{kind}.txt").write_text("# time name\n")
    assert first(tmp_path).read()[1].max() == pytest.approx(0.8, abs=1e-3)


@pytest.mark.parametrize("scale", [0.0, -0.001, float("nan"), 1000.0])
def test_impossible_units_are_refused(scale: float, tmp_path: Path) -> None:
    record(tmp_path, MILLIMETRES.astype(np.uint16))
    with pytest.raises(ToolkitError, match="--depth-scale: must be metres per unit"):
        first(tmp_path, depth_scale=scale)
