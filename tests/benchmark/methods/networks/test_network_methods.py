"""Network methods from their names to restored depth."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
import torch
from network_cases import CASES, SIDE, views, weights_of

from benchmark.methods import registry
from benchmark.methods.network import NetworkRestorer, parameter_count
from benchmark.methods.protocol import View
from benchmark.methods.registry import MethodOptions, make_restorer
from benchmark.methods.weights import load_weights, save_weights
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

METHODS = sorted({case.method for case in CASES.values()})


def restorer_of(name: str, folder, **options) -> NetworkRestorer:
    case = CASES[name]
    made = make_restorer(
        case.method,
        MethodOptions(weights=weights_of(case, folder), settings=case.settings, **options),
    )
    assert isinstance(made, NetworkRestorer)
    return made


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_by_name_with_weights_it_answers_what_the_network_answers(name, tmp_path):
    restorer = restorer_of(name, tmp_path)
    assert restorer.input_size == (64, 64) and not restorer.needs_mask
    some = views(3)
    answers = restorer.restore(some)
    network = CASES[name].make().eval()
    with torch.inference_mode():
        expected = network(*restorer.inputs(some))
    for index, answer in enumerate(answers):
        np.testing.assert_allclose(
            answer.depth, expected.depth[index, 0].numpy(), rtol=1e-3, atol=1e-5
        )
        assert (answer.confidence is None) == (expected.confidence is None)
        if answer.confidence is not None:
            assert (answer.confidence >= 0).all() and (answer.confidence <= 1).all()
    assert restorer.parameter_count == parameter_count(network)
    assert restorer.macs(some[0]) > 100_000


@pytest.mark.parametrize("name", CASES)
def test_a_frame_does_not_change_another(name, tmp_path):
    """Nor does one whose depth is broken or missing altogether."""
    restorer = restorer_of(name, tmp_path)
    some = views(3)
    alone = restorer.restore(some[:1])[0].depth
    some[1].depth[:] = 0
    some[2].depth[::2] = np.nan
    some[2].depth[1::2] = np.inf
    answers = restorer.restore(some)
    np.testing.assert_allclose(answers[0].depth, alone, rtol=1e-4, atol=1e-5)
    assert all(np.isfinite(answer.depth).all() for answer in answers)


@pytest.mark.parametrize("name", CASES)
def test_round_trip_of_weights(name, tmp_path):
    case = CASES[name]
    first, second = case.make(seed=1), case.make(seed=2)
    save_weights(first, tmp_path / "a.safetensors")
    load_weights(second, tmp_path / "a.safetensors")
    for (key, one), (_, other) in zip(
        first.state_dict().items(), second.state_dict().items(), strict=True
    ):
        assert torch.equal(one, other), key


@pytest.mark.parametrize("name", ["swindrnet-released", "nlspn", "dfnet"])
def test_published_and_own_checkpoints_fit(name, tmp_path):
    case = CASES[name]
    state = {f"module.{key}": tensor for key, tensor in case.make().state_dict().items()}
    if name == "nlspn":  # constants that the published program keeps among its weights
        state["module.prop_layer.w"] = torch.ones(1, 1, 3, 3)
        state["module.prop_layer.b"] = torch.zeros(1)
        state["module.prop_layer.w_conf"] = torch.ones(1, 1, 1, 1)
    torch.save({"net": state, "epoch": 20}, tmp_path / "model.pth")
    options = MethodOptions(weights=tmp_path / "model.pth", settings=case.settings)
    (answer,) = make_restorer(case.method, options).restore(views(1))
    (expected,) = restorer_of(name, tmp_path).restore(views(1))
    np.testing.assert_array_equal(answer.depth, expected.depth)


TITLES = {"swindrnet": "SwinDRNet", "nlspn": "NLSPN", "dfnet": "DFNet"}


@pytest.mark.parametrize(("method", "other"), list(permutations(METHODS, 2)))
def test_weights_of_another_architecture(method, other, tmp_path):
    names = {m: next(n for n, c in CASES.items() if c.method == m) for m in METHODS}
    case = CASES[names[method]]
    path = weights_of(CASES[names[other]], tmp_path)
    with pytest.raises(ToolkitError) as caught:
        make_restorer(method, MethodOptions(weights=path, settings=case.settings))
    told = str(caught.value)
    assert "keys missing (" in told and "keys unknown (" in told
    assert f"they look like those of {TITLES[other]}" in told and path.name in told


@pytest.mark.parametrize("name", ["swindrnet-released", "nlspn", "dfnet"])
def test_weights_of_another_size(name, tmp_path):
    case = CASES[name]
    settings = case.settings | {"channels": "32"}
    with pytest.raises(ToolkitError) as caught:
        make_restorer(
            case.method, MethodOptions(weights=weights_of(case, tmp_path), settings=settings)
        )
    assert "of another shape (" in str(caught.value) and "of another size" in str(caught.value)


@pytest.mark.parametrize("method", METHODS)
def test_without_weights(method, tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "SHIPPED", tmp_path)
    with pytest.raises(ToolkitError, match=f"no weights for {method}, preset compact, come with"):
        make_restorer(method, MethodOptions(preset="compact"))


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_wrong_options(method, tmp_path):
    for options, told in (
        (MethodOptions(preset="huge"), "published, compact"),
        (MethodOptions(settings={"chanels": "3"}), "no such setting"),
        (MethodOptions(device="cuda:99"), "no such device"),
        (MethodOptions(weights=tmp_path / "absent.pth"), "no such file of weights"),
    ):
        with pytest.raises(ToolkitError, match=told):
            make_restorer(method, options)


def test_shipped_weights_are_refused_at_another_size():
    size = {"input_size": "320,180"}
    with pytest.raises(ToolkitError, match=r"input_size.*for 224x126 alone.*320x180.*--weights"):
        make_restorer("swindrnet", MethodOptions(preset="compact", settings=size))


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_narrow_arithmetic_is_near(name, tmp_path):
    some = views(2)
    whole = restorer_of(name, tmp_path).restore(some)
    narrow = restorer_of(name, tmp_path, precision="bf16").restore(some)
    for one, other in zip(narrow, whole, strict=True):
        assert np.isfinite(one.depth).all()
        spread = max(np.ptp(other.depth), abs(other.depth).max())
        assert abs(one.depth - other.depth).max() < 0.1 * spread + 0.01


def test_columns_are_restored_apart_and_put_together(tmp_path):
    """448x224 in the paper: each of the two halves is an image of the network's own size."""
    case = CASES["swindrnet-released"]
    path = weights_of(case, tmp_path)
    wide, plain = (
        make_restorer("swindrnet", MethodOptions(weights=path, settings=case.settings | more))
        for more in ({"interleaved": "true"}, {})
    )
    assert wide.input_size == (2 * SIDE, SIDE) and plain.input_size == (SIDE, SIDE)
    rng = np.random.default_rng(0)
    color = rng.integers(0, 255, (SIDE, 2 * SIDE, 3)).astype(np.uint8)
    depth = rng.uniform(0.4, 0.9, (SIDE, 2 * SIDE)).astype(np.float32)
    camera = Camera(2 * SIDE, SIDE, 100, 100, SIDE, SIDE / 2)
    (whole,) = wide.restore([View(color, depth, camera)])
    for first in (0, 1):
        half = View(
            np.ascontiguousarray(color[:, first::2]),
            np.ascontiguousarray(depth[:, first::2]),
            Camera(SIDE, SIDE, 50, 100, SIDE / 2, SIDE / 2),
        )
        (expected,) = plain.restore([half])
        np.testing.assert_allclose(whole.depth[:, first::2], expected.depth, atol=1e-5)
        np.testing.assert_allclose(whole.confidence[:, first::2], expected.confidence, atol=1e-5)
    assert wide.macs(View(color, depth, camera)) == 2 * plain.macs(half)
