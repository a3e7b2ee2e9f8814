"""Several sources of metres: reported together, contradictions stop the run."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from std_toolkit.plugins import Registry
from std_toolkit.poses import PoseOptions, scale_sources
from std_toolkit.poses.pose_step import _judged, _width
from std_toolkit.poses.scale_sources import ScaleContext, _disagreement, resolve_scale
from std_toolkit.scene.model import ScaleEstimate, ScaleReport


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


def test_agreeing_sources_are_all_reported_and_the_board_is_trusted(monkeypatch, context) -> None:
    use(monkeypatch, Depth, Board, Absent)
    factor, report = resolve_scale(context, scale="auto", max_disagreement=0.005)
    assert factor == 1.0 and report.chosen == "board" and report.unit == "metre"
    assert [e.source for e in report.estimates] == ["depth", "board"]
    assert report.disagreement == pytest.approx(0.004, abs=1e-4)


@pytest.mark.parametrize("order", list(permutations((Board, Cad, Depth, Far))))
@pytest.mark.parametrize("absent", [0, 1, 2])
def test_board_before_cad_before_depth_before_plug_ins(
    monkeypatch, context, order: tuple[type, ...], absent: int
) -> None:
    """Whatever the order in which they are asked."""
    trusted = (Board, Cad, Depth, Far)[absent:]
    use(monkeypatch, *(source for source in order if source in trusted))
    factor, report = resolve_scale(context, scale="auto", max_disagreement=0.05)
    assert (report.chosen, factor) == (trusted[0].name, trusted[0].factor)
    assert len(report.estimates) == len(trusted)


def test_contradicting_sources_stop_the_run_unless_one_is_named(monkeypatch, context) -> None:
    use(monkeypatch, Board, Far)
    with pytest.raises(ToolkitError, match=r"differ by .*--scale board or --scale far|--scale"):
        resolve_scale(context, scale="auto", max_disagreement=0.005)
    factor, report = resolve_scale(context, scale="far", max_disagreement=0.005)
    assert factor == 1.02 and len(report.estimates) == 2
    assert report.disagreement > 0.015


def test_a_broken_source_stops_auto_but_not_a_named_one(monkeypatch, context) -> None:
    use(monkeypatch, Board, Broken)
    with pytest.raises(ToolkitError, match="nothing to see"):
        resolve_scale(context, scale="auto", max_disagreement=0.005)
    factor, _ = resolve_scale(context, scale="board", max_disagreement=0.005)
    assert factor == 1.0


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
    assert factor == 1.02 and report.chosen.endswith(":Far")


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
    estimates = {
        s: ScaleEstimate(source=s, factor=f, spread=0.01, standard_error=0.001, count=9)
        for s, f in (("board", 0.2), ("cad", 0.25), ("depth", 0.3))
    }
    share, pair = _disagreement(estimates)
    assert share == pytest.approx(1 / 3)
    assert pair == ("board", "depth")


@pytest.mark.parametrize(
    ("threads", "engine", "workers"), [(None, "local", 3), (1, "serial", 1), (2, "local", 2)]
)
def test_threads_set_the_workers(threads: int | None, engine: str, workers: int) -> None:
    given = JobOptions(engine="local", workers=3)
    found = _width(given, PoseOptions(threads=threads))
    assert (found.engine, found.workers) == (engine, workers)
