"""Commands of `std-curate project`."""

from __future__ import annotations

import contextlib
import io
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from std_toolkit import commands, options
from std_toolkit.cli.command import print_json
from std_toolkit.errors import ToolkitError
from std_toolkit.options import JobOptions
from std_toolkit.project.options import (
    AddCommand,
    AgreementCommand,
    CreateCommand,
    ExportCommand,
    PeopleCommand,
    ReviewCommand,
    RunCommand,
    StatusCommand,
)

if TYPE_CHECKING:
    from std_toolkit.project.record import Project
    from std_toolkit.project.status import SceneRow

_LOGS = Path(".std") / "runs"
_SHARED = ("refine", "refine_scale", "poses", "render", "jobs")


def create(command: CreateCommand) -> int:
    """Make a project; 1 if a folder is no scene."""
    from std_toolkit.project.record import Rules, create_project

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


def _made(project: Project, problems: list[ToolkitError]) -> int:
    from std_toolkit.project.shared import share_meshes

    if problems:
        for problem in problems:
            print(f"error: {problem}", file=sys.stderr)
        return 1
    for line in share_meshes(project):
        print(f"note: {line}")
    record = project.record
    people = ", ".join(record.people) or "nobody yet"
    print(f"{project.root}: {len(record.scenes)} scenes, people: {people}")
    return 0


def people(command: PeopleCommand) -> int:
    """List people, or make or revoke a token."""
    from std_toolkit.project.people import make_token, people_table, revoke_token
    from std_toolkit.project.record import Project

    project = Project.open(command.project)
    if command.token is not None and command.revoke is not None:
        raise ToolkitError("--token and --revoke exclude each other")
    if command.revoke is not None:
        revoke_token(project, command.revoke)
        print(f"the token of {command.revoke} is revoked")
    elif command.token is not None:
        token = make_token(project, command.token)
        print(f"{command.token} opens the address of the server with ?token={token}")
        print("note: this is shown once; whoever has it acts in this name", file=sys.stderr)
    else:
        print(people_table(project).terminal())
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
    """Store a review or comment; 1 if something stands against the acceptance."""
    from std_toolkit.project.queue import comment_scene, review_scene
    from std_toolkit.project.record import Project

    project = Project.open(command.project)
    if command.comment is not None:
        if command.accept or command.send_back is not None or command.reason:
            raise ToolkitError("--comment stands alone")
        comment_scene(project, command.scene, by=command.by, text=command.comment)
        print(f"{command.scene}: commented by {command.by}")
        return 0
    against = review_scene(
        project,
        command.scene,
        by=command.by,
        accept=command.accept,
        send_back=command.send_back,
        reasons=command.reason,
    )
    for line in against:
        print(f"error: {command.scene}: {line}", file=sys.stderr)
    if not against:
        told = "noted" if command.send_back is None else "sent back"
        told = "accepted" if command.accept else told
        print(f"{command.scene}: {told} by {command.by}")
    return 1 if against else 0


def run(command: RunCommand) -> int:
    """Take every scene through the steps that are due; 1 if one failed or a label is wrong."""
    from std_toolkit.jobs import run_jobs
    from std_toolkit.project.record import Project
    from std_toolkit.project.shared import make_second, share_meshes
    from std_toolkit.project.status import due_steps, needs_second, project_board

    project = Project.open(command.project)
    for line in share_meshes(project):
        print(f"note: {line}")
    failed: dict[str, str] = {}
    for item, row in zip(project.record.scenes, project_board(project), strict=True):
        if needs_second(row):
            try:
                make_second(project, item)
                print(f"{row.name}: to be labelled again in {project.second(item)}")
            except ToolkitError as error:
                failed[f"{row.name} (second)"] = str(error)
    items = due_steps(project, project_board(project))
    alone = len(items) == 1 and command.jobs.engine != "ray"
    inner = command.jobs if alone else JobOptions(engine="serial", progress=False)
    step = partial(_run_scene, command=replace(command, jobs=inner), logs=project.root / _LOGS)
    report = run_jobs(step, items, name="scenes", key=lambda item: item[0], options=command.jobs)
    failed |= report.failed
    rows = project_board(project)
    wrong = _wrong(rows, [name for name, _, _ in items])
    for name, why in {**failed, **wrong}.items():
        log = project.root / _LOGS / f"{name}.log"
        print(f"failed: {name}: {why}" + (f"; see {log}" if log.is_file() else ""))
    done = len(report.results) - len(wrong.keys() & report.results.keys())
    waiting = sum(row.stage in ("to label", "to correct", "to review", "to fix") for row in rows)
    accepted = sum(row.stage == "accepted" for row in rows)
    print(
        f"{done} scenes done, {len(failed) + len(wrong)} failed; of all {len(rows)}, {waiting} "
        f"wait for a person, {accepted} are accepted"
    )
    return 1 if failed or wrong else 0


def _wrong(rows: list[SceneRow], names: list[str]) -> dict[str, str]:
    """What the check says of the scenes that ran, where it fails them."""
    found = {}
    for row in rows:
        gates = row.scene.check_gates
        wrong = [f"{o.name} is wrong: {o.reason}" for o in row.scene.graded("wrong")]
        if row.name in names and (gates or wrong):
            found[row.name] = "; ".join([*gates, *wrong])
    return found


def _run_scene(item: tuple[str, Path, bool], *, command: RunCommand, logs: Path) -> None:
    """Run what is due in a scene; its output goes to a file, the reason of a failure is raised."""
    from std_toolkit.cli import labelling
    from std_toolkit.io.atomic import write_bytes_atomic

    name, folder, is_second = item
    basics = {key: getattr(command, key) for key in _SHARED}
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            if is_second:
                settings = options.PropagateOptions(
                    refine=command.refine, refine_scale=command.refine_scale
                )
                again = commands.PropagateCommand(scene=folder, options=settings)
                status = labelling.propagate(again)
            else:
                allowed = options.CheckBasics(allow_doubtful=True)
                status = labelling.run(commands.RunCommand(scene=folder, check=allowed, **basics))
    except BaseException as error:
        output.write(f"error: {error}\n")
        raise
    finally:
        write_bytes_atomic(logs / f"{name}.log", output.getvalue().encode())
    lines = output.getvalue().splitlines()
    checked = any(line == "== check" for line in lines)
    if status and not checked:  # the board shows what the check says
        raise ToolkitError(lines[-1] if lines else "failed", path=folder)


def export(command: ExportCommand) -> int:
    """Write one data set of all accepted scenes."""
    from std_toolkit.cli.recording import asked
    from std_toolkit.project.dataset import export_project
    from std_toolkit.project.record import Project
    from std_toolkit.project.status import project_board

    project = Project.open(command.project)
    rows = project_board(project, fresh=True)
    dataset = export_project(
        project,
        rows,
        command.format,
        command.out,
        licence=command.licence,
        shares=command.split,
        by=command.split_by,
        shard_images=command.shards,
        options=options.ExportOptions(**vars(command.options)),
        jobs=asked(command.jobs),
    )
    frames = sum(scene.frames for scene in dataset.scenes)
    print(
        f"{command.out}: {len(dataset.scenes)} scenes, {frames} frames in the layout of "
        f"{dataset.layout}"
    )
    for split, names in dataset.splits.items():
        print(f"{split}: {', '.join(names)}")
    if left := [row.name for row in rows if row.stage != "accepted"]:
        print(f"not accepted and left out: {', '.join(left)}")
    return 0


def agreement(command: AgreementCommand) -> int:
    """Compare scenes that were labelled twice; 1 if labels disagree or are not comparable."""
    from std_toolkit.project import agreement as step
    from std_toolkit.project.record import Project
    from std_toolkit.project.status import project_board

    project = Project.open(command.project)
    found = step.agreement(
        project, project_board(project), names=command.names, options=command.options
    )
    if command.json:
        print_json(found)
    else:
        print("\n".join([step.agreement_table(found).terminal(), *step.agreement_lines(found)]))
    return 1 if found.problems or any(p.verdict != "agree" for p in found.pairs) else 0
