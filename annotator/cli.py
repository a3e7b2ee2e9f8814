"""Entry point of `std-annotate`: the window, the browser, a script, or a comparison."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from annotator.startup import quick_imports
from std_toolkit import __version__
from std_toolkit.cli.command import exit_status
from std_toolkit.errors import ToolkitError
from std_toolkit.log import log_to_stderr

# Words that stand in the place of SCENE; a folder of that name is written ./compare.
COMMANDS = ("compare", "merge")

TOKEN_VARIABLE = "STD_ANNOTATE_TOKEN"

EPILOG = """other commands:
  std-annotate compare A B      how far the labels of two annotators are apart
  std-annotate merge A B ...    one set of labels from those of several
  (a scene folder of such a name is written ./compare)

examples:
  std-annotate scenes/bench_7
  std-annotate scenes/bench_7 --web 8090     then open http://127.0.0.1:8090 (ssh -L from afar)
  std-annotate scenes/bench_7 --script edits.json --annotator mk
data_spec.md tells what a script may hold.
"""


def build_parser() -> argparse.ArgumentParser:
    """The parser of `std-annotate SCENE`; imports no heavy library."""
    parser = argparse.ArgumentParser(
        prog="std-annotate",
        description="Align the CAD meshes of objects to a recorded scene: in a window, in a\n"
        "browser (--web), or by a script (--script). Every edit is on disk at once; what was\n"
        "not saved is offered for recovery when the scene is opened again.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "scene",
        type=Path,
        nargs="?",
        metavar="SCENE",
        help="scene folder (without it the window asks for one)",
    )
    _add_general(parser)
    parser.add_argument(
        "--annotator", metavar="NAME", help="who annotates (default: the user of this computer)"
    )
    parser.add_argument(
        "--read-only", action="store_true", help="look only: nothing can be edited or saved"
    )
    parser.add_argument(
        "--recover",
        choices=("ask", "yes", "no"),
        default="ask",
        help="edits of an earlier session that were not saved: bring them back, or keep them "
        "aside (default: ask; a script needs yes or no then)",
    )
    script = parser.add_argument_group("by a script")
    script.add_argument(
        "--script", type=Path, metavar="FILE", help="carry out the edits in a JSON file"
    )
    web = parser.add_argument_group("a browser")
    web.add_argument("--web", type=_port, metavar="PORT", help="serve on this port (0: any free)")
    web.add_argument("--host", metavar="H", help="address to listen on (default: 127.0.0.1)")
    web.add_argument(
        "--token",
        metavar="T",
        help="secret that a browser must give; needed beyond 127.0.0.1 (default: "
        f"${TOKEN_VARIABLE}, which other users of this computer cannot see)",
    )
    parser.set_defaults(command=None)
    return parser


def build_command_parser() -> argparse.ArgumentParser:
    """The parser of the commands that take the place of SCENE."""
    parser = argparse.ArgumentParser(prog="std-annotate")
    _add_general(parser)
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    importlib.import_module("annotator.compare.compare_cli").add_parsers(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Exit status: 0 done, 1 an error (or labels that do not agree), 2 bad usage."""
    words = list(sys.argv[1:] if argv is None else argv)
    first = next((w for w in words if w not in ("--debug", "--quiet")), None)
    if first in COMMANDS:
        args = build_command_parser().parse_args(words)
        run = args.run
    else:
        parser = build_parser()
        args = parser.parse_args(words)
        _check_usage(parser, args)
        args.host = args.host or "127.0.0.1"
        run = _run_scene
    log_to_stderr(logging.WARNING if args.quiet else logging.INFO)
    return exit_status(
        lambda: run(args),
        program="std-annotate",
        debug=args.debug,
        on_interrupt="edits that were not saved are kept: open the scene again to recover them",
    )


def _add_general(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--version", action="version", version=f"std-toolkit {__version__}")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser.add_argument("--quiet", action="store_true", help="print warnings and errors only")


def _check_usage(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    if args.script is not None and args.web is not None:
        parser.error("--script and --web exclude each other")
    if args.script is not None and args.read_only:
        parser.error("a script edits: it cannot be run with --read-only")
    if args.web is None and (args.host is not None or args.token is not None):
        parser.error("--host and --token go with --web")
    if args.scene is None and (args.script is not None or args.web is not None):
        parser.error("--script and --web need SCENE")


def _run_scene(args: argparse.Namespace) -> int:
    if args.scene is not None and not (args.scene / "scene.json").is_file():
        raise ToolkitError(
            "no scene here (scene.json is missing)",
            path=args.scene,
            hint="make one with `std-curate import`",
        )
    if args.script is not None:
        return int(importlib.import_module("annotator.session.script").run(args))
    if args.web is not None:
        args.token = args.token or os.environ.get(TOKEN_VARIABLE)
        needs = ("aiohttp", "pyvista", "trame", "trame_vuetify")
        app = _front_end("annotator.web.web_app", "web", needs, "a browser")
        return int(app.run(args))
    # What is missing is told before the display: installing it may be done without one.
    app = _front_end("annotator.qt.qt_app", "gui", ("PySide6", "pyvista", "pyvistaqt"), "a window")
    return int(app.run(args))


def _front_end(module: str, extra: str, needs: tuple[str, ...], what: str) -> ModuleType:
    """Import a front end.

    Raises:
        ToolkitError: its libraries are not installed, or do not load; or there is no display.
    """
    missing = [name for name in needs if importlib.util.find_spec(name) is None]
    if missing:
        raise ToolkitError(
            f"annotating in {what} needs {', '.join(missing)}",
            hint=f"pip install 'std-toolkit[{extra}]'",
        )
    if extra == "gui":
        _require_display()
    try:
        with quick_imports():
            return importlib.import_module(module)
    except ImportError as error:
        # Such as a system library that Qt or VTK is linked to.
        raise ToolkitError(
            f"annotating in {what} cannot start: {error}",
            hint=f"pip install 'std-toolkit[{extra}]' and the system libraries that it names",
        ) from error


def _require_display() -> None:
    """Qt without a display ends the process with a page of text about plug-ins."""
    known = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in known):
        raise ToolkitError(
            "there is no display for a window here",
            hint="use --web PORT and a browser (ssh -L PORT:127.0.0.1:PORT from afar), "
            "or --script FILE",
        )


def _port(text: str) -> int:
    value = int(text) if text.isdigit() else -1
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"a port is 0 to 65535, got {text!r}")
    return value


if __name__ == "__main__":
    sys.exit(main())
