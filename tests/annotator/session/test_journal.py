"""The journal: what is on disk when `apply` returns, and what a damaged one still gives."""

from __future__ import annotations

import json
import os
import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from annotator.session import AddObject, ChangeObject, Move, Session
from annotator.session.journal import (
    Journal,
    encode_entry,
    history_folder,
    journal_path,
    read_journal,
    scene_digests,
)
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError


def step(mm: float = 1.0) -> Move:
    return Move(object="box_1", frame=0, shift_mm=[mm, 0, 0])


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """Writing beyond `size` bytes of a file fails, after as much as fits was written.

    A real disk that is full does the same, with another number in errno.
    """
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)


def test_every_edit_is_a_line_on_disk_before_apply_returns(root: Path) -> None:
    with Session.open(root, annotator="mk") as session:
        assert not journal_path(root).exists()  # looking leaves no trace
        for count in range(1, 4):
            session.apply(step())
            assert len(journal_path(root).read_bytes().splitlines()) == 1 + count
        session.undo()
        session.redo()
        session.save()
        lines = [json.loads(x)["entry"] for x in journal_path(root).read_text().splitlines()]
    assert [x["line"] for x in lines] == [
        "begun", "edit", "edit", "edit", "undo", "redo", "save",
    ]  # fmt: skip
    assert [x["number"] for x in lines] == list(range(7))
    assert all(x["annotator"] == "mk" and x["version"] == __version__ for x in lines)
    assert all(x["time"].endswith("Z") for x in lines)


def test_the_disk_is_synced_before_an_edit_takes_effect(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Session.open(root) as session:
        session.apply(step())
        seen = []

        def sync(descriptor: int) -> None:
            on_disk = os.fstat(descriptor).st_size
            seen.append((on_disk, len(session.steps)))

        before = journal_path(root).stat().st_size
        monkeypatch.setattr(os, "fdatasync", sync)
        session.apply(step())
        assert len(seen) == 1
        assert seen[0][0] > before
        assert seen[0][1] == 1  # the second edit was not in force yet
        assert len(session.steps) == 2


def test_the_first_line_binds_the_journal_to_the_scene(root: Path) -> None:
    digests = scene_digests(root)
    with Session.open(root) as session:
        session.apply(step())
        begun = read_journal(journal_path(root)).begun
    assert begun is not None
    assert begun.digests == digests
    assert set(digests) == {
        "frames.json", "poses.json", "objects.json", "labels.json", "annotation.json",
    }  # fmt: skip
    assert digests["annotation.json"] == ""  # it is not there
    assert begun.scene == "tiny"


class TestDamage:
    @pytest.fixture
    def journal(self, root: Path) -> Path:
        """Of four edits that were not saved."""
        with Session.open(root, annotator="mk") as session:
            for i in range(4):
                session.apply(step(i + 1.0))
        return journal_path(root)

    def test_a_torn_last_line_is_the_edit_that_was_being_written(
        self, root: Path, journal: Path
    ) -> None:
        whole = journal.read_bytes()
        for cut in (1, 30, len(whole.splitlines(keepends=True)[-1])):
            journal.write_bytes(whole[:-cut])
            content = read_journal(journal)
            assert len(content.entries) == 3
            assert content.damage == ""
        with Session.open(root, recover="yes") as session:
            assert len(session.steps) == 3
            session.apply(step(9))  # the rest of the torn line is gone from the file
            assert read_journal(journal).damage == ""

    @pytest.mark.parametrize("damage", ["flipped digit", "line lost", "not JSON", "zeros"])
    def test_what_stands_before_a_damaged_line_is_recovered_and_the_file_kept(
        self, root: Path, journal: Path, damage: str
    ) -> None:
        lines = journal.read_bytes().splitlines(keepends=True)
        if damage == "flipped digit":
            at = lines[3].index(b'"T_cam_obj":[0.') + len(b'"T_cam_obj":[0.')
            digit = lines[3][at : at + 1]
            lines[3] = lines[3][:at] + (b"1" if digit != b"1" else b"2") + lines[3][at + 1 :]
        elif damage == "line lost":
            del lines[3]
        else:
            lines[3] = b"garbage\n" if damage == "not JSON" else b"\0" * len(lines[3])
        journal.write_bytes(b"".join(lines))
        damaged = journal.read_bytes()
        session = Session.open(root)
        assert session.recovery is not None
        assert session.recovery.count == 2
        assert "line 4 is damaged" in str(session.recovery)
        session.recover()
        assert len(session.steps) == 2
        (kept,) = history_folder(root).glob("*-damaged.jsonl")
        assert kept.read_bytes() == damaged
        session.apply(step())
        state = session.state
        session.close()
        with Session.open(root, recover="yes") as again:
            assert again.state == state

    def test_a_journal_whose_first_line_is_damaged_is_kept_and_told(
        self, root: Path, journal: Path
    ) -> None:
        journal.write_bytes(b"x" + journal.read_bytes())
        with Session.open(root) as session:
            assert session.recovery is None
            assert any("damaged" in w and "kept as" in w for w in session.warnings)
            session.apply(step())
        assert len(list(history_folder(root).glob("*-damaged.jsonl"))) == 1

    @pytest.mark.parametrize("size", [0, 100])
    def test_a_torn_first_line_is_the_first_edit_that_was_being_written(
        self, root: Path, journal: Path, size: int
    ) -> None:
        journal.write_bytes(journal.read_bytes()[:size])
        with Session.open(root) as session:
            assert session.recovery is None
            assert session.warnings == []
            session.apply(step())


class TestFullDisk:
    def test_an_edit_that_cannot_be_journalled_is_not_made(self, root: Path) -> None:
        with Session.open(root) as session:
            session.apply(step())
            state, size = session.state, journal_path(root).stat().st_size
            with (
                file_size_limit(size + 40),
                pytest.raises(
                    ToolkitError, match=r"cannot write the journal.*not applied.*disk space"
                ),
            ):
                session.apply(step())
            assert session.state is state
            assert journal_path(root).stat().st_size == size
            with file_size_limit(size + 40), pytest.raises(ToolkitError, match="cannot write"):
                session.undo()
            assert session.state is state
            # With room again it goes on, and the journal is whole.
            session.apply(step())
            session.undo()
            session.undo()
        content = read_journal(journal_path(root)) if journal_path(root).exists() else None
        assert content is None  # nothing unsaved: set aside
        (kept,) = history_folder(root).iterdir()
        assert read_journal(kept).damage == ""
        assert len(read_journal(kept).entries) == 4

    def test_what_a_failed_write_left_behind_does_not_hurt_the_next_line(
        self, root: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Where even cutting the torn line off fails."""
        with Session.open(root) as session:
            session.apply(step())
            size = journal_path(root).stat().st_size

            def fail(*_: object) -> None:
                raise OSError(5, "Input/output error")

            with monkeypatch.context() as patch:
                patch.setattr(os, "ftruncate", fail)
                with file_size_limit(size + 40), pytest.raises(ToolkitError):
                    session.apply(step())
            assert journal_path(root).stat().st_size == size + 40
            session.apply(ChangeObject(object="box_1", note="x"))
            state = session.state
        with Session.open(root, recover="yes") as again:
            assert again.state == state

    def test_the_very_first_edit_on_a_full_disk(self, root: Path) -> None:
        with Session.open(root) as session:
            with file_size_limit(100), pytest.raises(ToolkitError, match="cannot write"):
                session.apply(step())
            assert not session.steps
            session.apply(step())
            assert len(session.steps) == 1

    def test_saving_onto_a_full_disk_loses_nothing(self, root: Path) -> None:
        before = (root / "labels.json").read_bytes()
        with Session.open(root) as session:
            session.apply(step())
            with (
                file_size_limit(journal_path(root).stat().st_size - 10),
                pytest.raises(ToolkitError, match="cannot write"),
            ):
                session.apply(AddObject(object="box_2", model="box"))
            with file_size_limit(300), pytest.raises(ToolkitError, match="cannot write the file"):
                session.save()
            assert session.unsaved
            assert (root / "labels.json").read_bytes() == before
            session.save()
            assert not session.unsaved


class TestHistory:
    def test_a_finished_journal_is_kept(self, root: Path) -> None:
        with Session.open(root) as session:
            session.apply(step())
            session.save()
        assert not journal_path(root).exists()
        (kept,) = history_folder(root).iterdir()
        assert kept.name.endswith("-saved.jsonl")
        assert [type(x).__name__ for x in read_journal(kept).entries] == ["Edited", "Saved"]

    def test_two_journals_of_one_second_do_not_replace_each_other(self, root: Path) -> None:
        for _ in range(3):
            with Session.open(root) as session:
                session.apply(step())
                session.save()
        assert len(list(history_folder(root).iterdir())) == 3

    def test_looking_alone_keeps_nothing(self, root: Path) -> None:
        with Session.open(root):
            pass
        assert not history_folder(root).exists()


def test_a_link_in_place_of_the_journal_is_not_written_through(root: Path, tmp_path: Path) -> None:
    """A scene from a stranger must not be able to have a file elsewhere written."""
    precious = tmp_path / "precious.jsonl"
    path = journal_path(root)
    path.parent.mkdir(parents=True)
    path.symlink_to(precious)
    with Session.open(root) as session, pytest.raises(ToolkitError, match="cannot write"):
        session.apply(step())
    assert not precious.exists()
    path.unlink()
    shutil.rmtree(path.parent)
    outside = tmp_path / "outside"
    outside.mkdir()
    path.parent.symlink_to(outside)
    with pytest.raises(ToolkitError, match="symbolic link"), Session.open(root) as session:
        session.apply(step())
    assert list(outside.iterdir()) == []


def test_an_entry_that_could_not_be_read_back_is_refused() -> None:
    class Odd:
        pass

    with pytest.raises(ToolkitError, match="cannot be written"):
        encode_entry(Odd())  # type: ignore[arg-type]


def test_a_second_journal_is_never_started_over_a_first(tmp_path: Path) -> None:
    Journal.create(tmp_path / "j.jsonl").close()
    with pytest.raises(ToolkitError, match="File exists"):
        Journal.create(tmp_path / "j.jsonl")
