"""The board of several scenes, as `std-curate info A B` prints it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.project.board import board, board_table, doubts
from std_toolkit.scene import Scene
from std_toolkit.scene.model import LabelProvenance
from std_toolkit.scene.pose_model import Annotation, ObjectAnnotation
from tests.std_toolkit.checks.toy_balls import Toy, write_toy

CHECK = ("--engine", "serial", "--overlay-frames", "0", "--max-motion-deg", "20")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A checked scene with a wrong label, one without labels, and one that is damaged."""
    top = tmp_path_factory.mktemp("lab")
    wrong = write_toy(top / "wrong", Toy(frames=5, moved={2: np.array([0.0, 0.012, 0.0])}))
    assert main(["check", str(wrong.root), *CHECK]) == 1
    bare = write_toy(top / "bare", Toy(frames=5))
    labels = bare.labels
    bare.save_labels(msgspec.structs.replace(labels, labels=[]))
    (top / "damaged").mkdir()
    (top / "damaged/scene.json").write_text("{")
    return [wrong.root, bare.root, top / "damaged"]


def test_each_scene_has_its_verdicts_and_its_next_command(scenes: list[Path]) -> None:
    wrong, bare, damaged = board(scenes)
    assert [(o.name, o.state, o.grade) for o in wrong.objects] == [
        ("ball_1", "labelled", "fits"),
        ("ball_2", "labelled", "wrong"),
    ]
    assert wrong.check == "failed" and (wrong.registered, wrong.frames) == (5, 5)
    assert [(o.state, o.grade) for o in bare.objects] == [("open", None)] * 2
    assert bare.check == "" and bare.next_command is not None
    assert "std-curate label" in bare.next_command
    assert "scene.json" in damaged.problem and not damaged.objects
    (line,) = doubts([wrong, bare, damaged])
    assert line.startswith(f"wrong: {scenes[0]}: ball_2: ")


def test_who_did_it_and_in_which_time(scenes: list[Path], tmp_path: Path) -> None:
    root = tmp_path / "done"
    shutil.copytree(scenes[0], root)
    scene = Scene.open(root)
    by = LabelProvenance(
        time="2026-01-02T03:04:05Z", tool="std-annotate", version="1", hands_on_s=90.0
    )
    labels = [
        msgspec.structs.replace(x, annotator=name, provenance=by)
        for x, name in zip(scene.labels.labels, ("Zoe", "Ann"), strict=True)
    ]
    scene.save_labels(msgspec.structs.replace(scene.labels, labels=labels))
    scene.save_annotation(Annotation(objects=[ObjectAnnotation(object=1, status="done")]))
    (state,) = board([root])
    assert [o.state for o in state.objects] == ["done", "labelled"]
    assert state.minutes == pytest.approx(3.0)
    text = board_table([state]).terminal().splitlines()[-1].split()
    assert text[:4] == [str(root), "5/5", "2/2", "1/2"]
    assert "Ann, Zoe" in board_table([state]).terminal() and "3.0" in text


def test_the_command_prints_the_board(
    scenes: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["info", *map(str, scenes)]
    assert main(words) == 1  # one cannot be read
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:4]] == [str(path) for path in scenes]
    assert "unreadable" in lines[3] and lines[4].startswith("wrong: ")
    assert main([*words[:3], "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["scenes"]
    assert [s["root"] for s in found] == [str(path) for path in scenes[:2]]
    assert [o["grade"] for o in found[0]["objects"]] == ["fits", "wrong"]
    # A summary of one scene is as before.
    assert main(["info", str(scenes[0])]) == 0
    assert capsys.readouterr().out.startswith("scene ")


def test_a_scene_that_is_given_twice_is_named(scenes: list[Path]) -> None:
    with pytest.raises(ToolkitError, match=r"given twice"):
        board([scenes[0], scenes[0].parent / "bare/../wrong"])


def test_frames_are_those_of_one_scene(
    scenes: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", *map(str, scenes[:2]), "--frames"]) == 1
    assert "lists the frames of one scene" in capsys.readouterr().err
    assert main(["info"]) == 2
    assert "SCENES: needed" in capsys.readouterr().err
