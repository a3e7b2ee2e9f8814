"""Commands of `std-curate` before labelling: import, info, poses, trajectory, schema."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs.options import JobOptions
from std_toolkit.options import ImportOptions, ImportRequest, LinkMode, PoseOptions

if TYPE_CHECKING:
    from std_toolkit.scene.model import CameraPoses, ScaleReport


@dataclass(frozen=True, kw_only=True)
class ImportCommand:
    """Make a scene from a recording.

    Give SOURCE of a known format, or separate images with --color, --intrinsics and optionally
    --depth. Of a recording of ROS with several cameras, --color and --depth name topics.
    """

    source: Path | None = field(default=None, metadata={"option": ""})
    """folder of a recording in a known format, or a recording of ROS (rosbag2, .mcap, .db3,
    .bag)"""
    out: Path = field(metadata={"option": "out"})
    """new scene folder"""
    name: str | None = None
    """name of the scene (default: name of its folder)"""
    format: str | None = None
    """folder, ros, std, dreds, bop, nocs, cleargrasp or a plug-in (default: detected from
    SOURCE)"""
    options: ImportOptions = field(default_factory=ImportOptions)
    link: LinkMode = "copy"
    """copy images that need no conversion, or make hard or symbolic links; --link alone means
    --link hard"""
    jobs: JobOptions = field(default_factory=JobOptions)


def import_scene(command: ImportCommand) -> int:
    """Make the scene and print its summary."""
    from std_toolkit.checks.summary import summarise
    from std_toolkit.importers.import_step import import_recording
    from std_toolkit.importers.ros_importer import is_ros_recording
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
    scene = import_recording(
        request,
        command.out,
        format_name=command.format,
        link=command.link,
        options=asked(command.jobs),
    )
    print("\n".join(summarise(scene).lines()))
    if command.options.known.cameras is None or scene.poses is None:
        return 0
    print("\n".join(pose_lines(scene.poses, [f.name for f in scene.frames])))
    return report_failed_gates(scene.poses)


def asked(jobs: JobOptions) -> JobOptions | None:
    """None if no option was given: the step may then run short work without processes."""
    return None if jobs == JobOptions() else jobs


@dataclass(frozen=True, kw_only=True)
class InfoCommand:
    """Print the contents of a scene, what is missing, and the next command."""

    scene: Path
    """scene folder"""
    frames: bool = False
    """list the frames instead: id, name, files, registered, labelled"""
    json: bool = False
    """print JSON"""


def print_info(command: InfoCommand) -> int:
    """Print the summary of a scene, or its frames."""
    from std_toolkit.checks.summary import frame_table, list_frames, summarise
    from std_toolkit.scene.scene import Scene

    scene = Scene.open(command.scene)
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


def print_json(data: Any) -> None:
    """Print data as indented JSON."""
    import msgspec

    print(msgspec.json.format(msgspec.json.encode(data), indent=2).decode())


@dataclass(frozen=True, kw_only=True)
class PosesCommand:
    """Recover the camera pose of every frame with structure from motion.

    With --cameras, known poses are checked against the images and used instead. The metric scale
    is estimated from every source that the scene has. If a quality gate fails, the exit status is
    1 and the poses are saved with the failed gate.
    """

    scene: Path
    """scene folder"""
    options: PoseOptions = field(default_factory=PoseOptions)
    json: bool = False
    """print the result as JSON"""
    jobs: JobOptions = field(default_factory=JobOptions)


def recover_poses(command: PosesCommand) -> int:
    """Recover camera poses; 1 if a gate failed."""
    import pycolmap  # noqa: F401 - here, because it replaces the handlers of signals

    from std_toolkit.jobs.interrupt import keep_handlers
    from std_toolkit.poses.pose_step import estimate_poses
    from std_toolkit.scene.scene import Scene

    keep_handlers()
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
    from std_toolkit.poses.pose_step import failed_gates

    failed = failed_gates(poses)
    for line in failed:
        logger.error("gate failed: %s", line)
    return 1 if failed else 0


def pose_lines(poses: CameraPoses, names: list[str]) -> list[str]:
    """Summary lines of the camera poses."""
    lost = [name for p, name in zip(poses.frames, names, strict=True) if p.status != "registered"]
    lines = [f"registered {len(names) - len(lost)} of {len(names)} frames"]
    if lost:
        lines.append(f"  unregistered: {', '.join(lost[:8])}{' ...' if len(lost) > 8 else ''}")
    lines += [f"  note: {note}" for note in poses.notes]
    for gate in poses.gates:
        mark = "ok    " if gate.passed else "FAILED"
        lines.append(f"  {mark} {gate.name}: {gate.value:.4g} (limit {gate.limit:.4g})")
    if poses.scale is not None:
        lines.append(_scale_line(poses.scale))
        lines += [
            f"  {e.source}: {e.factor:.6g} m per unit, spread {100 * e.spread:.2f} %, "
            f"standard error {100 * e.standard_error:.3f} %, deviation {100 * e.sigma:.2f} %, "
            f"n = {e.count} ({e.note})"
            for e in poses.scale.estimates
        ]
    for key, camera in poses.cameras.items():
        values = " ".join(f"{v:.2f}" for v in (camera.fx, camera.fy, camera.cx, camera.cy))
        extra = " ".join(f"{v:.4f}" for v in camera.distortion)
        lines.append(f"camera {key}: {values}" + (f" distortion {extra}" if extra else ""))
    return lines


def _scale_line(scale: ScaleReport) -> str:
    line = f"scale: {scale.chosen}, unit {scale.unit}"
    if scale.factor is not None:
        line += f", {scale.factor:.6g} m per unit +- {100 * scale.applied_sigma:.2f} %"
    if len(scale.fused) > 1:
        line += f", weighted mean of {', '.join(scale.fused)}"
    return line


@dataclass(frozen=True, kw_only=True)
class TrajectoryCommand:
    """Write the camera poses, in metres, for other tools."""

    scene: Path
    """scene folder"""
    out: Path = field(metadata={"option": "out"})
    """output file; for colmap, output folder"""
    format: Literal["csv", "tum", "colmap", "nerf"] = "csv"
    """csv (one row per frame, T_world_cam row-major), tum, colmap (text model) or nerf
    (transforms.json, OpenGL axes)"""


def write_path(command: TrajectoryCommand) -> int:
    """Write the trajectory."""
    from std_toolkit.poses.trajectory import write_trajectory
    from std_toolkit.scene.scene import Scene

    scene = Scene.open(command.scene)
    write_trajectory(scene, command.out, format=command.format)
    done, total = len(scene.registered_frames()), len(scene.frames)
    print(f"{command.out}: {done} of {total} frames have a pose")
    return 0


@dataclass(frozen=True, kw_only=True)
class SchemaCommand:
    """Print the JSON Schema of one document, write all schemas, or list the documents."""

    document: str | None = field(default=None, metadata={"option": ""})
    """name of a document, such as scene or poses"""
    out: Path | None = None
    """write all schemas to this folder"""


def print_schema(command: SchemaCommand) -> int:
    """Print or write JSON Schemas."""
    from std_toolkit.checks.document_schema import document_types, schema_bytes, write_schemas

    if command.out is not None:
        print("\n".join(str(path) for path in write_schemas(command.out)))
    elif command.document is not None:
        print(schema_bytes(command.document).decode(), end="")
    else:
        print("\n".join(document_types()))
    return 0


@dataclass(frozen=True, kw_only=True)
class SettingsCommand:
    """Print the limits that decide what is accepted, as a file for `--settings`."""

    group: str = field(default="", metadata={"option": ""})
    """name of a group or of several, such as checks.gates (default: all)"""


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
