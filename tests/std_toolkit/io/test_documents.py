"""Documents: strict, bit-exact, and errors that name file and field."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import (
    decode_document,
    document_bytes,
    plain_integer,
    read_document,
    refuse_twice,
    write_document,
)
from std_toolkit.io.foreign_files import read_json
from std_toolkit.scene import CameraModel, CameraPoses, FramePose, Label, Labels

IDENTITY = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


class Note(msgspec.Struct, forbid_unknown_fields=True):
    """A document with a bit of everything."""

    text: str = ""
    number: float = 0.0
    rows: list[list[float]] = msgspec.field(default_factory=list)
    table: dict[str, float] = msgspec.field(default_factory=dict)
    maybe: float | None = None


finite = st.floats(allow_nan=False, allow_infinity=False)
notes = st.builds(
    Note,
    text=st.text(),
    number=finite,
    rows=st.lists(st.lists(finite, max_size=4), max_size=3),
    table=st.dictionaries(st.text(), finite, max_size=3),
    maybe=st.none() | finite,
)


@pytest.mark.slow
@given(notes)
def test_documents_round_trip_bit_exactly(note: Note) -> None:
    """Every double, -0.0 and the smallest ones included, and every text."""
    data = document_bytes(note)
    again = decode_document(data, Note)
    assert again == note
    assert document_bytes(again) == data
    assert np.signbit(again.number) == np.signbit(note.number)


@given(st.text(alphabet='[]1, 2.e-+\n\t"\\'))
def test_layout_never_changes_text(text: str) -> None:
    """Number lists are put on one line; what looks like one inside a text is left alone."""
    assert decode_document(document_bytes(Note(text=text)), Note).text == text


def test_poses_are_written_on_one_line() -> None:
    text = document_bytes(Note(rows=[[1.5, -2e-7], []])).decode()
    assert "[1.5, -2e-7]" in text
    assert text.endswith("}\n")
    assert json.loads(text)["rows"] == [[1.5, -2e-7], []]


def test_numbers_of_numpy_are_written_as_numbers() -> None:
    note = Note(number=np.float64(0.1), table={"a": np.float32(0.5)})  # type: ignore[dict-item]
    assert decode_document(document_bytes(note), Note) == Note(number=0.1, table={"a": 0.5})


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, np.float32("nan")])
@pytest.mark.parametrize(
    ("note", "field"),
    [
        (lambda v: Note(number=v), "number"),
        (lambda v: Note(maybe=v), "maybe"),
        (lambda v: Note(rows=[[0.0], [1.0, v]]), r"rows\[1\]\[1\]"),
        (lambda v: Note(table={"k": v}), r"table\.k"),
    ],
)
def test_numbers_that_are_not_finite_are_never_written(
    tmp_path: Path, note: Any, field: str, value: float
) -> None:
    """JSON has none; encoders write null, which reads as "not measured" or breaks the file."""
    write_document(tmp_path / "note.json", Note(number=1))
    before = (tmp_path / "note.json").read_bytes()
    with pytest.raises(ToolkitError, match=rf"note\.json: {field}: is not finite"):
        write_document(tmp_path / "note.json", note(value))
    assert (tmp_path / "note.json").read_bytes() == before


def test_what_would_not_be_readable_is_not_written(tmp_path: Path) -> None:
    """Structures are not checked when they are made, so writing checks them."""
    wrong = CameraPoses(frames=[FramePose(frame=-1, status="unregistered")])
    with pytest.raises(ToolkitError, match=r"poses\.json: frames\[0\]\.frame: Expected `int` >= 0"):
        write_document(tmp_path / "poses.json", wrong)
    foreign = Note(table={"a": object()})  # type: ignore[dict-item]
    with pytest.raises(ToolkitError, match="cannot be written as JSON: object"):
        write_document(tmp_path / "note.json", foreign)
    assert list(tmp_path.iterdir()) == []


MALFORMED = {
    "empty": b"",
    "blank": b"  \n",
    "truncated": b'{"text": "a", "num',
    "trailing": b'{"text": "a"} {"text": "b"}',
    "not_utf8": b'{"text": "\xff\xfe"}',
    "utf16": '{"text": "a"}'.encode("utf-16"),
    "nan_literal": b'{"number": NaN}',
    "infinity_literal": b'{"number": -Infinity}',
    "overflow": b'{"number": 1e999}',
    "huge_integer": b'{"number": ' + b"9" * 5000 + b"}",
    "deep_nesting": b"[" * 100_000,
    "deep_objects": b'{"rows":' + b"[" * 50_000 + b"]" * 50_000 + b"}",
    "unknown_field": b'{"txet": "a"}',
    "wrong_type": b'{"number": "1.5"}',
    "number_for_text": b'{"text": 5}',
    "null": b"null",
    "list": b"[]",
    "single_quotes": b"{'text': 'a'}",
    "trailing_comma": b'{"text": "a",}',
    "comment": b'{"text": "a"} // note',
    "nul_bytes": b"\0\0\0\0",
    "png": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR",
    "key_twice": b'{"number": 1, "number": 2}',
    "key_twice_inside": b'{"table": {"a": 1, "a": 2}}',
    "key_twice_escaped": b'{"number": 1, "n\\u0075mber": 2}',
    "lone_surrogate": b'{"text": "\\ud800"}',
}


@pytest.mark.parametrize("name", MALFORMED)
@pytest.mark.parametrize("type_", [Note, Any], ids=["typed", "untyped"])
def test_malformed_documents_are_one_error_naming_the_file(
    tmp_path: Path, name: str, type_: Any
) -> None:
    path = tmp_path / f"{name}.json"
    path.write_bytes(MALFORMED[name])
    valid_json = ("unknown_field", "wrong_type", "number_for_text", "null", "list")
    if type_ is Any and name in valid_json:
        read_document(path, type_)
        return
    with pytest.raises(ToolkitError, match=f"{name}\\.json: ") as caught:
        read_document(path, type_)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


# Objects as text, in which a key may appear twice, spelled in two ways.
_pieces = st.recursive(
    st.sampled_from(['"a"', '"\\""', '"\\u0022\\u0022"', "1", "-0.5e3", "9" * 31, "null", "[]"]),
    lambda inner: st.lists(
        st.tuples(st.sampled_from(['"a"', '"\\u0061"', '"b"', '"\\""', '"\\u0022"']), inner),
        max_size=4,
    ).map(lambda pairs: "{" + ", ".join(f"{key}: {value}" for key, value in pairs) + "}"),
    max_leaves=12,
)


@given(_pieces)
def test_the_quick_look_for_keys_twice_finds_what_the_slow_one_does(text: str) -> None:
    def slowly() -> None:
        json.loads(text, object_pairs_hook=refuse_twice, parse_int=plain_integer)

    try:
        slowly()
    except ToolkitError as error:
        with pytest.raises(ToolkitError, match=re.escape(error.problem)):
            decode_document(text.encode(), Any)
    else:
        decode_document(text.encode(), Any)


@pytest.mark.parametrize(
    ("data", "type_", "field"),
    [
        ('{"frames": [{"frame": 0, "status": "lost"}]}', CameraPoses, "frames[0].status"),
        ('{"frames": [{"frame": "0", "status": "registered"}]}', CameraPoses, "frames[0].frame"),
        (
            '{"frames": [{"frame": 0, "status": "unregistered"}, {"frame": 1, "status":'
            ' "registered", "T_world_cam": [2,0,0,0,0,2,0,0,0,0,2,0,0,0,0,1]}]}',
            CameraPoses,
            "frames[1].T_world_cam",
        ),
        (
            '{"labels": [{"object": 1, "frame": 0, "T_cam_obj": [1, 2, 3]}]}',
            Labels,
            "labels[0].T_cam_obj",
        ),
        (
            '{"width": 640, "height": 480, "fx": 600, "fy": 600, "cx": 640, "cy": 360}',
            CameraModel,
            "cx",
        ),
    ],
)
def test_errors_name_the_field(data: str, type_: Any, field: str) -> None:
    with pytest.raises(ToolkitError) as caught:
        decode_document(data.encode(), type_, path="some.json")
    assert caught.value.field == field
    assert str(caught.value).startswith(f"some.json: {field}: ")


def test_views_are_keyed_by_plain_frame_numbers() -> None:
    for key in ("-1", "1.5", "01", "²", "1 ", ""):
        with pytest.raises(ToolkitError, match="keyed by frame id"):
            Label(object=1, frame=0, T_cam_obj=IDENTITY, views={key: IDENTITY})


def test_missing_files_folders_pipes_and_devices_are_refused_without_blocking(
    tmp_path: Path,
) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "missing.json", tmp_path, tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ToolkitError):
            read_document(path, Note)


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "huge.json").open("wb") as file:
        file.truncate(1 << 40)  # sparse: a terabyte that needs no disk
    with pytest.raises(ToolkitError, match="implausibly large"):
        read_document(tmp_path / "huge.json", Note)


@given(st.binary(max_size=200))
def test_no_bytes_whatsoever_break_the_reader(data: bytes) -> None:
    try:
        decode_document(data, Note)
    except ToolkitError as error:
        assert "\n" not in str(error)


def test_a_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b"\xef\xbb\xbf" + b'{"a": [1, 2]}')
    assert read_document(tmp_path / "a.json", Any) == {"a": [1, 2]}
    assert read_json(tmp_path / "a.json") == {"a": [1, 2]}


def test_a_word_that_is_no_text_is_not_written(tmp_path: Path) -> None:
    """A word of the command line, or a file's name, may be in any encoding."""
    path = tmp_path / "note.json"
    with pytest.raises(ToolkitError, match="cannot be written as JSON: not text"):
        write_document(path, {"annotator": "\udcff"})
    assert not path.exists()
