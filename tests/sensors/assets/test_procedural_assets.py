"""The built-in library: closed solids in the canonical frame, the same for the same seed."""

from __future__ import annotations

import os
import subprocess
import sys
import zlib
from functools import cache

import numpy as np
import pytest

from sensors.assets import ASSET_SOURCES, TURN_Y, SourceOptions, open_source, scale_range
from sensors.assets.asset_source import draw_diagonal, scale_table
from sensors.assets.mesh_file import turn_symmetry
from sensors.assets.procedural.shape_library import CATEGORIES, make
from std_toolkit.errors import ToolkitError
from std_toolkit.scene.model import CATEGORY_CLASS_IDS

pytest.importorskip("manifold3d", reason="needs the extra [sim]")

SEEDS = range(8)
# Shapes take a while to make; nothing here changes them.
made = cache(make)


@pytest.mark.slow
@pytest.mark.parametrize("category", CATEGORIES)
def test_every_shape_is_a_closed_solid_in_the_canonical_frame(category: str) -> None:
    for seed in SEEDS:
        asset = made(category, seed)
        mesh = asset.mesh
        assert mesh.is_watertight and mesh.is_winding_consistent, (category, seed)
        assert mesh.volume > 0
        assert 2000 <= len(mesh.faces) <= 20000
        low, high = mesh.bounds
        np.testing.assert_allclose(low + high, 0, atol=1e-6)
        assert np.linalg.norm(high - low) == pytest.approx(1, abs=1e-6)
        assert mesh.area_faces.min() > 0
        assert asset.face_colors is not None and asset.corner_uv is not None
        assert np.isfinite(asset.corner_uv).all()
        assert asset.class_id == CATEGORY_CLASS_IDS[category]


@pytest.mark.slow
@pytest.mark.parametrize("category", CATEGORIES)
def test_seeds_differ(category: str) -> None:
    assert len({made(category, seed).content_hash for seed in SEEDS}) == len(SEEDS)


@pytest.mark.slow
def test_the_same_seed_is_the_same_mesh_in_another_process() -> None:
    chosen = [(c, s) for c in CATEGORIES for s in (3, 4)]
    script = (
        "import zlib\n"
        "from sensors.assets.procedural.shape_library import make\n"
        f"for c, s in {chosen!r}:\n"
        "    a = make(c, s)\n"
        "    print(a.content_hash, zlib.crc32(a.face_colors.tobytes()), float(a.corner_uv.sum()))\n"
    )
    # Neither the number of threads nor the order of sets and dicts may matter.
    run = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONHASHSEED": "7", "OMP_NUM_THREADS": "2"},
    )
    here = [make(c, s) for c, s in chosen]
    assert run.stdout.splitlines() == [
        f"{a.content_hash} {zlib.crc32(a.face_colors.tobytes())} {float(a.corner_uv.sum())}"
        for a in here
        if a.face_colors is not None and a.corner_uv is not None
    ]


@pytest.mark.parametrize("category", CATEGORIES)
def test_turned_shapes_and_no_others_are_symmetric(category: str) -> None:
    for seed in SEEDS:
        asset = made(category, seed)
        measured = turn_symmetry(asset.vertices, asset.faces)
        if asset.symmetry == TURN_Y:
            assert measured == TURN_Y, seed
        elif category != "other":  # a gear is nearly round
            assert measured.is_trivial, seed
        expected = category in ("bottle", "bowl", "can")
        assert category == "other" or (asset.symmetry == TURN_Y) == expected


@pytest.mark.parametrize("category", ["bottle", "bowl", "mug"])
def test_vessels_are_hollow(category: str) -> None:
    """Walls of a few per cent of the size, not a block."""
    for seed in SEEDS:
        mesh = made(category, seed).mesh
        assert mesh.volume < 0.45 * mesh.convex_hull.volume, seed


def test_fronts_and_handles_point_where_they_should() -> None:
    for seed in SEEDS:
        mug = made("mug", seed)
        reach = np.abs(mug.vertices[:, 0]).max()
        # The handle reaches out along x; the cup alone is as broad along z.
        assert reach > 1.15 * np.abs(mug.vertices[:, 2]).max()
        middle = mug.vertices[np.abs(mug.vertices[:, 2]) < 0.02]
        radius = np.abs(mug.vertices[:, 2]).max()
        assert middle[:, 0].max() - middle[:, 0].min() > 2.1 * radius
        car = made("car", seed)
        assert np.ptp(car.vertices[:, 2]) > 1.8 * np.ptp(car.vertices[:, 0])


def test_splits_share_no_instance() -> None:
    train, test = (open_source("procedural", SourceOptions(split=s)) for s in ("train", "test"))
    for source, odd in ((train, 0), (test, 1)):
        rng = np.random.default_rng(0)
        ids = [source.sample(rng, "can").id for _ in range(6)]
        assert {int(i[-1]) % 2 for i in ids} == {odd}
        assert source.load(ids[0]).id == ids[0]


def test_an_id_gives_the_sampled_asset_back() -> None:
    source = open_source("procedural")
    drawn = source.sample(np.random.default_rng(7), "bowl")
    again = source.load(drawn.id)
    assert again.content_hash == drawn.content_hash
    assert ASSET_SOURCES.names()[:3] == ["procedural", "shapenet", "folder"]


@pytest.mark.parametrize("wrong", ["mug", "mug-p1-12", "house-p1-000001", "mug-p9-000001"])
def test_ids_of_nothing_are_refused(wrong: str) -> None:
    with pytest.raises(ToolkitError):
        open_source("procedural").load(wrong)


def test_unknown_category_and_seed_are_refused() -> None:
    with pytest.raises(ToolkitError, match="no such category"):
        make("house", 0)
    with pytest.raises(ToolkitError, match="999999"):
        make("mug", -1)


def test_sizes_are_those_of_the_table() -> None:
    assert set(scale_table().diagonal_m) == set(CATEGORIES)
    rng = np.random.default_rng(0)
    asset = made("mug", 0)
    low, high = scale_range("mug")
    drawn = [draw_diagonal(rng, asset) for _ in range(50)]
    assert low <= min(drawn) < max(drawn) <= high
    assert scale_range("teapot") == scale_range("other")
    mesh = asset.scaled(0.16)
    assert np.linalg.norm(mesh.extents) == pytest.approx(0.16)
