"""Which package may import which: the layers of the repository, read from its source.

Imports within functions and for type checking count, too: a layer does not know what lies above it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

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


def imports_of(path: Path) -> Iterator[tuple[int, str]]:
    """Line and full name of all that a file imports; "a.b" for `from a import b`."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
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
