"""Gates, verdicts and warnings from numbers."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from std_toolkit.checks.gates.contour import is_uninformative
from std_toolkit.checks.gates.depth import scale_share
from std_toolkit.checks.gates.gate import Measured
from std_toolkit.checks.gates.judge import judge_rows
from std_toolkit.checks.result import (
    CheckGate,
    CheckReport,
    FrameCheck,
    GateFinding,
    ObjectCheck,
    SceneSummary,
    Value,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.options import CheckOptions
from std_toolkit.scene.model import ScaleEstimate, ScaleReport

OPTIONS = CheckOptions()
IDENTITY = {
    "object": 1,
    "name": "mug",
    "model": "mug",
    "category": "mug",
    "material": "diffuse",
    "label": "refined",
    "frames_seen": 20,
}
VALUES = {
    "visible_fraction": 0.9,
    "edge_px": 0.5,
    "edge_support": 0.9,
    "edge_chance_px": 4.0,
    "shift_px": 0.4,
    "shift_share": 0.9,
    "depth_mm": 2.0,
    "depth_mad_mm": 1.0,
    "distance_m": 0.7,
    "drift_px": 0.4,
    "label_std_mm": 1.0,
    "parallax_deg": 80,
}


def mug(**change: Any) -> ObjectCheck:
    """A good object with other fields or values; None takes a value away."""
    fields = {k: change.pop(k, v) for k, v in IDENTITY.items()}
    words = {
        "label_std_mm": change.pop("weak_direction", ""),
        "confirmed": "yes",
        "texture": change.pop("texture_verdict", ""),
    }
    values = [
        Value(key=k, value=v, source="contour", frames=18, text=words.get(k, ""))
        for k, v in (VALUES | change).items()
        if v is not None
    ]
    return ObjectCheck(**fields, values=values)


GOOD = mug()
SUMMARY = SceneSummary(
    frames=20,
    registered=20,
    looked_at=20,
    reprojection_px=0.6,
    objects=1,
    labelled=1,
    depth_frames=20,
    truth_frames=20,
    depth_bias=0.0,
)
FRAMES = [FrameCheck(frame=i, name=f"{i:06d}", status="registered") for i in range(20)]


def judged(
    *items: ObjectCheck,
    summary: SceneSummary = SUMMARY,
    frames: list[FrameCheck] = FRAMES,
) -> CheckReport:
    return judge_rows(Measured(summary=summary, objects=items, frames=frames, options=OPTIONS))


def gates(item: ObjectCheck = GOOD, summary: SceneSummary = SUMMARY) -> dict[str, CheckGate]:
    return {g.key: g for g in judged(item, summary=summary).gates}


def verdict(item: ObjectCheck) -> str:
    return judged(item).objects[0].verdict


def scale(difference: float, *, deviation: float = 0.001) -> ScaleReport:
    """Two sources; the stored disagreement is wrong on purpose, as in the files of 0.1.0."""
    estimates = [
        ScaleEstimate(
            source=s, factor=f, spread=0.01, standard_error=0.0, count=10, deviation=deviation
        )
        for s, f in (("depth", 1.0 + difference), ("cad", 1.0))
    ]
    return ScaleReport(unit="metre", chosen="cad", estimates=estimates, disagreement=0.0)


@pytest.mark.parametrize(
    ("std_px", "outlines", "status"),
    [(2.0, 4, "pass"), (2.0, 40, "fail"), (0.5, 4, "fail"), (0.5, 3, "fail"), (2.0, 2, "open")],
)
def test_few_outlines_do_not_tell_how_uncertain_they_are(
    std_px: float, outlines: int, status: str
) -> None:
    """A shift of 8 px, where 3 px are allowed."""
    shift = {"depth_shift_px": [-2.0, 7.7], "depth_shift_std_px": std_px, "depth_shifts": outlines}
    assert gates(summary=msgspec.structs.replace(SUMMARY, **shift))["alignment"].status == status


def test_a_good_scene_fails_nothing() -> None:
    assert [g.key for g in gates().values() if g.status == "fail"] == []
    assert verdict(GOOD) == "fits"


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"edge_px": 3.1, "edge_chance_px": 9.0}, "edges"),
        ({"shift_px": 3.5}, "shift"),
        ({"depth_mm": -5.2}, "depth"),
        ({"drift_px": 3.2}, "drift"),
        ({"label_std_mm": 5.5}, "covariance"),
        ({"edge_support": 0.1}, "evidence"),
        ({"edge_px": 1.8, "edge_chance_px": 1.9, "shift_share": 0.2}, "evidence"),
    ],
)
def test_a_bad_label_fails_its_gate(change: dict[str, object], key: str) -> None:
    item = mug(**change)
    failed = {g.key: g for g in gates(item).values() if g.status == "fail"}
    assert set(failed) == {key}
    assert failed[key].advice
    assert "mug" in failed[key].detail
    if key in ("edges", "shift", "depth", "drift", "covariance"):
        assert verdict(item) == "wrong"


def test_reflections_that_move_accuse_no_steel() -> None:
    steel = mug(material="specular", drift_px=3.2, depth_mm=None, distance_m=None)
    assert gates(steel)["drift"].status != "fail" and verdict(steel) == "unknown"
    far = mug(material="specular", drift_px=13.0, depth_mm=None, distance_m=None)
    assert gates(far)["drift"].status == "fail" and verdict(far) == "wrong"


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"registered": 17}, "registered"),
        ({"reprojection_px": 1.6}, "reprojection"),
        ({"scale": scale(0.006)}, "scale"),
        ({"scale": ScaleReport(unit="unknown", chosen="none")}, "metres"),
    ],
)
def test_bad_camera_poses_fail_their_gate(change: dict[str, object], key: str) -> None:
    found = gates(summary=msgspec.structs.replace(SUMMARY, **change))
    assert {g.key for g in found.values() if g.status == "fail"} == {key}


def test_the_limit_itself_passes() -> None:
    item = mug(edge_px=3.0, edge_chance_px=9.0, depth_mm=5.0)
    summary = msgspec.structs.replace(SUMMARY, registered=18, scale=scale(0.005))
    assert judged(item, summary=summary).failed_gates() == []


def test_glass_without_edges_warns_but_does_not_fail() -> None:
    glass = mug(material="transparent", edge_support=0.1, depth_mm=None, distance_m=None)
    assert all(g.status != "fail" for g in gates(glass).values())
    assert verdict(glass) == "unknown"
    warnings = judged(glass).warnings
    assert any("weakly supports" in w.problem for w in warnings)


def test_one_scale_source_leaves_the_agreement_open() -> None:
    one = ScaleReport(unit="metre", chosen="cad", estimates=scale(0.0).estimates[1:])
    gate = gates(summary=msgspec.structs.replace(SUMMARY, scale=one))["scale"]
    assert gate.status == "open" and gate.value is None
    assert gate.detail == "only one source (cad)"
    three = msgspec.structs.replace(one, estimates=[*scale(0.0).estimates, *one.estimates])
    gate = gates(summary=msgspec.structs.replace(SUMMARY, scale=three))["scale"]
    assert gate.detail.startswith("used: cad; depth 1 +- 0.10 % and cad 1 +- 0.10 % differ by")


@pytest.mark.parametrize(
    ("difference", "deviation", "status"),
    [
        (0.006, 0.001, "fail"),  # 4.2 joint deviations
        (0.0088, 0.0037, "pass"),  # 1.7 joint deviations
        (0.004, 0.0001, "pass"),  # many deviations, but below 0.5 %
        (0.03, 0.005, "fail"),
    ],
)
def test_the_scale_gate_compares_in_deviations(
    difference: float, deviation: float, status: str
) -> None:
    report = scale(difference, deviation=deviation)
    gate = gates(summary=msgspec.structs.replace(SUMMARY, scale=report))["scale"]
    assert gate.status == status
    assert f"differ by {100 * difference:.2f} %" in gate.detail


@pytest.mark.parametrize(("depth_mm", "status"), [(10.0, "pass"), (25.0, "fail")])
def test_one_object_does_not_tell_its_depth_from_a_bias(depth_mm: float, status: str) -> None:
    alone = msgspec.structs.replace(SUMMARY, depth_bias=None)
    assert gates(mug(depth_mm=depth_mm), alone)["depth"].status == status


def test_depth_gate_leaves_out_what_the_scale_explains() -> None:
    item = mug(depth_mm=10.0)
    assert gates(item)["depth"].status == "fail"
    # 1.5 % of 0.7 m are 10.5 mm: a sensor's bias.
    biased = msgspec.structs.replace(SUMMARY, depth_bias=0.015)
    assert scale_share(biased) == 0.015
    assert gates(item, biased)["depth"].status == "pass"
    # No sensor of this class is off by 5 %: then the labels or their scale are wrong.
    assert scale_share(msgspec.structs.replace(SUMMARY, depth_bias=0.05)) == 0


def test_warnings_are_ranked_and_failed_gates_lead() -> None:
    item = mug(depth_mm=9.0, offset_mm=4.0, weak_direction="depth is weak", parallax_deg=12)
    frames = [
        *FRAMES[:10],
        FrameCheck(frame=10, name="x", status="registered", problem="truncated"),
        FrameCheck(frame=11, name="y", status="unregistered"),
        FrameCheck(frame=12, name="z", status="registered", truth="stale"),
    ]
    found = judged(item, frames=frames).warnings
    assert [w.gate for w in found][:3] == ["depth", "frames", ""]
    assert found[0].about == "mug"
    order = [{"high": 0, "medium": 1, "low": 2}[w.severity] for w in found]
    assert order == sorted(order)
    text = " ".join(w.problem for w in found)
    for part in ("truncated", "other labels", "12 degrees", "depth is weak", "4.0 mm"):
        assert part in text
    assert all(w.advice for w in found)


@pytest.mark.parametrize(
    "bad",
    [
        {"min_registered": 1.5},
        {"max_edge_px": -1.0},
        {"max_edge_px": float("nan")},
        {"search_px": 2.0},
        {"shift_px": 30.0},
        {"jpeg_quality": 0},
        {"image_width": 10},
    ],
)
def test_options_out_of_range_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ToolkitError):
        CheckOptions(**bad)  # type: ignore[arg-type]


def test_metres_from_depth_alone_are_warned_about() -> None:
    # A scale that is as wrong as the depth leaves no residual.
    two = scale(0.001)
    for report, told in (
        (msgspec.structs.replace(two, estimates=two.estimates[:1]), True),
        (two, False),
        (None, False),
    ):
        summary = msgspec.structs.replace(SUMMARY, scale=report)
        found = judged(summary=summary).warnings
        assert any("--refine-scale" in w.advice for w in found) == told


@pytest.mark.parametrize(
    ("edge_px", "chance_px", "uninformative"), [(1.0, 2.0, False), (1.25, 2.0, True)]
)
def test_an_outline_must_lie_well_below_chance(
    edge_px: float, chance_px: float, uninformative: bool
) -> None:
    assert is_uninformative(mug(edge_px=edge_px, edge_chance_px=chance_px)) is uninformative


@pytest.mark.parametrize(("count", "shown"), [(1, 1), (6, 6), (8, 6)])
def test_frames_that_could_not_be_checked_are_named(count: int, shown: int) -> None:
    """Even if not one frame could be looked at."""
    frames = [msgspec.structs.replace(f, problem="damaged") for f in FRAMES[:count]]
    for looked_at in (0, 20):
        summary = msgspec.structs.replace(SUMMARY, looked_at=looked_at)
        gate = judged(GOOD, summary=summary, frames=frames).gate("frames")
        assert (gate.status, gate.value) == ("fail", count)
        names = ", ".join(f.name for f in frames[:shown])
        more = f" and {count - shown} more" if count > shown else ""
        assert gate.detail == names + more


def finding(item: ObjectCheck, gate: str) -> GateFinding:
    (found,) = (f for f in judged(item).objects[0].gates if f.gate == gate)
    return found


def moved(motion_mm: float, texture_mm: float | None = None) -> ObjectCheck:
    """An object whose contour, and whose texture, lie so far to the side."""
    covariance = np.diag([0.5**2] * 3 + [0.3**2] * 3).ravel().tolist()
    found = [("motion_mm", "contour", motion_mm)]
    found += [] if texture_mm is None else [("texture_mm", "texture", texture_mm)]
    values = [
        Value(key=k, value=x, source=s, motion=[x, 0, 0, 0, 0, 0], covariance=covariance)  # type: ignore[arg-type]
        for k, s, x in found
    ]
    item = mug(edge_px=5.0, edge_chance_px=20.0, confirmed=1.0, size_m=0.25)
    return item.with_values(values)


@pytest.mark.parametrize(("motion_mm", "key"), [(1.0, ""), (9.0, "motion")])
def test_pixels_do_not_count_where_the_motion_is_known(motion_mm: float, key: str) -> None:
    item = moved(motion_mm)
    failed = [g.key for g in gates(item).values() if g.status == "fail"]
    assert failed == ([key] if key else [])
    assert finding(item, "edges").exempt
    assert verdict(item) == ("wrong" if key else "fits")


def test_another_shape_is_told_only_where_the_texture_fits() -> None:
    item = moved(7.0, texture_mm=0.2)
    assert "another shape" in finding(item, "motion").exempt
    assert any("another shape" in w.problem for w in judged(item).warnings)
    assert verdict(item) == "fits"
    both = moved(7.0, texture_mm=7.0)
    assert verdict(both) == "wrong" and not finding(both, "motion").exempt


def test_glass_is_exempt_from_evidence_and_unknown() -> None:
    glass = mug(material="transparent", edge_support=0.1)
    found = finding(glass, "evidence")
    assert (found.value, found.verdict) == (1.0, "unknown")
    assert "glass" in found.exempt
    assert gates(glass)["evidence"].value == 0


@pytest.mark.parametrize(
    ("material", "shift_px", "word"),
    [("specular", 3.8, "unknown"), ("specular", 13.0, "wrong"), ("diffuse", 3.8, "wrong")],
)
def test_pixels_accuse_no_steel_whose_pose_is_not_determined(
    material: str, shift_px: float, word: str
) -> None:
    """The numbers are those of an exact label of a thermos flask of steel."""
    covariance = np.diag([6.0**2] * 3 + [2.5**2] * 3).ravel().tolist()
    motion = Value(
        key="motion_mm",
        value=5.7,
        source="contour",
        motion=[5, 0, 3, 0, 0, 1],
        covariance=covariance,
    )
    item = mug(material=material, shift_px=shift_px, size_m=0.2, depth_mm=None, drift_px=None)
    item = item.with_values([motion])
    assert finding(item, "shift").verdict == word
    assert verdict(item) == word


@pytest.mark.parametrize(
    ("material", "word"),
    [("specular", "unknown"), ("transparent", "doubtful"), ("diffuse", "unknown")],
)
def test_edges_beside_steel_may_be_those_of_its_highlights(material: str, word: str) -> None:
    """A right label of a steel banana, which reflects the table below."""
    item = with_edges_aside(material, 0.41, 0.05)
    assert finding(item, "seen").verdict == word
    if material == "specular":
        assert verdict(item) == word


def test_edges_that_fit_hardly_better_accuse_no_label_of_glass() -> None:
    """A right label of a dish."""
    assert finding(with_edges_aside("transparent", 0.27, 0.08), "seen").verdict == "unknown"


def with_edges_aside(material: str, support: float, at_label: float) -> ObjectCheck:
    item = mug(material=material, shift_px=3.0, size_m=0.2, depth_mm=None, drift_px=None)
    return item.with_values(
        [
            Value(key="confirmed", value=0.0, source="contour", text="no"),
            Value(key="support", value=support, std=0.12, source="contour", text="aside"),
            Value(key="label_support", value=at_label, std=0.1, source="contour"),
        ]
    )
