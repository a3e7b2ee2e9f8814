"""What code imports, followed from function to function through the project's own modules.

Read from the source alone; nothing is imported. From a function it goes on to the functions and
classes that it names, to the modules that it or its module imports, and to the `module:name`
strings of the registries. A method counts with its class. Branches that only some options take
count, too. Not followed are blocks for type checkers and of scripts, annotations of functions, and
imports whose failure the code handles: `try: import ... except ImportError`.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache, cached_property
from pathlib import Path

PACKAGES = ("std_toolkit", "annotator", "sensors", "benchmark")
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_OURS = rf"({'|'.join(PACKAGES)})\.[\w.]+"
_NOT_RUN = re.compile("TYPE_CHECKING|__name__")  # for type checkers, and of a script
_ENTRY = re.compile(rf"{_OURS}:\w+")

ANY = "*"  # all that a module defines
Place = tuple[str, str]  # a module, and a name in it; "" is what runs when it is imported


class Source:
    """The modules below a folder."""

    def __init__(self, root: Path) -> None:
        self.files: dict[str, Path] = {}
        for package in PACKAGES:
            for path in (root / package).rglob("*.py"):
                name = ".".join(path.relative_to(root).with_suffix("").parts)
                self.files[name.removesuffix(".__init__")] = path
        self._module = cache(lambda name: _Module(name, self.files))
        self._steps = cache(self._find_steps)

    def third_party(self, *entries: str, without: Iterable[str] = ()) -> dict[str, list[str]]:
        """Packages of others that running some code may import.

        Args:
            entries: `module:name` of the code.
            without: `module:name` where not to go on, such as the other commands of a program.

        Returns:
            Each package's top-level name, with the way to its import: `module:name` each.
        """
        places = [_place(entry) for entry in entries]
        closed = {_place(entry) for entry in without}
        before: dict[Place, Place | None] = dict.fromkeys(places)
        found: dict[str, list[str]] = {}
        while places:
            place = places.pop()
            ours, others = self._steps(place)
            for package in others - found.keys():
                way: list[str] = []
                step: Place | None = place
                while step is not None:
                    way.insert(0, f"{step[0]}:{step[1]}")
                    step = before[step]
                found[package] = way
            new = ours - before.keys() - closed
            before.update(dict.fromkeys(new, place))
            places += sorted(new, reverse=True)
        return found

    def handled(self) -> Iterator[tuple[str, set[str], str]]:
        """Each block that handles a failing import.

        Yields:
            Where it is; the packages of others that its imports lead to; the handlers' source.
        """
        for module in self.files:
            for node in ast.walk(self._module(module).tree):
                if isinstance(node, ast.Try) and handles_missing(node):
                    names = [n for part in node.body for n in _imported(part)]
                    entries = [f"{n}:{ANY}" for n in names if n in self.files]
                    packages = {n.partition(".")[0] for n in names} - set(PACKAGES)
                    packages -= set(sys.stdlib_module_names)
                    where = f"{module}:{node.lineno}"
                    yield (
                        where,
                        packages | self.third_party(*entries).keys(),
                        "\n".join(ast.unparse(handler) for handler in node.handlers),
                    )

    def _find_steps(self, place: Place) -> tuple[set[Place], set[str]]:
        """The places and the packages of others that one place leads to."""
        module, name = place
        parents = module.split(".")
        ours: set[Place] = {(".".join(parents[: i + 1]), "") for i in range(len(parents))}
        others = set()
        for target in self._module(module).uses(name):
            inside, rest = target, ""
            while inside and inside not in self.files:
                inside, _, last = inside.rpartition(".")
                rest = last
            package = target.partition(".")[0]
            if inside:
                ours.add((inside, rest))
            elif package not in sys.stdlib_module_names:
                others.add(package)
        return ours, others


def _place(entry: str) -> Place:
    module, _, name = entry.partition(":")
    return module, name


class _Module:
    """One file: its definitions, and what the names in it mean."""

    def __init__(self, name: str, files: dict[str, Path]) -> None:
        self.name = name
        self.files = files
        self.tree = ast.parse(files[name].read_text(encoding="utf-8"))
        kinds = (*_FUNCTIONS, ast.ClassDef)
        self.definitions = {node.name: node for node in self.tree.body if isinstance(node, kinds)}

    @cached_property
    def names(self) -> dict[str, str]:
        """What each name at the top of the module means, as a dotted name."""
        made = {name: f"{self.name}.{name}" for name in self.definitions}
        return made | _bound(list(_executed(self.tree, inside=False)))

    def uses(self, name: str) -> Iterator[str]:
        """Dotted names that a definition uses, or with "" the module itself on its import."""
        if name == ANY:
            yield from (f"{self.name}.{each}" for each in self.definitions)
            return
        if name and name not in self.definitions:
            yield from [self.names[name]] if name in self.names else []
            return
        start = self.definitions[name] if name else self.tree
        nodes = list(_executed(start, inside=bool(name)))
        names = self.names | _bound(nodes)
        for node in nodes:
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                yield node.module or ""
                # A module of a package runs now, a function when something calls it.
                whole = [f"{node.module}.{alias.name}" for alias in node.names]
                yield from (n for n in whole if name or n in self.files)
            elif isinstance(node, ast.Attribute):
                if isinstance(node.value, ast.Name) and node.value.id in names:
                    yield f"{names[node.value.id]}.{node.attr}"
            elif isinstance(node, ast.Name):
                yield from [names[node.id]] if node.id in names else []
            elif isinstance(node, ast.Call):
                # import_module("module") and its like; import_module(f"package.{name}").
                for word in node.args:
                    if isinstance(word, ast.Constant) and word.value in self.files:
                        yield f"{word.value}.{ANY}"
                    elif isinstance(word, ast.JoinedStr):
                        yield from self._named_by(word)
            elif isinstance(node, ast.Constant) and _ENTRY.fullmatch(str(node.value)):
                yield node.value.replace(":", ".")

    def _named_by(self, word: ast.JoinedStr) -> list[str]:
        """All modules that an f-string such as f"benchmark.tasks.{task}" may name."""
        start = word.values[0].value if isinstance(word.values[0], ast.Constant) else ""
        if not re.fullmatch(_OURS, f"{start}x"):
            return []
        return [n for n in self.files if n.startswith(start) and "." not in n[len(start) :]]


def _executed(node: ast.AST, inside: bool) -> Iterator[ast.AST]:
    """The nodes below one that run; with `inside` those of functions as well."""
    for field, value in ast.iter_fields(node):
        if isinstance(node, _FUNCTIONS) and (
            field == "returns" or (field == "body" and not inside)
        ):
            continue
        if isinstance(node, ast.arg):
            continue
        for child in value if isinstance(value, list) else (value,):
            if isinstance(child, ast.If) and _NOT_RUN.search(ast.unparse(child.test)):
                yield from child.orelse
                for other in child.orelse:
                    yield from _executed(other, inside)
            elif isinstance(child, ast.Try) and handles_missing(child):
                for part in (*child.handlers, *child.orelse, *child.finalbody):
                    yield from _executed(part, inside)
            elif isinstance(child, ast.AST):
                yield child
                yield from _executed(child, inside)


def _imported(node: ast.AST) -> Iterator[str]:
    """Modules that import statements within a node may name."""
    for each in ast.walk(node):
        if isinstance(each, ast.Import):
            yield from (alias.name for alias in each.names)
        elif isinstance(each, ast.ImportFrom):
            yield from (f"{each.module}.{alias.name}" for alias in each.names)
            yield each.module or ""


def handles_missing(node: ast.Try) -> bool:
    """Whether a failing import within the block is handled."""
    return any(
        handler.type is not None and re.search(r"ImportError|ModuleNot", ast.unparse(handler.type))
        for handler in node.handlers
    )


def _bound(nodes: list[ast.AST]) -> dict[str, str]:
    """Names that the import statements among nodes bind, as dotted names."""
    made = {}
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                first = alias.name.partition(".")[0]
                made[alias.asname or first] = alias.name if alias.asname else first
        elif isinstance(node, ast.ImportFrom):
            made |= {a.asname or a.name: f"{node.module}.{a.name}" for a in node.names}
    return made
