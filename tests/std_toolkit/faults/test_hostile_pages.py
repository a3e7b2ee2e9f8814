"""Scenes of somebody else: no text of their documents is markup on the page of the check."""

from __future__ import annotations

from pathlib import Path

import pytest
from hostile_pages import Field, attack, harm

from std_toolkit.checks.check_step import run_check
from std_toolkit.jobs import JobOptions
from std_toolkit.options import CheckOptions
from std_toolkit.rendering.ground_truth import read_frame_truth
from std_toolkit.scene import Scene

pytestmark = pytest.mark.slow
JOBS = JobOptions(engine="serial", progress=False)


def read_scene(root: Path) -> None:
    scene = Scene.open(root)
    _ = scene.frame_table, scene.objects, scene.poses, scene.labels, scene.annotation
    for frame in scene.frames:
        scene.color_path(frame)
        scene.mesh(scene.objects.models[0].id)
        read_frame_truth(scene, frame.id)


def test_no_field_is_markup(root: Path) -> None:
    def page() -> str:
        run_check(Scene.open(root), CheckOptions(max_frames=2, overlay_frames=1), JOBS)
        return (root / "check/report.html").read_text()

    assert harm(page()) == []
    tally = attack(root, lambda: read_scene(root), page, skip=of_the_last_check)
    assert len(tally.shown) > 20 and len(tally.refused) > 20


def of_the_last_check(field: Field) -> bool:
    return "check" in field.path.parts or field.path.name == "check.json"
