"""Environment maps from folders and made here, strengths and floors."""

from __future__ import annotations

import cv2
import msgspec
import numpy as np
import pytest

from sensors.lighting.environment import (
    EnvironmentFolder,
    mean_luminance,
    read_environment,
    split_of,
)
from sensors.lighting.environment_sources import StudioSource, environment_source, studio_map
from sensors.lighting.light_draw import FloorDraw, LightingDraw, draw_floor, draw_lighting
from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import write_exr


def write_hdr(path, pixels) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    _, data = cv2.imencode(".hdr", np.ascontiguousarray(pixels[..., ::-1], dtype=np.float32))
    path.write_bytes(data.tobytes())


def sky(height=32, seed=0):
    pixels = np.random.default_rng(seed).uniform(0.1, 5, (height, 2 * height, 3))
    pixels[: height // 2, :, 2] *= 4  # blue above: tells rows and channels apart
    return pixels.astype(np.float32)


@pytest.mark.parametrize("suffix", [".hdr", ".exr"])
def test_maps_are_read_with_their_channels_and_normalised(tmp_path, suffix) -> None:
    pixels = sky()
    path = tmp_path / f"sky{suffix}"
    if suffix == ".hdr":
        write_hdr(path, pixels)
    else:
        write_exr(path, {c: pixels[..., i] for i, c in enumerate("RGB")})
    read = read_environment(path)
    assert read.name == "sky"
    assert mean_luminance(read.pixels) == pytest.approx(1, rel=1e-5)
    scale = mean_luminance(pixels)
    # .hdr has 8 bits for each channel under one common exponent
    np.testing.assert_allclose(
        read.pixels * scale, pixels, atol=20 / 128 if "hdr" in suffix else 1e-5
    )


def test_large_maps_are_reduced(tmp_path) -> None:
    pixels = np.repeat(np.repeat(sky(), 20, 0), 20, 1)
    write_exr(tmp_path / "big.exr", {c: pixels[..., i] for i, c in enumerate("RGB")})
    assert read_environment(tmp_path / "big.exr").pixels.shape == (512, 1024, 3)


def test_splits_by_name_never_share_a_file(tmp_path) -> None:
    for i in range(30):
        write_hdr(tmp_path / f"map{i}.hdr", sky(8, i))
    train = EnvironmentFolder(tmp_path, split="train").files
    test = EnvironmentFolder(tmp_path, split="test").files
    everything = EnvironmentFolder(tmp_path, split="all").files
    assert not set(train) & set(test)
    assert sorted(train + test) == everything
    assert len(everything) == 30
    assert len(train) > len(test) > 0
    assert all(split_of(p.stem) == "train" for p in train)


def test_sub_folders_decide_the_split(tmp_path) -> None:
    write_hdr(tmp_path / "train" / "a.hdr", sky(8))
    write_hdr(tmp_path / "test" / "b.hdr", sky(8, 1))
    assert [p.stem for p in EnvironmentFolder(tmp_path, split="train").files] == ["a"]
    assert [p.stem for p in EnvironmentFolder(tmp_path, split="test").files] == ["b"]
    assert len(EnvironmentFolder(tmp_path, split="all").files) == 2


def test_missing_and_empty_folders_and_splits_are_told(tmp_path) -> None:
    with pytest.raises(ToolkitError, match=r"nowhere: no such folder.*built in"):
        EnvironmentFolder(tmp_path / "nowhere")
    with pytest.raises(ToolkitError, match=r"no \.hdr or \.exr file; put files there"):
        EnvironmentFolder(tmp_path)
    write_hdr(tmp_path / "only.hdr", sky(8))
    other = "test" if split_of("only") == "train" else "train"
    with pytest.raises(ToolkitError, match=f"for the split {other}.*1 files belong to the other"):
        EnvironmentFolder(tmp_path, split=other)


def test_bad_maps_are_refused_by_name(tmp_path) -> None:
    (tmp_path / "text.hdr").write_text("#?RADIANCE\nnothing")
    (tmp_path / "picture.hdr").write_bytes(b"\x89PNG")
    write_hdr(tmp_path / "square.hdr", np.ones((16, 16, 3)))
    write_hdr(tmp_path / "black.hdr", np.zeros((16, 32, 3)))
    bad = sky()
    bad[3, 4, 1] = np.inf
    write_exr(tmp_path / "inf.exr", {c: bad[..., i] for i, c in enumerate("RGB")})
    write_exr(tmp_path / "grey.exr", {"Y": bad[..., 0]})
    whole = tmp_path / "whole.hdr"
    write_hdr(whole, sky(64))
    (tmp_path / "cut.hdr").write_bytes(whole.read_bytes()[:2000])
    for name, message in {
        "text.hdr": "not a readable Radiance",
        "picture.hdr": "not a readable Radiance",
        "square.hdr": "twice as wide as high",
        "black.hdr": "black",
        "inf.exr": "negative or infinite",
        "grey.exr": "channels R, G and B",
        "none.hdr": "cannot read the environment map",
        "cut.hdr": "Radiance",
    }.items():
        with pytest.raises(ToolkitError, match=message) as caught:
            read_environment(tmp_path / name)
        assert name in str(caught.value)


def test_studio_maps_are_seeded_lit_from_above_and_varied() -> None:
    first = studio_map(1, height=64)
    np.testing.assert_array_equal(first.pixels, studio_map(1, height=64).pixels)
    assert first.pixels.shape == (64, 128, 3)
    for seed in range(12):
        pixels = studio_map(seed, height=64).pixels
        assert np.isfinite(pixels).all()
        assert pixels.min() >= 0
        assert mean_luminance(pixels) == pytest.approx(1, rel=1e-4)
        assert pixels[:32].mean() > pixels[32:].mean()
        assert pixels.max() > 4  # something to glint in metal
    assert np.abs(first.pixels - studio_map(2, height=64).pixels).mean() > 0.1


def test_studio_splits_differ_and_are_the_default() -> None:
    train, test = StudioSource(split="train"), StudioSource(split="test")
    assert not set(train.seeds) & set(test.seeds)
    source = environment_source()
    drawn = source.draw(np.random.default_rng(3))
    assert drawn.name == StudioSource().draw(np.random.default_rng(3)).name


def test_lighting_stays_in_range_and_is_recordable() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        light = draw_lighting(rng, "sky")
        assert 0.4 <= light.color_strength <= 0.6
        assert 0.028 <= light.infrared_strength <= 0.042
        assert 0.9 <= light.projector_factor <= 1.1
        assert 0 <= light.rotation_rad <= 2 * np.pi
    assert msgspec.json.decode(msgspec.json.encode(light), type=LightingDraw) == light


def test_floors_are_dull_or_tiled_and_take_images(tmp_path) -> None:
    rng = np.random.default_rng(0)
    floors = [draw_floor(rng) for _ in range(100)]
    assert len({f.material.name for f in floors}) > 20
    assert all(f.material.own_share == 0 and f.material.glass is None for f in floors)
    assert all(f.material.metallic <= 0.1 for f in floors)
    (tmp_path / "train").mkdir()
    (tmp_path / "train" / "tiles.png").write_bytes(b"")
    floor = draw_floor(rng, folder=tmp_path)
    assert floor.image is not None
    assert floor.image.endswith("tiles.png")
    assert floor.material.own_share > 0
    assert msgspec.json.decode(msgspec.json.encode(floor), type=FloorDraw) == floor


@pytest.mark.real
def test_real_maps_are_read(test_data) -> None:
    folder = EnvironmentFolder(test_data / "hdri", split="all")
    assert len(folder.files) == 5
    for path in folder.files:
        pixels = read_environment(path).pixels
        assert pixels.shape == (512, 1024, 3)
        assert mean_luminance(pixels) == pytest.approx(1, rel=1e-4)
