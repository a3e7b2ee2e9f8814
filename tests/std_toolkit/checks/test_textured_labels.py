"""A label of a textured object: faults are told from another shape, and from nothing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import pytest
from fault_table import FaultCase, Study

from sensors.synthetic import RecordingOptions, scene_from_truth
from sensors.synthetic.recording import textured_meshes
from std_toolkit.checks.inject.faults import Fault, apply_fault
from std_toolkit.checks.measure.contours import object_centre
from std_toolkit.checks.result import CheckReport, ObjectCheck
from std_toolkit.scene import Scene

NAME = "cereal_box"


def textured_scene(recording: Path, out: Path, scale: Sequence[float] = (1, 1, 1)) -> Scene:
    """The opaque objects with right labels; the box has its texture, and a mesh of this scale."""
    scene = scene_from_truth(recording, out)
    folder = out / "models" / NAME
    mesh = textured_meshes(RecordingOptions(frames=9, seed=1))[NAME]
    mesh.apply_scale(list(scale))
    for old in folder.iterdir():
        old.unlink()
    mesh.export(folder / f"{NAME}.obj")
    objects, labels = scene.objects, scene.labels
    kept = [o for o in objects.objects if o.material == "diffuse"]
    models = [
        msgspec.structs.replace(m, mesh=f"models/{NAME}/{NAME}.obj") if m.id == NAME else m
        for m in objects.models
    ]
    ids = {o.id for o in kept}
    documents = {
        "objects.json": msgspec.structs.replace(objects, objects=kept, models=models),
        "labels.json": msgspec.structs.replace(
            labels, labels=[x for x in labels.labels if x.object in ids]
        ),
    }
    for name, document in documents.items():
        (out / name).write_bytes(msgspec.json.encode(document))
    return Scene.open(out)


def box(report: CheckReport) -> ObjectCheck:
    return next(o for o in report.objects if o.name == NAME)


def faulty(study: Study, name: str, size: float) -> ObjectCheck:
    """The row of the box with a wrong label."""
    scene = study.scene
    i = next(o.id for o in scene.objects.objects if o.name == NAME)
    positions = [T.t for f in scene.registered_frames() if (T := scene.T_world_cam(f.id))]
    along = object_centre(scene, i) - sum(positions) / len(positions)
    along = tuple(along / (along @ along) ** 0.5)
    changed = apply_fault(scene, Fault(name, size, i, along=along))  # type: ignore[arg-type]
    return box(study.report(FaultCase(name, "fail", changed, objects=(i,))))


@pytest.mark.slow
@pytest.mark.parametrize(
    "faults",
    [
        pytest.param([("along", -4, 8)], id="short"),
        pytest.param([("sideways", 4, -8), ("turn", 3, -5)], id="long", marks=pytest.mark.long),
    ],
)
def test_faults_of_a_textured_box_are_caught(
    synthetic_table: Path, tmp_path: Path, faults: list[tuple[str, float, float]]
) -> None:
    study = Study(textured_scene(synthetic_table, tmp_path / "scene"))
    plain = study.plain()
    assert plain.passed and {o.verdict for o in plain.objects} == {"fits"}
    assert [w for w in plain.warnings if w.about == NAME and w.severity != "low"] == []
    for name, small, large in faults:
        caught = faulty(study, name, small)
        gate = "rotation" if name == "turn" else "motion"
        found = {f.gate: f for f in caught.gates}[gate]
        assert caught.verdict in ("doubtful", "wrong"), (name, small)
        assert found.verdict in ("doubtful", "wrong") and not found.exempt
        assert faulty(study, name, large).verdict == "wrong", (name, large)
    turned = faulty(study, "turn", 180)
    assert "texture" in {f.gate for f in turned.gates if f.verdict == "wrong"}


@pytest.mark.slow
def test_a_right_label_on_a_mesh_of_another_shape_passes_with_words(
    synthetic_table: Path, tmp_path: Path
) -> None:
    scene = textured_scene(synthetic_table, tmp_path / "scene", (1.03, 0.98, 1.0))
    study = Study(scene)
    assert box(study.plain()).verdict == "fits"
    assert faulty(study, "sideways", 8).verdict == "wrong"
