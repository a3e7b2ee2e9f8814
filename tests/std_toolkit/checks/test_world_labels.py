"""Labels of kinds of objects that set no limit: right ones are not refused, wrong ones are."""

from __future__ import annotations

from pathlib import Path

import pytest
from fault_table import FaultCase, Study

from sensors.synthetic.kinds import JUDGING, SETTING
from sensors.synthetic.world_faults import label_faults
from sensors.synthetic.world_scene import world_scene

REFUSED = ("doubtful", "wrong")


@pytest.mark.slow
# 224 has flat dishes and bottles of steel, which show the table at their foot.
@pytest.mark.parametrize(
    "seed", [204, *(pytest.param(seed, marks=pytest.mark.long) for seed in (201, 224))]
)
def test_labels_of_unseen_kinds(seed: int, tmp_path: Path) -> None:
    scene = world_scene(seed, JUDGING, frames=8, folder=tmp_path)
    study = Study(scene)
    plain = study.plain()
    said = {o.name: (o.material, o.verdict) for o in plain.objects}
    assert plain.passed, said
    assert {v for m, v in said.values() if m == "diffuse"} == {"fits"}, said
    for item in plain.objects:
        large = [f for f in label_faults(scene, item.object, seed=seed) if f.level == 2]
        for fault in large[:2]:
            case = FaultCase(fault.name, "fail", fault.apply(scene), objects=(item.object,))
            (row,) = (o for o in study.report(case).objects if o.object == item.object)
            caught = row.verdict in REFUSED
            # What could not see the fault says so.
            assert caught or (item.material != "diffuse" and row.verdict == "unknown"), (
                item.name,
                fault.name,
                row.verdict,
            )


@pytest.mark.slow
def test_steel_is_found_beside_its_label(tmp_path: Path) -> None:
    """From the label itself the edges of the ball are out of reach."""
    scene = world_scene(401, SETTING, frames=8, folder=tmp_path)
    ball = next(o.id for o in scene.objects.objects if o.name == "ball_1")
    fault = next(
        f
        for f in label_faults(scene, ball, seed=401)
        if f.level == 2 and f.name.startswith("sideways")
    )
    case = FaultCase(fault.name, "fail", fault.apply(scene), objects=(ball,))
    (row,) = (o for o in Study(scene).report(case).objects if o.object == ball)
    assert row.verdict == "wrong"
    assert row.text("support") == "seen"
    assert row.value("motion_mm") == pytest.approx(12, abs=2)
