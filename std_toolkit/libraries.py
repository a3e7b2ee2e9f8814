"""Libraries that do more than they are asked: report their use, take signals, fill the memory.

`prepare` is called when one of the four packages is imported, before any of these libraries:

- Variables of the environment switch off what a library would send to its makers. onnxruntime 1.32
  writes a device id and a queue of events below the home folder when it is imported, and looks up
  an address; Ray reports statistics of use. The processes that a command starts inherit them. A
  variable that the user has set stays.
- The log library within pycolmap handles SIGTERM by itself, with a stack trace. While pycolmap
  loads, SIGINT and SIGTERM wait; behind it, the handlers of Python are installed again. Threads
  that other libraries started would still take a signal meanwhile: commands import pycolmap first.
- rosbags unpacks whatever a recording claims; see `std_toolkit.io.bounded_bags`.
"""

import importlib
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

UNREPORTED = {
    "ORT_DISABLE_TELEMETRY": "1",  # onnxruntime
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_DISABLE_USAGE_STATS_PROMPT": "1",
    "NO_MKDOCS_2_WARNING": "true",
    "HF_HUB_DISABLE_TELEMETRY": "1",
    "LIGHTNING_DISABLE_VERSION_CHECK": "1",
    "NO_ALBUMENTATIONS_UPDATE": "1",
    # librealsense 2.59: its viewer sends what the library collects in ~/.rum of each use.
    "RS2_RUM_CLOUD_ENABLED": "0",
    "DO_NOT_TRACK": "1",  # what several libraries ask before they report
}

TAKES_SIGNALS = frozenset({"pycolmap", "pycolmap._core"})

# Modules that unpack recordings, and what bounds that.
UNPACKS = frozenset(
    {"rosbags.rosbag1.reader", "rosbags.rosbag2.reader", "rosbags.rosbag2.storage_mcap"}
)

_BOUND = "std_toolkit.io.bounded_bags:bound"

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def prepare() -> None:
    """Switch reports off, and see to the signals at imports to come."""
    for name, value in UNREPORTED.items():
        os.environ.setdefault(name, value)
    if _FINDER not in sys.meta_path:
        sys.meta_path.insert(0, _FINDER)
        for name in UNPACKS & sys.modules.keys():  # imported before this package
            _bound(sys.modules[name])


def keep_handlers() -> None:
    """Install Python's handlers again after a library replaced them."""
    if threading.current_thread() is threading.main_thread():
        for number in SIGNALS:
            handler = signal.getsignal(number)
            if handler is not None:
                signal.signal(number, handler)


@contextmanager
def signals_waiting() -> Iterator[None]:
    """SIGINT and SIGTERM wait until the block ends, with the handlers as they were before it.

    Only in the main thread, where signals are handled.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        keep_handlers()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Finder(MetaPathFinder):
    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None = None,
        target: ModuleType | None = None,
    ) -> ModuleSpec | None:
        """The library as it is found otherwise, loaded while signals wait; else None."""
        kind = _Waiting if fullname in TAKES_SIGNALS else _Bounding
        if fullname not in TAKES_SIGNALS | UNPACKS:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = kind(spec.loader)
        return spec


class _Wrapped(Loader):
    """The loader of a library, with more around it."""

    def __init__(self, loader: Loader) -> None:
        self.loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self.loader.create_module(spec)

    def __getattr__(self, name: str) -> object:  # get_resource_reader, and what else it has
        return getattr(self.loader, name)


class _Bounding(_Wrapped):
    """The loader of a module that unpacks, which is then bounded."""

    def exec_module(self, module: ModuleType) -> None:
        self.loader.exec_module(module)
        _bound(module)


def _bound(module: ModuleType) -> None:
    where, _, name = _BOUND.partition(":")
    getattr(importlib.import_module(where), name)(module)


class _Waiting(_Wrapped):
    """The loader of a library, while signals wait."""

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        with signals_waiting():
            return self.loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        with signals_waiting():
            self.loader.exec_module(module)


_FINDER = _Finder()
