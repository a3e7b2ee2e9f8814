"""`std-record`: record a scene with a RealSense camera, or from a librealsense file."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from contextvars import ContextVar
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sensors.record.options import RecordCommand, SessionOptions
from std_toolkit.cli.command import Command, Program, print_json
from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from sensors.record import device_source, realsense, recording_document, recording_session

_DEVICES: ContextVar[Sequence[Any] | None] = ContextVar("devices", default=None)


def main(arguments: Sequence[str] | None = None, *, devices: Sequence[Any] | None = None) -> int:
    """Entry point; returns the exit status.

    Args:
        devices: devices to choose from instead of the connected ones, such as a software device.
    """
    token = _DEVICES.set(devices)
    try:
        return PROGRAM.main(arguments)
    finally:
        _DEVICES.reset(token)


def run(options: RecordCommand) -> None:
    """Record, recover a recording, or list cameras."""
    if options.list or options.scene is None:
        _list(options)
    elif options.recover:
        _recover(options.scene)
    elif options.file is not None and _is_ros(options.file):
        _import_ros(options, options.file, options.scene)
    else:
        _record(options, options.scene)


def _devices() -> Sequence[Any]:
    from sensors.record.realsense import connected

    devices = _DEVICES.get()
    return connected() if devices is None else devices


def _record(options: RecordCommand, scene: Path) -> None:
    from sensors.record.device_source import DeviceSource, open_file
    from sensors.record.realsense import choose, recorded_streams, requested_streams
    from std_toolkit.io.atomic import check_vacant
    from std_toolkit.jobs.live import stopped_by_signal
    from std_toolkit.scene.document import check_name

    session = options.session
    warm_up = (30 if options.file is None else 0) if session.warm_up is None else session.warm_up
    name = check_name(session.name or scene.absolute().name, field="--name")
    session = replace(session, name=name, warm_up=max(0, warm_up))
    # Check the output before a camera is opened.
    if not session.writer.resume:
        if (scene / "scene.json").exists():
            raise ToolkitError(
                "there is a scene here already",
                path=scene,
                hint="--resume adds frames to it; or choose another folder",
            )
        check_vacant(scene)
    infrared = session.writer.files.infrared
    with stopped_by_signal() as stop:
        if options.file is not None:
            device = open_file(options.file)
            streams = recorded_streams(device, options.file, infrared=infrared)
        else:
            device = choose(_devices(), options.serial)
            streams = requested_streams(device, replace(options.streams, infrared=infrared))
        with DeviceSource(
            device,
            streams,
            playback=options.file is not None,
            align=options.align == "librealsense",
            stop=stop,
        ) as source:
            made = _session(options, scene, session, source, streams)
    print(made.summary(scene))


def _is_ros(file: str) -> bool:
    from std_toolkit.importers.foreign_files import is_ros_recording

    return is_ros_recording(Path(file))


def _import_ros(options: RecordCommand, file: str, scene: Path) -> None:
    """Make a scene of a recording of ROS, whose depth is aligned to colour already.

    Raises:
        ToolkitError: an option that only a camera or a file of librealsense has.
    """
    from std_toolkit.importers.import_step import import_recording
    from std_toolkit.importers.options import ImportRequest
    from std_toolkit.scene.document import check_name

    name = check_name(options.session.name or scene.absolute().name, field="--name")
    plain = RecordCommand(scene=scene, file=file, session=SessionOptions(name=options.session.name))
    if options != plain:
        raise ToolkitError(
            "of a recording of ROS, std-record takes SCENE, --from and --name alone",
            path=file,
            hint="`std-curate import` has options of its topics and intrinsics",
        )
    made = import_recording(ImportRequest(source=Path(file), name=name), scene, format_name="ros")
    print(f"{len(made.frames)} frames written to {scene}")
    print(f"next: std-curate poses {shlex.quote(str(scene))}")


def _session(
    options: RecordCommand,
    scene: Path,
    session: SessionOptions,
    source: device_source.DeviceSource,
    streams: dict[str, realsense.Stream],
) -> recording_document.Session:
    from sensors.record.camera_settings import apply_settings, lock
    from sensors.record.live_view import enter_pressed
    from sensors.record.recording_session import record
    from std_toolkit.html.preview import PreviewPage, asked_token
    from std_toolkit.jobs.live import StatusLine

    settings = options.settings
    if options.file is None:
        done = apply_settings(streams, settings)
    elif given := [k for k, v in vars(settings).items() if v is not None]:
        raise ToolkitError(
            "a file is as it was recorded",
            field=f"--{given[0].replace('_', '-')}",
            hint="leave it out",
        )
    else:
        done = {}
    status = StatusLine()
    with ExitStack() as open_parts:
        page = None
        if options.web is not None:
            page = open_parts.enter_context(PreviewPage(options.web, asked_token(options.token)))
            print(f"preview: {page.address}", file=sys.stderr)
        if options.wait:
            print("press Enter to record", file=sys.stderr)
        open_parts.callback(status.end)

        def watch(
            frame: recording_document.CapturedFrame, progress: recording_session.Progress
        ) -> None:
            status.show(progress.line())
            if options.preview is None and page is None:
                return
            from sensors.record.live_view import preview_picture
            from std_toolkit.html.preview import encoded
            from std_toolkit.io.atomic import write_bytes_atomic

            head = progress.line().split("  ")[0]
            unit = source.calibration.depth_unit_m
            picture = encoded(preview_picture(frame, progress.hints, head, unit))
            if page is not None:
                page.show(picture)
            if options.preview is not None:
                write_bytes_atomic(options.preview, picture)

        return record(
            scene,
            source,
            session,
            aligned_by=options.align,
            origin="camera" if options.file is None else Path(options.file).name,
            settings=done,
            started=enter_pressed() if options.wait else lambda: True,
            on_start=lambda frame: lock(streams, settings, frame.exposure_s),
            watch=watch,
        )


def _list(options: RecordCommand) -> None:
    from sensors.record.realsense import device_info

    found = [device_info(device) for device in _devices()]
    if options.json:
        print_json(found)
        return
    for info in found:
        usb = f", USB {info.usb}" if info.usb else ""
        print(f"{info.serial}  {info.name}, firmware {info.firmware or 'unknown'}{usb}")
    if not found:
        print("no RealSense camera is connected")


def _recover(root: Path) -> None:
    from sensors.record.frame_table import recovered
    from std_toolkit.io.locks import scene_lock
    from std_toolkit.scene.scene import Scene

    before = len(Scene.open(root).frames)
    with scene_lock(root):
        after = len(recovered(root).frames)
    print(f"{after} frames in {root}, {after - before} of them brought back")


PROGRAM = Program(
    name="std-record",
    about="Record a scene with a RealSense camera, or from a file.",
    commands=(
        Command(
            name="record",
            about="record a scene",
            options="sensors.record.options:RecordCommand",
            run="sensors.record.cli:run",
        ),
    ),
    on_interrupt="finished frames are in the scene; `--recover` brings back the last frames",
    grace_s=None,  # the frames in memory are still written
)

if __name__ == "__main__":
    sys.exit(main())
