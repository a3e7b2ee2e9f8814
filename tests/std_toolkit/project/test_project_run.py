"""`project run`: what is due in all scenes; one that fails or is killed stops no other."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from std_toolkit.cli.main import main
from std_toolkit.project.record import Project, Rules, create_project
from std_toolkit.project.status import due_steps, project_board
from std_toolkit.scene import Scene
from tests.std_toolkit.project.lab import copied

WORDS = ("--no-refine", "--renderer", "raycast", "--engine", "serial")


@pytest.fixture
def lab(rendered: Path, tmp_path: Path) -> Project:
    """Two scenes whose labels were not propagated, one without a frame, one without labels."""
    folders = [copied(rendered, tmp_path / n, by="Ann") for n in ("one", "two", "broken")]
    for root in folders:
        scene = Scene.open(root)
        label = msgspec.structs.replace(
            scene.labels.labels[0], T_world_obj=None, judgement=msgspec.UNSET
        )
        scene.save_labels(msgspec.structs.replace(scene.labels, labels=[label]))
        for name in ("check", "gt"):
            shutil.rmtree(root / name)
    poses = Scene.open(folders[2]).poses
    assert poses is not None
    # Its label is annotated in a frame that has no camera pose.
    gone = msgspec.structs.replace(poses.frames[0], status="unregistered", T_world_cam=None)
    Scene.open(folders[2]).save_poses(
        msgspec.structs.replace(poses, frames=[gone, *poses.frames[1:]])
    )
    folders.append(copied(rendered, tmp_path / "bare", grade=None))
    project, _ = create_project(
        tmp_path / "lab", scenes=folders, people=["Ann", "Ben"], rules=Rules(twice_every=2)
    )
    return project


def test_one_scene_that_fails_stops_no_other(
    lab: Project, killed_at: Callable[[str, list[str]], int], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["project", "run", str(lab.root), *WORDS]
    assert killed_at("one/gt/info/000001", words) == -signal.SIGKILL
    assert Scene.open(lab.folder(lab.find("one"))).T_world_obj(1) is not None
    assert main(["--quiet", *words]) == 1
    out = capsys.readouterr().out
    (line,) = [line for line in out.splitlines() if line.startswith("failed: broken")]
    assert "no label is annotated in a registered frame" in line
    log = lab.root / ".std/runs/broken.log"
    assert str(log) in line and "== propagate" in log.read_text()
    rows = {row.name: row for row in project_board(lab)}
    for name in ("one", "two"):
        scene = rows[name].scene
        assert (scene.registered, scene.frames) == (2, 2)
        assert scene.next_step in ("", "look", "fix"), scene.next_command
        assert scene.objects[0].grade is not None
        assert (Path(scene.root) / "check/report.html").is_file()
        assert not list(Path(scene.root).rglob(".*.tmp*"))
    assert rows["bare"].stage == "to label" and rows["bare"].second is None
    # The second of every two scenes was copied for blind labels as its first ones were complete.
    assert rows["two"].second is not None and rows["one"].second is None
    # Of what is done nothing is due any more.
    assert [name for name, *_ in due_steps(lab, list(rows.values()))] == ["broken"]
    again = rows["two"].second
    assert [o.state for o in again.objects] == ["open"]
    labels = Scene.open(lab.folder(lab.find("two"))).labels
    bare = msgspec.structs.replace(labels.labels[0], T_world_obj=None, annotator="Ben")
    Scene.open(Path(again.root)).save_labels(msgspec.structs.replace(labels, labels=[bare]))
    due = due_steps(lab, project_board(lab))
    assert [(name, second) for name, _, second in due] == [
        ("two (second)", True),
        ("broken", False),
    ]
    assert main(["--quiet", *words]) == 1
    assert Scene.open(Path(again.root)).T_world_obj(1) is not None
    capsys.readouterr()
    assert main(["project", "agreement", str(lab.root)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == ["box", "A", "all"]
    assert main(["project", "agreement", str(lab.root), "--names"]) == 0
    assert "Ann and Ben" in capsys.readouterr().out
