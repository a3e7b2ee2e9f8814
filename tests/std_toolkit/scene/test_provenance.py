"""A finished step is skipped, a stale one redone."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.scene import document
from std_toolkit.scene.document import (
    digest_file,
    digest_of,
    is_fresh,
    record_path,
    write_record,
)


@pytest.fixture
def digest(tmp_path: Path) -> str:
    """Digest of a step that was finished with two outputs."""
    for name in ("a.bin", "gt/b.bin"):
        write_bytes_atomic(tmp_path / name, name.encode())
    value = digest_of("step", {"threshold": 0.1})
    outputs = [tmp_path / "gt/b.bin", tmp_path / "a.bin"]
    write_record(tmp_path, "step", value, outputs=outputs, parameters={"threshold": 0.1})
    return value


def test_a_finished_step_is_fresh(tmp_path: Path, digest: str) -> None:
    assert is_fresh(tmp_path, "step", digest)
    assert not is_fresh(tmp_path, "other", digest)


def test_other_inputs_make_it_stale(tmp_path: Path, digest: str) -> None:
    assert not is_fresh(tmp_path, "step", digest_of("step", {"threshold": 0.2}))


@pytest.mark.parametrize("change", ["edited", "removed", "made_a_folder"])
def test_a_changed_output_makes_it_stale(tmp_path: Path, digest: str, change: str) -> None:
    path = tmp_path / "gt/b.bin"
    path.unlink()
    if change == "edited":
        path.write_bytes(b"gt/c.bin")  # same length
    elif change == "made_a_folder":
        path.mkdir()
    assert not is_fresh(tmp_path, "step", digest)


def test_another_version_of_the_toolkit_makes_it_stale(
    digest: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(document, "__version__", "99.0")
    assert digest_of("step", {"threshold": 0.1}) != digest


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"step": 1}', b"\x00" * 50])
def test_a_damaged_record_means_redo_and_not_stop(
    tmp_path: Path, digest: str, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    record_path(tmp_path, "step").write_bytes(content)
    with caplog.at_level(logging.WARNING, logger="std_toolkit"):
        assert not is_fresh(tmp_path, "step", digest)


def test_digests_depend_on_content_only(tmp_path: Path) -> None:
    assert digest_of({"a": 1, "b": 2}) == digest_of({"b": 2, "a": 1})
    assert digest_of(1, 2) != digest_of(12)
    assert digest_of("1") != digest_of(1)
    (tmp_path / "a").write_bytes(b"x")
    (tmp_path / "b").write_bytes(b"x")
    assert digest_file(tmp_path / "a") == digest_file(tmp_path / "b")


def test_records_are_the_same_whoever_writes_them(tmp_path: Path, digest: str) -> None:
    text = record_path(tmp_path, "step").read_bytes()
    assert str(tmp_path).encode() not in text
    write_record(
        tmp_path,
        "step",
        digest,
        outputs=[tmp_path / "a.bin", tmp_path / "gt/b.bin"],
        parameters={"threshold": 0.1},
    )
    assert record_path(tmp_path, "step").read_bytes() == text
