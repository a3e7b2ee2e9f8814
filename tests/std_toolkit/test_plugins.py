"""Plug-ins by name, by entry point, and by path; what cannot be loaded is one clear error."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.plugins import Registry, error_of_plugin, names_of


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Registry:
    installed = [
        EntryPoint("joined", "posixpath:join", "std_toolkit.tests"),
        EntryPoint("sqrt", "math:cos", "std_toolkit.tests"),
        EntryPoint("broken", "no_such_module:thing", "std_toolkit.tests"),
    ]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: installed)
    return Registry("std_toolkit.tests", {"sqrt": "math:sqrt"})


def test_built_in_plug_ins_come_first(registry: Registry) -> None:
    assert registry.names() == ["sqrt", "joined", "broken"]
    assert registry.get("sqrt")(4) == 2


def test_installed_plug_ins_and_paths_are_found(registry: Registry) -> None:
    assert registry.get("joined")("a", "b") == "a/b"
    assert registry.get("math:floor")(1.5) == 1


def test_an_unknown_name_lists_the_known_ones(registry: Registry) -> None:
    with pytest.raises(ToolkitError, match=r"no plug-in .*'cube'.*known: sqrt, joined, broken"):
        registry.get("cube")


@pytest.mark.parametrize("name", ["broken", "math:no_such", "math:", ":sqrt", "no_such:x", ".a:b"])
def test_what_cannot_be_imported_is_one_error(registry: Registry, name: str) -> None:
    with pytest.raises(ToolkitError, match="cannot import plug-in"):
        registry.get(name)


def test_a_plug_in_that_fails_while_imported_is_one_error(
    registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "failing_plugin.py").write_text("raise RuntimeError('needs a GPU')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ToolkitError, match="needs a GPU"):
        registry.get("failing_plugin:thing")
    sys.modules.pop("failing_plugin", None)


def test_a_file_is_a_plug_in(tmp_path: Path) -> None:
    """By its path, without a place on the module path; it is executed once."""
    file = tmp_path / "my-parts 2.py"
    file.write_text("COUNT = []\nCOUNT.append(1)\n\n\nclass Part:\n    pass\n")
    registry: Registry[Any] = Registry("none", {})
    assert registry.get(f"{file}:Part") is registry.get(f"{file}:Part")
    assert registry.get(f"{file}:COUNT") == [1]
    with pytest.raises(ToolkitError, match="no such file"):
        registry.get(f"{tmp_path}/absent.py:Part")
    file = tmp_path / "broken.py"
    file.write_text("1 / 0\n")
    for _ in range(2):
        with pytest.raises(ToolkitError, match="division by zero"):
            registry.get(f"{file}:Part")


def test_an_error_of_a_plug_in_names_its_file_and_line(registry: Registry, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("def run(x):\n    return 1 / x\n\ndef odd(x):\n    return None\n")
    run = registry.get(f"{file}:run")
    with pytest.raises(ZeroDivisionError) as raised:
        run(0)
    found = error_of_plugin(raised.value)
    assert found is not None
    assert str(found).startswith(f"{file}: line 2, run: ZeroDivisionError: division by zero")
    with pytest.raises(TypeError) as raised_here:
        len(registry.get(f"{file}:odd")(0))
    assert error_of_plugin(raised_here.value) is None
    found = error_of_plugin(raised_here.value, in_use=True)
    assert found is not None
    assert str(file) in str(found) and "does the plug-in give what" in str(found)


def _attribute(name: str) -> int:
    registry: Registry[int] = Registry("std_toolkit.tests", {})
    return registry.get(name)


def test_workers_and_threads_run_no_code_of_a_document(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\nX = 1\n")
    names = [f"{file}:X", f"{file}:Y"]
    with names_of("the recipe a.toml"):
        report = run_jobs(_attribute, names, name="names", options=JobOptions(workers=2))
        with ThreadPoolExecutor(1) as pool:
            thread = pool.submit(_attribute, names[0])
    for error in (*report.failed.values(), str(thread.exception())):
        assert "a.toml names code, which is not loaded" in error
    assert len(report.failed) == 2 and not (tmp_path / "ran").exists()


def test_names_of_a_document_run_no_code(registry: Registry, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\nX = 1\n")
    with names_of("the recipe a.toml"):
        assert registry.get("sqrt")(4) == 2
        for name in (f"{file}:X", "math:floor"):
            with pytest.raises(ToolkitError, match=r"a\.toml names code, which is not loaded"):
                registry.get(name)
    assert not (tmp_path / "ran").exists()
    assert registry.get(f"{file}:X") == 1
