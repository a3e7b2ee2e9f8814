"""`benchmark.evaluate` gives the figures of the command line, for names, files and objects."""

from __future__ import annotations

import ast
import importlib
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import benchmark
from benchmark import MethodOptions, Restored, View, evaluate, read_results
from benchmark.cli.bench import main
from std_toolkit import JobOptions, ToolkitError
from std_toolkit.cli.command import print_json
from tests.benchmark.evaluation import bench_set
from tests.benchmark.evaluation.bench_set import SPLIT, Filling, HalfNaN, WrongSize, write_split

SERIAL = JobOptions(engine="serial")
FILE = bench_set.__file__


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_split(tmp_path_factory.mktemp("data"), scenes=2, frames=2)


def bench(root: Path, out: Path, *words: str) -> int:
    places = ["--data", str(root), "--split", SPLIT, "--out", str(out), "--engine", "serial"]
    return main([*words, *places, "--no-gallery"])


class Constant:
    """Answers one depth everywhere."""

    input_size = None
    needs_mask = False

    def __init__(self, depth: float) -> None:
        self.depth = depth

    def restore(self, views: Sequence[View]) -> list[Restored]:
        return [Restored(np.full(view.depth.shape, self.depth, np.float32)) for view in views]


class Needy(Constant):
    def __init__(self, options: MethodOptions) -> None:  # noqa: ARG002
        raise ValueError("needs a sun")


def test_the_table_is_that_of_the_command_line(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    methods = ["raw", f"{FILE}:HalfNaN"]
    words = ["--method", *methods, "--protocol", "strict", "paper", "--no-speed", "--limit", "3"]
    assert bench(root, tmp_path / "cli", *words, "--json") == 0
    expected = capsys.readouterr().out
    options = {"limit": 3, "speed": False, "gallery": False, "jobs": SERIAL}
    found = evaluate(
        methods, SPLIT, ["strict", "paper"], data=root, out=tmp_path / "python", **options
    )
    print_json(found.to_dict("records"))
    assert capsys.readouterr().out == expected
    assert bench(root, tmp_path / "python", *words) == 0, "the command line resumes it"
    shown = capsys.readouterr().out
    assert bench(root, tmp_path / "cli", *words) == 0
    assert capsys.readouterr().out == shown
    # The tables of images, too, to the byte.
    for one in sorted((tmp_path / "cli").rglob("images.parquet")):
        other = tmp_path / "python" / one.relative_to(tmp_path / "cli")
        assert one.read_bytes() == other.read_bytes()


def test_a_name_a_file_a_class_and_an_object_give_the_same(root: Path) -> None:
    given = [f"{FILE}:Filling", Filling, Constant(0.7)]
    table = evaluate(given, SPLIT, data={SPLIT: root}, jobs=SERIAL)
    assert list(dict.fromkeys(table["method"])) == ["bench_set.py.Filling", "Filling", "Constant"]
    parts = [part.drop(columns="method") for _, part in table.groupby("method", sort=False)]
    for part in parts[1:]:
        pd.testing.assert_frame_equal(
            part.reset_index(drop=True), parts[0].reset_index(drop=True), check_exact=True
        )
    assert len(table) and (table["rmse"] > 0).all()


def test_objects_of_one_class_have_names(root: Path) -> None:
    near = {f"at-{depth}": Constant(depth) for depth in (0.6, 0.7)}
    table = evaluate(near, SPLIT, data=root)
    assert list(dict.fromkeys(table["method"])) == ["at-0.6", "at-0.7"]
    assert table.groupby("method")["rmse"].first().nunique() == 2


def test_results_of_another_object_are_not_resumed(root: Path, tmp_path: Path) -> None:
    first = evaluate(Constant(0.6), SPLIT, data=root, out=tmp_path, speed=False, gallery=False)
    (run,) = read_results([tmp_path])
    assert run.manifest.label == "Constant" and len(first)
    with pytest.raises(ToolkitError, match="begun with"):
        evaluate(Constant(0.7), SPLIT, data=root, out=tmp_path, speed=False, gallery=False)


def test_settings_go_to_their_method(root: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    place = f"{FILE}:Counting"
    evaluate(place, SPLIT, data=root, settings={"log": log}, limit=1, jobs=SERIAL)
    assert log.read_text() == "view\n"
    log.unlink()
    more = {"settings": {f"{place}.log": log}, "limit": 1, "jobs": SERIAL}
    evaluate(["raw", place], SPLIT, data=root, **more)
    assert log.read_text() == "view\n"


def test_frames_that_fail_count_as_missing(root: Path) -> None:
    table = evaluate([WrongSize, HalfNaN], SPLIT, data=root)
    by_method = table[table["subset"] == "all"].set_index("method")
    assert 0 < by_method["coverage"]["HalfNaN"] < 1
    assert pd.isna(by_method["coverage"]["WrongSize"]), "failed everywhere: no figures"
    assert by_method["failed"].to_dict() == {"WrongSize": 4, "HalfNaN": 0}
    assert by_method["frames_unanswered"]["WrongSize"] == by_method["frames"]["WrongSize"] == 4


def test_poses_are_scored_as_well(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["pose", "--method", "gt-nocs", "--limit", "1", "--json"]
    assert bench(root, tmp_path, *words) == 0
    expected = json.loads(capsys.readouterr().out)
    found = evaluate("gt-nocs", SPLIT, data=root, task="pose", limit=1, jobs=SERIAL)
    assert found.to_dict("records") == expected


@pytest.mark.parametrize(
    ("methods", "options", "reported"),
    [
        (["nowhere"], {}, "no plug-in with this name.*nowhere"),
        ([3], {}, r"has no restore\(\).*int"),
        ([Constant(1), Constant(2)], {}, "two methods have this name.*Constant"),
        ({"mine": "raw"}, {}, "only objects and classes.*mine"),
        ({"a/b": Constant(1)}, {}, "usable as a folder's name.*a/b"),
        (["raw"], {"limits": 3}, "limits.*no option of evaluate"),
        (["raw"], {"limit": 0}, "limit.*at least 1"),
        (["raw"], {"task": "grasp"}, "task.*depth, pose"),
        (["raw", "raw"], {}, "given twice"),
        ([Needy], {}, "could not be scored: the method cannot be made.*needs a sun.*Needy"),
        (["raw"], {"data": "/nowhere"}, "/nowhere"),
    ],
)
def test_what_is_wrong_is_one_error(
    root: Path, methods: list[object], options: dict[str, object], reported: str
) -> None:
    with pytest.raises(ToolkitError, match=reported):
        evaluate(methods, SPLIT, **{"data": root, "jobs": SERIAL, **options})  # type: ignore[arg-type]


def test_the_other_methods_are_kept_where_one_fails(root: Path, tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="results of the others are in"):
        evaluate(["raw", "gone.py:Broken"], SPLIT, data=root, out=tmp_path, speed=False)
    assert [run.manifest.label for run in read_results([tmp_path])] == ["raw"]


@pytest.mark.parametrize("name", benchmark.__all__)
def test_every_name_of_the_front_door_is_there(name: str) -> None:
    assert getattr(benchmark, name).__name__ == name
    assert name in dir(benchmark)


def test_type_checkers_see_the_names_where_they_are() -> None:
    tree = ast.parse(Path(benchmark.__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    found = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert sorted(found) == sorted(benchmark.__all__)
    for name, module in found.items():
        assert getattr(benchmark, name) is getattr(importlib.import_module(str(module)), name)


def test_the_front_door_loads_no_library() -> None:
    heavy = ("numpy", "pandas", "cv2", "torch", "pyarrow", "msgspec")
    code = f"import sys, benchmark; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_a_class_is_made_with_options(root: Path) -> None:
    seen: list[MethodOptions] = []

    def make(options: MethodOptions) -> Constant:
        seen.append(options)
        return Constant(0.7)

    evaluate({"made": make}, SPLIT, data=root, limit=1, settings={"a": "1"}, precision="bf16")
    assert {(dict(o.settings)["a"], o.precision) for o in seen} == {("1", "bf16")}
