"""Tokens of the people of a project, and comments."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.project.people import FILE, Doorkeeper, make_token, read_tokens, revoke_token
from std_toolkit.project.record import Project, create_project
from std_toolkit.project.status import project_board
from std_toolkit.scene.review import read_reviews
from tests.std_toolkit.project.lab import copied

ODD = 'Zoë "O\'Neil" <b>'


@pytest.fixture
def lab(rendered: Path, tmp_path: Path) -> Project:
    root = copied(rendered, tmp_path / "one", by="Ann", grade="fits")
    people = ["Ann", "Ben", ODD]
    return create_project(tmp_path / "p", scenes=[root], people=people, rules=None)[0]


def test_a_token_is_printed_once_and_only_its_digest_is_stored(
    lab: Project, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["project", "people", str(lab.root)]
    assert main([*words, "--token", ODD]) == 0
    told = capsys.readouterr()
    token = told.out.strip().rpartition("?token=")[2]
    assert len(token) > 40 and token not in told.err
    stored = "".join(p.read_text() for p in lab.root.rglob("*.json"))
    assert token not in stored and ODD in [t.person for t in read_tokens(lab).tokens]
    door = Doorkeeper(lab, {"guest": "Ben"})
    assert (door.person_of(token), door.person_of("guest")) == (ODD, "Ben")
    assert all(door.person_of(t) is None for t in ("", "x", token[:-1], token + "x", "\udcff"))
    # A new token replaces the old one; a revoked one is worthless at once.
    new = make_token(lab, ODD)
    os.utime(lab.root / FILE, (1, 1))
    assert (door.person_of(token), door.person_of(new)) == (None, ODD)
    assert main([*words, "--revoke", ODD]) == 0
    assert door.person_of(new) is None
    assert main(words) == 0
    assert capsys.readouterr().out.count("none") == 3


def test_a_person_who_left_the_project_stays_outside(lab: Project) -> None:
    token = make_token(lab, "Ben")
    record = (lab.root / "project.json").read_text().replace('"Ben"', '"Bert"')
    (lab.root / "project.json").write_text(record)
    assert Doorkeeper(Project.open(lab.root), {}).person_of(token) is None
    (lab.root / FILE).write_text('{"tokens": [{"person": "Bert", "digest": "x"}]}')
    with pytest.raises(ToolkitError, match=r"tokens\[0\]"):
        Doorkeeper(lab, {}).person_of(token)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--token Max", "the project has no such person"),
        ("--revoke Ben", "has no token"),
        ("--token Ann --revoke Ann", "exclude each other"),
    ],
)
def test_wrong_people_are_one_line(
    lab: Project, words: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["project", "people", str(lab.root), *words.split()]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line and not (lab.root / FILE).exists()


def test_a_token_that_was_being_made_is_there_or_not(
    lab: Project, killed_at: Callable[[str, list[str]], int]
) -> None:
    token = make_token(lab, "Ann")
    words = ["project", "people", str(lab.root), "--token", "Ann"]
    assert killed_at("tokens.json", words) == -signal.SIGKILL
    assert Doorkeeper(lab, {}).person_of(token) == "Ann"
    revoke_token(lab, "Ann")
    assert read_tokens(lab).tokens == []


def test_a_comment_changes_no_state(lab: Project, capsys: pytest.CaptureFixture[str]) -> None:
    before = project_board(lab)[0]
    words = ["project", "review", str(lab.root), "one", "--by"]
    assert main([*words, "Ann", "--comment", " upright? "]) == 0
    assert main([*words, "Ben", "--accept", "--comment", "x"]) == 1
    assert main([*words, "Ben", "--comment", " "]) == 1
    assert main([*words, "Max", "--comment", "x"]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 3
    (row,) = read_reviews(lab.folder(lab.find("one"))).reviews
    assert (row.by, row.verdict, row.reason, row.reasons) == ("Ann", "noted", "upright?", {})
    (after,) = project_board(lab)
    assert (after.stage, after.scene.objects) == (before.stage, before.scene.objects)
    (event,) = after.scene.events[:1]
    assert (event.by, event.did, event.text) == ("Ann", "commented", "upright?")
