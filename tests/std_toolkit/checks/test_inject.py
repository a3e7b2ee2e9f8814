"""Known faults in a scene: what they change, and the smallest ones that the check catches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from toy_balls import Toy, write_toy

from std_toolkit.checks.check_step import run_check
from std_toolkit.checks.inject.faults import KINDS, Fault, FaultKind, apply_fault, has_no_effect
from std_toolkit.checks.inject.inject import inject_faults
from std_toolkit.checks.measure.residuals import measure_frame, open_for_work
from std_toolkit.checks.page.inject_report import detectability_table
from std_toolkit.checks.result import CheckReport
from std_toolkit.cli import main as cli
from std_toolkit.geometry import rotation_angle
from std_toolkit.io.documents import read_document
from std_toolkit.jobs import JobOptions
from std_toolkit.options import CheckOptions
from std_toolkit.scene import ObjectTable, Scene
from std_toolkit.scene.model import ContinuousSymmetry, SymmetryModel

MakeScene = Callable[[Toy], Scene]
SERIAL = JobOptions(engine="serial", progress=False)
UP = np.array([0.0, 1.0, 0.0])


def kind(name: str) -> FaultKind:
    return next(k for k in KINDS if k.name == name)


def fault(name: str, size: float, **more: object) -> Fault:
    fields: dict[str, object] = {"object": 1, "up": (0.0, 1.0, 0.0), "along": (0.0, 0.0, -1.0)}
    return Fault(name, size, **(fields | more))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_toy(tmp_path_factory.mktemp("faults") / "toy", Toy(frames=2)).root


@pytest.fixture()
def scene(recorded: Path) -> Scene:
    return Scene.open(recorded)


@pytest.mark.parametrize(
    ("name", "expected_m"),
    [("sideways", (0.01, 0, 0)), ("along", (0, 0, -0.01)), ("moved", (0.01, 0, 0))],
)
def test_a_translation_has_its_size_and_direction(
    scene: Scene, name: str, expected_m: tuple[float, float, float]
) -> None:
    faulty = apply_fault(scene, fault(name, 10.0))
    change = faulty.T_world_obj(1).t - scene.T_world_obj(1).t
    np.testing.assert_allclose(change, expected_m, atol=1e-12)
    np.testing.assert_array_equal(faulty.T_world_obj(2).t, scene.T_world_obj(2).t)
    # The annotated pose is off by the same motion.
    before, after = scene.labels.of(1), faulty.labels.of(1)
    moved = np.reshape(after.T_cam_obj, (4, 4))[:3, 3] - np.reshape(before.T_cam_obj, (4, 4))[:3, 3]
    assert np.linalg.norm(moved) == pytest.approx(0.01, abs=1e-9)


@pytest.mark.parametrize(("name", "axis"), [("tilt", 0), ("turn", 1)])
def test_a_rotation_keeps_the_centre(scene: Scene, name: str, axis: int) -> None:
    faulty = apply_fault(scene, fault(name, 12.0))
    before, after = scene.T_world_obj(1), faulty.T_world_obj(1)
    np.testing.assert_allclose(after.t, before.t, atol=1e-9)  # the balls' origin is their centre
    R = after.R @ before.R.T
    assert np.rad2deg(rotation_angle(R)) == pytest.approx(12.0, abs=1e-6)
    np.testing.assert_allclose(R[:, axis], np.eye(3)[axis], atol=1e-9)


def test_a_scaled_mesh_belongs_to_one_object(scene: Scene) -> None:
    faulty = apply_fault(scene, fault("scale", 5.0))
    one = scene.mesh(scene.objects.object(1).model)
    scaled = faulty.mesh(faulty.objects.object(1).model)
    np.testing.assert_allclose(scaled.extents, 1.05 * np.asarray(one.extents), rtol=1e-9)
    np.testing.assert_allclose(np.mean(scaled.bounds, 0), np.mean(one.bounds, 0), atol=1e-12)
    assert faulty.objects.object(2).model == scene.objects.object(2).model


def test_a_camera_is_off_in_one_frame(scene: Scene) -> None:
    faulty = apply_fault(scene, fault("camera", 30.0, object=0, frame=1))
    np.testing.assert_array_equal(faulty.T_world_cam(0).t, scene.T_world_cam(0).t)
    between = scene.T_world_cam(1).inverse() @ faulty.T_world_cam(1)
    np.testing.assert_allclose(between.t, [0.03, 0, 0], atol=1e-9)


def test_depth_is_shifted_to_the_right(scene: Scene) -> None:
    faulty = apply_fault(scene, fault("alignment", 7.0, object=0))
    before, after = (s.read_depth(s.frames[0]) for s in (scene, faulty))
    np.testing.assert_array_equal(after[:, 7:], before[:, :-7])
    assert not after[:, :7].any()
    np.testing.assert_array_equal(before, Scene.open(scene.root).read_depth(scene.frames[0]))


def test_a_symmetric_rotation_is_no_fault(scene: Scene) -> None:
    axis = scene.T_world_obj(1).R.T @ UP
    upright = SymmetryModel(continuous=[ContinuousSymmetry(axis=axis.tolist())])
    models = [msgspec.structs.replace(m, symmetry=upright) for m in scene.objects.models]
    scene.objects = ObjectTable(models=models, objects=scene.objects.objects)
    assert has_no_effect(scene, kind("turn"), fault("turn", 5.0))
    assert not has_no_effect(scene, kind("tilt"), fault("tilt", 5.0))
    assert not has_no_effect(scene, kind("sideways"), fault("sideways", 5.0))


@pytest.mark.slow
def test_the_smallest_fault_is_that_of_the_limit(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=3, arc_deg=20))
    before = {p: p.read_bytes() for p in sorted(scene.root.rglob("*")) if p.is_file()}
    options = CheckOptions()
    _, caster = open_for_work(scene.root, "smallest")
    observed = [measure_frame(scene, caster, f, options) for f in scene.frames]
    kinds = [kind("sideways"), replace(kind("turn"), sizes=(20.0,))]
    found = inject_faults(scene, observed, "smallest", options, SERIAL, up=UP, kinds=kinds)
    assert {p: p.read_bytes() for p in sorted(scene.root.rglob("*")) if p.is_file()} == before
    assert found.passed and found.frames == [0, 1, 2] and found.left_out == []
    rows = {(r.object, r.fault): r for r in found.rows}
    for object_id in (1, 2):
        row = rows[object_id, "sideways"]
        # 3 px, the limit of the gate "shift", are 5.5 mm at this distance.
        assert row.missed_to < row.caught_from <= 8
        assert row.gates
        assert [t.size for t in row.trials] == sorted(t.size for t in row.trials)
        assert row.trials[0].size == 0 and row.trials[0].ratio < 0.5 and not row.trials[0].caught
        # A ball looks the same after any turn.
        turned = rows[object_id, "turn"]
        assert turned.caught_from is None and "symmetric" in turned.note
    text = detectability_table(found).terminal(notes=False)
    assert f"{rows[1, 'sideways'].caught_from:g} mm" in text


@pytest.mark.long
def test_the_command_prints_and_stores_the_table(
    make_scene: MakeScene, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = make_scene(Toy(frames=6))
    arguments = ["check", str(scene.root), "--inject", "--inject-frames", "4", "--engine", "serial"]
    assert cli.main([*arguments, "--inject-objects", "1", "--overlay-frames", "0"]) == 0
    textured = capsys.readouterr().out
    assert "Smallest fault that the check catches" in textured
    report = read_document(scene.root / "check" / "report.json", CheckReport)
    found = report.detectability
    assert found is not None and len(found.frames) == 4
    assert found.left_out == ["ball_2"]
    rows = {r.fault: r for r in found.rows}
    assert set(rows) == {k.name for k in KINDS}
    assert rows["sideways"].caught_from is not None
    assert rows["along"].caught_from is not None and rows["along"].caught_from <= 12
    page = Path(scene.root / "check" / "report.html").read_text()
    assert "Smallest faults caught" in page and "inject-sideways" in page
    assert run_check(scene, CheckOptions(), SERIAL).detectability is None
