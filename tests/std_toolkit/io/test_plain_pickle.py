"""Pickles of others: plain values come back, anything else is one line and runs nothing."""

from __future__ import annotations

import os
import pickle
import time
from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.io.plain_pickle import array_in, read_pickle

VALUES = {
    "ids": np.array([1, 2]),
    "poses": np.stack([np.eye(4)] * 2),
    "scores": np.array([0.5, 0.25], np.float32),
    "big end": np.arange(3, dtype=">i4"),
    "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "empty": np.zeros((0, 3)),
    "number": np.float32(3),
    "list": [[1, 2.5], (3, True)],
}


@pytest.mark.parametrize("protocol", range(6))
def test_arrays_of_every_protocol(tmp_path: Path, protocol: int) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps(OrderedDict(VALUES, path="scene/0001"), protocol))
    found = read_pickle(path)
    assert found["path"] == "scene/0001"
    for name, value in VALUES.items():
        np.testing.assert_array_equal(array_in(found[name], path, name), value)
        assert array_in(found[name], path, name).shape == np.shape(value)


def test_arrays_of_python_2(tmp_path: Path) -> None:
    """There, the bytes of an array are a text."""
    path = tmp_path / "a.pkl"
    path.write_bytes(
        b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
        b"(K\x01K\x02\x85cnumpy\ndtype\nU\x02i2K\x00K\x01\x87R"
        b"(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U\x04\x01\x00\xff\x00tb."
    )
    assert array_in(read_pickle(path), path, "a").tolist() == [1, 255]


class Runs:
    """Runs a program where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, (f"touch {self.mark}",)


def nested(levels: int) -> list:
    found: list = [1.0] * 10
    for _ in range(levels):
        found = [found] * 10
    return found


BOMBS = {
    "a program": lambda mark: pickle.dumps(Runs(mark)),
    "a program, text": lambda mark: pickle.dumps(Runs(mark), 0),
    "in an array": lambda mark: pickle.dumps(np.array([Runs(mark)], object)),
    "eval": lambda _: b"cbuiltins\neval\n(V1\ntR.",
    "a length that lies": lambda _: b"\x80\x05\x96" + (10**12).to_bytes(8, "little") + b"xx.",
    "a million million bytes": lambda _: b"cbuiltins\nbytearray\n(I1000000000000\ntR.",
    "a large array": lambda _: (
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I1000000000000\ntS'b'\ntR."
    ),
    "an array without its bytes": lambda _: pickle.dumps(np.zeros(99), 2).replace(b"Kc", b"Kb"),
    "a flag of objects": lambda _: (
        b"cnumpy\ndtype\n(S'V8'\nI0\nI1\ntR(I3\nS'|'\nNNNI8\nI1\nI63\ntb."
    ),
    "lists without end": lambda _: pickle.dumps(nested(40)),
    "many numbers": lambda _: pickle.dumps([[[1.0] * 1000] * 1000] * 1000),
    "a place in the memo": lambda _: b"\x80\x02Nr" + (2**31 - 1).to_bytes(4, "little") + b"(.",
    "a deep key": lambda _: b"\x80\x02})" + b"\x85" * 200_000 + b"K\x01s.",
    "a key that doubles": lambda _: b"\x80\x02})q\x00" + b"0h\x00h\x00\x86q\x00" * 60 + b"K\x01s.",
    "a set": lambda _: pickle.dumps([{1, 2}]),
    "a type without a name": lambda _: (
        b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
        b"(K\x01K\x02\x85cnumpy\ndtype\n)\x81\x89U\x04abcdtb."
    ),
    "sides of millions of digits": lambda _: pickle.dumps([2**10_000_000]),
    "copies": lambda _: (
        pickle.dumps("a" * 2**20, 2)[:-1]
        + b"q\x010]"
        + b"c_codecs\nencode\nh\x01U\x06latin1\x86R0" * 500
        + b"K\x01a."
    ),
    "attributes of an ordered dict": lambda _: (
        b"\x80\x02ccollections\nOrderedDict\n)R}U\x03getK\x05sb."
    ),
    "no pickle": lambda _: b"\x89PNG",
    "nothing": lambda _: b"",
    "cut off": lambda _: pickle.dumps(VALUES)[:-9],
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_bomb_is_one_line_and_runs_nothing(tmp_path: Path, bomb: str) -> None:
    path, mark = tmp_path / "a.pkl", tmp_path / "ran"
    path.write_bytes(BOMBS[bomb](mark))
    begin = time.process_time()
    with pytest.raises(ToolkitError) as caught:
        array_in(read_pickle(path), path, "poses")
    assert time.process_time() - begin < 5
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert not mark.exists()


@pytest.mark.parametrize(
    "bomb",
    ["a set", "a type without a name", "sides of millions of digits", "copies",
     "attributes of an ordered dict"],
)  # fmt: skip
def test_what_is_no_plain_value_is_refused_at_once(tmp_path: Path, bomb: str) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(BOMBS[bomb](path))
    with pytest.raises(ToolkitError, match="no pickle of plain values"):
        read_pickle(path)


def test_no_pickle_changes_how_the_next_one_is_read(tmp_path: Path) -> None:
    """Filling a function with fields would set the order of arrays that do not state one."""
    path = tmp_path / "a.pkl"
    path.write_bytes(
        b"\x80\x02cnumpy.core.numeric\n_frombuffer\nN}U\x0c__defaults__U\x01F\x85s\x86b."
    )
    with pytest.raises(ToolkitError, match="fields of something else"):
        read_pickle(path)
    whole = pickle.dumps(np.arange(6.0).reshape(2, 3), 5)
    path.write_bytes(whole.replace(b"\x8c\x01C\x94t", b"t"))
    assert path.read_bytes() != whole
    assert array_in(read_pickle(path), path, "a").tolist() == [[0, 1, 2], [3, 4, 5]]


class Point:
    """A record of another program."""

    def __init__(self, x: object) -> None:
        self.x = x


def test_a_record_that_the_caller_names_is_a_dict(tmp_path: Path) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps([Point(Point(np.arange(3))), Point("text")]))
    records = [(__name__, "Point")]
    first, second = read_pickle(path, records=records)
    assert array_in(first["x"]["x"], path, "x").tolist() == [0, 1, 2]
    assert second == {"x": "text"} and isinstance(second, dict)
    with pytest.raises(ToolkitError, match="Point, which could run anything"):
        read_pickle(path)


@pytest.mark.parametrize(
    "data",
    [
        f"c{__name__}\nPoint\n(tR.".encode(),  # called
        f"c{__name__}\nPoint\n(](KAKBeetR.".encode(),
        b"\x80\x02" + f"c{__name__}\nPoint\n)\x81]b.".encode(),  # filled with a list
        b"\x80\x02" + f"c{__name__}\nPoint\n)\x81}}K\x01K\x02sb.".encode(),  # fields without names
    ],
)
def test_a_record_is_filled_with_named_fields_alone(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(data)
    with pytest.raises(ToolkitError, match="no pickle of plain values"):
        read_pickle(path, records=[(__name__, "Point")])
