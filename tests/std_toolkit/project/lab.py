"""A lab: copies of one small rendered scene with labels of people and verdicts of the check."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import msgspec

from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.options import RenderOptions
from std_toolkit.rendering.render_step import render_ground_truth
from std_toolkit.scene import Scene
from std_toolkit.scene.check_flags import SCENE_INPUT, scene_fingerprint
from std_toolkit.scene.judgement import Grade, Judgement
from std_toolkit.scene.label_verdicts import judgement_inputs
from std_toolkit.scene.model import LabelProvenance, Labels
from tests.scene_on_disk import write_scene

SERIAL = JobOptions(engine="serial", progress=False)


def template(root: Path) -> Path:
    """A scene of two frames and one labelled object, with ground truth."""
    scene = write_scene(root, frames=2)
    render_ground_truth(scene, RenderOptions(renderer="raycast"), jobs=SERIAL)
    return root


def copied(source: Path, root: Path, *, by: str = "", grade: Grade | None = "fits") -> Path:
    """A copy, labelled by a person and judged; None for a scene without a label."""
    shutil.copytree(source, root)
    scene = Scene.open(root)
    if grade is None:
        scene.save_labels(Labels())
    else:
        judge(scene, by=by, grades={1: grade})
    return root


def judge(scene: Scene, *, by: str, grades: Mapping[int, Grade]) -> None:
    """Store who labelled, and verdicts and a report as the check writes them."""
    inputs = judgement_inputs(scene, {})
    labels = []
    for label in scene.labels.labels:
        assert label.T_world_obj is not None
        said = Judgement(
            grade=grades[label.object],
            probability=0.5,
            reason=f"it {grades[label.object]}",
            T_obj=label.T_world_obj,
            deviation_mm=0.4,
            deviation_deg=0.3,
            inputs=inputs[label.object],
            time="2026-01-02T03:04:05Z",
        )
        made = LabelProvenance(
            time="2026-01-02T03:04:05Z",
            tool="std-annotate",
            version="1",
            refinement=f"mean of A ({by}) and B" if by else "",
            hands_on_s=90.0,
        )
        labels.append(msgspec.structs.replace(label, annotator=by, judgement=said, provenance=made))
    scene.save_labels(Labels(labels=labels))
    (scene.root / "check").mkdir(exist_ok=True)
    passed = "false" if "wrong" in grades.values() else "true"
    report = f'{{"objects": [], "frames": [], "passed": {passed}}}'
    (scene.root / "check/report.json").write_text(report)
    (scene.root / "check/report.html").write_text("")
    Artefact(scene.root, "check", {SCENE_INPUT: scene_fingerprint(scene)}).write([])
