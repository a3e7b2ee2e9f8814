"""A question as the page shows it: a text, fields and buttons."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from std_toolkit.errors import ToolkitError

Answers = dict[str, Any]
Reaction = Callable[[str, Answers], None]
Button = dict[str, str]
_numbers = itertools.count(1)


def button(id: str, text: str) -> Button:
    """A button; the first of a question is the usual answer."""
    return {"id": id, "text": text}


CANCEL = button("", "Cancel")


def whole_number(answers: Answers, name: str) -> int:
    """A number that was filled in.

    Raises:
        ToolkitError: it is none.
    """
    try:
        return int(str(answers.get(name, "")).strip())
    except ValueError:
        raise ToolkitError(
            "this is not a whole number", field=name, value=answers.get(name)
        ) from None


@dataclass(frozen=True)
class Field:
    """Something to be filled in.

    Attributes:
        name: key of its value in the answers.
        choices: titles and values of a field that lets choose.
        value: what stands in it first.
        when: name and value of another field: it is shown only if that has the value.
    """

    name: str
    label: str
    kind: Literal["line", "lines", "number", "switch", "choice"] = "line"
    choices: tuple[tuple[str, str], ...] = ()
    value: str | int | bool = ""
    when: tuple[str, Any] | None = None

    def shown(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "label": self.label,
            "kind": self.kind,
            "choices": [{"title": title, "value": value} for title, value in self.choices],
            "when": None if self.when is None else list(self.when),
        }


@dataclass(frozen=True)
class Question:
    """A dialog.

    Attributes:
        react: called with the button's id and the answers, unless it is cancelled.
        groups: tables to read: a heading each, and rows of two cells.
        must: it goes away only by one of its buttons.
        number: tells it from every other.
    """

    title: str
    react: Reaction
    text: str = ""
    fields: list[Field] = field(default_factory=list)
    buttons: list[Button] = field(default_factory=list)
    groups: list[tuple[str, list[tuple[str, str]]]] = field(default_factory=list)
    must: bool = False
    number: int = field(default_factory=lambda: next(_numbers))

    def shown(self) -> dict[str, Any]:
        """As plain values for the page."""
        return {
            "number": self.number,
            "title": self.title,
            "text": self.text,
            "fields": [f.shown() for f in self.fields],
            "buttons": self.buttons,
            "groups": [
                {"name": name, "rows": [list(r) for r in rows]} for name, rows in self.groups
            ],
            "must": self.must,
        }

    def first_answers(self) -> Answers:
        return {f.name: f.value for f in self.fields}
