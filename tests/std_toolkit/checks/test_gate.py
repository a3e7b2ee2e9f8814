"""A gate is one object: one from outside is in the report, the page and the verdicts."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator

import pytest
from toy_balls import Toy

from std_toolkit.checks.gates import judge
from std_toolkit.checks.gates.gate import Measured, ObjectGate, Reading, SceneGate
from std_toolkit.checks.gates.judge import all_gates, judge_rows, register_gate
from std_toolkit.checks.page.report import PageParts, render_page
from std_toolkit.checks.result import CheckReport, FrameCheck, ObjectCheck, SceneSummary, Value
from std_toolkit.cli import main as cli
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import document_bytes
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene

TILT = "tilt of an object against the table, worst object"
SUMMARY = SceneSummary(
    frames=3, registered=3, looked_at=3, objects=2, labelled=2, depth_frames=0, truth_frames=0
)
FRAMES = [FrameCheck(frame=i, name=f"{i}", status="registered") for i in range(3)]


@pytest.fixture(autouse=True)
def _registry(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(judge, "_added", [])
    yield


def tilt_gate(**more: object) -> ObjectGate:
    """What a stranger writes; its limit is that on the rotation, without a file touched."""
    fields: dict[str, object] = {
        "key": "tilt",
        "title": TILT,
        "unit": "deg",
        "limit": lambda options: options.max_motion_deg,
        "measure": lambda item, _: Reading(item.value("tilt_deg"), item.std("tilt_deg")),
        "advice": "put it upright",
    }
    return ObjectGate(**(fields | more))  # type: ignore[arg-type]


def tilted(number: int, degrees: float | None, label: str = "refined") -> ObjectCheck:
    """An object that the images confirm, with a value that no built-in gate reads."""
    numbers = {"edge_px": 0.5, "edge_support": 0.9, "edge_chance_px": 4.0, "tilt_deg": degrees}
    return ObjectCheck(
        object=number,
        name=f"o{number}",
        model="m",
        category="c",
        material="diffuse",
        label=label,  # type: ignore[arg-type]
        frames_seen=3,
        values=[
            Value(key=k, value=v, std=0.5 if k == "tilt_deg" else None, source="contour")
            for k, v in numbers.items()
            if v is not None
        ],
    )


def judged(*items: ObjectCheck, options: CheckOptions | None = None) -> CheckReport:
    return judge_rows(
        Measured(summary=SUMMARY, objects=items, frames=FRAMES, options=options or CheckOptions())
    )


def test_a_gate_from_outside_is_everywhere() -> None:
    before = judged(tilted(1, 1.0), tilted(2, 9.0))
    assert before.passed and {o.verdict for o in before.objects} == {"fits"}
    register_gate(tilt_gate(after="rotation"))
    report = judged(tilted(1, 1.0), tilted(2, 9.0))
    keys = [g.key for g in report.gates]
    assert keys[keys.index("rotation") + 1] == "tilt"
    row = report.gate("tilt")
    assert (row.value, row.deviation, row.limit, row.status) == (9.0, 0.5, 2.5, "fail")
    assert row.detail == "o2"
    assert report.verdict == "FAIL: wrong: o2" and not report.passed
    assert row.scope == "label"
    assert [o.verdict for o in report.objects] == ["fits", "wrong"]
    (finding,) = (f for f in report.objects[1].gates if f.gate == "tilt")
    assert (finding.value, finding.verdict) == (9.0, "wrong")
    (warning,) = (w for w in report.warnings if w.gate == "tilt")
    assert (warning.about, warning.advice) == ("o2", "put it upright")
    assert warning.problem == f"{TILT}: 9 deg, must be at most 2.5 deg"
    stored = json.loads(document_bytes(report))
    assert "tilt" in {g["key"] for g in stored["gates"]}
    page = render_page(report, PageParts(None, None, []))
    assert TILT in page and "put it upright" in page


@pytest.mark.slow
def test_the_command_reports_a_gate_from_outside(
    make_scene: Callable[[Toy], Scene], capsys: pytest.CaptureFixture[str]
) -> None:
    scene = make_scene(Toy(frames=2))
    arguments = ["check", str(scene.root), "--engine", "serial", "--overlay-frames", "0"]
    assert cli.main(arguments) == 0
    register_gate(
        SceneGate(
            key="many",
            title="frames of the recording",
            measure=lambda measured: Reading(float(measured.summary.frames)),
            limit=lambda _: 3.0,
            rule="at least",
            advice="record more",
        )
    )
    # The report of the same scene without the gate is no longer fresh.
    assert cli.main(arguments) == 1
    assert "FAIL many: frames of the recording: 2, must be at least 3" in capsys.readouterr().out
    assert "frames of the recording" in (scene.root / "check/report.html").read_text()


def test_two_gates_with_one_key_are_refused() -> None:
    with pytest.raises(ToolkitError, match="two gates"):
        register_gate(tilt_gate(key="edges"))
    assert "tilt" not in {g.key for g in all_gates()}


def test_nothing_is_known_of_an_exempt_object_beyond_the_limit() -> None:
    register_gate(tilt_gate(exempt=lambda item, _: "leans" if item.name == "o2" else ""))
    report = judged(tilted(1, 1.0), tilted(2, 9.0))
    assert report.passed and report.gate("tilt").value == 1.0
    assert [o.verdict for o in report.objects] == ["fits", "unknown"]
    assert report.verdict == "PASS: no label is known to be wrong; unknown: o2"
    assert {f.exempt for f in report.objects[1].gates if f.gate == "tilt"} == {"leans"}


def test_a_gate_warns_below_its_limit() -> None:
    register_gate(tilt_gate(warn_from=2.0))
    report = judged(tilted(1, 1.9), tilted(2, 2.2))
    assert report.passed
    told = [w for w in report.warnings if w.problem.startswith(TILT)]
    assert [(w.about, w.severity, w.problem) for w in told] == [
        ("o2", "medium", f"{TILT}: 2.2 deg")
    ]


def test_a_gate_without_a_value_is_open_and_says_nothing_of_an_object() -> None:
    register_gate(tilt_gate())
    report = judged(tilted(1, None))
    assert report.gate("tilt").status == "open" and report.passed
    assert report.objects[0].verdict == "fits"
    # An object without a label in the world cannot fail the gate.
    report = judged(tilted(1, 9.0, label="annotated"))
    assert report.gate("tilt").status == "open"


@pytest.mark.parametrize(
    ("verdicts", "worst"),
    [
        (["fits", "doubtful"], "doubtful"),
        (["doubtful", "unknown"], "doubtful"),
        (["unknown", "wrong"], "wrong"),
        (["fits", "fits"], "fits"),
    ],
)
def test_the_verdict_is_the_worst_of_the_gates(
    monkeypatch: pytest.MonkeyPatch, verdicts: list[str], worst: str
) -> None:
    monkeypatch.setattr(judge, "_FAMILIES", ())
    for k, verdict in enumerate(verdicts):
        # A limit that nothing exceeds says "fits".
        limit = 100.0 if verdict == "fits" else 0.0
        register_gate(
            tilt_gate(key=f"gate{k}", verdict=verdict, limit=lambda _, limit=limit: limit)
        )
    measured = Measured(
        summary=SUMMARY, objects=[tilted(1, 9.0)], frames=FRAMES, options=CheckOptions()
    )
    assert judge_rows(measured).objects[0].verdict == worst


@pytest.mark.parametrize(("value", "status"), [(7.0, "pass"), (7.1, "fail")])
def test_a_value_must_exceed_its_limit_by_its_deviations(value: float, status: str) -> None:
    register_gate(tilt_gate(limit=lambda _: 6.0, sigmas=2.0))
    assert judged(tilted(1, value)).gate("tilt").status == status
