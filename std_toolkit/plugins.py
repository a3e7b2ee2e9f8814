"""Plug-in registries, and aliases for module names of version 0.1.

A plug-in is built in, installed as an entry point, or named as `package.module:attribute`. The
aliases keep plug-ins written for 0.1 working: `import benchmark.pose_methods.protocol` gives the
module `benchmark.methods.protocol`, with a `DeprecationWarning`. The four packages call `install`
when they are imported.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from std_toolkit.errors import ToolkitError, missing_extra

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")


def _module_of_file(path: str) -> ModuleType:
    """The module loaded from a file; the file is executed once."""
    file = Path(path).resolve()
    name = f"plug-in {file}"
    if name not in sys.modules:
        if not file.is_file():
            raise FileNotFoundError(f"no such file: {path}")
        spec = spec_from_file_location(name, file)
        assert spec is not None and spec.loader is not None
        module = module_from_spec(spec)
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]


# Module names that the guides of version 0.1 documented for user code.
RENAMED: dict[str, str] = {
    "annotator.agreement": "annotator.compare",
    "benchmark.data.selection": "benchmark.data.frame",
    "benchmark.data.source": "benchmark.data.splits",
    "benchmark.grasp_methods.protocol": "benchmark.methods.protocol",
    "benchmark.grasp_methods.registry": "benchmark.methods.registry",
    "benchmark.grasping": "benchmark.metrics.grasp",
    "benchmark.grasping.ap": "benchmark.metrics.grasp.ap",
    "benchmark.grasping.collision": "benchmark.metrics.grasp.collision",
    "benchmark.grasping.force_closure": "benchmark.metrics.grasp.force_closure",
    "benchmark.grasping.graspnet_format": "benchmark.metrics.grasp.grasp",
    "benchmark.methods.cleargrasp": "benchmark.methods.depth.cleargrasp",
    "benchmark.methods.cleargrasp.global_optimization": (
        "benchmark.methods.depth.cleargrasp.global_optimization"
    ),
    "benchmark.methods.cleargrasp.join": "benchmark.methods.depth.cleargrasp.join",
    "benchmark.methods.full_size": "benchmark.methods.depth.full_size",
    "benchmark.methods.settings": "benchmark.methods.registry",
    "benchmark.metrics.depth_torch": "benchmark.metrics.depth.depth_torch",
    "benchmark.metrics.resize": "benchmark.data.frame",
    "benchmark.pose_methods.fitting": "benchmark.methods.pose.fitting",
    "benchmark.pose_methods.protocol": "benchmark.methods.protocol",
    "benchmark.pose_methods.registry": "benchmark.methods.registry",
    "benchmark.pose_running.results": "benchmark.evaluation.tasks.pose_results",
    "benchmark.pose_running.scoring": "benchmark.evaluation.tasks.pose_results",
    "benchmark.protocols": "benchmark.metrics.protocols",
    "benchmark.protocols.summary": "benchmark.evaluation.tasks.depth_results",
    "benchmark.running.results": "benchmark.evaluation.tasks.depth_results",
    "std_toolkit.checks.step": "std_toolkit.checks.check_step",
    "std_toolkit.exporters.protocol": "std_toolkit.exporters.exporter",
    "std_toolkit.geometry.depth": "std_toolkit.geometry.camera",
    "std_toolkit.importers.protocol": "std_toolkit.importers.importer",
    "std_toolkit.labels.refine.auto": "std_toolkit.labels.auto_refine",
    "std_toolkit.labels.refine.solver": "std_toolkit.labels.refine.edges.solver",
    "std_toolkit.poses.scale": "std_toolkit.poses.scale_sources",
    "std_toolkit.poses.scale.source": "std_toolkit.poses.scale_sources",
    "std_toolkit.poses.step": "std_toolkit.poses.pose_step",
    "std_toolkit.rendering.protocol": "std_toolkit.rendering.renderer",
}

# The other packages of this distribution.
SIBLINGS = frozenset({"annotator", "benchmark", "sensors"})

# Packages that no longer exist; their modules were moved to several others.
_GONE = frozenset(
    {
        "benchmark.grasp_methods",
        "benchmark.pose_methods",
        "benchmark.pose_running",
        "benchmark.running",
        "std_toolkit.poses.scale",
    }
)


class Registry(Generic[T]):
    """Plug-ins of one kind, by name.

    `get` searches the built-in plug-ins first (`module:attribute` strings, imported on first
    use), then the installed entry points of `group`. It imports a name with a colon as
    `package.module:attribute` or `path/to/file.py:attribute`.

    Args:
        group: entry-point group, such as `std_toolkit.renderers`.
        builtin: name to `package.module:attribute`.
    """

    def __init__(self, group: str, builtin: dict[str, str]) -> None:
        self.group = group
        self._targets = dict(builtin)

    def names(self) -> list[str]:
        """All known names, built-in ones first."""
        return list(dict.fromkeys([*self._targets, *(e.name for e in self._entries())]))

    def _entries(self) -> Iterable[EntryPoint]:
        from importlib.metadata import entry_points

        return entry_points(group=self.group)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def get(self, name: str) -> T:
        """Import and return the plug-in called `name`.

        Raises:
            ToolkitError: no such plug-in, or it cannot be imported.
        """
        if name in self._targets:
            return self._import(self._targets[name])
        for entry in self._entries():
            if entry.name == name:
                return self._loaded(entry.load, entry.value)
        if ":" in name:
            return self._import(name)
        raise ToolkitError(
            f"no plug-in with this name in {self.group}",
            value=name,
            hint=f"known: {', '.join(self.names())}; or give package.module:NAME or file.py:NAME",
        )

    def _import(self, target: str) -> T:
        module, _, attribute = target.rpartition(":")
        load = _module_of_file if module.endswith(".py") else importlib.import_module
        return self._loaded(lambda: getattr(load(module), attribute), target)

    def _loaded(self, load: Callable[[], Any], target: str) -> T:
        try:
            return load()
        except (Exception, SystemExit) as error:  # importing foreign code can raise anything
            if (missing := missing_extra(error)) is not None:
                raise ToolkitError(missing.problem, value=target, hint=missing.hint) from error
            reason = " ".join(str(error).split()) or type(error).__name__
            raise ToolkitError(
                f"cannot import plug-in for {self.group}: {reason}", value=target
            ) from error


class _Alias(Loader):
    def __init__(self, new: str) -> None:
        self.new = new

    def exec_module(self, module: ModuleType) -> None:
        """Replace the module by that of the new name."""
        old = module.__name__
        warnings.warn(f"{old} is now {self.new}", DeprecationWarning, stacklevel=2)
        sys.modules[old] = importlib.import_module(self.new)


class _GonePackage(Loader):
    def exec_module(self, module: ModuleType) -> None:
        """Leave the package empty; look up its own names in their new module."""
        new = RENAMED.get(module.__name__)
        if new is None:
            return

        def attribute(name: str) -> object:
            if name.startswith("__"):
                raise AttributeError(name)
            return getattr(importlib.import_module(new), name)

        module.__dict__["__getattr__"] = attribute


class _Finder(MetaPathFinder):
    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None = None,  # noqa: ARG002 (Python passes both)
        target: ModuleType | None = None,  # noqa: ARG002
    ) -> ModuleSpec | None:
        """The alias of a renamed module, or a package of this distribution; None for others."""
        if fullname in SIBLINGS:
            # Not a folder of the user with this name.
            init = Path(__file__).parent.parent / fullname / "__init__.py"
            return (
                spec_from_file_location(
                    fullname, init, submodule_search_locations=[str(init.parent)]
                )
                if init.is_file()
                else None
            )
        if fullname in _GONE:
            return ModuleSpec(fullname, _GonePackage(), is_package=True)
        new = RENAMED.get(fullname)
        if new is None:
            parent, _, name = fullname.rpartition(".")
            if parent in _GONE or parent not in RENAMED:
                return None
            new = f"{importlib.import_module(RENAMED[parent]).__name__}.{name}"
            if find_spec(new) is None:
                return None
        return ModuleSpec(fullname, _Alias(new))


_FINDER = _Finder()


def install() -> None:
    """Make modules importable under their old names, and find the packages of this distribution."""
    if _FINDER not in sys.meta_path:
        # First in the list: the others would load the modules of a renamed package twice.
        sys.meta_path.insert(0, _FINDER)
