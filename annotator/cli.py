"""`std-annotate`: annotate in a window, a browser or a script; compare and merge annotators."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from annotator.options import TOKEN_VARIABLE
from annotator.startup import front_end
from std_toolkit.cli.command import Command, Program, print_json
from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from annotator.options import AnnotateOptions, CompareCommand, MergeCommand


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return PROGRAM.main(arguments)


def open_scene(options: AnnotateOptions) -> int:
    """Annotate a scene."""
    project = options.scene is not None and (options.scene / "project.json").is_file()
    if project and (options.script is not None or options.read_only or options.recover != "ask"):
        raise ToolkitError(
            "--script, --read-only and --recover are for one scene, and this is a project",
            path=options.scene,
            hint="name the folder of a scene",
        )
    if options.scene is not None and not project and not (options.scene / "scene.json").is_file():
        raise ToolkitError(
            "no scene here (scene.json is missing)",
            path=options.scene,
            hint="make one with `std-curate import`",
        )
    if options.script is not None:
        script = importlib.import_module("annotator.session.script")
        doubt = importlib.import_module("annotator.app.pose_checks").ScriptDoubt()
        who, recover = options.annotator, options.recover
        done = script.run(
            options.scene, options.script, annotator=who, recover=recover, doubt=doubt
        )
        return int(done)
    if options.web is not None:
        token = options.token or os.environ.get(TOKEN_VARIABLE)
        needs = ("aiohttp", "pyvista", "trame", "trame_vuetify")
        module = "annotator.web.board_app" if project else "annotator.web.web_app"
        app = front_end(module, "web", needs, "a browser")
        return int(app.run(replace(options, token=token)))
    # Report missing packages before a missing display: installing needs no display.
    app = front_end("annotator.qt.qt_app", "gui", ("PySide6", "pyvista", "pyvistaqt"), "a window")
    return int(app.run(options))


def compare(options: CompareCommand) -> int:
    """Compare two annotators; returns 1 if an object labelled by both disagrees."""
    from annotator.compare import compare_labels
    from annotator.compare.comparison_report import (
        comparison_document,
        comparison_lines,
        file_names,
        write_csv,
        write_pictures,
        write_tables,
    )
    from std_toolkit.jobs.door import own_files
    from std_toolkit.scene.scene import Scene

    comparison = compare_labels(Scene.open(options.a), Scene.open(options.b), options.options)
    if options.json:
        print_json(comparison_document(comparison))
    else:
        print("\n".join(comparison_lines(comparison)))
    if options.csv is not None:
        write_csv(comparison, options.csv)
    if options.out is not None:
        with own_files(options.out, file_names(comparison)):
            written = write_tables(comparison, options.out)
            written += write_pictures(comparison, options.out)
        if not options.json:
            print(f"written: {', '.join(str(p) for p in written)}")
    return 1 if comparison.disagreements else 0


def merge(options: MergeCommand) -> int:
    """Merge annotators; returns 1 if an object is left without a label."""
    from annotator.compare import merge_labels
    from annotator.compare.comparison_report import merge_lines
    from annotator.compare.merge_output import check_target, write_into, write_scene
    from std_toolkit.io.atomic import check_vacant
    from std_toolkit.scene.scene import Scene

    # Fail before the computation, not after it.
    if options.out is not None:
        check_vacant(options.out)
    if options.into is not None:
        check_target(options.into, options.scenes)
    scenes = [Scene.open(path) for path in options.scenes]
    target = None if options.into is None else Scene.open(options.into)
    merged = merge_labels(scenes, options.options, target=target)
    if options.out is not None:
        written = write_scene(merged, options.out)
    else:
        written = write_into(merged, overwrite=options.overwrite)
    print("\n".join(merge_lines(merged, written.root)))
    return 1 if merged.open else 0


def _with_command(words: list[str]) -> list[str]:
    """Insert the default command; a folder named like a command is written `./compare`."""
    first = next((word for word in words if word not in ("--quiet", "--debug")), "")
    others = ("open", "compare", "merge", "-h", "--help", "--version", "--print-completion")
    return words if first in others else ["open", *words]


def _command(name: str, about: str, kind: str, function: str) -> Command:
    return Command(
        name=name, about=about, options=f"annotator.options:{kind}", run=f"annotator.cli:{function}"
    )


PROGRAM = Program(
    name="std-annotate",
    about="Align the CAD meshes of objects to a recorded scene, and compare annotators.",
    commands=(
        _command(
            "open",
            "annotate a scene (also without the word: std-annotate [SCENE] ...)",
            "AnnotateOptions",
            "open_scene",
        ),
        _command(
            "compare", "labels of two annotators of one recording", "CompareCommand", "compare"
        ),
        _command("merge", "one set of labels from those of several", "MergeCommand", "merge"),
    ),
    default="open",
    rewrite=_with_command,
    on_interrupt="edits that were not saved are kept: open the scene again to recover them",
)

if __name__ == "__main__":
    sys.exit(main())
