"""Checks of the guides: Python blocks run, options of command lines exist, names have docstrings.

`python tools/check_docs.py` prints what is wrong; exit status 1 if anything is. `make docs` and the
tests call it.
"""

from __future__ import annotations

import ast
import contextlib
import inspect
import io
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PAGES = (*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md")

# Public names of the API reference by page; "" lists all of `__all__`.
API: dict[str, tuple[str, dict[str, list[str]]]] = {
    "curation": (
        "Curation in Python",
        {
            "std_toolkit": [
                *("Scene", "SE3", "Camera", "ToolkitError", "ImportRequest", "import_recording"),
                *("PoseOptions", "estimate_poses", "failed_gates", "add_model", "add_object"),
                *("set_pose", "solve_pnp", "LabelCommand", "run_label_command"),
                *("PropagateOptions", "propagate_labels", "refine_labels", "RenderOptions"),
                *("render_ground_truth", "rendered_frames", "read_ground_truth", "CheckOptions"),
                *("run_check", "ExportOptions", "export_scene", "JobOptions"),
                *("ScanOptions", "scan", "scan_all"),
            ],
            "std_toolkit.cameras": ["LiveFrame", "CameraRequest", "LiveCamera"],
            "std_toolkit.importers.importer": ["Importer", "Recording", "SourceFrame"],
        },
    ),
    "benchmark": (
        "Benchmark in Python",
        {
            "benchmark": ["evaluate", "read_results", "Restorer", "RestoredFrame"],
            "benchmark.methods.protocol": ["View", "Restored", "Restorer"],
            "benchmark.methods.registry": ["MethodOptions", "make_restorer"],
            "benchmark.data.splits": ["open_split", "get_split", "iterate"],
            "benchmark.data.frame": ["DepthFrame", "selection_of"],
            "benchmark.metrics.protocols": ["get_protocol", "score_frame", "score_sensor"],
            "benchmark.metrics.pose": ["score_poses", "PosePrediction", "PoseTruth"],
            "benchmark.metrics.bop": ["open_bop", "read_bop_results", "score_bop"],
            "benchmark.published.citations": ["citations"],
        },
    ),
    "annotator": ("Annotation in Python", {"annotator.session": ["Session", "Move"]}),
    "sensors": (
        "Sensors in Python",
        {
            "sensors.specs": ["load_sensor"],
            "sensors.align": ["align_depth"],
            "sensors.record.live_camera": ["RealSenseCamera"],
        },
    ),
}

# Guides whose blocks need a labelled scene, results or weights; a test runs or checks each.
RUN_BY_TESTS = {
    "benchmark_data.md": "tests/benchmark/data/test_benchmark_data_guide.py",
    "board.md": "tests/benchmark/evaluation/test_board_guide.py",
    "methods.md": "tests/benchmark/methods/depth/filling/test_methods_guide.py",
    "pose.md": "tests/benchmark/evaluation/test_pose_task_guide.py",
    "bop.md": "tests/benchmark/metrics/bop/test_bop_of_an_export.py",
    "grasp_methods.md": "tests/benchmark/tabletop/test_clearing_guide.py",
}

_ONLY_COMPILED = "# only compiled\n"


def check_all() -> list[str]:
    """All problems, one line each."""
    return [*check_python(), *check_commands(), *check_docstrings()]


def python_blocks(path: Path) -> list[str]:
    """The Python blocks of a page; one below `<!-- not run: WHY -->` is only compiled."""
    found = re.finditer(
        r"(<!-- not run: .+ -->\n\n?)?^```python\n(.*?)^```",
        path.read_text(encoding="utf-8"),
        re.S | re.M,
    )
    return [f"{_ONLY_COMPILED if m[1] else ''}{m[2]}" for m in found]


def check_python() -> Iterator[str]:
    """Blocks that do not compile, import what does not exist, or do not run."""
    for path in PAGES:
        blocks = python_blocks(path)
        for i, block in enumerate(blocks, 1):
            where = f"{path.relative_to(ROOT)}: Python block {i}"
            try:
                tree = ast.parse(block)
            except SyntaxError as error:
                yield f"{where}: {error}"
                continue
            yield from (f"{where}: {text}" for text in _imports(tree))
        if blocks and path.name in RUN_BY_TESTS:
            if not (ROOT / RUN_BY_TESTS[path.name]).is_file():
                yield f"{path.name}: no test {RUN_BY_TESTS[path.name]}"
        elif blocks:
            yield from _run(path, blocks)


def _imports(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module != "__future__":
            try:
                module = import_module(node.module)
            except ModuleNotFoundError as error:
                if (error.name or "").partition(".")[0] in ("torch", "PySide6", "mujoco"):
                    continue
                yield str(error)
                continue
            for alias in node.names:
                if not hasattr(module, alias.name):
                    yield f"{node.module} has no {alias.name}"


def _run(path: Path, blocks: list[str]) -> Iterator[str]:
    """Run the blocks of a page in order, with the names that its text introduces."""
    from tools.docs_names import names_of

    with tempfile.TemporaryDirectory() as folder, _working_folder(Path(folder)):
        names: dict[str, Any] = {"__name__": "__main__", **names_of(path.name, Path(folder))}
        for i, block in enumerate(blocks, 1):
            try:
                if block.startswith(_ONLY_COMPILED):
                    continue
                with contextlib.redirect_stdout(io.StringIO()):
                    exec(compile(block, f"{path.name} block {i}", "exec"), names)
            except Exception as error:
                yield f"{path.relative_to(ROOT)}: Python block {i}: {type(error).__name__}: {error}"
                return


@contextlib.contextmanager
def _working_folder(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def check_commands() -> Iterator[str]:
    """Options of command lines in the guides that no command has."""
    for path in PAGES:
        text = path.read_text(encoding="utf-8")
        for block in re.findall(r"^```bash\n(.*?)^```", text, re.S | re.M):
            for line in block.replace("\\\n", " ").splitlines():
                yield from (f"{path.relative_to(ROOT)}: {p}" for p in _command(line))


def _command(line: str) -> Iterator[str]:
    line = line.split(" #")[0].split("|")[0].strip().removeprefix("$ ")
    try:
        words = shlex.split(line.replace("<", " ").replace(">", " "))
    except ValueError:
        return
    if not words or not words[0].startswith("std-"):
        return
    page = help_page(words[0], " ".join(words[1:3]), "--live" in words)
    for word in words[1:]:
        option = word.partition("=")[0]
        if re.fullmatch(r"--[a-z][a-z-]+", option) and option not in page and option != "--live":
            yield f"{words[0]} has no {option}: {line}"


@cache
def help_page(program: str, begin: str, live: bool) -> str:
    """The help of the command that a command line of these first two words runs."""
    from std_toolkit.cli.programs import PROGRAMS

    if program not in PROGRAMS:
        return ""
    made = import_module(PROGRAMS[program]).PROGRAM
    known = {command.name for command in made.commands}
    first = begin if begin in known else begin.partition(" ")[0]
    words = [] if len(known) == 1 else [first if first in known else made.default or "--help"]
    if live:
        words = ["live"]
    out = io.StringIO()
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(out):
        made.main([*words, "--help"] if "--help" not in words else words)
    # And the options of every program.
    return out.getvalue() + " --help --version --quiet --debug --print-completion"


def check_docstrings() -> Iterator[str]:
    """Public names of the API reference without a docstring, and their public members."""
    for _, modules in API.values():
        for module, names in modules.items():
            for name in names:
                value = getattr(import_module(module), name)
                yield from _undocumented(value, f"{module}.{name}")
    import std_toolkit

    listed = set(API["curation"][1]["std_toolkit"]) | {"__version__"}
    yield from (
        f"std_toolkit.{n} is not in the reference" for n in set(std_toolkit.__all__) - listed
    )


def _undocumented(value: Any, name: str) -> Iterator[str]:
    if not inspect.getdoc(value) or (
        inspect.isclass(value) and value.__doc__ and value.__doc__.startswith(f"{value.__name__}(")
    ):
        yield f"{name} has no docstring"
    if not inspect.isclass(value) or issubclass(value, BaseException):
        return
    for member, method in vars(value).items():
        plain = getattr(method, "__func__", method)
        if member.startswith("_") or not (inspect.isfunction(plain) or isinstance(plain, property)):
            continue
        default = getattr(plain, "__name__", "") == "<lambda>"  # of a field
        if not default and not inspect.getdoc(plain):
            yield f"{name}.{member} has no docstring"


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    found = check_all()
    print("\n".join(found) or "all Python blocks run, all options exist, all names have docstrings")
    sys.exit(bool(found))
