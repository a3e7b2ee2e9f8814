"""Count the structure of the code: `python tools/structure.py [--flows] [--json]`.

Prints for its source tree: code lines of the four packages (without blank lines, comments and
docstrings), modules and their median length, the fraction of import lines, lines of the
command-line modules, copies of the form `x=args.x`, import cycles between modules and between
folders, imports against the order of folders, and with `--flows` how many files of the repository
execute a function in typical user workflows.
"""

from __future__ import annotations

import argparse
import ast
import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("std_toolkit", "annotator", "sensors", "benchmark")
# Folders and single modules of each package from the lowest layer up; "" is the package itself.
# Each may import from the lines above its own, and within its own line only from itself.
# tests/test_import_arrows.py tests the same order.
ORDER: dict[str, tuple[tuple[str, ...], ...]] = {
    "std_toolkit": (
        ("arrays", "errors", "libraries"),
        ("log", "options", "plugins", "settings"),
        ("compiled",),
        ("",),
        ("geometry", "io"),
        ("jobs",),
        ("cameras", "html", "scene"),
        ("poses", "rendering"),
        ("importers",),
        ("commands",),
        ("exporters", "labels"),
        ("scanning",),
        ("checks",),
        ("project",),
        ("cli",),
    ),
    "annotator": (
        ("", "options", "startup"),
        ("session",),
        ("app", "compare"),
        ("views",),
        ("qt", "web"),
        ("cli",),
    ),
    "sensors": (
        ("", "assets", "materials", "output", "specs", "viewpoints"),
        ("align", "lighting", "pattern", "physics", "stereo"),
        ("record", "render"),
        ("depth_models",),
        ("simulation",),
        ("synthetic",),
    ),
    "benchmark": (
        ("", "data", "published", "weights"),
        ("metrics",),
        ("methods",),
        ("tabletop",),
        ("evaluation",),
        ("restoring", "training"),
        ("report",),
        ("recipes",),
        ("cli",),
    ),
}

# Where limits decide what is accepted. A number that is compared there is a limit, and belongs into
# a class of `Settings`, except these: sizes of buffers, samples and pictures, formats, numbers that
# name something, numerical guards, and weights of a fit.
DECIDING = ("std_toolkit.checks", "std_toolkit.labels", "std_toolkit.poses", "std_toolkit.scanning",
            "benchmark.tabletop", "annotator.app", "annotator.compare")  # fmt: skip
NO_LIMITS: dict[str, str] = {
    "std_toolkit.checks": "_DRAWN_HERE _SERIAL_BELOW _LARGEST_PX NOTHING LARGEST_SAMPLE "
    "_LARGEST_SAMPLE _PARALLEL _STEPS _BLOCK_FRAMES _CLIMBS _SHOWN_LIMIT_M _REACH_PX MOST_POINTS "
    "_NEIGHBOURS _IMAGES",
    "std_toolkit.labels": "_LARGEST_FILE_BYTES AXES _NEAREST_M _MOST_BYTES _SMALLEST_COSINE "
    "_NEAR_M _STANDS_OUT_M _FEWEST_POINTS _SAME _SIDEWAYS _CLOSE _SAME_WAY _CREASE_COSINE "
    "_SMALLEST_WINDOW_PX _DISTINCT _MOST_VIEWS _SETTLED_MM _NOTHING _TEXTURE_VIEWS "
    "_MOST_SAMPLES _FEW_VERTICES _FIRST_RAYS _MOST_HULL_FACETS _KEPT _MANY _CREASE_DEG "
    "_FAR _SAME_POSE _SMALL_PX _FEW",
    "std_toolkit.poses": "PAPER_MM _CELLS _LARGEST_FILE_BYTES _ALL_PAIRS ROBUST_PX _LARGEST_PX "
    "_NEIGHBOURS",
    "std_toolkit.scanning": "_SQUARE _MATCHED_DEG _RING _BOARD _BODY _MARGIN _STAIRS _WITHIN_PX "
    "_LEAST_CONTRAST _FITTED _CONE_M _CONE _KEPT _NEAREST_M _LARGE_PX",
    "benchmark.tabletop": "TABLE_HALF_M STEP_M BORDER_PX SURFACE OTHER WRONG HOLE",
    "annotator.app": "MANY_FACES MOST_LINES POINTS_FOR_A_POSE _MARGIN _UPRIGHT",
    "annotator.compare": "_ID",
}

# User workflows, as programs that end in the call of `measured`. `ROOT` and `TMP` are defined.
_SCENE = "from tests.scene_on_disk import write_scene; scene = write_scene(TMP / 'scene')\n"
_FOLDER = _SCENE + (
    "arguments = ['import', '--color', str(TMP / 'scene/color'), '--depth',\n"
    "    str(TMP / 'scene/depth'), '--intrinsics', '90,90,47.5,35.5', '--out', str(TMP / 'new')]\n"
)
FLOWS: dict[str, str] = {
    "import": _FOLDER + "from std_toolkit.cli.main import main\nmeasured(lambda: main(arguments))",
    "ground truth": _SCENE + "from std_toolkit.cli.main import main\n"
    "measured(lambda: main(['propagate', str(scene.root)])\n"
    "    or main(['render', str(scene.root), '--workers', '1']))",
    "check": _SCENE + "from std_toolkit.cli.main import main\nmain(['render', str(scene.root)])\n"
    "measured(lambda: main(['check', str(scene.root), '--workers', '1']))",
    "std-bench --method raw": "from tests.dreds_on_disk import write_dreds_scene\n"
    "import tests.dreds_on_disk as d\n"
    "from benchmark.cli.bench import main\n"
    "write_dreds_scene(TMP / 'data/DREDS-CatKnown/test/shapenet_generate_1216_val_novel/00000')\n"
    "measured(lambda: main(['--method', 'raw', '--split', 'dreds-catknown-test', '--data',\n"
    "    str(TMP / 'data'), '--out', str(TMP / 'out'), '--workers', '1', '--no-gallery',\n"
    "    '--no-speed']))",
    "drag": _SCENE + "from tests.annotator.desk_without_window import Desk\n"
    "from std_toolkit.geometry import SE3\n"
    "desk = Desk(scene.root); c = desk.controller\n"
    "def drag(x):\n"
    "    c.drag_to('box_1', 0, SE3.exp([0, 0, 0, x, 0, 0]) @ c.pose('box_1', 0)); c.end_drag()\n"
    "drag(0.01)  # makes the journal\n"
    "measured(lambda: drag(0.01))\n"
    "desk.close()",
    "weights": "from benchmark.methods.registry import MethodOptions, make_restorer\n"
    "measured(lambda: make_restorer('swindrnet', MethodOptions(preset='compact')))",
}
_HARNESS = """
import sys, threading
from pathlib import Path
ROOT, TMP = Path({root!r}), Path({tmp!r})
sys.path.insert(0, str(ROOT))
def measured(run):
    files = set()
    def see(frame, event, arg):
        code = frame.f_code
        # Bodies of modules and classes, and what is comprehended in them, run when imported.
        of_import = not code.co_flags & 1 or (
            code.co_name.startswith("<") and frame.f_back and not frame.f_back.f_code.co_flags & 1)
        if event == "call" and not of_import:
            files.add(code.co_filename)
    threading.setprofile(see); sys.setprofile(see)
    try: status = run()
    finally: sys.setprofile(None); threading.setprofile(None)
    ours = sorted(str(Path(f).relative_to(ROOT)) for f in files if Path(f).is_relative_to(ROOT))
    ours = [f for f in ours if f.split("/")[0] in {packages!r}]
    print("FILES", *ours)
    print("IMPORTED", sum(n.split(".")[0] in {packages!r} for n in sys.modules))
"""


def modules(root: Path) -> dict[str, Path]:
    """Return every module of the four packages by dotted name; packages end in `.__init__`."""
    return {
        ".".join(path.relative_to(root).with_suffix("").parts): path
        for package in PACKAGES
        for path in sorted((root / package).rglob("*.py"))
    }


def code_lines(text: str) -> tuple[int, int]:
    """Return (code lines, import lines among them), without blank lines, comments, docstrings."""
    tree = ast.parse(text)
    hidden: set[int] = set()
    imports: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            # Also those of fields, which follow them in the body of the class.
            for entry in node.body if isinstance(node, ast.ClassDef) else node.body[:1]:
                if isinstance(entry, ast.Expr) and isinstance(entry.value, ast.Constant):
                    hidden.update(range(entry.lineno, (entry.end_lineno or 0) + 1))
        if isinstance(node, ast.Import | ast.ImportFrom):
            imports.update(range(node.lineno, (node.end_lineno or 0) + 1))
    lines = {
        number
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#") and number not in hidden
    }
    return len(lines), len(lines & imports)


def is_command_line(name: str) -> bool:
    """Whether a module is one of a command line: in a `cli`, named so, or run by `python -m`."""
    parts = name.split(".")
    return "cli" in parts or parts[-1] == "__main__" or parts[-1].endswith("_cli")


def _at_run_time(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes except those under `if TYPE_CHECKING`."""
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        yield child
        yield from _at_run_time(child)


def import_graph(root: Path, *, for_types: bool = False) -> dict[str, set[str]]:
    """Return the modules of the four packages that each module imports, also within functions.

    Args:
        root: folder of the packages.
        for_types: include imports under `if TYPE_CHECKING`, except lazy names of an `__init__`.
    """
    named = modules(root)
    plain = {name.removesuffix(".__init__"): name for name in named}
    graph: dict[str, set[str]] = {}
    for name, path in named.items():
        found: set[str] = set()
        tree = ast.parse(path.read_text(encoding="utf-8"))
        lazy = not for_types or name.endswith(".__init__")
        for node in _at_run_time(tree) if lazy else ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    target = plain.get(f"{node.module}.{alias.name}") or plain.get(node.module)
                    found |= {target} if target else set()
            elif isinstance(node, ast.Import):
                found |= {plain[a.name] for a in node.names if a.name in plain}
        graph[name] = found - {name}
    return graph


def circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Return the strongly connected components of two or more nodes (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph.get(node, ()):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(sorted(group))

    sys.setrecursionlimit(10_000)
    for node in graph:
        if node not in index:
            visit(node)
    return sorted(found)


def folder_graph(graph: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Return imports between first-level folders (or files) of a package, without `__init__`."""
    folders: dict[str, set[str]] = {}
    for name, targets in graph.items():
        parts = name.split(".")
        if parts[1] == "__init__":
            continue
        mine = ".".join(parts[:2])
        folders.setdefault(mine, set())
        for target in targets:
            other = target.split(".")
            if other[0] == parts[0] and other[1] != "__init__" and ".".join(other[:2]) != mine:
                folders[mine].add(".".join(other[:2]))
    return folders


def arrows_up(graph: Mapping[str, set[str]]) -> list[str]:
    """Return imports between folders to the same layer of `ORDER` or a higher one."""
    layer = {
        f"{package}.{name}": i
        for package, order in ORDER.items()
        for i, names in enumerate(order)
        for name in names
    }
    return [
        f"{mine} -> {other}"
        for mine, others in folder_graph(graph).items()
        for other in sorted(others)
        if layer[other] >= layer[mine]
    ]


def limits_of(tree: ast.Module) -> list[str]:
    """Return the fields that `limit` makes."""
    return [
        node.target.id
        for node in ast.walk(tree)
        if isinstance(node, ast.AnnAssign)
        and isinstance(node.target, ast.Name)
        and isinstance(node.value, ast.Call)
        and ast.unparse(node.value.func) == "limit"
    ]


def numbers_of(tree: ast.Module) -> list[str]:
    """Return the names of the constants of a module that hold numbers."""

    def is_number(value: ast.expr | None) -> bool:
        if isinstance(value, ast.Tuple | ast.Dict):
            parts = value.elts if isinstance(value, ast.Tuple) else value.values
            return bool(parts) and all(map(is_number, parts))
        if isinstance(value, ast.BinOp):
            return is_number(value.left) and is_number(value.right)
        if isinstance(value, ast.Call):
            return bool(value.args) and all(map(is_number, value.args))
        inner = value.operand if isinstance(value, ast.UnaryOp) else value
        return isinstance(inner, ast.Constant) and type(inner.value) in (int, float)

    found = []
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and is_number(node.value):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found += [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
    return found


def limits_outside(name: str, tree: ast.Module) -> list[str]:
    """Return the numbers that a module of `DECIDING` compares and that are no settings."""
    where = next((d for d in DECIDING if f"{name}.".startswith(f"{d}.")), None)
    if where is None:
        return []
    compared = {
        part.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Compare)
        for part in ast.walk(node)
        if isinstance(part, ast.Name)
    }
    known = NO_LIMITS[where].split()
    return [f"{name}.{n}" for n in numbers_of(tree) if n in compared and n not in known]


def run_flow(program: str, root: Path = ROOT) -> tuple[list[str], int]:
    """Return the repository's files that a program executes, and the number of modules imported."""
    with tempfile.TemporaryDirectory() as folder:
        head = _HARNESS.format(root=str(root), tmp=folder, packages=PACKAGES)
        done = subprocess.run(
            [sys.executable, "-c", head + program], cwd=root, capture_output=True, text=True
        )
    rows = {line.partition(" ")[0]: line.split()[1:] for line in done.stdout.splitlines() if line}
    if "FILES" not in rows:
        raise RuntimeError(f"the flow failed:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return rows["FILES"], int(rows["IMPORTED"][0])


def count(root: Path = ROOT) -> dict[str, object]:
    """Return the static part of the table."""
    named = modules(root)
    texts = {name: path.read_text(encoding="utf-8") for name, path in named.items()}
    lines = {name: code_lines(text) for name, text in texts.items()}
    total, imports = (sum(values) for values in zip(*lines.values(), strict=True))
    graph = import_graph(root)
    trees = {name: ast.parse(text) for name, text in texts.items()}
    sizes = {name: text.count("\n") for name, text in texts.items()}
    return {
        "code lines": total,
        "modules": len(named),
        "median lines of a module": statistics.median(sizes.values()),
        "median without __init__": statistics.median(
            size for name, size in sizes.items() if not name.endswith("__init__")
        ),
        "imports, % of code": round(100 * imports / total, 1),
        "lines of command-line modules": sum(
            size for name, size in sizes.items() if is_command_line(name)
        ),
        "copies x=args.x": sum(
            isinstance(node, ast.keyword)
            and isinstance(node.value, ast.Attribute)
            and isinstance(node.value.value, ast.Name)
            and node.value.value.id == "args"
            and node.value.attr == node.arg
            for tree in trees.values()
            for node in ast.walk(tree)
        ),
        "limits in settings": sum(len(limits_of(tree)) for tree in trees.values()),
        "other numeric constants": sum(len(numbers_of(tree)) for tree in trees.values()),
        "limits outside of settings": [
            limit for name, tree in trees.items() for limit in limits_outside(name, tree)
        ],
        "circles of modules": circles(graph),
        "circles with imports for types": circles(import_graph(root, for_types=True)),
        "circles of folders": circles(folder_graph(graph)),
        "arrows up": arrows_up(graph),
    }


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--flows", action="store_true", help="run the flows as well (a minute)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    args = parser.parse_args()
    table = count()
    if args.flows:
        for name, program in FLOWS.items():
            try:
                files, imported = run_flow(program)
            except RuntimeError as error:
                print(f"{name}: {error}", file=sys.stderr)
                return 1
            table[f"files executed: {name}"] = f"{len(files)} ({imported} imported)"
    if args.json:
        print(json.dumps(table, indent=2))
        return 0
    for name, value in table.items():
        print(f"{name:40} {len(value) if isinstance(value, list) else value}")
        for row in value if isinstance(value, list) else ():
            print(f"    {row if isinstance(row, str) else ', '.join(row)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
