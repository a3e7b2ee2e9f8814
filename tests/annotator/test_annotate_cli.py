"""`std-annotate`: starts at once, and says what is missing."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
import time
import tomllib
import types
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from scene_on_disk import write_scene

from annotator import cli, options
from annotator.cli import main
from std_toolkit import __version__

OWN = (cli.__name__, options.__name__)
REPOSITORY = Path(__file__).resolve().parents[2]
HEAVY = (
    "numpy", "PySide6", "vtkmodules", "pyvista", "trame", "trimesh", "scipy", "cv2", "open3d",
)  # fmt: skip


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "annotator.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True)


def test_help_imports_no_heavy_library() -> None:
    script = (
        "import sys\n"
        "from annotator.cli import main\n"
        "try: main(['open', '--help'])\n"
        "except SystemExit: pass\n"
        f"print([m for m in {HEAVY} if m in sys.modules])\n"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert result.stdout.splitlines()[-1] == "[]", result.stdout + result.stderr


def test_help_takes_half_a_second_at_most() -> None:
    assert "usage: std-annotate" in run("--help").stdout
    best = float("inf")
    for _ in range(3):
        start = time.perf_counter()
        run("--help")
        best = min(best, time.perf_counter() - start)
    assert best < 0.5


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"std-toolkit {__version__}"


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--web", "0"], "need SCENE"),
        (["--script", "f"], "need SCENE"),
        (["s", "--script", "f", "--web", "1"], "exclude each other"),
        (["s", "--script", "f", "--read-only"], "cannot be run with --read-only"),
        (["s", "--token", "x"], "need --web"),
        (["s", "--host", "0.0.0.0"], "need --web"),
        (["s", "--web", "70000"], "--web: must be at most 65535"),
        (["s", "--web", "http"], "--web"),
        (["s", "--recover", "maybe"], "--recover"),
        (["compare", "a"], "B"),
    ],
)
def test_bad_usage_is_status_2(
    arguments: list[str], problem: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert problem in capsys.readouterr().err


def test_a_folder_without_a_scene_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path)]) == 1
    assert f"error: {tmp_path}: no scene here" in capsys.readouterr().err


def test_the_token_may_come_from_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = []
    app = types.SimpleNamespace(run=lambda args: given.append(args.token) or 0)
    monkeypatch.setattr(cli, "front_end", lambda *_: app)
    monkeypatch.setenv("STD_ANNOTATE_TOKEN", "from the environment")
    scene = str(write_scene(tmp_path / "scene").root)
    assert main([scene, "--web", "0"]) == 0
    assert main([scene, "--web", "0", "--token", "given"]) == 0
    assert given == ["from the environment", "given"]


def test_a_scene_called_like_a_command_can_be_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_scene(tmp_path / "compare")
    (tmp_path / "edits.json").write_text(json.dumps([{"edit": "save"}]))
    monkeypatch.chdir(tmp_path)
    assert main(["./compare", "--script", "edits.json"]) == 0
    # Also where the word is the value of an option.
    assert main(["--annotator", "merge", "./compare", "--script", "edits.json"]) == 0


@pytest.mark.parametrize(
    ("package", "extra"), [("web", "web"), ("views", "web"), ("window", "gui")]
)
def test_what_a_front_end_imports_is_in_its_extra(package: str, extra: str) -> None:
    """Also what others of its libraries bring along today."""
    imported: set[str] = set()
    for path in (Path(cli.__file__).parent / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                imported.add(node.module.split(".")[0])
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"][extra]]
    named = {re.split(r"[^\w-]", w)[0].lower().replace("-", "_") for w in wanted}
    owners = packages_distributions()
    ours = {"annotator", "std_toolkit", "__future__"}
    for module in sorted(imported - ours - set(sys.stdlib_module_names)):
        assert named & {n.lower().replace("-", "_") for n in owners[module]}, module


class TestWithoutAWindow:
    @pytest.fixture
    def scene(self, tmp_path: Path) -> str:
        return str(write_scene(tmp_path / "scene").root)

    def test_no_display_points_to_the_browser_and_to_scripts(
        self, scene: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr(cli.importlib.util, "find_spec", lambda _: object())
        assert main([scene]) == 1
        error = capsys.readouterr().err
        assert error.startswith("error: there is no display")
        assert "--web PORT" in error
        assert "--script FILE" in error

    @pytest.mark.parametrize("name", ["aiohttp", "pyvista", "trame", "trame_vuetify"])
    def test_each_library_of_the_browser_is_looked_for(
        self,
        scene: str,
        name: str,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        def fail(module: str) -> types.ModuleType:
            if module in OWN:
                return sys.modules[module]
            raise ImportError("it was not looked for")

        monkeypatch.setattr(cli.importlib, "import_module", fail)
        monkeypatch.setattr(
            cli.importlib.util, "find_spec", lambda wanted: None if wanted == name else object()
        )
        assert main([scene, "--web", "0"]) == 1
        assert f"annotating in a browser needs {name}" in capsys.readouterr().err

    @pytest.mark.parametrize(("options", "extra"), [([], "gui"), (["--web", "0"], "web")])
    def test_missing_libraries_are_named_with_the_way_to_get_them(
        self,
        scene: str,
        options: list[str],
        extra: str,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        monkeypatch.setattr(cli.importlib.util, "find_spec", lambda _: None)
        assert main([scene, *options]) == 1
        error = capsys.readouterr().err
        assert "needs" in error
        assert "pyvista" in error
        assert f"pip install 'std-toolkit[{extra}]'" in error

    def test_a_library_that_does_not_load_is_one_line(
        self, scene: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        def fail(module: str) -> types.ModuleType:
            if module in OWN:
                return sys.modules[module]
            raise ImportError("libEGL.so.1: cannot open shared object file")

        monkeypatch.setenv("DISPLAY", ":0")
        monkeypatch.setattr(cli.importlib.util, "find_spec", lambda _: object())
        monkeypatch.setattr(cli.importlib, "import_module", fail)
        assert main([scene]) == 1
        error = capsys.readouterr().err
        assert len(error.splitlines()) == 1
        assert "libEGL.so.1" in error
