"""Commands of `std-curate project`."""

from __future__ import annotations

import sys

from std_toolkit.cli.command import print_json
from std_toolkit.errors import ToolkitError
from std_toolkit.project.options import AddCommand, CreateCommand, ReviewCommand, StatusCommand


def create(command: CreateCommand) -> int:
    """Make a project; 1 if a folder is no scene."""
    from std_toolkit.project.record import Project, Rules, create_project

    rules = Rules(twice_every=command.twice_every)
    project, problems = create_project(
        command.project, scenes=command.scenes, people=command.people, rules=rules
    )
    return _made(project, problems)


def add(command: AddCommand) -> int:
    """Extend a project; 1 if a folder is no scene."""
    from std_toolkit.project.record import Project, extend_project

    if not command.scenes and not command.people and command.twice_every is None:
        raise ToolkitError("nothing to add", hint="give --scenes, --people or --twice-every")
    project, problems = extend_project(
        Project.open(command.project),
        scenes=command.scenes,
        people=command.people,
        twice_every=command.twice_every,
    )
    return _made(project, problems)


def _made(project, problems) -> int:  # type: ignore[no-untyped-def]
    if problems:
        for problem in problems:
            print(f"error: {problem}", file=sys.stderr)
        return 1
    record = project.record
    people = ", ".join(record.people) or "nobody yet"
    print(f"{project.root}: {len(record.scenes)} scenes, people: {people}")
    return 0


def status(command: StatusCommand) -> int:
    """Print the board, or the queue of a person; 1 if a scene cannot be read."""
    from std_toolkit.project.queue import due_for, due_table
    from std_toolkit.project.record import Project
    from std_toolkit.project.status import board_lines, object_table, project_board, project_table

    project = Project.open(command.project)
    rows = project_board(project)
    if command.person is not None:
        found = due_for(project, rows, command.person)
        if command.json:
            print_json({"person": command.person, "due": found})
        else:
            print(due_table(found).terminal() if found else f"nothing is due for {command.person}")
    elif command.json:
        print_json({"name": project.record.name, "people": project.record.people, "scenes": rows})
    else:
        table = object_table(rows) if command.objects else project_table(rows)
        print("\n".join([*([table.terminal()] if rows else []), *board_lines(rows)]))
    return 1 if any(row.stage == "unreadable" for row in rows) else 0


def review(command: ReviewCommand) -> int:
    """Store a review; 1 if something stands against the acceptance."""
    from std_toolkit.project.queue import review_scene
    from std_toolkit.project.record import Project

    against = review_scene(
        Project.open(command.project),
        command.scene,
        by=command.by,
        accept=command.accept,
        send_back=command.send_back,
        reasons=command.reason,
    )
    for line in against:
        print(f"error: {command.scene}: {line}", file=sys.stderr)
    if not against:
        told = "accepted" if command.accept else "noted" if command.send_back is None else "sent back"
        print(f"{command.scene}: {told} by {command.by}")
    return 1 if against else 0
