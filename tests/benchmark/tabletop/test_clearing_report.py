"""Table clearing in a report: what it says of restored depth, and what papers print."""

from pathlib import Path

import pytest
from hostile_pages import attack

from benchmark.evaluation.manifest import GRASP_MANIFEST, GraspManifest, GraspSetup, circumstances
from benchmark.evaluation.tasks.grasp_results import Gain, Rate
from benchmark.evaluation.tasks.grasp_table import ATTEMPTS, GRASPED, LEFT
from benchmark.report.page import render_page
from benchmark.report.parts.grasp import grasp_part, points, verdict
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import write_document
from tests.benchmark.tabletop.test_clearing_rates import run_table

ALL, NONE = [("transparent", GRASPED)] * 2, [("transparent", LEFT)] * 2


def _write(out: Path, depth: str, rounds: list) -> None:
    folder = out / "grasp" / "quick-seed0" / "antipodal" / depth
    setup = GraspSetup(
        seed=0, attempts=10, camera="quick", depth_model_sha256="", gripper="panda",
        planner="antipodal", planner_preset="published", planner_settings={},
        planner_weights_sha256="", depth=depth, depth_preset="", depth_settings={},
        depth_weights_sha256="", precision="fp32", compile=False, device="cpu",
    )  # fmt: skip
    manifest = GraspManifest(
        setup=setup, depth_label=depth, planner_label="antipodal", planner_weights="",
        depth_weights="", **circumstances(),
    )  # fmt: skip
    folder.mkdir(parents=True)
    write_document(folder / GRASP_MANIFEST, manifest)
    table = run_table(rounds).assign(scene="", frame="", error="", attempt=0)
    table.to_parquet(folder / ATTEMPTS, index=False)


def test_the_gain_over_raw_depth_is_told_with_its_interval(tmp_path):
    won, lost = [("held", 1), ("held", 1)], [("slipped", 0)] * 3
    _write(tmp_path, "raw", [(NONE, lost)] * 3 + [(ALL, won)])
    _write(tmp_path, "gt", [(ALL, won)] * 4)
    part = grasp_part([tmp_path])
    ((sentence,),) = (block.items for block in part.answer)
    assert "True depth with antipodal: 75.0 points [25.0, 100.0] more" in sentence.text
    # Three of four tables gain: swapping the depths of tables does as well in 2 of 8 cases.
    assert "more (p = 0.25)" in sentence.text and "transparent ones 75.0 points" in sentence.text
    assert "not statistically significant" in sentence.text
    assert "Attempts that succeeded: 75.0 points" in sentence.text
    # Headings, a rule and two measured rows: real robots have tables of their own.
    assert part.files["grasping.md"].count("\n|") == 2 + 2
    assert r"\%" in part.files["grasping.tex"]
    assert "antipodal" in part.terminal
    page = render_page([part])
    assert "slipped" in page and "96.15" in page
    # Of the tables 0 to 3, as `run_table` has their precision.
    assert "30.0<small>[10.0, 50.0]</small>" in page and "25.0" in part.terminal
    alone = grasp_part([tmp_path], published=False)
    assert "96.15" not in render_page([alone])


def test_a_folder_without_a_finished_run_is_refused(tmp_path):
    with pytest.raises(ToolkitError, match="no finished run"):
        grasp_part([tmp_path])


def test_an_interval_decides_what_may_be_said():
    nan = float("nan")
    assert verdict(Gain(Rate(0.3, 0.1, 0.5, 3, 10), 0.01)) == "it helps"
    assert verdict(Gain(Rate(-0.3, -0.5, -0.1, 3, 10), 0.01)) == "it harms"
    assert verdict(Gain(Rate(0.1, -0.1, 0.3, 3, 10), 0.3)) == "not statistically significant"
    assert verdict(Gain(Rate(0.1, nan, nan, 1, 1), 1.0)) == "one table is too few to say"
    told = points(Gain(Rate(-0.05, -0.2, 0.1, 0, 4), 0.5))
    assert told == "5.0 points [-20.0, 10.0] fewer (p = 0.5)"


def test_no_field_of_somebody_elses_run_is_markup(tmp_path):
    rounds = [(ALL, [("held", 1), ("held", 1)]), (NONE, [("slipped", 0)])]
    for depth in ("raw", "gt"):
        _write(tmp_path, depth, rounds)
    tally = attack(
        tmp_path,
        lambda: grasp_part([tmp_path]),
        lambda: render_page([grasp_part([tmp_path])]),
        skip=lambda field: "packages" in field.keys,
    )
    assert len(tally.shown) > 10
    assert len(tally.refused) > 5
