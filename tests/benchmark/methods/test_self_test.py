"""`std-bench self-test`: pinned answers of every network, and what tells a change."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmark.cli.bench import main
from benchmark.methods.known import self_test as tests
from benchmark.methods.known.released import RELEASED, known_weights
from benchmark.methods.known.self_test import NEGATIVE, SEEDS, Known, pinned
from benchmark.methods.known.shipped import SHIPPED
from benchmark.methods.registry import SHIPPED as WEIGHTS

EVERY = pinned()


def test_every_network_has_answers_of_three_seeds() -> None:
    found = {(known.case, known.seed) for known in EVERY}
    wanted = {(c, s) for c in (*RELEASED, *SHIPPED) for s in (*SEEDS, *NEGATIVE.get(c, ()))}
    assert found == wanted and len(SEEDS) == 3
    # Each file of weights has a case, and only the authors' programs are called authors.
    files = {p.stem for p in WEIGHTS.glob("*.safetensors")}
    assert files == {case.replace(" ", "-") for case in SHIPPED}
    authors = {(known.case, known.seed) for known in EVERY if known.by == "authors"}
    assert authors == {(case, 0) for case in RELEASED}
    for known in EVERY:
        for output in known.outputs.values():
            assert np.isfinite(output.values).all() and output.high - output.low > 1e-3
    negative = next(known for known in EVERY if known.seed == 3)
    assert negative.outputs["depth"].low < -0.05  # of every fourth pixel


def test_shipped_networks_answer_as_pinned(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["self-test", "--networks", "shipped", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert len(rows) == len(SEEDS) * len(SHIPPED)
    assert all(row["good"] and row["apart"] < 5e-4 for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["dfnet released", "spd released"])
def test_small_released_networks_answer_as_pinned(case: str) -> None:
    done = list(tests.self_test(known for known in EVERY if known.case == case))
    assert len(done) >= 3 and all(d.is_good for d in done), [(d.apart, d.error) for d in done]


@pytest.mark.long
def test_all_networks_answer_as_pinned(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["self-test"]) == 0
    assert capsys.readouterr().out.count(" good") == len(EVERY)


def test_a_change_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    known = next(k for k in EVERY if k.case == "crop-nocs compact")
    half = known.outputs["half_sides"]
    off = Known(
        shape=half.shape, low=half.low, high=half.high, mean=half.mean,
        values=[half.values[0] + 2e-3, *half.values[1:]],
    )  # fmt: skip
    from msgspec.structs import replace

    wrong = [
        replace(known, outputs={**known.outputs, "half_sides": off}),
        replace(known, outputs={**known.outputs, "half_sides": replace(half, shape=[4])}),
        replace(known, outputs={"logits": known.outputs["logits"]}),
    ]
    monkeypatch.setattr(tests, "pinned", lambda _: wrong[:1])
    assert main(["self-test"]) == 1
    assert "differs by 0.002, more than 0.0005" in capsys.readouterr().err
    monkeypatch.setattr(tests, "pinned", lambda _: wrong)
    assert main(["self-test"]) == 1
    assert capsys.readouterr().out.count("FAILED") == 3
    monkeypatch.setitem(SHIPPED, "crop-nocs compact", lambda _: 1 / 0)
    assert main(["self-test"]) == 1
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_weights_of_the_rule() -> None:
    assert known_weights("a.weight", (3,)).mean() == pytest.approx(1, abs=0.3)
    assert (known_weights("a.running_var", (5,)) >= 1).all()
    assert not np.array_equal(known_weights("a", (4, 4), 1), known_weights("a", (4, 4)))
    assert Path(tests.FILE).stat().st_size < 400_000
