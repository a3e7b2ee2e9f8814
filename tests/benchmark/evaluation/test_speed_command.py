"""Speed of networks without weights and data."""

from __future__ import annotations

import json

import pytest
import torch

from benchmark.cli.bench import main
from benchmark.methods.registry import MethodOptions, restorers
from benchmark.methods.weights import is_untrained, untrained

COMPACT = MethodOptions(preset="compact")


def test_speed_needs_no_weights(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["speed", "--method", "dfnet", "two-branch", "--preset", "compact", "--repeats", "1"]
    assert main([*words, "--size", "64x48", "--json"]) == 0
    dfnet, two_branch = json.loads(capsys.readouterr().out)
    assert (dfnet["method"], two_branch["method"]) == ("dfnet", "two-branch")
    speed = dfnet["speed"]
    assert (speed["width"], speed["height"], speed["batch_size"]) == (224, 126, 1)
    assert speed["frames_per_s"] > 0 and speed["gmacs"] > 0
    # The two-branch network has no weights that ship.
    assert two_branch["speed"]["parameters"] > 0
    shipped = restorers.make("dfnet", COMPACT)
    assert shipped.parameter_count == speed["parameters"]  # type: ignore[attr-defined]


def test_the_table_has_what_papers_print_below(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["speed", "--method", "dfnet", "no-such", "--preset", "compact", "--repeats", "1"]
    assert main([*words, "--size", "64x48"]) == 1
    told = capsys.readouterr()
    assert "Speed without weights" in told.out and "224x126" in told.out
    assert "two-branch baseline" in told.out and "RTX 3090" in told.out
    assert "no-such" in told.err


def test_networks_have_their_weights_again_after_the_block() -> None:
    with untrained():
        assert is_untrained()
        begin = restorers.make("dfnet", COMPACT)
    assert not is_untrained()
    trained, other = (restorers.make("dfnet", COMPACT) for _ in range(2))
    name, there = next(iter(trained.network.state_dict().items()))  # type: ignore[attr-defined]
    assert torch.equal(there, other.network.state_dict()[name])  # type: ignore[attr-defined]
    assert not torch.equal(there, begin.network.state_dict()[name])  # type: ignore[attr-defined]
