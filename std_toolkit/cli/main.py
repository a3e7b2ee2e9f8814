"""Entry point of `std-curate`: the table of its commands."""

import sys
from collections.abc import Sequence

from std_toolkit.cli.command import Command, Program


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command. Exit status: 0 done, 1 a failure or failed gate, 2 wrong usage."""
    return PROGRAM.main(arguments)


def with_link_mode(words: list[str]) -> list[str]:
    """`--link` without a mode is `--link hard`.

    >>> with_link_mode(["import", "SRC", "--link", "--out", "SCENE"])
    ['import', 'SRC', '--link', 'hard', '--out', 'SCENE']
    """
    if "import" not in words or "--link" not in words:
        return words
    place = words.index("--link") + 1
    if words[place : place + 1] in (["copy"], ["hard"], ["sym"]):
        return words
    return [*words[:place], "hard", *words[place:]]


def _command(name: str, about: str, run: str, options: str = "") -> Command:
    options = options or f"{name.capitalize()}Command"
    run = f"std_toolkit.cli.{run}"
    return Command(name=name, about=about, options=f"std_toolkit.commands:{options}", run=run)


def _of_project(name: str, about: str) -> Command:
    return Command(
        name=f"project {name}",
        about=about,
        options=f"std_toolkit.project.options:{name.capitalize()}Command",
        run=f"std_toolkit.cli.project:{name}",
    )


PROGRAM = Program(
    name="std-curate",
    about="Curate an RGB-D recording of specular, transparent and diffuse objects: camera poses\n"
    "in metres, 6D labels, ground truth, checks, export.",
    commands=(
        _command("import", "make a scene from a recording", "recording:import_scene"),
        _command(
            "doctor", "tell what an import finds, reads, guesses, ignores", "recording:doctor"
        ),
        _command("info", "print the contents of a scene and the next step", "recording:print_info"),
        _command("poses", "recover camera poses in metres", "recording:recover_poses"),
        _command(
            "trajectory",
            "write the camera poses as CSV, TUM, COLMAP or NeRF files",
            "recording:write_path",
        ),
        _command(
            "label",
            "set or import an object's pose in a frame",
            "labelling:label",
            "LabelArguments",
        ),
        Command(
            name="carry",
            about="carry poses over from a scene of the same table",
            options="std_toolkit.labels.carry.options:CarryCommand",
            run="std_toolkit.cli.labelling:carry",
        ),
        _command(
            "propagate",
            "propagate annotated poses to every registered frame",
            "labelling:propagate",
        ),
        _command(
            "render",
            "render depth, masks, NOCS and normals of the labelled objects",
            "labelling:render",
        ),
        _command(
            "check", "measure the labels, test gates, write an HTML report", "labelling:check"
        ),
        _command(
            "export", "write a labelled scene in the layout of STD, BOP or NOCS", "labelling:export"
        ),
        _command("run", "run poses, propagate --refine, render and check", "labelling:run"),
        _of_project("create", "make a project of many scenes: people, rules, board, queue"),
        _of_project("add", "add scenes and people to a project"),
        _of_project("people", "list the people of a project, make or revoke a person's token"),
        _of_project("status", "print the board of a project, or what is due for a person"),
        _of_project("run", "take every scene of a project through the steps that are due"),
        _of_project("review", "accept the labels of a scene, or send it back with a reason"),
        _of_project("agreement", "compare the scenes of a project that were labelled twice"),
        _of_project("export", "write one data set of all accepted scenes of a project"),
        _command(
            "schema", "print or write the JSON Schema of the documents", "recording:print_schema"
        ),
        _command(
            "settings",
            "print the limits that decide what is accepted, as TOML",
            "recording:print_settings",
        ),
    ),
    rewrite=with_link_mode,
    on_interrupt="run the same command again to resume",
)


if __name__ == "__main__":
    sys.exit(main())
