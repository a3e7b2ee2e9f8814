"""Pose networks that know two frames by heart, from the first step to poses in space."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from learnt_poses import FRAMES, TINY, learn, packed_things, true_poses, views_of, write_things

from benchmark.methods.registry import MethodOptions, make_pose_method
from benchmark.training.catalogue import get_trainable

pytestmark = pytest.mark.slow
STEPS = {"swindrnet-nocs": 200, "nocs": 200}


@pytest.fixture(
    scope="module", params=["swindrnet-nocs", pytest.param("nocs", marks=pytest.mark.long)]
)
def learnt(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict:
    method, folder = request.param, tmp_path_factory.mktemp(request.param)
    root = write_things(folder / "data")
    frames = packed_things(folder / "pack", root, method)
    losses = learn(method, frames, folder / "w.safetensors", STEPS[method], 2e-3)
    options = MethodOptions(
        preset="compact", weights=folder / "w.safetensors", settings=TINY[method]
    )
    return {
        "method": method,
        "root": root,
        "frames": frames,
        "losses": losses,
        "estimator": make_pose_method(method, options),
        "folder": folder,
    }


def test_the_loss_falls(learnt):
    losses = learnt["losses"]
    assert np.mean(losses[-5:]) < 0.25 * np.mean(losses[:5])


def test_poses_are_within_5_degrees_and_5_cm(learnt):
    views = views_of(learnt["root"], learnt["method"])
    estimates = learnt["estimator"].estimate(views)
    for index, found in enumerate(estimates):
        true = true_poses(index)
        assert sorted(found.prediction.class_ids) == sorted(true)
        for class_id, RT in zip(found.prediction.class_ids, found.prediction.RT, strict=True):
            degrees, metres = apart(RT, true[class_id], round_about_y=class_id == 1)
            assert degrees < 5
            assert metres < 0.05
        assert found.masks.shape == (3, *views[index].depth.shape)
        assert (found.prediction.scores > 0.3).all()


def test_segments_are_the_objects_and_one_view_is_as_many(learnt):
    """What a batch says of a view is what the view alone gives, at any size of the view."""
    views = views_of(learnt["root"], learnt["method"])
    together = learnt["estimator"].segment(views)
    alone = learnt["estimator"].segment(views[1:])[0]
    assert alone.class_ids.tolist() == together[1].class_ids.tolist()
    assert (alone.masks != together[1].masks).mean() < 1e-3
    source = learnt["frames"].frame(1)
    for class_id, mask in zip(alone.class_ids, alone.masks, strict=True):
        true = source.mask_where(lambda i, c=class_id: i.class_id == c)
        assert (mask & true).sum() > 0.7 * (mask | true).sum()


def test_validation_scores_what_was_learnt(learnt, tmp_path):
    trainable = get_trainable(learnt["method"])
    network = learnt["estimator"].network
    validator = trainable.validator(learnt["frames"], range(FRAMES), 1, trainable.loss)
    states = validator.states(network, torch.device("cpu"))
    parts = [validator.states(network, torch.device("cpu"), rank=r, world=2) for r in (0, 1)]
    assert np.allclose(states, sum(parts))
    scores = validator.scores(states)
    name, value = validator.main_score(scores)
    assert name == "nocs_error"
    assert value < 0.15
    assert scores["nocs_error_where_right"] < 0.05
    assert scores["class_recall"] > 0.75
    validator.gallery(network, torch.device("cpu"), tmp_path / "g.jpg")
    assert (tmp_path / "g.jpg").stat().st_size > 5000


def test_a_larger_view_gives_the_same_poses(learnt):
    """A view of another size than the network's is shrunk for it, and poses fitted at its own."""
    from benchmark.data.splits import open_split
    from benchmark.methods.protocol import PoseView

    frame = open_split("dreds-catknown-train", learnt["root"]).load(0)
    view = PoseView(frame.color, frame.depth_raw, frame.depth_true, frame.camera)
    found = learnt["estimator"].estimate([view])[0]
    true = true_poses(0)
    assert sorted(found.prediction.class_ids) == sorted(true)
    for class_id, RT in zip(found.prediction.class_ids, found.prediction.RT, strict=True):
        degrees, metres = apart(RT, true[class_id], round_about_y=class_id == 1)
        assert degrees < 10
        assert metres < 0.05
    assert found.masks.shape[1:] == frame.depth_true.shape


def apart(one: np.ndarray, other: np.ndarray, *, round_about_y: bool) -> tuple[float, float]:
    """Degrees and metres between poses with their scales inside."""
    a, b = (RT[:3, :3] / np.cbrt(np.linalg.det(RT[:3, :3])) for RT in (one, other))
    cos = a[:, 1] @ b[:, 1] if round_about_y else (np.trace(a.T @ b) - 1) / 2
    degrees = float(np.degrees(np.arccos(np.clip(cos, -1, 1))))
    return degrees, float(np.linalg.norm(one[:3, 3] - other[:3, 3]))
