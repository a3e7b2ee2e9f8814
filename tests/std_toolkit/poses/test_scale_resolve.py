"""Several sources of metres: reported together, contradictions stop the run."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from std_toolkit.plugins import Registry
from std_toolkit.poses import PoseOptions, scale_sources
from std_toolkit.poses.pose_step import _judged, _width
from std_toolkit.poses.scale_sources import ScaleContext, resolve_scale
from std_toolkit.scene.model import ScaleEstimate, ScaleReport
from std_toolkit.scene.scale_model import contradiction, fuse


class Fixed:
    name = "fixed"
    factor = 1.0
    present = True
    broken = False

    def available(self, context: ScaleContext) -> bool:  # noqa: ARG002 - the protocol
        return self.present

    def estimate(self, context: ScaleContext) -> ScaleEstimate:  # noqa: ARG002
        if self.broken:
            raise ToolkitError("nothing to see")
        return ScaleEstimate(
            source=self.name, factor=self.factor, spread=0.01, standard_error=0.001, count=9
        )


class Depth(Fixed):
    name, factor = "depth", 1.004


class Board(Fixed):
    name, factor = "board", 1.0


class Cad(Fixed):
    name, factor = "cad", 1.002


class Far(Fixed):
    name, factor = "far", 1.02


class Broken(Fixed):
    name, broken = "broken", True


class Absent(Fixed):
    name, present = "absent", False


@pytest.fixture
def context() -> ScaleContext:
    return ScaleContext(None, None, {}, {}, Path("x"))  # type: ignore[arg-type]


def use(monkeypatch: pytest.MonkeyPatch, *sources: type) -> None:
    module = Fixed.__module__
    known = {s.name: f"{module}:{s.__name__}" for s in sources}
    monkeypatch.setattr(scale_sources, "SOURCES", Registry("std_toolkit.test_sources", known))


def test_agreeing_sources_are_all_reported_and_the_board_weighs_most(monkeypatch, context) -> None:
    use(monkeypatch, Depth, Board, Absent)
    factor, report = resolve_scale(context, scale="auto", max_disagreement=0.005)
    assert report.chosen == "board" and report.unit == "metre"
    assert [e.source for e in report.estimates] == ["depth", "board"]
    assert report.fused == ["depth", "board"]
    assert report.disagreement == pytest.approx(0.004, abs=1e-4)
    # The board is ten times as precise: the depth moves the mean by a hundredth of the way.
    assert 1.0 < factor < 1.0001
    assert report.factor == factor
    assert report.deviation < min(e.deviation for e in report.estimates)


@pytest.mark.parametrize("order", list(permutations((Board, Cad, Depth))))
@pytest.mark.parametrize("absent", [0, 1, 2])
def test_the_most_precise_source_is_chosen_in_any_order(
    monkeypatch, context, order: tuple[type, ...], absent: int
) -> None:
    """Whatever the order in which they are asked."""
    trusted = (Board, Cad, Depth)[absent:]
    use(monkeypatch, *(source for source in order if source in trusted))
    factor, report = resolve_scale(context, scale="auto", max_disagreement=0.05)
    assert report.chosen == trusted[0].name
    assert factor == pytest.approx(trusted[0].factor, abs=3e-4)
    assert len(report.estimates) == len(trusted)


def test_contradicting_sources_stop_the_run_unless_one_is_named(monkeypatch, context) -> None:
    use(monkeypatch, Board, Far)
    with pytest.raises(ToolkitError, match=r"differ by 1.96 %, .* --scale board or --scale far"):
        resolve_scale(context, scale="auto", max_disagreement=0.005)
    factor, report = resolve_scale(context, scale="far", max_disagreement=0.005)
    assert factor == pytest.approx(1.02) and len(report.estimates) == 2
    assert report.fused == ["far"]
    assert report.disagreement > 0.015


def estimate(source: str, factor: float, deviation: float) -> ScaleEstimate:
    return ScaleEstimate(
        source=source, factor=factor, spread=0, standard_error=0, count=1, deviation=deviation
    )


@pytest.mark.parametrize("deviation", [0.002, 0.005])
@pytest.mark.parametrize(("sigma", "refused"), [(1.7, False), (2.9, False), (3.1, True), (9, True)])
def test_sources_are_compared_in_joint_deviations(
    monkeypatch, context, deviation: float, sigma: float, refused: bool
) -> None:
    use(monkeypatch, Board, Cad)
    joint = np.sqrt(2) * deviation
    estimates = [
        estimate("board", 1.0, deviation),
        estimate("cad", np.exp(sigma * joint), deviation),
    ]
    for source, found in zip((Board, Cad), estimates, strict=True):
        monkeypatch.setattr(source, "estimate", lambda *_, found=found: found)
    if refused:
        with pytest.raises(ToolkitError, match="contradict each other"):
            resolve_scale(context, scale="auto")
    else:
        factor, report = resolve_scale(context, scale="auto")
        assert factor == pytest.approx(np.exp(sigma * joint / 2))
        assert report.deviation == pytest.approx(deviation / np.sqrt(2))


def test_a_difference_below_half_a_percent_is_no_contradiction() -> None:
    assert contradiction([estimate("board", 1.0, 1e-4), estimate("x", 1.0049, 1e-4)]) is None
    assert contradiction([estimate("board", 1.0, 1e-4), estimate("x", 1.0051, 1e-4)]) is not None


deviations = st.lists(st.floats(1e-4, 0.05), min_size=2, max_size=6)


@settings(max_examples=60, deadline=None)
@given(deviations=deviations, seed=st.integers(0, 10_000), factor=st.floats(1e-3, 1e3))
def test_a_fusion_of_consistent_estimates_is_better_than_each(
    deviations: list[float], seed: int, factor: float
) -> None:
    z = np.random.default_rng(seed).uniform(-1, 1, len(deviations))
    estimates = [
        estimate(f"s{i}", factor * float(np.exp(z_ * d)), d)
        for i, (z_, d) in enumerate(zip(z, deviations, strict=True))
    ]
    fused, deviation = fuse(estimates)
    assert deviation < min(deviations)
    assert min(e.factor for e in estimates) <= fused * (1 + 1e-9)
    assert fused <= max(e.factor for e in estimates) * (1 + 1e-9)
    assert contradiction(estimates) is None


def test_the_mean_has_the_deviation_that_is_reported() -> None:
    """Drawn often, the error of the mean over its deviation is standard normal."""
    rng = np.random.default_rng(0)
    given = np.array([0.001, 0.004, 0.015])
    errors = []
    for _ in range(500):
        estimates = [
            estimate(name, float(np.exp(rng.normal(0, d))), d)
            for name, d in zip(("board", "cad", "depth"), given, strict=True)
        ]
        fused, deviation = fuse(estimates)
        errors.append(np.log(fused) / deviation)
    assert np.std(errors) == pytest.approx(1, abs=0.1)


def test_two_comparisons_of_the_same_meshes_count_once() -> None:
    cad, objects = estimate("cad", 1.004, 0.004), estimate("objects", 1.0, 0.002)
    assert fuse([cad, objects]) == pytest.approx((1.0, 0.002))


def test_every_source_has_a_systematic_error() -> None:
    perfect = {
        s: ScaleEstimate(source=s, factor=1, spread=0, standard_error=0, count=9).sigma
        for s in ("board", "cad", "depth", "plug-in")
    }
    assert 0 < perfect["board"] < perfect["cad"] < perfect["depth"]
    assert perfect["plug-in"] > 0
    noisy = ScaleEstimate(source="board", factor=1, spread=0, standard_error=0.01, count=9)
    assert noisy.sigma == pytest.approx(0.01, rel=0.01)


def test_a_broken_source_stops_auto_but_not_a_named_one(monkeypatch, context) -> None:
    use(monkeypatch, Board, Broken)
    with pytest.raises(ToolkitError, match="nothing to see"):
        resolve_scale(context, scale="auto", max_disagreement=0.005)
    factor, _ = resolve_scale(context, scale="board", max_disagreement=0.005)
    assert factor == pytest.approx(1.0)


def test_no_source_and_none(monkeypatch, context, caplog) -> None:
    use(monkeypatch, Absent)
    with caplog.at_level("WARNING", logger="std_toolkit"):
        factor, report = resolve_scale(context, scale="auto", max_disagreement=0.005)
    assert (factor, report.unit) == (1.0, "unknown") and "UNKNOWN" in caplog.text
    caplog.clear()
    _, report = resolve_scale(context, scale="none", max_disagreement=0.005)
    assert report.unit == "unknown" and not caplog.text


def test_a_plug_in_named_by_its_path(monkeypatch, context) -> None:
    use(monkeypatch, Absent)
    factor, report = resolve_scale(context, scale=f"{Far.__module__}:Far", max_disagreement=0.005)
    assert factor == pytest.approx(1.02) and report.chosen.endswith(":Far")


def test_a_source_the_user_named_is_judged_alone() -> None:
    estimates = [
        ScaleEstimate(source=s, factor=f, spread=0.01, standard_error=0.001, count=9)
        for s, f in (("depth", 0.3), ("board", 0.4))
    ]
    report = ScaleReport(unit="metre", chosen="board", estimates=estimates, disagreement=0.3)
    assert _judged(report, PoseOptions(scale="auto")) is report
    named = _judged(report, PoseOptions(scale="board"))
    assert (named.unit, named.chosen) == ("metre", "board")
    assert not named.estimates
    assert named.disagreement == 0


def test_the_disagreement_is_the_largest_relative_difference() -> None:
    estimates = [
        ScaleEstimate(source=s, factor=f, spread=0.01, standard_error=0.001, count=9)
        for s, f in (("board", 0.2), ("cad", 0.25), ("depth", 0.3))
    ]
    report = ScaleReport(unit="metre", chosen="board", estimates=estimates, disagreement=0.0)
    assert report.consistent().disagreement == pytest.approx(1 / 3)
    wrong = contradiction(estimates)
    assert (wrong.a.source, wrong.b.source) == ("board", "cad")


@pytest.mark.parametrize(
    ("threads", "engine", "workers"), [(None, "local", 3), (1, "serial", 1), (2, "local", 2)]
)
def test_threads_set_the_workers(threads: int | None, engine: str, workers: int) -> None:
    given = JobOptions(engine="local", workers=3)
    found = _width(given, PoseOptions(threads=threads))
    assert (found.engine, found.workers) == (engine, workers)
