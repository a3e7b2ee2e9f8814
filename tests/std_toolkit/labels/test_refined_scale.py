"""Scale from the sizes of objects: fused with what the poses have, never in place of better."""

from __future__ import annotations

import numpy as np
import pytest

from std_toolkit.geometry import SE3
from std_toolkit.labels.entry.label import add_model, add_object, set_pose
from std_toolkit.labels.refine_step import RefinedLabels
from std_toolkit.labels.refined_scale import MeasuredScale, decide_scale
from std_toolkit.scene import Label, Scene
from std_toolkit.scene.model import ScaleEstimate, ScaleReport, pose_from_list


def measured(
    factor: float, error: float = 0.002, *, models: int = 1, settled: bool = True
) -> MeasuredScale:
    return MeasuredScale(
        factor=factor, standard_error=error, objects=models, models=models, settled=settled
    )


def report(*sources: tuple[str, float, float]) -> ScaleReport:
    """The first source is used; (name, factor, standard error)."""
    estimates = [
        ScaleEstimate(source=s, factor=f, spread=0.01, standard_error=e, count=9)
        for s, f, e in sources
    ]
    name, factor, _ = sources[0]
    return ScaleReport(
        unit="metre", chosen=name, estimates=estimates, factor=factor, fused=[name]
    ).consistent()


def test_metres_from_a_board_are_kept() -> None:
    """The figures of the fault: board 0.010 %, CAD sizes 0.9954 +- 0.0021."""
    before = report(("board", 0.3, 0.0001))
    decision = decide_scale(before, measured(0.9954, 0.0021))
    assert decision.kept and decision.factor == 1
    assert "metres from board are kept" in decision.sentence
    after = decision.report
    assert (after.chosen, after.fused, after.factor) == ("board", ["board"], pytest.approx(0.3))
    assert [e.source for e in after.estimates] == ["board", "objects"]
    assert after.disagreement == pytest.approx(1 / 0.9954 - 1, rel=1e-6)


def test_sizes_of_objects_correct_sensor_depth() -> None:
    before = report(("depth", 0.3, 0.0005))
    decision = decide_scale(before, measured(0.985, 0.001, models=4))
    assert not decision.kept
    # 1.5 % against 0.22 %: nearly all of the way, not more.
    assert 0.985 < decision.factor < 0.9855
    after = decision.report
    assert after.chosen == "objects" and set(after.fused) == {"depth", "objects"}
    assert after.factor == pytest.approx(0.3 * decision.factor)
    assert after.deviation < 0.00225
    assert after.disagreement == pytest.approx(1 / 0.985 - 1, rel=1e-3)


def test_a_second_run_counts_the_objects_once() -> None:
    before = report(("depth", 0.3, 0.0005))
    first = decide_scale(before, measured(0.985, 0.001, models=4))
    again = decide_scale(first.report, measured(0.985 / first.factor, 0.001, models=4))
    assert again.factor == pytest.approx(1, abs=1e-9)
    assert again.report.deviation == pytest.approx(first.report.deviation)
    assert [e.source for e in again.report.estimates] == ["depth", "objects"]


def test_a_scale_that_did_not_settle_is_not_applied() -> None:
    before = report(("depth", 0.3, 0.0005))
    decision = decide_scale(before, measured(0.99, settled=False))
    assert decision.kept and decision.factor == 1
    assert "did not settle" in decision.sentence
    assert decision.report == before


def test_sizes_that_contradict_the_present_scale_are_not_applied() -> None:
    decision = decide_scale(report(("depth", 0.3, 0.0005)), measured(0.9, 0.001))
    assert decision.kept and decision.factor == 1
    assert "standard deviations" in decision.sentence
    assert decision.report.disagreement == pytest.approx(1 / 0.9 - 1, rel=1e-3)


def test_imported_poses_are_a_source_of_unknown_quality() -> None:
    decision = decide_scale(None, measured(0.985, 0.001))
    assert not decision.kept
    assert 0.985 < decision.factor < 0.99
    assert [e.source for e in decision.report.estimates] == ["given", "objects"]


def test_a_report_of_version_0_1_0_has_the_scale_of_its_source() -> None:
    old = ScaleReport(
        unit="metre",
        chosen="objects",
        estimates=[
            ScaleEstimate(source=s, factor=f, spread=0, standard_error=0.001, count=1)
            for s, f in (("depth", 0.3), ("objects", 0.296))
        ],
    )
    assert old.applied_factor == 0.296
    decision = decide_scale(old, measured(1.0, 0.001))
    assert decision.factor == pytest.approx(1, abs=0.002)
    assert set(decision.report.fused) == {"depth", "objects"}


def test_labels_follow_the_scale_to_first_order() -> None:
    pose = SE3.exp([0.1, 0.2, 0.7, 0.3, 0.2, 0.1])
    label = Label(object=1, frame=0, T_cam_obj=pose.flat(), T_world_obj=pose.flat())
    coupling = np.array([0.0, 0, 0.5, 0, 0, 0.1])
    found = RefinedLabels({1: label}, measured(0.99), {1: coupling})
    assert found.at_scale(0.99) == {1: label}
    moved = pose_from_list(found.at_scale(1.0)[1].T_world_obj)
    expected = pose @ SE3.exp(np.log(1 / 0.99) * coupling)
    np.testing.assert_allclose(moved.matrix(), expected.matrix(), atol=1e-12)


def test_poses_save_with_the_disagreement_of_their_sources(scene: Scene, box_path) -> None:
    import msgspec

    add_model(scene, box_path)
    add_object(scene, "box", model="box")
    set_pose(scene, "box", 0, scene.T_world_cam(0))
    stale = msgspec.structs.replace(
        report(("board", 1.0, 0.0001), ("objects", 0.9954, 0.0021)), disagreement=0.0
    )
    scene.save_poses(msgspec.structs.replace(scene.poses, scale=stale))
    assert Scene.open(scene.root).poses.scale.disagreement == pytest.approx(1 / 0.9954 - 1)
    assert scene.poses.scale.disagreement == pytest.approx(1 / 0.9954 - 1)
