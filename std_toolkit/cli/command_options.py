"""Options of a command from a dataclass: parsing, help, and back to words.

`tyro` builds the command line from the dataclass:

- the help of an option is the docstring below its field;
- its range is a `msgspec.Meta` in its annotation, its choices are an enum or a `Literal`;
- a field without a default is a positional argument;
- a mapping takes `NAME=VALUE ...`;
- the help of a flag that is on by default is a noun: "pictures" becomes "without pictures" for
  `--no-NAME`;
- a nested dataclass or `msgspec.Struct` is flattened.

The metadata of a field (for a Struct the `extra` of a `msgspec.Meta`) changes this:

- `{"option": "set"}` names the option `--set`, `{"option": ""}` makes it positional, and
  `{"option": None}` keeps it off the command line;
- `{"off": "flat-normals"}` makes a flag of this name that turns the field off;
- `{"repeat": True}` lets a tuple or mapping collect one value each time the option is given;
- `{"factor": 1000}` reads metres as millimetres;
- `{"size": True}` reads two whole numbers as `1280x720`;
- `{"writes": Writes("new")}` says that it is written to, see `std_toolkit.jobs.door`.
"""

import contextlib
import copy
import dataclasses
import enum
import functools
import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any, Union, get_args, get_origin

from std_toolkit.cli.option_fields import MAPPINGS, build_options, option_fields
from std_toolkit.errors import ToolkitError, check_options

_REPEATED = re.compile(r"\{?\[(\{[^{}]*\}|[A-Z]+) \[\1 \.\.\.\]\]\}?")


@dataclass(frozen=True, kw_only=True)
class CommonOptions:
    """Options of every command."""

    limits: Path | None = dataclasses.field(default=None, metadata={"option": "settings"})
    """TOML file of limits that decide what is accepted; `std-curate settings` prints all"""
    quiet: bool = False
    """print warnings and errors only"""
    debug: bool = False
    """show the traceback of an error"""


class UsageError(Exception):
    """A command line that cannot be parsed; the message is one line."""


def parse_options(kind: type[Any], words: Sequence[str], program: str) -> tuple[Any, CommonOptions]:
    """Parse the words of a command line.

    Args:
        kind: a dataclass; nested ones are flattened, fields without a default are positional.
        words: words of the command line, without program and command.
        program: title of the program in help and errors.

    Returns:
        An instance of `kind`, and the options of every command.

    Raises:
        SystemExit: after `--help`.
    """
    import tyro
    from tyro._errors import on_parse_error

    _refuse_twice(kind, words)

    def parse() -> Any:
        with on_parse_error(functools.partial(_refuse, program)):
            args = _in_millimetres(kind, words)
            return tyro.cli(_with_common(kind), prog=program, args=args, config=_markers())

    if "--help" in words or "-h" in words:
        page = io.StringIO()
        try:
            with contextlib.redirect_stdout(page):
                parse()
        finally:
            print(_tidy(page.getvalue()))
    call = parse()
    try:
        options = build_options(kind, vars(call))
        check_options(options)
    except ToolkitError as error:
        titles = {option.field: option.title for option in option_fields(kind)}
        error.field = titles.get(error.field or "", error.field)
        raise UsageError(str(error)) from error
    common = {field.name: getattr(call, field.name) for field in dataclasses.fields(CommonOptions)}
    return options, CommonOptions(**common)


def _refuse_twice(kind: type[Any], words: Sequence[str]) -> None:
    """Refuse an option of several values that is given twice: the parser drops the first ones."""
    for option in option_fields(kind):
        many = get_origin(option.type) in (*MAPPINGS, tuple, list) and "size" not in option.metadata
        times = sum(word.partition("=")[0] == f"--{option.name}" for word in words)
        if option.name and many and times > 1 and not option.metadata.get("repeat"):
            raise UsageError(f"--{option.name}: given twice; give all values after one of them")


_LENGTH = re.compile(r"(\d+(?:\.\d*)?|\.\d+)(mm|cm|m)")
_MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0}


def _in_millimetres(kind: type[Any], words: Sequence[str]) -> list[str]:
    """The words, where lengths such as 10mm or 0.01m are numbers of millimetres."""
    lengths = {f"--{option.name}" for option in option_fields(kind) if "factor" in option.metadata}
    found = list(words)
    for index, name in enumerate(words[:-1]):
        if name in lengths and (given := _LENGTH.fullmatch(words[index + 1])):
            found[index + 1] = f"{float(given[1]) * _MILLIMETRES[given[2]]:g}"
    return found


def print_completion(kinds: Mapping[str, type[Any]], shell: str, program: str) -> None:
    """Print the completion script of a program.

    Args:
        kinds: dataclass of options by command; with one command its name is not a word.
        shell: bash, zsh or fish.
        program: what the user types.
    """
    import tyro

    calls: dict[str, Callable[..., Any]] = {n: _with_common(k) for n, k in kinds.items()}
    arguments = ["--tyro-print-completion", shell]
    chosen = next(iter(calls.values())) if len(calls) == 1 else _choice(calls)
    tyro.cli(chosen, prog=program, args=arguments, config=_markers())


def _choice(calls: Mapping[str, Callable[..., Any]]) -> Any:
    """The type of a command line that chooses one of them; two words are a command of a group."""
    from tyro import conf

    groups: dict[str, dict[str, Callable[..., Any]]] = {}
    for name, call in calls.items():
        first, _, second = name.partition(" ")
        groups.setdefault(first, {})[second] = call
    kinds: list[Any] = [
        Annotated[Any, conf.subcommand(name=name, constructor=group[""])]
        if "" in group
        else Annotated[_choice(group), conf.subcommand(name=name)]
        for name, group in groups.items()
    ]
    return Union[tuple(kinds)]  # noqa: UP007 - made of a list


def values_of(options: Any) -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    """Title, value and metadata of each option; those of nested dataclasses as their own."""
    return ((o.title, o.default, o.metadata) for o in option_fields(type(options), options))


def words_of(options: Any) -> list[str]:
    """The words that `parse_options` parses to equal options; defaults are left out."""
    positional: list[str] = []
    named: list[str] = []
    kind = type(options)
    for given, plain in zip(option_fields(kind, options), option_fields(kind), strict=True):
        value = given.default
        if value == plain.default:
            continue
        if isinstance(value, bool):
            on = value or "off" in plain.metadata
            named.append(f"--{plain.name}" if on else f"--no-{plain.name}")
            continue
        value = value and value * plain.metadata["factor"] if "factor" in plain.metadata else value
        if isinstance(value, Mapping):
            value = tuple(f"{key}={item}" for key, item in value.items())
        values = value if isinstance(value, tuple) else (value,)
        texts = [str(v.value if isinstance(v, enum.Enum) else v) for v in values]
        if plain.name:
            named += [f"--{plain.name}", *texts]
        else:
            positional += texts
    return [*positional, *named]


def _tidy(page: str) -> str:
    """A help page without ruled lines, paragraphs filled, `STR ...` for `[STR [STR ...]]`."""
    page = _REPEATED.sub(lambda found: f"{found[1]} ...".ljust(len(found[0])), page)
    filled = (fill(x, 80) if x[:1].strip() and len(x) > 80 else x for x in page.splitlines())
    lines = (line.rstrip() for line in "\n".join(filled).splitlines())
    return "\n".join(line for line in lines if line.strip("-─ ") or not line)


def _markers() -> tuple[Any, ...]:
    from tyro import conf

    return (
        conf.FlagCreatePairsOff,
        conf.EnumChoicesFromValues,
        conf.DisallowNone,
        conf.PositionalMetavarFromFieldName,
        conf.HelptextFromCommentsOff,
    )


def _with_common(kind: type[Any]) -> type[Any]:
    """A flat dataclass of all options, for the parser."""
    from tyro import conf

    fields: list[tuple[str, Any, Any]] = []
    options = sorted(option_fields(kind), key=lambda o: o.default is not dataclasses.MISSING)
    for option in (*options, *option_fields(CommonOptions)):
        hint, default, metavar = option.type, option.default, None
        if get_origin(hint) in MAPPINGS:
            hint, metavar = tuple[str, ...], "NAME=VALUE ..."
            default = tuple(f"{name}={value}" for name, value in default.items())
            if option.metadata.get("repeat"):
                hint = conf.UseAppendAction[tuple[str, ...]]
        elif "off" in option.metadata:
            default = not default
        elif "size" in option.metadata:
            hint, metavar = (str | None if default is None else str), "WxH"
            default = default and f"{default[0]}x{default[1]}"
        elif "factor" in option.metadata:
            default = default and default * option.metadata["factor"]
        elif option.metadata.get("repeat"):
            default = () if default is None else default
            hint = conf.UseAppendAction[next(t for t in (*get_args(hint), hint) if _is_tuple(t))]  # type: ignore[misc]
        needed = default is dataclasses.MISSING
        says_nothing = default in (None, "", ()) or isinstance(default, bool)
        suffix: Any = "" if says_nothing else "(required)" if needed else "(default: {})".format
        about = conf.arg(
            name=option.name or None,
            metavar=metavar,
            help=f"without {option.help}" if default is True else option.help,
            help_behavior_hint=suffix,
        )
        annotated: Any = Annotated[hint, about]
        if not option.name:
            annotated = conf.Positional[annotated]  # type: ignore[misc]
        place: Any = dataclasses.field()
        if not needed:
            place = dataclasses.field(default_factory=functools.partial(copy.copy, default))
        fields.append((option.field, annotated, place))
    call = dataclasses.make_dataclass(kind.__name__, fields, frozen=True, kw_only=True)
    call.__doc__ = kind.__doc__
    return call


def _is_tuple(hint: Any) -> bool:
    return get_origin(hint) is tuple


def _refuse(program: str, event: Any) -> None:
    """Raise an error of the parser as one line."""
    kind = type(event).__name__
    argument = getattr(event, "argument", None)
    name = _flag(argument) if argument is not None else ""
    if kind == "InvalidChoice":
        problem = f"{event.value}: expected one of {', '.join(str(c) for c in event.choices)}"
    elif kind == "UnrecognizedArgs":
        problem = f"{' '.join(event.tokens)}: not an option of {program}"
    elif kind == "MissingArgs":
        missing = [_flag(m.arg) for m in event.missing_arguments]
        problem = f"{', '.join(missing)}: needed"
        if event.unrecognized_tokens:
            problem += f"; {' '.join(event.unrecognized_tokens)}: not an option"
    elif kind == "BadValue":
        problem = f"expected {event.argument.lowered.metavar}"
    else:
        problem = " ".join(str(getattr(event, "message", kind)).split())
        got = re.search(r"Got errors: - <class '.*?'>: (.*)", problem)
        problem = got[1] if got else problem
    where = f"{name}: " if name else ""
    raise UsageError(f"{where}{problem}; see `{program} --help`")


def _flag(argument: Any) -> str:
    lowered = argument.lowered
    if argument.is_positional():
        return str(argument.field.intern_name).upper()
    return str(lowered.name_or_flags[-1])
