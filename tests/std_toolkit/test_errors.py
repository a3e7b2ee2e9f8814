"""An error is one printable line that says where, what, and how to mend it."""

from __future__ import annotations

import math
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from std_toolkit.errors import CheckedOptions, ToolkitError, is_interrupt
from std_toolkit.io.documents import InvalidDocument


def test_the_line_names_file_field_value_and_remedy() -> None:
    error = ToolkitError(
        "must be positive", path=Path("a/scene.json"), field="fx", value=-1.5, hint="check K"
    )
    assert str(error) == "a/scene.json: fx: must be positive (got -1.5); check K"
    assert str(ToolkitError("no frames")) == "no frames"


@given(st.text(), st.text(), st.text())
def test_any_text_stays_one_printable_line(problem: str, path: str, value: str) -> None:
    assert str(ToolkitError(problem, path=path, value=value)).isprintable()


def test_escape_codes_in_names_do_not_reach_the_terminal() -> None:
    assert str(ToolkitError("gone", path="\x1b[2Ja\nb")) == "\\x1b[2Ja b: gone"


@pytest.mark.parametrize("part", ["problem", "path", "field", "hint"])
def test_a_line_stays_readable_whatever_a_file_says(part: str) -> None:
    parts = {"problem": "no such key", "field": "k", part: "k" * 100_000}
    problem = parts.pop("problem")
    assert len(str(ToolkitError(problem, **parts))) < 5000


def test_long_values_are_cut_and_numbers_of_numpy_are_plain() -> None:
    assert len(str(ToolkitError("wrong", value="x" * 10_000))) < 150
    assert str(ToolkitError("wrong", value=np.float64(0.5))) == "wrong (got 0.5)"
    assert str(ToolkitError("wrong", value=(np.int64(1), 2))) == "wrong (got (1, 2))"
    assert str(ToolkitError("wrong", value=np.eye(2))) == "wrong (got [[1.0, 0.0], [0.0, 1.0]])"


@pytest.mark.parametrize("kind", [ToolkitError, InvalidDocument])
def test_errors_cross_process_borders(kind: type[ToolkitError]) -> None:
    error = kind("wrong", path="p", field="f", value=[1], hint="h")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert str(again) == str(error)
    assert again.field == "f"


def test_an_interrupt_is_found_behind_other_errors_even_in_a_circle() -> None:
    hidden, circle = RuntimeError("of a library"), [ValueError("a"), ValueError("b")]
    hidden.__context__ = KeyboardInterrupt()
    assert is_interrupt(hidden) and is_interrupt(KeyboardInterrupt())
    circle[0].__cause__, circle[1].__context__ = circle[1], circle[0]
    assert not is_interrupt(circle[0])


@dataclass(frozen=True)
class _Sized(CheckedOptions):
    sizes: tuple[Annotated[str, msgspec.Meta(pattern=r"^[1-9]\d*x[1-9]\d*$")], ...] = ()
    rate: float = 1.0


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"sizes": ("9x9", "0x0")}, "sizes: must have the form"),
        ({"rate": math.inf}, "rate: must be finite"),
        ({"rate": math.nan}, "rate: must be finite"),
    ],
)
def test_options_are_of_their_form_and_finite(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ToolkitError, match=words):
        _Sized(**values)
    _Sized(sizes=("9x9",), rate=1e300)
