"""Maps survive their files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import write_png
from std_toolkit.rendering import ground_truth

SIZE = (57, 43)


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(3)


def test_depth_is_lossless(tmp_path: Path, random: np.random.Generator) -> None:
    depth = random.uniform(0, 3, (43, 57)).astype(np.float32)
    depth[:20] = 0
    ground_truth.write_depth(tmp_path / "d.exr", depth)
    assert np.array_equal(ground_truth.load_depth(tmp_path / "d.exr", SIZE), depth)


def test_nocs_keeps_five_micrometres_of_a_third_of_a_metre(
    tmp_path: Path, random: np.random.Generator
) -> None:
    nocs = random.uniform(0, 1, (43, 57, 3)).astype(np.float32)
    nocs[:20] = 0
    mask = np.ones((43, 57), np.uint8)
    mask[:20] = 0
    ground_truth.write_nocs(tmp_path / "n.png", nocs, mask)
    back = ground_truth.load_nocs(tmp_path / "n.png", SIZE)
    assert np.abs(back - nocs).max() <= 0.5 / 65535 + 1e-7
    assert not back[:20].any()


@pytest.mark.parametrize("covered_rows", [0, 3, 43])
def test_values_are_rounded_to_the_nearest_step(tmp_path: Path, covered_rows: int) -> None:
    steps = np.linspace(0, 65535, 43 * 57 * 3).reshape(43, 57, 3)
    mask = np.zeros((43, 57), np.uint8)
    mask[:covered_rows] = 7
    ground_truth.write_nocs(tmp_path / "n.png", (steps / 65535).astype(np.float32), mask)
    normals = (2 * steps / 65535 - 1).astype(np.float32)
    ground_truth.write_normals(tmp_path / "v.png", normals, mask)
    expected = np.where(mask[..., None], steps, 0)
    for name in ("n.png", "v.png"):
        stored = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)[..., ::-1]
        assert np.abs(stored - expected).max() <= 0.51


def test_normals_keep_a_thousandth_of_a_degree(tmp_path: Path, random: np.random.Generator) -> None:
    normals = random.normal(size=(43, 57, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    mask = np.ones((43, 57), np.uint8)
    mask[:20] = 0
    normals[:20] = 0
    ground_truth.write_normals(tmp_path / "v.png", normals.astype(np.float32), mask)
    back = ground_truth.load_normals(tmp_path / "v.png", SIZE)
    assert not back[:20].any()
    sine = np.linalg.norm(np.cross(back[20:], normals[20:]), axis=2)
    assert np.rad2deg(sine).max() < 0.002
    assert np.abs((back[20:] * normals[20:]).sum(axis=2) - 1).max() < 1e-4


def test_files_are_byte_deterministic(tmp_path: Path, random: np.random.Generator) -> None:
    depth = random.uniform(0, 3, (43, 57)).astype(np.float32)
    for name in ("a.exr", "b.exr"):
        ground_truth.write_depth(tmp_path / name, depth)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_wrong_files_are_told(tmp_path: Path) -> None:
    path = tmp_path / "n.png"
    write_png(path, np.zeros((43, 57, 3), np.uint8))
    with pytest.raises(ToolkitError, match="16-bit RGB"):
        ground_truth.load_nocs(path, SIZE)
    with pytest.raises(ToolkitError, match="57x44"):
        ground_truth.load_nocs(path, (57, 44))
