"""Which package may import which: the layers of the repository, read from its source.

Imports within functions count. Those for type checking count between the layers of `FORBIDDEN`: a
layer does not know what lies above it. They do not count for circles and for the order of folders.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest

from tools.structure import ORDER

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGES = ("std_toolkit", "annotator", "sensors", "benchmark")
QT = ("PySide6", "pyvistaqt")
VTK = ("vtk", "vtkmodules", "pyvista")
WEB = ("trame", "trame_client", "trame_server", "trame_vtk", "trame_vuetify", "wslink", "aiohttp")
SCREENS = ("annotator.views", "annotator.qt", "annotator.web")

# What each part must not import. A part is a package, or the modules of a folder without those of
# its sub-packages ("annotator/*").
FORBIDDEN = {
    "std_toolkit": ("annotator", "sensors", "benchmark", *QT, *VTK, *WEB),
    "sensors": ("annotator", "benchmark"),
    "benchmark": ("annotator",),
    "annotator": ("sensors", "benchmark"),
    # All that the window and the browser share runs without either, and without a display.
    "annotator/*": (*SCREENS, *QT, *VTK, *WEB),
    "annotator/app": (*SCREENS, *QT, *VTK, *WEB, "annotator.compare"),
    "annotator/compare": (
        *SCREENS,
        *QT,
        *VTK,
        *WEB,
        "annotator.app",
    ),
    "annotator/session": (*QT, *VTK, *WEB, "annotator"),
    "annotator/views": ("annotator.qt", "annotator.web", *QT, *WEB),
    "annotator/qt": ("annotator.web", *WEB),
    "annotator/web": ("annotator.qt", *QT),
}
# Of what is forbidden above, the part itself.
ALLOWED = {"annotator/session": ("annotator.session",)}


def modules_of(part: str) -> list[Path]:
    folder = REPOSITORY / part.removesuffix("/*")
    return sorted(folder.glob("*.py") if part.endswith("/*") else folder.rglob("*.py"))


def imports_of(
    path: Path, nodes: Callable[[ast.AST], Iterable[ast.AST]] = ast.walk
) -> Iterator[tuple[int, str]]:
    """Line and full name of all that a file imports; "a.b" for `from a import b`."""
    for node in nodes(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: imports are absolute here"
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)


def within(name: str, packages: tuple[str, ...]) -> bool:
    return any(name == p or name.startswith(f"{p}.") for p in packages)


@pytest.mark.slow
@pytest.mark.parametrize("part", FORBIDDEN)
def test_no_layer_knows_what_lies_above_it(part: str) -> None:
    files = modules_of(part)
    assert files, f"there is no {part} any more"
    wrong = [
        f"{path.relative_to(REPOSITORY)}:{line} imports {name}"
        for path in files
        for line, name in imports_of(path)
        if within(name, FORBIDDEN[part]) and not within(name, ALLOWED.get(part, ()))
    ]
    assert wrong == []


def test_every_package_is_looked_at() -> None:
    """A new one needs its place among the layers."""
    assert set(PACKAGES) <= set(FORBIDDEN)
    found = {f"annotator/{p.parent.name}" for p in (REPOSITORY / "annotator").glob("*/__init__.py")}
    assert found <= set(FORBIDDEN)


def test_a_wrong_import_would_be_seen(tmp_path: Path) -> None:
    """Wherever it hides in the file."""
    path = tmp_path / "module.py"
    path.write_text(
        "import annotator.web as w\nfrom annotator import views\n"
        "def f():\n    from annotator.qt.qt_app import run\n"
    )
    assert [name for _, name in imports_of(path) if within(name, SCREENS)] == [
        "annotator.web",
        "annotator.views",
        "annotator.qt.qt_app.run",
    ]
    assert not within("annotator.viewpoint", SCREENS)


Graph = dict[str, set[str]]


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes below one but those that only a type checker reads."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and ast.unparse(child.test).endswith("TYPE_CHECKING"):
            for other in child.orelse:
                yield other
                yield from statements(other)
        else:
            yield child
            yield from statements(child)


def import_graph(root: Path, package: str) -> Graph:
    """Which modules of a package each of its modules imports, imports within functions included."""
    files = {}
    for path in sorted((root / package).rglob("*.py")):
        name = ".".join(path.relative_to(root).with_suffix("").parts)
        files[name.removesuffix(".__init__")] = path

    def module_of(name: str) -> str:
        while name and name not in files:
            name = name.rpartition(".")[0]
        return name

    return {
        module: {module_of(name) for _, name in imports_of(path, statements)} - {module, ""}
        for module, path in files.items()
    }


def folder_graph(modules: Graph, folder: str) -> Graph:
    """The graph of what lies directly in a folder; a sub-folder counts as one."""

    def child(name: str) -> str:
        return ".".join(name.split(".")[: folder.count(".") + 2])

    graph: Graph = {}
    for module, targets in modules.items():
        if module.startswith(f"{folder}."):
            inside = {child(name) for name in targets if name.startswith(f"{folder}.")}
            graph.setdefault(child(module), set()).update(inside - {child(module)})
    return graph


def circles(graph: Graph) -> list[list[str]]:
    """Groups of nodes of which each reaches all others."""
    reached = {}
    for start in graph:
        seen: set[str] = set()
        left = [start]
        while left:
            new = graph.get(left.pop(), set()) - seen
            seen |= new
            left.extend(new)
        reached[start] = seen
    groups = {
        tuple(sorted(b for b in reached[a] if a in reached.get(b, ())))
        for a in graph
        if a in reached[a]
    }
    return [list(group) for group in sorted(groups)]


def all_circles(modules: Graph) -> list[list[str]]:
    """Circles between modules, and between the folders and modules of each folder."""
    folders = sorted({name.rpartition(".")[0] for name in modules} - {""})
    found = circles(modules)
    for folder in folders:
        found += [c for c in circles(folder_graph(modules, folder)) if c not in found]
    return found


def arrows_up(modules: Graph, package: str, order: tuple[tuple[str, ...], ...]) -> list[str]:
    """Imports that lead to the same layer or a higher one.

    Raises:
        KeyError: a folder has no place in the order.
    """
    layer = {name: i for i, names in enumerate(order) for name in names}

    def part(module: str) -> str:
        return ".".join(module.split(".")[1:2])

    return [
        f"{module} imports {target}"
        for module, targets in sorted(modules.items())
        for target in sorted(targets)
        if part(target) != part(module) and layer[part(target)] >= layer[part(module)]
    ]


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_no_circles(package: str) -> None:
    modules = import_graph(REPOSITORY, package)
    assert len(modules) > 10
    assert all_circles(modules) == []


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_no_arrow_leads_up(package: str) -> None:
    modules = import_graph(REPOSITORY, package)
    placed = [name for names in ORDER[package] for name in names]
    assert sorted(placed) == sorted({".".join(m.split(".")[1:2]) for m in modules})
    assert arrows_up(modules, package, ORDER[package]) == []


def made_up(root: Path, files: dict[str, str]) -> Graph:
    """The graph of a package "shop" that has `__init__.py` in every folder."""
    for name, text in files.items():
        path = root / "shop" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        for folder in path.relative_to(root).parents:
            if folder != Path():
                (root / folder / "__init__.py").touch()
    return import_graph(root, "shop")


def test_circles_would_be_seen(tmp_path: Path) -> None:
    modules = made_up(
        tmp_path,
        {
            # Between modules; one import hides in a function.
            "goods/fruit.py": "from shop.goods import price\n",
            "goods/price.py": "def f():\n    import shop.goods.fruit\n",
            # Between folders, no module of which is in a circle.
            "till/coin.py": "from shop.stock.shelf import Shelf\n",
            "till/note.py": "",
            "stock/shelf.py": "",
            "stock/count.py": "import shop.till.note\n",
            # Between sub-folders.
            "staff/day/plan.py": "from shop.staff.night.list import names\n",
            "staff/day/clock.py": "",
            "staff/night/list.py": "",
            "staff/night/watch.py": "from shop.staff.day.clock import now\n",
            # With the folder's own __init__.
            "door/__init__.py": "from shop.door.bell import ring\n",
            "door/bell.py": "def f():\n    from shop.door import ring\n",
            # None: the second import is for a type checker alone.
            "sign/a.py": "from shop.sign.b import B\n",
            "sign/b.py": "import typing\nif typing.TYPE_CHECKING:\n    from shop.sign.a import A\n",
        },
    )
    assert all_circles(modules) == [
        ["shop.door", "shop.door.bell"],
        ["shop.goods.fruit", "shop.goods.price"],
        ["shop.stock", "shop.till"],
        ["shop.staff.day", "shop.staff.night"],
    ]


def test_an_arrow_up_would_be_seen(tmp_path: Path) -> None:
    modules = made_up(
        tmp_path,
        {
            "goods/fruit.py": "def f():\n    from shop.till.coin import Coin\n",
            "stock/shelf.py": "import shop.goods.price\n",
            "goods/price.py": "import os\n",
            "till/coin.py": "from shop.goods.price import price\n",
        },
    )
    order = (("",), ("goods", "stock"), ("till",))
    assert arrows_up(modules, "shop", order) == [
        "shop.goods.fruit imports shop.till.coin",
        "shop.stock.shelf imports shop.goods.price",
    ]
    with pytest.raises(KeyError, match="till"):
        arrows_up(modules, "shop", order[:2])
