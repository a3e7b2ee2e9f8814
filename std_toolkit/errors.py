"""The error type of the toolkit: which file, field and value is wrong, and how to fix it."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

_BOUNDS: dict[str, tuple[str, Callable[[Any, Any], bool]]] = {
    "ge": ("at least", lambda value, bound: value >= bound),
    "gt": ("above", lambda value, bound: value > bound),
    "le": ("at most", lambda value, bound: value <= bound),
    "lt": ("below", lambda value, bound: value < bound),
}


# Characters that an error shows of each part. A path has at most 4096 bytes; a key or a library's
# message that repeats its input can have any length and would fill the terminal.
_LONGEST_PATH, _LONGEST_FIELD, _LONGEST_PROBLEM, _LONGEST_VALUE = 4096, 200, 2000, 120

_ARGUMENTS = ("problem", "path", "field", "value", "hint")


class ToolkitError(Exception):
    """Invalid input or a failed gate, reported in one line.

    Args:
        problem: what is wrong, as a sentence without the location.
        path: the file or folder concerned.
        field: the field inside the file, such as `objects[2].material`; long names are cut.
        value: the invalid value; long values are cut.
        hint: how to fix it.
    """

    def __init__(
        self,
        problem: str,
        *,
        path: Path | str | None = None,
        field: str | None = None,
        value: Any = None,
        hint: str | None = None,
    ) -> None:
        self.problem = problem
        self.path = None if path is None else str(path)
        self.field = field
        self.value = value
        self.hint = hint
        super().__init__(problem, self.path, field, value, hint)

    def __str__(self) -> str:
        where = [_cut(self.path, _LONGEST_PATH)] if self.path else []
        where += [_cut(self.field, _LONGEST_FIELD)] if self.field else []
        text = ": ".join([*where, _cut(self.problem, _LONGEST_PROBLEM)])
        if self.value is not None:
            text += f" (got {_cut(repr(_plain(self.value)), _LONGEST_VALUE)})"
        if self.hint:
            text += f"; {_cut(self.hint, _LONGEST_PROBLEM)}"
        # One line of printable text: control characters in a library's message or a file name
        # could rewrite the terminal.
        text = " ".join(text.split())
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)

    def relocated(self, old: Path, new: Path) -> ToolkitError:
        """The same error with path `old` replaced by `new`, for staging folders."""
        return self.revised(
            path=None if self.path is None else self.path.replace(str(old), str(new))
        )

    def revised(self, **changes: Any) -> ToolkitError:
        """The same error with some of its arguments replaced, by a caller that knows more."""
        return type(self)(**{name: getattr(self, name) for name in _ARGUMENTS} | changes)

    def __reduce__(self) -> tuple[Any, ...]:
        # Exceptions with keyword-only arguments cannot be pickled between worker processes
        # otherwise.
        return (_rebuild, (type(self), self.problem, self.path, self.field, self.value, self.hint))


# Module that is imported, and the extra of this distribution that brings it.
EXTRAS: dict[str, str] = {
    "PySide6": "gui",
    "aiohttp": "web",
    "coacd": "sim",
    "kornia": "train",
    "manifold3d": "scan",
    "mitsuba": "sim",
    "mujoco": "sim",
    "onnx": "train",
    "onnxruntime": "restore",
    "onnxscript": "train",
    "pillow_heif": "heic",
    "pyoidn": "sim",
    "pyrealsense2": "realsense",
    "pytorch_lightning": "train",
    "pyvista": "gui",
    "pyvistaqt": "gui",
    "ray": "cluster",
    "rosbags": "ros",
    "safetensors": "train",
    "tensorboard": "train",
    "torch": "train",
    "trame": "web",
    "vtk": "gui",
}


@contextmanager
def located(path: Path | str | None, field: str | None = None) -> Iterator[None]:
    """Context manager that adds the file, and the field if given, to errors of its block."""
    try:
        yield
    except ToolkitError as error:
        raise ToolkitError(
            error.problem,
            path=path,
            field=field or error.field,
            value=error.value,
            hint=error.hint,
        ) from error


def is_interrupt(error: BaseException) -> bool:
    """Whether an error is a KeyboardInterrupt or comes from one.

    Compiled code that is interrupted within a callback, such as a loop that drjit traces, reports
    that as an error of its own.
    """
    chain: BaseException | None = error
    seen: set[int] = set()  # libraries make chains that lead back to where they began
    while chain is not None and id(chain) not in seen:
        if isinstance(chain, KeyboardInterrupt):
            return True
        seen.add(id(chain))
        chain = chain.__cause__ or chain.__context__
    return False


def missing_extra(error: BaseException) -> ToolkitError | None:
    """The error to report for the import of a module that an extra brings; None for any other."""
    if not isinstance(error, ModuleNotFoundError):
        return None
    module = (error.name or "").partition(".")[0]
    if module not in EXTRAS:
        return None
    return ToolkitError(
        f"{module} is not installed", hint=f"pip install 'std-toolkit[{EXTRAS[module]}]'"
    )


def check_known(
    value: object,
    known: Iterable[Any],
    problem: str,
    *,
    path: Path | str | None = None,
    field: str | None = None,
    told: str = "one of",
) -> None:
    """Check that a value is one of those that there are.

    Args:
        value: what was asked for.
        known: what there is; listed in the hint, after `told`.
        problem, path, field: of the error.

    Raises:
        ToolkitError: it is none of them.

    >>> check_known("panda", ["panda", "suction"], "no such gripper")
    """
    names = list(dict.fromkeys(known))
    if value not in names:
        listed = f"{told} {', '.join(map(str, names))}"
        raise ToolkitError(problem, path=path, field=field, value=value, hint=listed)


def listed(names: Sequence[str], most: int = 6, joint: str = ", ") -> str:
    """The first names of a message, and the number of the others.

    >>> listed(["a", "b", "c"], 2)
    'a, b and 1 more'
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return joint.join(names[:most]) + more


def check_options(options: Any) -> None:
    """Check the fields of a dataclass or Struct against the ranges and choices in its annotations.

    A range or pattern is a `msgspec.Meta`, choices are a `Literal`; None is not checked. Each value
    of a tuple and each nested dataclass is checked, and that numbers are finite.

    Raises:
        ToolkitError: a value is outside its range or choices; names the first such field.
    """
    kind: Any = type(options)
    for name, parts in _field_parts(kind):
        value = getattr(options, name)
        if dataclasses.is_dataclass(value):
            check_options(value)
        values = value if isinstance(value, tuple) else () if value is None else (value,)
        for part in parts:
            if get_origin(part) is Literal and not all(v in get_args(part) for v in values):
                problem = f"expected one of {', '.join(map(str, get_args(part)))}"
                raise ToolkitError(problem, field=name, value=value)
            pattern = getattr(part, "pattern", None)
            if isinstance(pattern, str) and not all(re.search(pattern, v) for v in values):
                form = getattr(part, "description", None) or pattern
                raise ToolkitError(f"must have the form {form}", field=name, value=value)
            for bound_name, (words, holds) in _BOUNDS.items():
                bound = getattr(part, bound_name, None)
                if bound is not None and not all(holds(v, bound) for v in values):
                    raise ToolkitError(f"must be {words} {bound}", field=name, value=value)
        if any(isinstance(v, float) and not math.isfinite(v) for v in values):
            raise ToolkitError("must be finite", field=name, value=value)


@cache
def _field_parts(type_: type) -> list[tuple[str, list[Any]]]:
    hints = get_type_hints(type_, include_extras=True)
    return [(name, [*_parts(hint)]) for name, hint in hints.items()]


class CheckedOptions:
    """Base of dataclasses of options that are checked when they are made, by `check_options`."""

    def __post_init__(self) -> None:
        check_options(self)


def _parts(hint: Any) -> Iterator[Any]:
    """A type, its type arguments, and their annotations."""
    yield hint
    if get_origin(hint) is not Literal:
        for part in (*get_args(hint), *getattr(hint, "__metadata__", ())):
            yield from _parts(part)


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."


def _plain(value: Any) -> Any:
    """NumPy numbers, arrays and paths as Python values, which print readably."""
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    if type(value) in (list, tuple):
        return type(value)(_plain(item) for item in value)
    return value


def _rebuild(
    cls: type[ToolkitError],
    problem: str,
    path: str | None,
    field: str | None,
    value: Any,
    hint: str | None,
) -> ToolkitError:
    return cls(problem, path=path, field=field, value=value, hint=hint)
