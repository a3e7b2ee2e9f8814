"""Names from documents become paths: none of them leads out of the scene."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from std_toolkit.errors import ToolkitError
from std_toolkit.scene.document import check_name, check_relative, safe_name

HOSTILE = [
    "",
    ".",
    "..",
    "../up",
    "a/../../up",
    "/etc/passwd",
    "//server/share",
    "C:\\windows",
    "..\\up",
    "a\\b",
    "~/secret",
    "$HOME",
    "a\0b",
    "a\nb",
    "newline_at_the_end\n",
    "\x1b[31mred",
    "a b",
    ".hidden",
    "-rf",
    "mug*",
    "mug;rm",
    "café",
    "\u202egnp.exe",
    "／slash",
    "a" * 129,
    "\ud800",
]
# A temporary of an atomic write could be mistaken for a leftover and swept.
HOSTILE.append(".mug.0123456789ab.tmp")


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_names_are_refused(name: str) -> None:
    with pytest.raises(ToolkitError) as caught:
        check_name(name)
    assert str(caught.value).isprintable()
    with pytest.raises(ToolkitError):
        check_relative(name)
    with pytest.raises(ToolkitError):
        check_relative(f"color/{name}")


@pytest.mark.parametrize("path", ["a//b", "./a", "a/", "a/./b", "/", "a/" * 300 + "b"])
def test_paths_have_one_spelling(path: str) -> None:
    with pytest.raises(ToolkitError):
        check_relative(path)


@pytest.mark.parametrize("name", ["mug", "006_mustard_bottle", "IMG-20.1+x.png", "a" * 128, "0"])
def test_common_names_pass(name: str) -> None:
    assert check_name(name) == name
    assert check_relative(f"models/{name}/x.obj") == f"models/{name}/x.obj"


@given(st.text())
def test_any_text_becomes_a_safe_name(text: str) -> None:
    assert check_name(safe_name(text)) == safe_name(text)


@given(st.text())
def test_what_passes_stays_inside_the_folder(text: str) -> None:
    try:
        check_relative(text)
    except ToolkitError as error:
        assert str(error).isprintable()
        return
    root = Path("/scene")
    assert (root / text).resolve().is_relative_to(root)


@pytest.mark.parametrize(
    ("text", "name"),
    [("杯子", "u676fu5b50"), ("Tasse é", "Tasse_e"), ("rec [1]", "rec_1_"), ("..", "unnamed")],
)
def test_names_of_other_scripts_stay_different(text: str, name: str) -> None:
    assert safe_name(text) == name
    assert safe_name("碗") != safe_name("杯")
