"""Files of others: every failure of a reader is one line that names the file, and comes at once."""

from __future__ import annotations

import ast
import io
import json
import os
import random
import struct
import time
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from std_toolkit.cli.command import read_settings
from std_toolkit.errors import ToolkitError
from std_toolkit.io.colmap_files import check_colmap_model
from std_toolkit.io.documents import read_document
from std_toolkit.io.foreign_files import (
    csv_rows,
    mapped_npy,
    read_json,
    read_npy,
    read_npz,
    read_toml,
    read_yaml,
)
from std_toolkit.io.regular import read_text
from std_toolkit.jobs.artefact import Record
from std_toolkit.poses.board_scale import Board

REPOSITORY = Path(__file__).parents[3]


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def npz(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def colmap_images(count: int) -> bytes:
    rows = b"".join(
        struct.pack("<I7dI", i + 1, 1, 0, 0, 0, 0, 0, 0, 1)
        + b"%06d.png\0" % i
        + struct.pack("<Q2dq", 1, 3.0, 4.0, -1)
        for i in range(count)
    )
    return struct.pack("<Q", count) + rows


TOML = b'title = "a [b]"\n[sets.a]\nlike = "train" # {x}\noptions = {views = 3, sizes = [1, 2.5]}\n'
RECORD = {
    "name": "frame 1", "version": "1", "inputs": {"a": "b"}, "options": {"n": 3}, "outputs": {}
}  # fmt: skip

# Name of a good file, its content, and its reader.
READERS: dict[str, tuple[bytes, Callable[[Path], object]]] = {
    "a.json": (b'{"a": [1, 2.5, {"b": null}], "c": "\\u00e9"}', read_json),
    "a.yaml": (b"a: [1, 2]\nb:\n  - {c: 1.5}\n  - 2026-01-01\n", read_yaml),
    "a.toml": (TOML, lambda path: read_toml(path, dict[str, Any])),
    "s.toml": (b"[poses.board_scale]\nfewest_corners = 9\n", read_settings),
    "a.npy": (npy(np.arange(12, dtype=np.float32).reshape(3, 4)), read_npy),
    "a.npz": (npz(a=np.arange(12), b=np.eye(3)), read_npz),
    "m.npy": (npy(np.arange(12, dtype=np.uint16)), mapped_npy),
    "a.csv": (
        b'a, b\n1, "x\ny"\n',
        lambda path: list(csv_rows(read_text(path, "table").splitlines(True), path)),
    ),
    "record.json": (json.dumps(RECORD).encode(), lambda path: read_document(path, Record)),
    "board.json": (b'{"3": [[0,0,0],[8,0,0],[8,8,0],[0,8,0]]}', Board.read),
    "charuco.json": (
        b'{"charuco": {"squares_x": 5, "squares_y": 7, "square_mm": 20, "marker_mm": 15}}',
        Board.read,
    ),
    "images.bin": (colmap_images(3), lambda path: check_colmap_model(path.parent)),
    "frames.bin": (
        struct.pack("<QII7dIiIQ", 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 1, 0, 1, 1),
        lambda path: check_colmap_model(path.parent),
    ),
}


def damaged(data: bytes, seed: int) -> bytes:
    """The data cut, with other bytes, with a part twice, or with a large or odd number."""
    rng = random.Random(seed)
    at = rng.randrange(len(data))
    other = bytes(rng.randrange(256) for _ in range(rng.choice((1, 2, 8))))
    numbers = (b"NaN", b"1e999", b"-1", b"9" * 400, "²".encode())
    odd = rng.choice((*numbers, b"\xff\xfe", b"[" * 3000, b"\0", b"true"))
    return (
        data[:at],
        data[:at] + other + data[at + len(other) :],
        data[:at] + data[max(0, at - 9) :],
        data[:at] + odd + data[at + 1 :],
        odd,
    )[seed % 5]


@pytest.mark.parametrize("name", READERS)
def test_a_good_file_is_read(tmp_path: Path, name: str) -> None:
    data, read = READERS[name]
    (tmp_path / name).write_bytes(data)
    found = read(tmp_path / name)
    # The files of COLMAP are checked alone.
    assert (found is None) == name.endswith(".bin")


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_one_line(tmp_path: Path, name: str) -> None:
    data, read = READERS[name]
    path = tmp_path / name
    refused = 0
    for seed in range(150):
        path.write_bytes(damaged(data, seed))
        try:
            read(path)
        except ToolkitError as error:
            refused += 1
            assert "\n" not in str(error)
            assert name in str(error), error
    assert refused > 20


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_refused_at_once(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    os.mkfifo(path)
    began = time.monotonic()
    with pytest.raises(ToolkitError, match=r"regular file|not found"):
        READERS[name][1](path)
    assert time.monotonic() - began < 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a" + ".a" * 8000 + "=1\n", "a key of more than 20 parts"),
        ("[" + "a." * 3000 + "b]\n", "a key of more than 20 parts"),
        ("a=" + "[" * 5000 + "]" * 5000, "nested deeper than 40 levels"),
        ("a={b=" * 50 + "1" + "}" * 50, "nested deeper than 40 levels"),
        ("x=1\n" * 400_000, "implausibly large"),
        ('[a]\nb = ["\\u001b[2J"]', r"a\.toml: a\.b\[0\]: holds a control character"),
        ('"\\u0007" = 1', "holds a control character"),
    ],
)
def test_toml_that_would_harm_is_refused(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(ToolkitError, match=words):
        read_toml(path, dict[str, Any])


def test_dots_and_brackets_within_strings_and_comments_count_for_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    dots, signs = "." * 50, "[" * 50
    path.write_text(f'a = "{dots}[[["\nb = \'{signs}\'\n# {signs}\nc = """\n{dots}"""\n')
    assert set(read_toml(path, dict[str, str])) == {"a", "b", "c"}


def test_a_header_of_numpy_that_is_no_python_is_a_damaged_file(tmp_path: Path) -> None:
    head = b"{'descr': '|u1', 'fortran_order': False, 'shape': (\xff\xff\xff".ljust(118)
    path = tmp_path / "shard-00000.npy"
    path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head)
    for read in (read_npy, mapped_npy):
        with pytest.raises(ToolkitError, match=r"shard-00000\.npy: not a numpy array"):
            read(path)


def test_packed_arrays_that_unpack_to_gigabytes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for k in range(5):
            archive.writestr(f"a{k}.npy", bytes(2**20))
    data = path.read_bytes()
    # The sizes that the directory claims: 2**20 bytes become 2**30.
    path.write_bytes(data.replace(struct.pack("<I", 2**20), struct.pack("<I", 2**30)))
    with pytest.raises(ToolkitError, match="bytes that unpack to 5120 MB"):
        read_npz(path)


def test_objects_in_packed_arrays_are_never_made(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, a=np.array([Path()], dtype=object))
    with pytest.raises(ToolkitError, match="Object arrays cannot be loaded"):
        read_npz(path)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("frames", struct.pack("<Q", 10**12), "claims 1000000000000 entries in 8 bytes"),
        ("images", colmap_images(2).replace(b"000001", b"\xff0001"), "entry 1.*not UTF-8"),
        ("images", colmap_images(2)[:-32] + struct.pack("<Q", 10**12), "entry 1.*ends within"),
        ("points3D", struct.pack("<QQ3d3BdQ", 1, 1, 0, 0, 0, 0, 0, 0, 0, 10**12), "ends within"),
        ("rigs", struct.pack("<QII", 1, 1, 2**32 - 1), "ends within"),
        ("cameras", struct.pack("<QIiQQ4d", 1, 1, 1, 2**62, 48, 1, 1, 1, 1), "implausible size"),
    ],
)
def test_a_model_that_claims_more_than_it_holds(
    tmp_path: Path, name: str, data: bytes, words: str
) -> None:
    (tmp_path / f"{name}.bin").write_bytes(data)
    with pytest.raises(ToolkitError, match=words):
        check_colmap_model(tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"charuco":{"squares_x":5000,"squares_y":5000,"square_mm":20,"marker_mm":15}}', "100 x"),
        ('{"²":[[0,0,0],[8,0,0],[8,8,0],[0,8,0]]}', "no tags"),
        (json.dumps({str(k): 0 for k in range(10_001)}), "at most 10000 tags"),
    ],
)
def test_a_board_that_nobody_printed(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "board.json").write_text(text)
    with pytest.raises(ToolkitError, match=words):
        Board.read(tmp_path / "board.json")


# Files that the toolkit itself wrote, or that lie in it; and readers that have their own checks.
OWN = {
    *("std_toolkit/jobs/artefact.py", "std_toolkit/poses/register.py"),
    *("std_toolkit/poses/features.py", "std_toolkit/scene/check_flags.py"),
    *("annotator/app/mesh_folder.py", "annotator/qt/settings.py"),
    *("benchmark/training/grasp/packed_grasps.py", "benchmark/training/grasp/grasp_labels.py"),
    *("benchmark/published/citations.py", "benchmark/restoring/onnx_export.py"),
    *("benchmark/methods/pose/priors/prior_file.py", "sensors/assets/asset_source.py"),
    *("sensors/physics/coacd_process.py", "sensors/physics/convex.py"),
    *("sensors/record/frame_table.py", "sensors/simulation/turntable.py"),
    *("benchmark/methods/known/released.py", "std_toolkit/project/status.py"),
}
RAW = {
    "json.loads", "json.load", "tomllib.loads", "tomllib.load", "msgspec.json.decode",
    "msgspec.toml.decode", "yaml.load", "yaml.safe_load", "np.load", "csv.reader", "csv.DictReader",
}  # fmt: skip
# Poses and scripts have many layouts, told from each other by what is there.
UNTYPED = {
    *("std_toolkit/poses/camera_file.py", "std_toolkit/labels/entry/posefile.py"),
    *("std_toolkit/labels/entry/symmetry_argument.py", "annotator/session/script.py"),
}


@cache
def calls() -> list[tuple[str, ast.Call]]:
    found = []
    for package in ("std_toolkit", "annotator", "sensors", "benchmark"):
        for path in (REPOSITORY / package).rglob("*.py"):
            name = path.relative_to(REPOSITORY).as_posix()
            tree = ast.parse(path.read_text(encoding="utf-8"))
            found += [(name, node) for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return found


def test_documents_are_read_by_the_readers_of_io_alone() -> None:
    wrong = [
        f"{name}:{call.lineno} {ast.unparse(call.func)}"
        for name, call in calls()
        if ast.unparse(call.func) in RAW
        and not name.startswith("std_toolkit/io/")
        and name not in OWN
    ]
    assert not wrong, "use std_toolkit.io.foreign_files or documents"


def test_no_document_is_read_as_a_bare_dict() -> None:
    bare = {"dict", "Any", "dict[str, Any]", "list", "object"}
    wrong = [
        f"{name}:{call.lineno} {ast.unparse(call)}"
        for name, call in calls()
        if ast.unparse(call.func).rpartition(".")[2] in ("read_document", "read_toml")
        and len(call.args) == 2
        and ast.unparse(call.args[1]) in bare
        and name not in UNTYPED
    ]
    # Limits are checked one by one.
    wrong = [line for line in wrong if not line.startswith("std_toolkit/cli/command.py")]
    assert not wrong, "give the structure of the document"
