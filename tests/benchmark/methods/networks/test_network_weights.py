"""Files of weights: formats, wrappers, wrong ones."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
import torch
from torch import nn

from benchmark.methods import registry
from benchmark.methods.registry import MethodOptions, weights_digest
from benchmark.methods.weights import (
    architecture_of,
    load_weights,
    read_weights,
    save_weights,
    shipped_weights,
    weights_for,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import digest_file


def network(width: int = 4, seed: int = 0) -> nn.Module:
    torch.manual_seed(seed)
    return nn.Sequential(nn.Conv2d(3, width, 1), nn.BatchNorm2d(width), nn.Conv2d(width, 1, 1))


def same(a: nn.Module, b: nn.Module) -> bool:
    pairs = zip(a.state_dict().items(), b.state_dict().items(), strict=True)
    return all(k == m and torch.equal(t, u) for (k, t), (m, u) in pairs)


def test_safetensors_round_trip(tmp_path):
    first, second = network(seed=1), network(seed=2)
    assert not same(first, second)
    save_weights(first, tmp_path / "a.safetensors")
    load_weights(second, tmp_path / "a.safetensors")
    assert same(first, second)
    assert all(parameter.requires_grad for parameter in second.parameters())
    second(torch.rand(2, 3, 4, 4)).sum().backward()


@pytest.mark.parametrize(
    "wrap",
    [
        lambda s: s,
        lambda s: {"state_dict": s, "epoch": 3},
        lambda s: {"model": s, "optimizer": {"state": {}}, "lr": 0.1},
        lambda s: {"net": {f"module.{k}": v for k, v in s.items()}},
        lambda s: {f"module._orig_mod.{k}": v for k, v in s.items()},
        lambda s: {f"_orig_mod.module.{k}": v for k, v in s.items()},
    ],
)
@pytest.mark.parametrize("suffix", ["pth", "pt", "pth.tar"])
def test_checkpoints_of_training_programs(tmp_path, wrap, suffix):
    first, second = network(seed=1), network(seed=2)
    path = tmp_path / f"epoch_3.{suffix}"
    torch.save(wrap(first.state_dict()), path)
    load_weights(second, path)
    assert same(first, second)


def test_half_precision_weights_keep_the_networks_precision(tmp_path):
    save_weights(network(seed=1).half(), tmp_path / "half.safetensors")
    second = network(seed=2)
    load_weights(second, tmp_path / "half.safetensors")
    assert {tensor.dtype for tensor in second.parameters()} == {torch.float32}


class Bomb:
    def __reduce__(self):
        return Path.touch, (Path("exploded"),)


def test_checkpoints_run_no_code(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({"state_dict": network().state_dict(), "extra": Bomb()}, "bomb.pth")
    with pytest.raises(ToolkitError, match="could run any code"):
        read_weights(tmp_path / "bomb.pth")
    assert not Path("exploded").exists()


@pytest.mark.parametrize("name", ["x.safetensors", "x.pth"])
@pytest.mark.parametrize("content", [b"", b"hello, this is text", b"\x80\x02garbage" * 50])
def test_files_that_are_no_weights(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ToolkitError) as caught:
        read_weights(tmp_path / name)
    assert name in str(caught.value)


def test_truncated_weights(tmp_path):
    for path in (tmp_path / "a.safetensors", tmp_path / "a.pth"):
        if path.suffix == ".pth":
            torch.save(network().state_dict(), path)
        else:
            save_weights(network(), path)
        path.write_bytes(path.read_bytes()[:-40])
        with pytest.raises(ToolkitError):
            read_weights(path)


def test_no_file(tmp_path):
    with pytest.raises(ToolkitError, match="no such file of weights"):
        read_weights(tmp_path / "absent.pth")


def test_a_checkpoint_without_tensors(tmp_path):
    torch.save({"epoch": 3}, tmp_path / "a.pth")
    with pytest.raises(ToolkitError, match="no tensors by name"):
        read_weights(tmp_path / "a.pth")


@pytest.mark.parametrize("key", ["state_dict", "model"])
def test_a_checkpoint_that_contains_itself(key, tmp_path):
    endless = {"epoch": 3}
    endless[key] = endless
    torch.save(endless, tmp_path / "a.pth")
    with pytest.raises(ToolkitError, match="no tensors by name"):
        read_weights(tmp_path / "a.pth")


def test_what_differs_is_told(tmp_path):
    state = network(width=5).state_dict()
    state["9.weight"] = state.pop("2.bias")
    torch.save(state, tmp_path / "a.pth")
    with pytest.raises(ToolkitError) as caught:
        load_weights(network(), tmp_path / "a.pth")
    told = str(caught.value)
    assert "1 keys missing (2.bias)" in told
    assert "1 keys unknown (9.weight)" in told
    assert "7 of another shape (0.weight 5x3x1x1 instead of 4x3x1x1, 0.bias 5 instead of 4," in told
    assert "..." in told


def test_ignored_keys_may_be_there(tmp_path):
    first, second = network(seed=1), network(seed=2)
    torch.save(first.state_dict() | {"constant": torch.ones(3)}, tmp_path / "a.pth")
    with pytest.raises(ToolkitError, match="constant"):
        load_weights(second, tmp_path / "a.pth")
    load_weights(second, tmp_path / "a.pth", ignored=["constant"])
    assert same(first, second)


@pytest.mark.parametrize(
    ("keys", "title"),
    [
        (["backbone_rgb_branch.a", "decode_head_depth_restoration.b"], "SwinDRNet"),
        (["conv1_dep.0.weight", "prop_layer.aff_scale_const"], "NLSPN"),
        (["conv1.weight", "layer4.0.x", "fc.weight"], "a ResNet classifier (ImageNet)"),
        (["patch_embed.x", "layers.0.y", "head.weight"], "a Swin classifier (ImageNet)"),
        (["something.else"], None),
    ],
)
def test_architectures_are_known_by_their_keys(keys, title):
    assert architecture_of(dict.fromkeys(keys)) == title


def test_shipped_weights(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "SHIPPED", tmp_path)
    with pytest.raises(ToolkitError, match="no weights for m, preset compact, come with") as caught:
        shipped_weights("m", "compact")
    assert "give --weights" in str(caught.value)
    path = tmp_path / "m-compact.safetensors"
    save_weights(network(), path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    path.with_name(path.name + ".sha256").write_text(f"{digest}  {path.name}\n")
    assert shipped_weights("m", "compact") == path
    assert weights_for("m", MethodOptions(preset="compact")) == path
    path.write_bytes(path.read_bytes()[:-1] + b"!")
    with pytest.raises(ToolkitError, match="SHA-256 differs"):
        shipped_weights("m", "compact")


def test_a_users_weights_come_first(tmp_path):
    own = tmp_path / "own.pth"
    assert weights_for("m", MethodOptions(weights=own)) == own


def test_weights_that_come_along_decide_the_preset_where_nobody_does(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "SHIPPED", tmp_path)
    assert registry.preset_for("swindrnet", None, None) == "published"
    (tmp_path / "swindrnet-compact.safetensors").touch()
    assert registry.preset_for("swindrnet", None, None) == "compact"
    assert registry.preset_for("nlspn", None, None) == "published"
    assert registry.preset_for("swindrnet", None, tmp_path / "own.safetensors") == "published"
    assert registry.preset_for("swindrnet", "published", None) == "published"


def test_results_name_weights_that_come_along(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "SHIPPED", tmp_path)
    assert weights_digest("m", object(), MethodOptions()) == ""
    path = tmp_path / "m-compact.safetensors"
    path.write_bytes(b"some")
    own = tmp_path / "own.safetensors"
    own.write_bytes(b"other")
    found = [
        weights_digest("m", method, options)
        for method, options in (
            (object(), MethodOptions(preset="compact")),
            (object(), MethodOptions(preset="compact", weights=own)),
            (None, MethodOptions(preset="compact")),
            (object(), MethodOptions(preset="published")),
        )
    ]
    assert found == [digest_file(path), digest_file(own), "", ""]
