"""What a training is made of: order of frames, scenes held out, learning rates, configuration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from training_set import TINY, packed, wishes, write_scenes

from benchmark.training.catalogue import get_trainable
from benchmark.training.config import TrainConfig
from benchmark.training.frame_order import BatchOrder, Steps, check_no_leak, hold_out, thinned
from benchmark.training.packed_frames import PackedFrames
from benchmark.training.plan import plan_training
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document, write_document


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("plan")
    return packed(top / "pack", write_scenes(top / "data", scenes=6))


@given(
    frames=st.integers(8, 60), parts=st.integers(1, 3), world=st.integers(1, 3),
    seed=st.integers(0, 5), begin=st.integers(0, 30), steps=st.integers(1, 12),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_processes_and_parts_share_out_the_same_batches(frames, parts, world, seed, begin, steps):
    batch = parts * world
    if frames < batch:
        return
    order = BatchOrder(frames, batch, seed=seed)
    shares = [
        list(
            Steps(order, lambda: begin, steps=steps, end=36, accumulate=parts, rank=r, world=world)
        )
        for r in range(world)
    ]
    for number, step in enumerate(range(begin, min(begin + steps, 36))):
        found = [
            f for s in shares for part in s[number * parts : (number + 1) * parts] for f in part
        ]
        assert sorted(found) == sorted(order.batch_of(step).tolist())
    assert all(len(share) == parts * max(0, min(steps, 36 - begin)) for share in shares)


def test_an_epoch_has_every_frame_once_and_the_next_another_order():
    order = BatchOrder(20, 4, seed=3)
    epochs = [np.concatenate([order.batch_of(5 * e + s) for s in range(5)]) for e in range(3)]
    for epoch in epochs:
        assert sorted(epoch) == list(range(20))
    assert not np.array_equal(epochs[0], epochs[1])
    # The same step is the same, in whatever order steps are asked for.
    assert np.array_equal(order.batch_of(0), epochs[0][:4])
    assert not np.array_equal(order.batch_of(0), BatchOrder(20, 4, seed=4).batch_of(0))


def test_what_fills_no_batch_is_left_out_of_its_epoch_only():
    order = BatchOrder(7, 3, seed=0)
    assert order.steps_per_epoch == 2
    seen = {f for step in range(40) for f in order.batch_of(step).tolist()}
    assert seen == set(range(7))


def test_too_little_data_is_told(pack, tmp_path):
    with pytest.raises(ToolkitError, match="too little data: 3 frames do not fill a batch of 4"):
        BatchOrder(3, 4, seed=0)
    with pytest.raises(ToolkitError, match="batch_size: must be a multiple of 2 x 3"):
        Steps(BatchOrder(20, 8, seed=0), lambda: 0, steps=1, end=1, accumulate=2, world=3)
    alone = packed(tmp_path / "alone", write_scenes(tmp_path / "data", scenes=1))
    with pytest.raises(ToolkitError, match="too little data: 1 scene"):
        plan_training(wishes("dfnet", alone))
    with pytest.raises(ToolkitError, match=r"hold_out: must be between 0 and 1 \(got 1\.0\)"):
        plan_training(wishes("dfnet", pack, hold_out=1.0))


@pytest.mark.parametrize("share", [0.01, 0.3, 0.99])
def test_held_out_are_whole_scenes(share, pack):
    frames = PackedFrames([pack])
    training, validation = hold_out(frames, share, seed=0)
    assert sorted(training + validation) == list(range(len(frames)))
    assert training
    assert validation
    assert not {frames.scene(i) for i in training} & {frames.scene(i) for i in validation}
    check_no_leak(frames, training, frames, validation)


@pytest.mark.slow
def test_a_share_of_the_scenes_trains_and_the_same_ones_judge(tmp_path):
    pack = packed(tmp_path / "p", write_scenes(tmp_path / "data", scenes=12, frames=2))
    whole = plan_training(wishes("dfnet", pack))[1]
    half = plan_training(wishes("dfnet", pack, share=0.5))[1]
    third = plan_training(wishes("dfnet", pack, share=0.34))[1]
    assert half.of_validation == whole.of_validation

    def scenes(data):
        return {data.training.scene(i) for i in data.of_training}

    assert scenes(third) < scenes(half) < scenes(whole)
    assert 2 * len(scenes(half)) == len(scenes(whole)) == 8
    assert len(half.of_training) == 8
    frames = PackedFrames([pack])
    assert len({frames.scene(i) for i in thinned(frames, [0, 1, 2, 3], 0.01, seed=0)}) == 1
    for share in (0.0, 1.5):
        with pytest.raises(ToolkitError, match="share: must lie above 0"):
            plan_training(wishes("dfnet", pack, share=share))


def test_other_seeds_hold_out_other_scenes(pack):
    frames = PackedFrames([pack])
    assert len({tuple(hold_out(frames, 0.2, seed=s)[1]) for s in range(8)}) > 2


def test_scenes_on_both_sides_are_refused(pack, tmp_path):
    root = tmp_path / "data"
    other = packed(tmp_path / "other", write_scenes(root, scenes=3, seed=90))
    plan_training(wishes("dfnet", pack, validation=[other]))
    with pytest.raises(ToolkitError, match="18 frames of validation are of scenes that are"):
        plan_training(wishes("dfnet", pack, validation=[pack]))
    # A copy of one scene under other names, in another folder.
    copied = packed(tmp_path / "copied", write_scenes(tmp_path / "copy", scenes=1, seed=91))
    with pytest.raises(ToolkitError, match="3 frames of validation are of frames that are"):
        plan_training(wishes("dfnet", other, validation=[copied]))


def test_frames_of_another_size_than_the_network_are_refused(pack):
    with pytest.raises(ToolkitError, match=r"at 32x32, the network works at 224x126.*--size"):
        plan_training(wishes("dfnet", pack, settings={}))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"settings": {"chanels": "3"}}, "chanels: the method has no such setting"),
        ({"loss": {"smothness": "3"}}, "smothness: the method has no such setting"),
        ({"loss": {"objects": "-1"}}, "--loss objects: must be 0 or more, and finite (got -1.0)"),
        ({"loss": {"objects": "nan"}}, "--loss objects: must be 0 or more, and finite"),
        ({"method": "raw"}, "no plug-in with this name in std_toolkit.trainables"),
        ({"preset": "huge"}, "no such preset"),
        ({"batch_size": 0}, "batch_size: must be at least 1"),
        ({"learning_rate": float("nan")}, "learning_rate: must be above 0"),
        ({"validate_every": 3}, "validate_every: must be a multiple of checkpoint_every, 2"),
        ({"object_dropout": 1.5}, "object_dropout: must be at most 1"),
        ({"steps": 0}, "steps: must be at least 1"),
        ({"checkpoint_every": 0}, "checkpoint_every: must be at least 1"),
        ({"weights": Path("nowhere.safetensors")}, "no such file of weights"),
    ],
)
def test_wrong_wishes_are_told(changes, told, pack):
    with pytest.raises(ToolkitError) as error:
        plan_training(replace(wishes("dfnet", pack), **changes))
    assert told in str(error.value)


@pytest.mark.parametrize("method", TINY)
def test_configuration_comes_back_from_its_file(method, pack, tmp_path):
    config = plan_training(wishes(method, pack, loss={}))[0]
    write_document(tmp_path / "config.json", config)
    assert read_document(tmp_path / "config.json", TrainConfig) == config


def test_swindrnet_warms_up_and_falls_to_nothing():
    plan, steps = get_trainable("swindrnet").optimization, 62_620
    assert plan.learning_rate * plan.rate(0, steps) == pytest.approx(1e-10)
    assert plan.rate(250, steps) == pytest.approx(0.5 * (1 - 250 / steps), rel=1e-5)
    assert plan.rate(500, steps) == pytest.approx(1 - 500 / steps)
    assert plan.rate(steps // 2, steps) == pytest.approx(0.5)
    assert plan.rate(steps, steps) == 0
    # A short training is not all warm-up.
    assert plan.rate(100, 1000) == pytest.approx(0.9)


def test_nlspn_and_dfnet_fall_by_a_fifth_when_published():
    nlspn = get_trainable("nlspn").optimization
    shares = [nlspn.rate(epoch * 100 + 50, 2000) for epoch in range(20)]
    assert shares == pytest.approx([0.5 + 5e-7] + [1] * 9 + [0.2] * 5 + [0.04] * 5)
    dfnet = get_trainable("dfnet").optimization
    shares = [dfnet.rate(epoch * 100, 4000) for epoch in range(40)]
    expected = [1] * 5 + [0.2] * 10 + [0.04] * 10 + [0.008] * 10 + [0.0016] * 5
    assert shares == pytest.approx(expected)


@pytest.mark.parametrize(
    ("method", "kind", "decay"),
    [("swindrnet", torch.optim.AdamW, 0.01), ("nlspn", torch.optim.Adam, 0.0)],
)
def test_optimizers_are_the_published_ones(method, kind, decay):
    made = get_trainable(method).optimization.make(torch.nn.Linear(1, 1))
    assert type(made) is kind
    assert made.defaults["weight_decay"] == decay
    assert made.defaults["betas"] == (0.9, 0.999)


def test_an_encoder_that_saw_photographs_learns_slowly():
    network = torch.nn.ModuleDict({"encoder": torch.nn.Linear(1, 1), "head": torch.nn.Linear(1, 1)})
    made = get_trainable("compactdr").optimization.make(network)
    rates = {id(p): group["lr"] for group in made.param_groups for p in group["params"]}
    assert rates[id(network["encoder"].weight)] == pytest.approx(1e-4)
    assert rates[id(network["head"].weight)] == pytest.approx(1e-3)


def test_a_short_training_may_fall_in_a_straight_line(pack):
    published, straight = (
        plan_training(wishes("dfnet", pack, steps=80, decay=decay))[0] for decay in (None, "linear")
    )
    at = (0, 20, 40, 60)
    rate = straight.optimization.learning_rate
    assert [straight.rate(step) / rate for step in at] == pytest.approx([1, 0.75, 0.5, 0.25])
    assert [published.rate(step) / rate for step in at] == pytest.approx([1, 0.2, 0.04, 0.008])
