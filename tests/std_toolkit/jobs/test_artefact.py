"""A finished artefact is kept, a stale one made again, and the log says why."""

from __future__ import annotations

import logging
from dataclasses import fields, replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.io import documents
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import digest_file, digest_files, digest_of
from std_toolkit.jobs import artefact as module
from std_toolkit.jobs.artefact import Artefact, Record, begin, record_path
from std_toolkit.settings import override


@pytest.fixture
def artefact(tmp_path: Path) -> Artefact:
    """A step that was finished with two outputs."""
    for name in ("a.bin", "gt/b.bin"):
        write_bytes_atomic(tmp_path / name, name.encode())
    found = Artefact(tmp_path, "step", {"images": "12"}, {"threshold": 0.1, "pair": (1, 2)})
    found.write([tmp_path / "gt/b.bin", tmp_path / "a.bin"])
    return found


def changed(artefact: Artefact, **fields: object) -> Artefact:
    return Artefact(**{**vars(artefact), **fields})


def reason(artefact: Artefact, caplog: pytest.LogCaptureFixture) -> str:
    caplog.clear()
    with caplog.at_level(logging.INFO, logger="std_toolkit"):
        assert not artefact.is_kept()
    return caplog.text


def test_a_finished_step_is_kept(artefact: Artefact, caplog) -> None:
    with caplog.at_level(logging.INFO, logger="std_toolkit"):
        assert artefact.is_kept()
    assert "step: kept" in caplog.text
    assert reason(changed(artefact, name="other"), caplog) == ""


def test_the_log_names_what_changed(artefact: Artefact, caplog) -> None:
    other = changed(artefact, inputs={"images": "13"})
    assert "step: stale because the images changed" in reason(other, caplog)
    other = changed(artefact, inputs={"images": "12", "masks": "1"})
    assert "stale because the masks changed" in reason(other, caplog)
    other = changed(artefact, options={"threshold": 0.2, "pair": (1, 2)})
    assert "stale because threshold was 0.1" in reason(other, caplog)
    other = changed(artefact, inputs={str(i): "" for i in range(9)})
    assert "and 7 more" in reason(other, caplog)


def test_another_limit_makes_it_stale(artefact: Artefact, caplog) -> None:
    from std_toolkit.labels.texture.comparison import TextureSettings

    artefact = changed(artefact, limits=("labels.",))
    artefact.write([artefact.root / "gt/b.bin", artefact.root / "a.bin"])
    others = changed(artefact, limits=("poses.",))
    before, plain = artefact.digest, TextureSettings()
    name = next(f.name for f in fields(plain) if isinstance(getattr(plain, f.name), float))
    with override(replace(plain, **{name: 0.9 * getattr(plain, name)})):
        told = reason(artefact, caplog)
        assert f"stale because labels.texture.comparison.{name} was the default" in told
        assert artefact.digest != before
        assert others.is_kept() and others.digest == before
    assert artefact.is_kept() and artefact.digest == before


@pytest.mark.parametrize("change", ["edited", "removed", "made_a_folder"])
def test_a_changed_output_makes_it_stale(artefact: Artefact, change: str, caplog) -> None:
    path = artefact.root / "gt/b.bin"
    path.unlink()
    if change == "edited":
        path.write_bytes(b"gt/c.bin")  # same length
    elif change == "made_a_folder":
        path.mkdir()
    said = "gt/b.bin changed" if change == "edited" else "gt/b.bin is missing"
    assert said in reason(artefact, caplog)


def test_another_version_of_the_toolkit_makes_it_stale(artefact, monkeypatch, caplog) -> None:
    before, version = artefact.digest, module.__version__
    monkeypatch.setattr(module, "__version__", "99.0")
    monkeypatch.setattr(documents, "__version__", "99.0")
    assert f"made by version {version}" in reason(artefact, caplog)
    assert artefact.digest != before


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"name": "step"}', b"\x00" * 50])
def test_a_damaged_record_means_redo_and_not_stop(artefact, content: bytes, caplog) -> None:
    record_path(artefact.root, "step").write_bytes(content)
    assert "made again" in reason(artefact, caplog)


def test_digests_depend_on_content_only(tmp_path: Path) -> None:
    assert digest_of({"a": 1, "b": 2}) == digest_of({"b": 2, "a": 1})
    assert digest_of(1, 2) != digest_of(12)
    assert digest_of("1") != digest_of(1)
    (tmp_path / "a").write_bytes(b"x")
    (tmp_path / "b").write_bytes(b"x")
    assert digest_file(tmp_path / "a") == digest_file(tmp_path / "b")
    found = digest_files(tmp_path, [tmp_path / "a", tmp_path / "c/d"])
    assert found == {"a": digest_file(tmp_path / "b"), "c/d": ""}


def test_records_are_the_same_whoever_writes_them(artefact: Artefact) -> None:
    text = record_path(artefact.root, "step").read_bytes()
    assert str(artefact.root).encode() not in text
    artefact.write([artefact.root / "a.bin", artefact.root / "gt/b.bin"])
    assert record_path(artefact.root, "step").read_bytes() == text


def test_an_output_that_is_not_there_is_not_recorded(artefact: Artefact) -> None:
    with pytest.raises(ToolkitError, match="file not found"):
        artefact.write([artefact.root / "c.bin"])


class Row(Record, frozen=True, kw_only=True, forbid_unknown_fields=True):
    value: int


def test_a_document_may_have_more_fields_than_the_record(artefact: Artefact) -> None:
    path = artefact.root / "row.json"
    assert artefact.find(path, Row) is None
    made = artefact.record([artefact.root / "a.bin"])
    documents.write_document(path, Row(**msgspec.structs.asdict(made), value=3))
    found = artefact.find(path, Row)
    assert found is not None and found.value == 3
    assert changed(artefact, inputs={}).find(path, Row) is None


def test_arrays_are_made_again_if_an_input_changed_or_their_file_is_damaged(tmp_path: Path) -> None:
    made = []

    def make() -> dict[str, np.ndarray]:
        made.append(1)
        return {"x": np.arange(3)}

    part = Artefact(tmp_path, "part", {"photos": "a"})
    first = part.arrays(make)
    assert np.array_equal(part.arrays(make)["x"], first["x"])
    assert len(made) == 1
    other = Artefact(tmp_path, "part", {"photos": "b"})
    other.arrays(make)
    assert len(made) == 2
    (kept,) = tmp_path.glob("*.npz")
    kept.write_bytes(kept.read_bytes()[:60])
    assert np.array_equal(other.arrays(make)["x"], first["x"])
    assert len(made) == 3


class Setup(msgspec.Struct, frozen=True, kw_only=True):
    size: tuple[int, int]
    note: str = ""


class Run(msgspec.Struct, frozen=True, kw_only=True):
    setup: Setup
    host: str


def test_a_folder_goes_on_with_the_same_values_only(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    first = Run(setup=Setup(size=(2, 3)), host="a")
    begin(path, first, within=["setup"], hint="choose another")
    text = path.read_bytes()
    begin(path, Run(setup=first.setup, host="b"), within=["setup"], hint="choose another")
    assert path.read_bytes() == text
    with pytest.raises(ToolkitError, match=r"host: begun with 'a' \(got 'b'\)"):
        begin(path, Run(setup=first.setup, host="b"), hint="choose another")
    other = Run(setup=Setup(size=(2, 4), note="n"), host="a")
    with pytest.raises(
        ToolkitError, match=r"setup.size: begun with \(2, 3\) \(got \(2, 4\)\)"
    ) as told:
        begin(path, other, within=["setup"], hint="choose another")
    assert told.value.hint == "choose another; setup.note: '' then, 'n' now"
    (tmp_path / "run.json").unlink()
    (tmp_path / "other").touch()
    with pytest.raises(ToolkitError, match=r"files but no run.json"):
        begin(path, first, hint="choose another")
