"""Pickles of others: plain values are read, and nothing that a file names is run."""

from __future__ import annotations

import collections
import io
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.io.plain_pickle import read_plain_pickle

PLAIN: dict[str, Any] = {
    "floats": np.arange(6, dtype=np.float32).reshape(2, 3),
    "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "swapped": np.arange(3, dtype=">i4"),
    "flags": np.array([True, False]),
    "none": np.zeros((0, 4)),
    "scalar": np.float64(2.5),
    "count": np.int64(7),
    "names": np.array(["mug", "Glas"]),
    "nested": [1, (2.5, "x", None, True), {"a": {1, 2}}, b"bytes", 1 << 80],
}


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_values_come_back(tmp_path: Path, protocol: int) -> None:
    path = tmp_path / "label.pkl"
    path.write_bytes(pickle.dumps(PLAIN, protocol=protocol))
    found = read_plain_pickle(path)
    for name, value in PLAIN.items():
        if isinstance(value, np.ndarray | np.generic):
            assert found[name].dtype == value.dtype
            np.testing.assert_array_equal(found[name], value)
        else:
            assert found[name] == value
    found["floats"][0, 0] = 5  # its own memory


def test_files_of_numpy_1_are_read(tmp_path: Path) -> None:
    data = pickle.dumps(PLAIN["floats"], protocol=2).replace(b"numpy._core.", b"numpy.core.")
    (tmp_path / "a.pkl").write_bytes(data)
    np.testing.assert_array_equal(read_plain_pickle(tmp_path / "a.pkl"), PLAIN["floats"])


class Call:
    """Calls a function when it is unpickled."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.call = function, arguments

    def __reduce__(self) -> Any:
        return self.call


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("name", ["os.system", "eval", "getattr", "np.load", "bytearray"])
def test_nothing_is_run(tmp_path: Path, name: str, protocol: int) -> None:
    mark = tmp_path / "ran"
    calls = {
        "os.system": Call(os.system, f"touch {mark}"),
        "eval": Call(eval, f"open({str(mark)!r}, 'w')"),
        "getattr": Call(getattr, 1, "real"),
        "np.load": Call(np.load, str(tmp_path / "other.npy"), None, True),
        "bytearray": Call(bytearray, 10),
    }
    path = tmp_path / "bomb.pkl"
    path.write_bytes(pickle.dumps({"x": calls[name]}, protocol=protocol))
    with pytest.raises(ToolkitError) as error:
        read_plain_pickle(path)
    assert "\n" not in str(error.value) and "bomb.pkl" in str(error.value)
    assert not mark.exists()


def array_of(shape: tuple[int, ...], kind: str, data: bytes) -> bytes:
    """A pickle of an array that says what it likes."""

    class Odd:
        def __reduce__(self) -> Any:
            reconstruct = np.zeros(1).__reduce__()[0]
            state = (1, shape, np.dtype(kind), False, data)
            return reconstruct, (np.ndarray, (0,), b"b"), state

    return pickle.dumps(Odd(), protocol=4)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (array_of((10**12,), "f8", b"12345678"), "another number of bytes"),
        (array_of((-1,), "f8", b"12345678"), "another number of bytes"),
        (array_of((1,), "O", b"12345678"), "no numbers"),
        (array_of((1,), "M8[s]", b"12345678"), "no numbers"),
        (pickle.dumps(np.zeros(2, [("a", "f4")])), "no numbers|records"),
        (pickle.dumps(np.array([[], None], object)), "no numbers"),
        (pickle.dumps(collections.OrderedDict(a=1)), "collections.OrderedDict"),
        (pickle.dumps(Path("x")), "no plain value"),
        (b"cbuiltins\nbytes\n(I1000000000000\ntR.", "not a pickle"),
        (pickle.dumps(complex(1, 2)), "builtins.complex"),
        (b"cos\nsystem\n(S'true'\ntR.", "os.system"),
        (b"\x80\x04\x95\xff\xff\xff\xff\xff\xff\xff\x7f.", "not a pickle"),
        (b"\x80\x02r\xff\xff\xff\x7f.", "not a pickle"),
        (b"\x80\x02" + b"]" * 100_000 + b"a" * 99_999 + b".", "not a pickle"),
        (b"\x82\x01.", "extension"),
        (b"", "not a pickle"),
        (b"P1\n.", "outside of the file"),
    ],
)
def test_odd_files_are_refused_in_a_line(tmp_path: Path, data: bytes, said: str) -> None:
    (tmp_path / "odd.pkl").write_bytes(data)
    with pytest.raises(ToolkitError, match=said) as error:
        read_plain_pickle(tmp_path / "odd.pkl")
    assert "\n" not in str(error.value) and len(str(error.value)) < 400


def test_only_the_known_names(tmp_path: Path) -> None:
    """Another function of numpy of the same module is not among them."""
    for module, name in (("numpy", "fromfile"), ("numpy._core.multiarray", "fromfile"),
                         ("_codecs", "decode"), ("numpy", "f2py")):  # fmt: skip
        out = io.BytesIO()
        out.write(f"c{module}\n{name}\n.".encode())
        (tmp_path / "n.pkl").write_bytes(out.getvalue())
        with pytest.raises(ToolkitError, match="it was not run"):
            read_plain_pickle(tmp_path / "n.pkl")
    (tmp_path / "n.pkl").write_bytes(b"c_codecs\nencode\n(Vx\nVzip\ntR.")
    with pytest.raises(ToolkitError, match="names a codec"):
        read_plain_pickle(tmp_path / "n.pkl")
