"""The script that counts the structure of the code sees what it is there to see."""

from __future__ import annotations

import ast
import importlib.util
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def structure() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "structure", REPOSITORY / "tools" / "structure.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def made_up(tmp_path: Path) -> Path:
    """Four packages, of which one has a circle and an import upwards."""
    for package in ("std_toolkit", "annotator", "sensors", "benchmark"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("")
    for name, text in {
        "geometry/a.py": "from std_toolkit.scene.b import x\n",
        "scene/b.py": "def f():\n    from std_toolkit.scene.c import y\nx = 1\n",
        "scene/c.py": "from std_toolkit.scene.b import x\ny = x\n",
        "scene/d.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n"
        "    from std_toolkit.cli import e\n",
        "cli/e.py": '"""Doc\nstring."""\n\n# comment\nimport os\n\n\ndef f():\n    """Doc."""\n'
        "    return g(x=args.x, y=args.z)\n",
    }.items():
        path = tmp_path / "std_toolkit" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return tmp_path


def test_circles_and_arrows_up_are_seen(structure: ModuleType, made_up: Path) -> None:
    table = structure.count(made_up)
    assert table["circles of modules"] == [["std_toolkit.scene.b", "std_toolkit.scene.c"]]
    assert table["circles of folders"] == []
    assert table["arrows up"] == ["std_toolkit.geometry -> std_toolkit.scene"]


def test_a_circle_of_folders_is_seen(structure: ModuleType, made_up: Path) -> None:
    (made_up / "std_toolkit/scene/d.py").write_text("import std_toolkit.geometry.a\n")
    assert structure.count(made_up)["circles of folders"] == [
        ["std_toolkit.geometry", "std_toolkit.scene"]
    ]


def test_a_circle_of_types_is_seen_apart(structure: ModuleType, made_up: Path) -> None:
    (made_up / "std_toolkit/cli/e.py").write_text("import std_toolkit.scene.d\n")
    table = structure.count(made_up)
    assert ["std_toolkit.cli.e", "std_toolkit.scene.d"] not in table["circles of modules"]
    assert ["std_toolkit.cli.e", "std_toolkit.scene.d"] in table["circles with imports for types"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("std_toolkit.cli.check", True),
        ("std_toolkit.cli.labels", True),
        ("sensors.synthetic.__main__", True),
        ("std_toolkit.scene.click", False),
    ],
)
def test_modules_of_a_command_line(structure: ModuleType, name: str, expected: bool) -> None:
    assert structure.is_command_line(name) is expected


def test_docstrings_comments_and_blanks_are_no_code(structure: ModuleType, made_up: Path) -> None:
    text = (made_up / "std_toolkit/cli/e.py").read_text()
    assert structure.code_lines(text) == (3, 1)
    table = structure.count(made_up)
    assert table["modules"] == 9
    assert table["copies x=args.x"] == 1


def test_a_flow_counts_files_whose_functions_run(structure: ModuleType) -> None:
    program = "from std_toolkit.geometry import SE3\nmeasured(lambda: SE3.exp([0.0] * 6))"
    files, imported = structure.run_flow(program, REPOSITORY)
    assert files == ["std_toolkit/geometry/se3.py"]
    assert imported > 3


def test_what_runs_on_import_is_not_executed(structure: ModuleType, tmp_path: Path) -> None:
    """Bodies of classes and comprehensions of a module; its functions are, once called."""
    package = tmp_path / "sensors"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "a.py").write_text(
        "class A:\n    x = [i for i in (1, 2)]\ny = {k: 1 for k in 'ab'}\ndef f():\n    return 1\n"
    )
    program = "def run():\n    import sensors.a\n"
    files, imported = structure.run_flow(f"{program}measured(run)", tmp_path)
    assert (files, imported) == ([], 2)
    files, _ = structure.run_flow(f"{program}    sensors.a.f()\nmeasured(run)", tmp_path)
    assert files == ["sensors/a.py"]


@pytest.mark.slow
def test_no_circles_and_no_arrows_up(structure: ModuleType) -> None:
    """Between modules, between the folders of a package, against the order of folders."""
    graph = structure.import_graph(REPOSITORY)
    assert structure.circles(graph) == []
    assert structure.circles(structure.folder_graph(graph)) == []
    assert structure.arrows_up(graph) == []


def test_limits_are_settings(structure: ModuleType) -> None:
    """A number that decides what is accepted stands in a class of `Settings`, with its source."""
    trees = {n: ast.parse(p.read_text("utf-8")) for n, p in structure.modules(REPOSITORY).items()}
    assert [x for name, tree in trees.items() for x in structure.limits_outside(name, tree)] == []
    assert sum(len(structure.limits_of(tree)) for tree in trees.values()) > 300


def test_a_limit_outside_of_settings_is_seen(structure: ModuleType, made_up: Path) -> None:
    path = made_up / "std_toolkit" / "checks" / "f.py"
    path.parent.mkdir()
    path.write_text(
        "_FAR, _NEAR = 3.0, {'glass': 1.0}\n_SIZE = 640\n"
        "def f(x):\n    return x > 2 * _FAR or x < _NEAR['glass']\n"
    )
    names = structure.count(made_up)["limits outside of settings"]
    assert names == ["std_toolkit.checks.f._FAR", "std_toolkit.checks.f._NEAR"]


def test_files_of_tests_have_names_of_their_own() -> None:
    """Folders of tests are no packages: pytest reads one file of a name and fails on others."""
    names = Counter(path.name for path in (REPOSITORY / "tests").rglob("test_*.py"))
    assert [name for name, count in names.items() if count > 1] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["import", "check", "std-bench --method raw", "drag", "weights"])
def test_every_flow_runs(structure: ModuleType, name: str) -> None:
    files, _ = structure.run_flow(structure.FLOWS[name], REPOSITORY)
    assert 3 < len(files) < 120
