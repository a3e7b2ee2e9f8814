"""What fails a check: gates of the scene, and labels by their verdicts."""

from __future__ import annotations

import pytest

from std_toolkit.checks.gates.outcome import Outcome
from std_toolkit.checks.result import CheckGate, ObjectCheck, Verdict
from std_toolkit.options import CheckOptions


def item(name: str, verdict: Verdict) -> ObjectCheck:
    return ObjectCheck(
        object=1,
        name=name,
        model="m",
        category="c",
        material="diffuse",
        label="refined",
        verdict=verdict,
    )


def gate(key: str, scope: str, status: str = "fail") -> CheckGate:
    return CheckGate(
        key=key,
        title=key,
        value=1.0,
        limit=0.0,
        rule="at most",
        status=status,  # type: ignore[arg-type]
        scope=scope,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize(
    ("verdict", "options", "passed"),
    [
        ("fits", CheckOptions(strict=True), True),
        ("wrong", CheckOptions(allow_doubtful=True), False),
        ("doubtful", CheckOptions(), False),
        ("doubtful", CheckOptions(allow_doubtful=True), True),
        ("unknown", CheckOptions(), True),
        ("unknown", CheckOptions(strict=True), False),
    ],
)
def test_a_label_counts_by_its_verdict(
    verdict: Verdict, options: CheckOptions, passed: bool
) -> None:
    outcome = Outcome.of([], [item("a", "fits"), item("b", verdict)], options)
    assert outcome.passed == passed
    if not passed:
        assert outcome.line() == f"FAIL: {verdict}: b"
    elif verdict == "fits":
        assert outcome.line() == "PASS: labels usable"
    else:
        assert outcome.line() == f"PASS: no label is known to be wrong; {verdict}: b"


def test_a_gate_of_the_scene_fails_it_and_one_of_labels_does_not() -> None:
    rows = [gate("drift", "label"), gate("camera", "scene"), gate("scale", "scene", "pass")]
    fits = [item("a", "fits")]
    assert Outcome.of(rows[:1], fits, CheckOptions()).passed
    outcome = Outcome.of(rows, [*fits, item("b", "wrong")], CheckOptions())
    assert outcome.line() == "FAIL: gate camera; wrong: b"


def test_without_labels_the_poses_pass() -> None:
    assert "no labels" in Outcome.of([], [], CheckOptions(strict=True)).line()
