"""Commands of `std-curate` before labelling: import, info, poses, trajectory, schema."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from std_toolkit.cli.command import print_json
from std_toolkit.commands import (
    DoctorCommand,
    ImportCommand,
    InfoCommand,
    PosesCommand,
    SchemaCommand,
    SettingsCommand,
    TrajectoryCommand,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.importers.options import ImportRequest
from std_toolkit.options import JobOptions

if TYPE_CHECKING:
    from std_toolkit.scene.model import CameraPoses
    from std_toolkit.scene.scene import Scene


def import_scene(command: ImportCommand) -> int:
    """Make the scene and print its summary."""
    if command.options.known.cameras is not None:
        import pycolmap  # noqa: F401 - first: see `std_toolkit.libraries`

    from std_toolkit.checks.summary import summarise
    from std_toolkit.importers.depth_survey import with_unit_asked
    from std_toolkit.importers.foreign_files import is_ros_recording
    from std_toolkit.importers.import_step import import_recording
    from std_toolkit.scene.document import check_name, safe_name

    source = command.source or command.options.color
    both = command.source and command.options.color and not is_ros_recording(command.source)
    if source is None or both:
        raise ToolkitError("give either SOURCE or --color", hint="see `std-curate import --help`")
    if command.name:
        name = check_name(command.name, field="--name")
    else:
        name = safe_name(command.out.resolve().name)
    request = ImportRequest(source=Path(source), name=name, **vars(command.options))

    def run(depth_scale: float | None) -> Scene:
        return import_recording(
            request if depth_scale is None else replace(request, depth_scale=depth_scale),
            command.out,
            format_name=command.format,
            link=command.link,
            options=asked(command.jobs),
        )

    scene = with_unit_asked(run)
    print("\n".join(summarise(scene).lines()))
    if command.options.known.cameras is None or scene.poses is None:
        return 0
    from std_toolkit.poses.pose_gates import pose_lines

    print("\n".join(pose_lines(scene.poses, [f.name for f in scene.frames])))
    return report_failed_gates(scene.poses)


def doctor(command: DoctorCommand) -> int:
    """Print what an import would find; 1 if it would stop."""
    from std_toolkit.importers.doctor import examine

    source = command.source or command.options.color
    if source is None:
        raise ToolkitError("give a folder or file, or --color", hint="see doctor --help")
    request = ImportRequest(source=Path(source), name="doctor", **vars(command.options))
    report = examine(request, format_name=command.format)
    if command.json:
        print_json([{"kind": kind, "text": text} for kind, text in report.rows])
    else:
        print("\n".join(report.lines()))
    return 1 if report.is_refused else 0


def asked(jobs: JobOptions) -> JobOptions | None:
    """None if no option was given: the step may then run short work without processes."""
    return None if jobs == JobOptions() else jobs


def print_info(command: InfoCommand) -> int:
    """Print the summary of a scene, or its frames; of several scenes, a row each."""
    from std_toolkit.checks.summary import frame_table, list_frames, summarise
    from std_toolkit.scene.scene import Scene

    if len(command.scenes) > 1:
        return _print_board(command)
    scene = Scene.open(command.scenes[0])
    if command.frames:
        rows = list_frames(scene)
        if command.json:
            print_json([asdict(row) for row in rows])
        else:
            print(frame_table(rows).terminal())
        return 0
    summary = summarise(scene)
    if command.json:
        print_json({**asdict(summary), "root": str(summary.root)})
    else:
        print("\n".join(summary.lines()))
    return 0


def _print_board(command: InfoCommand) -> int:
    from std_toolkit.project.board import board, board_table, doubts

    if command.frames:
        raise ToolkitError("lists the frames of one scene", field="--frames")
    scenes = board(command.scenes)
    if command.json:
        print_json({"scenes": scenes})
    else:
        print("\n".join([board_table(scenes).terminal(), *doubts(scenes)]))
    return 1 if any(scene.problem for scene in scenes) else 0


def recover_poses(command: PosesCommand) -> int:
    """Recover camera poses; 1 if a gate failed."""
    import pycolmap  # noqa: F401 - first: see `std_toolkit.libraries`

    from std_toolkit.poses.pose_gates import pose_lines
    from std_toolkit.poses.pose_step import estimate_poses
    from std_toolkit.scene.scene import Scene

    scene = Scene.open(command.scene)
    poses = estimate_poses(scene, command.options, jobs=command.jobs)
    if command.json:
        print_json(poses)
    else:
        print("\n".join(pose_lines(poses, [f.name for f in scene.frames])))
    return report_failed_gates(poses)


def report_failed_gates(poses: CameraPoses) -> int:
    """Print the failed gates; 1 if there are any."""
    from std_toolkit.log import logger
    from std_toolkit.poses.pose_gates import failed_gates

    failed = failed_gates(poses)
    for line in failed:
        logger.error("gate failed: %s", line)
    return 1 if failed else 0


def write_path(command: TrajectoryCommand) -> int:
    """Write the trajectory."""
    from std_toolkit.poses.trajectory import write_trajectory
    from std_toolkit.scene.scene import Scene

    scene = Scene.open(command.scene)
    write_trajectory(scene, command.out, format=command.format)
    done, total = len(scene.registered_frames()), len(scene.frames)
    print(f"{command.out}: {done} of {total} frames have a pose")
    return 0


def print_schema(command: SchemaCommand) -> int:
    """Print or write JSON Schemas."""
    from std_toolkit.cli.document_schema import document_types, schema_bytes, write_schemas

    if command.out is not None:
        print("\n".join(str(path) for path in write_schemas(command.out)))
    elif command.document is not None:
        print(schema_bytes(command.document).decode(), end="")
    else:
        print("\n".join(document_types()))
    return 0


def print_settings(command: SettingsCommand) -> int:
    """Print the limits in force."""
    from std_toolkit.settings import every_group, settings_text

    groups = [
        kind
        for kind in every_group()
        if f"{kind.group}.".startswith(f"{command.group}." if command.group else "")
    ]
    if not groups:
        raise ToolkitError("no group of settings has this name", value=command.group)
    print("\n\n".join(settings_text(kind) for kind in groups))
    return 0
