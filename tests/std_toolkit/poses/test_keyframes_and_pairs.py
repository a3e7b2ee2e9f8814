"""Choice of keyframes and of image pairs."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import write_png
from std_toolkit.jobs import JobOptions
from std_toolkit.poses.features import (
    FeatureJob,
    FrameMeasure,
    choose_keyframes,
    choose_pairs,
    describe_image,
    extract_features,
    feature_path,
    load_features,
    match_descriptors,
    measure_frames,
    train_vocabulary,
)


def measures(motions: list[float], sharpness: list[float] | None = None) -> list[FrameMeasure]:
    sharp = sharpness or [100.0] * len(motions)
    return [FrameMeasure(sharpness=s, motion=m) for s, m in zip(sharp, motions, strict=True)]


def test_a_still_camera_gives_few_keyframes() -> None:
    assert choose_keyframes(measures([1.0] + [0.0] * 99), motion=0.05, max_gap=30) == [
        0, 30, 60, 90, 99,
    ]  # fmt: skip


def test_keyframes_follow_the_motion() -> None:
    keys = choose_keyframes(measures([1.0] + [0.02] * 40), motion=0.06, max_gap=30)
    assert keys[0] == 0 and keys[-1] == 40
    gaps = np.diff(keys)
    assert gaps.max() <= 3 and gaps.mean() > 1.5


def test_a_blurred_frame_is_not_a_keyframe_where_a_sharp_one_is_near() -> None:
    sharpness = [100.0] * 40
    for i in range(3, 40, 3):
        sharpness[i] = 5.0
    keys = choose_keyframes(measures([1.0] + [0.02] * 39, sharpness), motion=0.06, max_gap=30)
    assert not [k for k in keys[:-1] if sharpness[k] < 50]


def test_every_frame_of_a_fast_camera_is_a_keyframe() -> None:
    assert choose_keyframes(measures([0.3] * 10), motion=0.05, max_gap=30) == list(range(10))


def test_features_in_a_pipe_are_found_again_and_damaged_ones_named(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8))
    kept = tmp_path / "kept"
    kept.mkdir()
    os.mkfifo(feature_path(kept, "a"))
    jobs = [FeatureJob("a", tmp_path / "a.png", (64, 48), fine=False)]
    extract_features(jobs, kept, max_features=100, options=JobOptions(engine="serial"))
    assert len(load_features(kept, "a").keypoints) > 0
    path = feature_path(kept, "a")
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(ToolkitError, match="delete it") as refused:
        load_features(kept, "a")
    assert str(refused.value.path) == str(path)


def test_no_frames() -> None:
    assert choose_keyframes([], motion=0.05, max_gap=30) == []


def test_measured_motion_and_sharpness(recording, tmp_path) -> None:
    scene = recording.write(tmp_path / "s", depth=False)
    found = measure_frames([scene.color_path(f) for f in scene.frames[:4]])
    assert found[0].motion == 1.0
    assert all(0.005 < m.motion < 0.2 for m in found[1:])


def test_pairs_grow_linearly_and_close_loops() -> None:
    rng = np.random.default_rng(0)
    n = 200
    angle = np.linspace(0, 4 * np.pi, n)  # twice round: i and i + 100 see the same
    base = rng.normal(size=(2, 64))
    vectors = [(np.cos(a) * base[0] + np.sin(a) * base[1]).astype(np.float32) for a in angle]
    vectors = [v / np.linalg.norm(v) for v in vectors]
    pairs = choose_pairs(vectors, overlap=5, loops=3)
    assert len(pairs) == len(set(pairs)) <= n * (5 + 3 + 3)
    assert all(i < j for i, j in pairs)
    loops = [(i, j) for i, j in pairs if j - i > 40]
    assert len(loops) > 100
    assert np.median([abs((j - i) - 100) for i, j in loops]) < 5


def test_matching_finds_the_permutation_and_rejects_the_ambiguous() -> None:
    rng = np.random.default_rng(0)
    d = rng.gamma(0.5, 1.0, size=(300, 128))
    d = np.rint(512 * d / np.linalg.norm(d, axis=1, keepdims=True)).clip(0, 255).astype(np.uint8)
    order = rng.permutation(300)
    noisy = np.clip(d[order] + rng.integers(-3, 4, d.shape), 0, 255).astype(np.uint8)
    pairs = match_descriptors(d, noisy)
    assert len(pairs) > 280
    assert (order[pairs[:, 1]] == pairs[:, 0]).all()
    twice = np.concatenate([noisy, noisy])
    assert len(match_descriptors(d, twice)) == 0
    assert match_descriptors(d[:0], noisy).shape == (0, 2)


def test_image_vectors_tell_images_apart() -> None:
    rng = np.random.default_rng(0)
    sets = [rng.integers(0, 255, size=(200, 128)).astype(np.uint8) for _ in range(4)]
    vocabulary = train_vocabulary(sets, seed=0)
    vectors = [describe_image(s, vocabulary) for s in sets]
    again = describe_image(sets[2][::2], vocabulary)
    assert int(np.argmax([v @ again for v in vectors])) == 2
    assert np.allclose([np.linalg.norm(v) for v in vectors], 1, atol=1e-5)
    assert np.isfinite(describe_image(sets[0][:0], vocabulary)).all()
