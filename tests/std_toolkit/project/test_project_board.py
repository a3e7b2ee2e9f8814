"""Projects: what is recorded, the board, the queue of each person, and reviews."""

from __future__ import annotations

import json
import signal
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.io import regular
from std_toolkit.io.locks import hold_lock
from std_toolkit.project.queue import due_for, review_scene
from std_toolkit.project.record import Project, Rules, create_project, extend_project
from std_toolkit.project.shared import make_second, read_library, share_meshes
from std_toolkit.project.status import project_board
from std_toolkit.rendering import placements
from std_toolkit.scene import Scene
from std_toolkit.scene.review import read_reviews
from tests.std_toolkit.project.lab import copied, judge


@pytest.fixture
def lab(rendered: Path, tmp_path: Path) -> Project:
    """Five scenes of three people: two that fit, one doubtful, one wrong, one not labelled."""
    for name, by, grade in (
        ("fits", "Ann", "fits"),
        ("fits2", "Zoe", "fits"),
        ("doubt", "Ann", "doubtful"),
        ("wrong", "Ann", "wrong"),
    ):
        copied(rendered, tmp_path / name, by=by, grade=grade)  # type: ignore[arg-type]
    copied(rendered, tmp_path / "bare", grade=None)
    project, problems = create_project(
        tmp_path / "project",
        scenes=[tmp_path / n for n in ("fits", "fits2", "doubt", "wrong", "bare")],
        people=["Ann", "Ben", "Zoe"],
        rules=Rules(twice_every=2),
    )
    assert problems == []
    return project


def tasks(project: Project, person: str) -> list[tuple[str, str]]:
    return [(d.task, d.scene) for d in due_for(project, project_board(project), person)]


def stages(project: Project) -> dict[str, str]:
    return {row.name: row.stage for row in project_board(project)}


def test_the_record_names_scenes_relative_to_the_project(lab: Project, tmp_path: Path) -> None:
    found = json.loads((lab.root / "project.json").read_bytes())
    assert [s["path"] for s in found["scenes"]][:2] == ["../fits", "../fits2"]
    assert Project.open(lab.root) == lab
    assert lab.find("doubt") == lab.find(str(tmp_path / "doubt"))
    assert [lab.is_twice(s) for s in lab.record.scenes] == [False, True, False, True, False]


def test_each_wrong_folder_is_a_line_and_nothing_is_written(
    lab: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new = str(tmp_path / "new")
    (tmp_path / "other").mkdir()
    copied(tmp_path / "bare", tmp_path / "other/fits", grade=None)
    words = ["--scenes", f"{tmp_path}/fits", f"{tmp_path}/none", f"{tmp_path}/other/fits"]
    assert main(["project", "create", new, *words, f"{tmp_path}/other"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[1] for line in lines] == [f"{tmp_path}/{n}" for n in
        ("none", "other/fits", "other")]  # fmt: skip
    assert not Path(new).exists()
    assert main(["project", "create", str(lab.root)]) == 1
    assert "there is a project here already" in capsys.readouterr().err
    assert main(["project", "create", str(tmp_path / "fits")]) == 1
    assert "a scene is no project" in capsys.readouterr().err
    for words, told in (
        (["--scenes", f"{tmp_path}/bare"], "in the project already"),
        (["--people", "Ann"], "appears twice"),
        (["--people", "A, B"], "no commas"),
        ([], "nothing to add"),
    ):
        assert main(["project", "add", str(lab.root), *words]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert told in line
    assert Project.open(lab.root) == lab
    assert main(["project", "add", str(lab.root), "--people", "Max", "--twice-every", "0"]) == 0
    assert Project.open(lab.root).record.people[-1] == "Max"
    assert main(["project", "status", str(tmp_path)]) == 1
    assert "project.json is missing" in capsys.readouterr().err
    (lab.root / "project.json").write_text('{"version": 2}')
    assert main(["project", "status", str(lab.root)]) == 1
    assert "project.json: version" in capsys.readouterr().err
    assert main(["project", "statuses"]) == 2


def test_the_board_says_what_each_scene_waits_for(
    lab: Project, capsys: pytest.CaptureFixture[str]
) -> None:
    assert stages(lab) == {
        "fits": "to review",
        "fits2": "to review",
        "doubt": "to review",
        "wrong": "to correct",
        "bare": "to label",
    }
    assert main(["project", "status", str(lab.root), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["scenes"]
    assert found[0]["scene"]["objects"][0] == {
        "name": "box_1",
        "state": "labelled",
        "grade": "fits",
        "reason": "it fits",
        "annotator": "Ann",
        "minutes": 1.5,
        "note": "",
    }
    assert main(["project", "status", str(lab.root)]) == 0
    out = capsys.readouterr().out
    assert "wrong: wrong: box_1: it wrong" in out
    assert "5 scenes: 1 to label, 1 to correct, 3 to review" in out
    assert main(["project", "status", str(lab.root), "--objects"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1 + 5 + 3
    with hold_lock(lab.folder(lab.find("fits")), "annotate.lock", doing="x", note="annotator Ann"):
        held = {row.name: row.held_by for row in project_board(lab)}
    assert held["fits"].endswith("annotator Ann") and not held["doubt"]
    (lab.folder(lab.find("fits")) / "labels.json").write_text("{")
    assert main(["project", "status", str(lab.root)]) == 1
    assert "unreadable: fits: " in capsys.readouterr().out


def test_a_board_looks_again_where_a_file_changed(lab: Project) -> None:
    before = project_board(lab)
    scene = Scene.open(lab.folder(lab.find("fits")))
    scene.save_labels(msgspec.structs.replace(scene.labels, labels=[]))
    after = project_board(lab)
    assert [row.stage for row in after] == ["to label", *(row.stage for row in before[1:])]
    assert after == project_board(lab, fresh=True)
    (lab.root / ".std/board.json").write_text("{")
    assert project_board(lab) == after


def test_a_board_opens_only_files_of_scenes_that_changed(
    lab: Project, tmp_path: Path, opened_files: Callable[[], list[str]]
) -> None:
    project_board(lab)
    opened_files()
    rows = project_board(lab)
    cache, record = str(lab.root / ".std/board.json"), str(lab.root / "project.json")
    assert {*opened_files()} <= {cache, record}
    scene = Scene.open(lab.folder(lab.find("fits")))
    scene.save_labels(msgspec.structs.replace(scene.labels, labels=[]))
    opened_files()
    assert project_board(lab)[1:] == rows[1:]
    read = {Path(p).relative_to(tmp_path).parts[0] for p in opened_files() if str(tmp_path) in p}
    assert read == {"fits", "project"}


def test_two_hundred_scenes_are_shown_in_two_seconds(rendered: Path, tmp_path: Path) -> None:
    """Once they were looked at; the copies are links to one scene."""
    copied(rendered, tmp_path / "one", by="Ann", grade="fits")
    project = Project(tmp_path, create_project(tmp_path / "p", rules=None)[0].record)
    rows = [{"name": f"s{i}", "path": f"s{i}"} for i in range(200)]
    for i in range(200):
        (tmp_path / f"s{i}").symlink_to(tmp_path / "one")
    record = json.loads((tmp_path / "p/project.json").read_bytes()) | {"scenes": rows}
    (tmp_path / "project.json").write_text(json.dumps(record))
    project = Project.open(tmp_path)
    assert len(project_board(project)) == 200
    began = time.process_time()
    assert {row.stage for row in project_board(project)} == {"to review"}
    # Half of what the command may take; the rest is its start.
    assert time.process_time() - began < 1.0


def test_what_is_due_follows_the_rules(lab: Project) -> None:
    assert tasks(lab, "Ann") == [("correct", "wrong"), ("review", "fits2"), ("label", "bare")]
    # Doubtful scenes are reviewed first.
    reviews = [("review", "doubt"), ("review", "fits"), ("review", "fits2")]
    assert tasks(lab, "Ben") == [*reviews, ("label", "bare")]
    assert tasks(lab, "Zoe") == [*reviews[:2], ("label", "bare")]
    make_second(lab, lab.find("fits2"))
    assert ("label again, blind", "fits2") in tasks(lab, "Ben")
    assert ("label again, blind", "fits2") not in tasks(lab, "Zoe")
    second = Scene.open(lab.second(lab.find("fits2")))
    assert second.labels.labels == [] and second.poses is not None
    assert not (second.root / "gt").exists() and not (second.root / "check").exists()
    first = Scene.open(lab.folder(lab.find("fits2")))
    second.save_labels(first.labels)
    judge(second, by="Ben", grades={1: "fits"})
    # Who labelled it a second time may not review it either.
    assert ("review", "fits2") not in tasks(lab, "Ben")
    with pytest.raises(ToolkitError, match="no such person"):
        tasks(lab, "Max")


def test_scenes_that_nobody_began_are_dealt_out(rendered: Path, tmp_path: Path) -> None:
    folders = [copied(rendered, tmp_path / f"s{i}", grade=None) for i in range(3)]
    lab, _ = create_project(
        tmp_path / "p", scenes=folders, people=["Ann", "Ben"], rules=Rules(twice_every=0)
    )
    assert tasks(lab, "Ann")[0] == ("label", "s0")
    assert tasks(lab, "Ben")[0] == ("label", "s1")


def test_a_review_is_kept_to_the_rules(lab: Project, capsys: pytest.CaptureFixture[str]) -> None:
    def status(scene: str, by: str, *words: str) -> tuple[int, str]:
        done = main(["project", "review", str(lab.root), scene, "--by", by, *words])
        return done, capsys.readouterr().err

    for scene, by, words, told in (
        ("fits", "Ann", "--accept", "who labelled a scene may not review it"),
        ("fits", "Max", "--accept", "no such person"),
        ("none", "Ben", "--accept", "no such scene"),
        ("fits", "Ben", "", "give --accept, --send-back REASON or --reason"),
        ("fits", "Ben", "--accept --send-back x", "exclude each other"),
        ("fits", "Ben", "--reason cup=x", "no such labelled object"),
        ("fits", "Ben", "--reason box_1", "expected NAME=VALUE"),
        ("wrong", "Ben", "--accept", "calls box_1 wrong"),
        ("bare", "Ben", "--accept", "without label: box_1"),
        ("doubt", "Ben", "--accept", "box_1 is doubtful and has no reason of Ben"),
    ):
        done, err = status(scene, by, *words.split())
        assert done in (1, 2) and told in err, err
    assert all(not read_reviews(lab.folder(s)).reviews for s in lab.record.scenes)
    assert status("fits", "Ben", "--accept") == (0, "")
    assert status("doubt", "Zoe", "--reason", "box_1=the edge is hidden") == (0, "")
    # The reason is Zoe's.
    assert status("doubt", "Ben", "--accept")[0] == 1
    assert status("doubt", "Zoe", "--accept") == (0, "")
    assert status("fits2", "Ben", "--send-back", "box_1 is upside down") == (0, "")
    assert stages(lab) == {
        "fits": "accepted",
        "fits2": "to correct",
        "doubt": "accepted",
        "wrong": "to correct",
        "bare": "to label",
    }
    states = {r.name: [o.state for o in r.scene.objects] for r in project_board(lab)}
    assert states["fits"] == ["reviewed"] and states["fits2"] == ["refused"]
    assert tasks(lab, "Zoe")[0] == ("correct", "fits2")


def test_a_review_holds_until_a_label_changes(lab: Project) -> None:
    review_scene(lab, "fits", by="Ben", accept=True)
    review_scene(lab, "fits2", by="Ben", send_back="turned")
    for name in ("fits", "fits2"):
        scene = Scene.open(lab.folder(lab.find(name)))
        (label,) = scene.labels.labels
        judge(scene, by=label.annotator, grades={1: "fits"})  # checked again: the same label
    assert stages(lab)["fits"] == "accepted" and stages(lab)["fits2"] == "to correct"
    for name in ("fits", "fits2"):
        scene = Scene.open(lab.folder(lab.find(name)))
        (label,) = scene.labels.labels
        moved = list(label.T_world_obj or ())
        moved[3] += 1e-7
        label = msgspec.structs.replace(label, T_world_obj=moved)
        scene.save_labels(msgspec.structs.replace(scene.labels, labels=[label]))
        judge(scene, by=label.annotator, grades={1: "fits"})
    assert stages(lab)["fits"] == stages(lab)["fits2"] == "to review"
    # A verdict that came later counts, too.
    review_scene(lab, "fits", by="Ben", accept=True)
    judge(Scene.open(lab.folder(lab.find("fits"))), by="Ann", grades={1: "doubtful"})
    (row,) = (row for row in project_board(lab) if row.name == "fits")
    assert row.stage == "to review" and "no reason of Ben" in row.objections[0]


def test_meshes_are_shared_with_symmetry_and_material(lab: Project) -> None:
    scene = Scene.open(lab.folder(lab.find("bare")))
    scene.save_objects(msgspec.structs.replace(scene.objects, models=[], objects=[]))
    assert share_meshes(lab) == []
    table = read_library(lab)
    assert [(o.model, o.material) for o in table.objects] == [("box", "diffuse")]
    given = Scene.open(scene.root)
    assert given.objects.models == table.models
    assert given.mesh("box").is_watertight
    other = Scene.open(lab.folder(lab.find("fits")))
    changed = msgspec.structs.replace(other.objects.models[0], category="mug")
    other.save_objects(msgspec.structs.replace(other.objects, models=[changed]))
    assert share_meshes(lab) == ["fits: box has another category than in the library"]


def test_a_killed_review_or_addition_is_done_or_not(
    lab: Project, killed_at: Callable[[str, list[str]], int]
) -> None:
    review_scene(lab, "fits", by="Ben", send_back="first")
    path = lab.folder(lab.find("fits")) / "review.json"
    before = path.read_bytes()
    words = ["project", "review", str(lab.root), "fits", "--by", "Ben", "--accept"]
    assert killed_at("review.json", words) == -signal.SIGKILL
    assert path.read_bytes() == before
    assert main(words) == 0
    assert [r.verdict for r in read_reviews(path.parent).reviews] == ["sent back", "accepted"]
    more = ["project", "add", str(lab.root), "--people", "Max"]
    assert killed_at("project.json", more) == -signal.SIGKILL
    assert Project.open(lab.root) == lab
    assert extend_project(lab, people=["Max"])[0].record.people[-1] == "Max"
    left = [p for p in (lab.root, lab.root / ".std") for p in p.glob(".*.tmp*")]
    assert left == []


def test_the_first_look_reads_every_file_once(
    lab: Project, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of hundreds of scenes, each second look at a file counts."""
    looked: Counter[str] = Counter()

    def counted(name: str, real: Callable[..., Any], path: Callable[..., list[str]]) -> None:
        def read(*args: Any, **options: Any) -> Any:
            looked.update(path(*args))
            return real(*args, **options)

        monkeypatch.setattr(name, read)

    counted(
        "std_toolkit.scene.label_verdicts.file_sizes",
        regular.file_sizes,
        lambda root, names: [f"{root}/{name}" for name in names],
    )
    counted("std_toolkit.io.documents.read_regular", regular.read_regular, lambda p, *_: [str(p)])
    counted("std_toolkit.rendering.placements._read", placements._read, lambda f, i: [f"{f}/{i}"])
    # A document is taken apart by the slow reader only where the quick one has a doubt.
    monkeypatch.setattr("std_toolkit.io.documents.json.loads", lambda *_, **__: pytest.fail("slow"))
    rows = project_board(lab)
    assert len(rows) == 5
    read_again = {path for path, times in looked.items() if times > 1}
    # The record of the check tells of its limits, its labels and its flags.
    assert {Path(path).name for path in read_again} <= {"check.json"}
    assert sum(path.endswith(".png") for path in looked) == sum(
        len([f for f in (frame.color, frame.depth) if f])
        for item in lab.record.scenes
        for frame in Scene.open(lab.folder(item)).frames
    )
