"""`std-record`: record a scene with a RealSense camera, or from a file that one recorded."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from std_toolkit import __version__
from std_toolkit.cli.command import exit_status
from std_toolkit.log import log_to_stderr

if TYPE_CHECKING:
    from sensors.record.camera_settings import CameraSettings
    from sensors.record.device_source import DeviceSource
    from sensors.record.realsense import Stream
    from sensors.record.recording_document import CapturedFrame, Session
    from sensors.record.recording_session import Progress, SessionOptions


def build_parser() -> argparse.ArgumentParser:
    """The parser, without any heavy import."""
    parser = argparse.ArgumentParser(
        prog="std-record",
        description="Record a scene with a RealSense camera, or from a .bag or .db3 file that "
        "librealsense recorded. Ctrl-C ends a recording; what was finished is a scene at any time.",
    )
    parser.add_argument("scene", type=Path, nargs="?", help="folder of the new scene")
    parser.add_argument("--from", dest="file", metavar="FILE", help="read a .bag or .db3 file")
    parser.add_argument(
        "--resume", action="store_true", help="add frames to the scene that is there"
    )
    parser.add_argument(
        "--recover",
        action="store_true",
        help="only bring back all finished frames of a recording that was killed",
    )
    parser.add_argument("--list", action="store_true", help="show connected cameras and end")
    parser.add_argument("--name", help="of the scene (default: its folder's)")
    parser.add_argument("--debug", action="store_true", help="errors with their traceback")
    parser.add_argument("--version", action="version", version=f"std-record {__version__}")
    _add_camera(parser)
    _add_extent(parser)
    _add_files(parser)
    _add_preview(parser)
    return parser


def _add_camera(parser: argparse.ArgumentParser) -> None:
    camera = parser.add_argument_group("camera")
    camera.add_argument("--serial", help="of the camera, if several are connected")
    camera.add_argument(
        "--color", type=_size, default=(1280, 720), metavar="WxH", help="default 1280x720"
    )
    camera.add_argument(
        "--depth", type=_size, default=(1280, 720), metavar="WxH", help="default 1280x720"
    )
    camera.add_argument("--fps", type=_count, default=30, help="default 30")
    camera.add_argument(
        "--exposure",
        type=_word_or_number("auto", "lock"),
        metavar="auto|lock|MS",
        help="of colour: automatic, automatic until recording starts, or milliseconds",
    )
    camera.add_argument(
        "--white-balance", type=_word_or_number("auto", "lock"), metavar="auto|lock|KELVIN"
    )
    camera.add_argument("--gain", type=float, help="of colour")
    camera.add_argument(
        "--infrared-exposure", type=_word_or_number("auto"), metavar="auto|MS", help="of depth"
    )
    camera.add_argument(
        "--laser",
        type=_word_or_number("off", "on", "max"),
        metavar="off|on|max|MW",
        help="projector of the dots",
    )
    camera.add_argument(
        "--preset", help="of the depth camera: high-accuracy, high-density, hand, default"
    )
    camera.add_argument(
        "--sensor", help="specification that the camera should fit (default: its model's)"
    )


def _add_extent(parser: argparse.ArgumentParser) -> None:
    extent = parser.add_argument_group("how much")
    extent.add_argument("--frames", type=_count, help="end after so many")
    extent.add_argument("--seconds", type=_positive, help="end after so long")
    extent.add_argument("--every", type=_count, default=1, metavar="N", help="keep each N-th")
    extent.add_argument(
        "--warm-up",
        type=int,
        metavar="N",
        help="images left out at the start while exposure settles (default 30; of a file 0)",
    )
    extent.add_argument(
        "--wait", action="store_true", help="only show the preview until Enter is pressed"
    )


def _add_files(parser: argparse.ArgumentParser) -> None:
    files = parser.add_argument_group("files")
    files.add_argument(
        "--align",
        choices=("toolkit", "librealsense"),
        default="toolkit",
        help="who brings depth to the colour image",
    )
    files.add_argument("--color-format", choices=("jpg", "png"), default="jpg")
    files.add_argument("--quality", type=_quality, default=95, help="of jpg, 50 to 100")
    files.add_argument(
        "--infrared", action="store_true", help="keep both infrared images in reference/"
    )
    files.add_argument(
        "--raw-depth", action="store_true", help="keep depth as the camera gave it in reference/"
    )
    files.add_argument("--threads", type=_count, help="that write (default: cores, at most 8)")
    files.add_argument(
        "--queue", type=_count, default=48, help="frames that may wait to be written (default 48)"
    )
    files.add_argument(
        "--keep-free", type=_positive, default=1.0, metavar="GB", help="of the disk (default 1)"
    )


def _add_preview(parser: argparse.ArgumentParser) -> None:
    preview = parser.add_argument_group("preview")
    preview.add_argument(
        "--preview", type=Path, metavar="FILE.jpg", help="picture that is replaced all the while"
    )
    preview.add_argument(
        "--web", type=int, metavar="PORT", help="preview page for a browser on this machine"
    )


def main(argv: Sequence[str] | None = None, *, devices: Sequence[Any] | None = None) -> int:
    """Run the command. Exit status: 0 done, 1 a failure, 2 bad usage.

    Args:
        devices: to choose from instead of those that are plugged in, such as a software device.
    """
    parser = build_parser()
    args = parser.parse_args(argv)
    if args.scene is None and not args.list:
        parser.error("the following argument is required: scene")
    log_to_stderr(logging.INFO)
    return exit_status(
        lambda: _run(args, devices),
        program="std-record",
        debug=args.debug,
        on_interrupt="what was finished is in the scene; `--recover` brings back the last frames",
    )


def _run(args: argparse.Namespace, devices: Sequence[Any] | None) -> int:
    if args.list:
        return _list(devices)
    if args.recover:
        return _recover(args.scene)
    from sensors.record.device_source import DeviceSource, open_file
    from sensors.record.live_view import stopped_by_signal
    from sensors.record.realsense import (
        StreamRequest,
        choose,
        connected,
        recorded_streams,
        requested_streams,
    )
    from std_toolkit.errors import ToolkitError
    from std_toolkit.io.atomic import check_vacant

    options = _session_options(args)
    # What cannot be written is refused before a camera is touched.
    if not args.resume:
        if (args.scene / "scene.json").exists():
            raise ToolkitError(
                "there is a scene here already",
                path=args.scene,
                hint="--resume adds frames to it; or choose another folder",
            )
        check_vacant(args.scene)
    with stopped_by_signal() as stop:
        if args.file is not None:
            device = open_file(args.file)
            streams = recorded_streams(device, args.file, infrared=args.infrared)
        else:
            device = choose(connected() if devices is None else devices, args.serial)
            request = StreamRequest(args.color, args.depth, args.fps, args.infrared)
            streams = requested_streams(device, request)
        with DeviceSource(
            device,
            streams,
            playback=args.file is not None,
            align=args.align == "librealsense",
            stop=stop,
        ) as source:
            session = _record(args, options, source, streams)
    print(_summary(args.scene, session))
    return 0


def _record(
    args: argparse.Namespace,
    options: SessionOptions,
    source: DeviceSource,
    streams: dict[str, Stream],
) -> Session:
    from sensors.record.camera_settings import apply_settings, lock
    from sensors.record.live_view import PreviewPage, StatusLine, enter_pressed
    from sensors.record.recording_session import record
    from std_toolkit.errors import ToolkitError

    settings = _settings(args)
    if args.file is None:
        done = apply_settings(streams, settings)
    elif given := [k for k, v in vars(settings).items() if v is not None]:
        raise ToolkitError(
            "a file is as it was recorded", field=f"--{given[0].replace('_', '-')}",
            hint="leave it out",
        )  # fmt: skip
    else:
        done = {}
    status = StatusLine()
    with ExitStack() as open_parts:
        page = None
        if args.web is not None:
            page = open_parts.enter_context(PreviewPage(args.web))
            print(f"preview: {page.address}", file=sys.stderr)
        if args.wait:
            print("press Enter to record", file=sys.stderr)
        open_parts.callback(status.end)

        def watch(frame: CapturedFrame, progress: Progress) -> None:
            status.show(progress.line())
            if args.preview is None and page is None:
                return
            from sensors.record.live_view import encoded, preview_picture, write_preview

            head = progress.line().split("  ")[0]
            unit = source.calibration.depth_unit_m
            picture = encoded(preview_picture(frame, progress.hints, head, unit))
            if page is not None:
                page.show(picture)
            if args.preview is not None:
                write_preview(args.preview, picture)

        return record(
            args.scene,
            source,
            options,
            aligned_by=args.align,
            origin="camera" if args.file is None else Path(args.file).name,
            settings=done,
            started=enter_pressed() if args.wait else lambda: True,
            on_start=lambda frame: lock(streams, settings, frame.exposure_s),
            watch=watch,
        )


def _session_options(args: argparse.Namespace) -> SessionOptions:
    from sensors.record.frame_files import FileOptions
    from sensors.record.recording_session import SessionOptions
    from sensors.record.scene_writer import WriterOptions
    from std_toolkit.scene.document import check_name

    name = args.name or args.scene.absolute().name
    check_name(name, field="--name")
    warm_up = args.warm_up if args.warm_up is not None else (30 if args.file is None else 0)
    files = FileOptions(args.color_format, args.quality, args.infrared, args.raw_depth)
    writer = WriterOptions(
        files=files,
        queue=args.queue,
        keep_free_bytes=int(args.keep_free * 1e9),
        resume=args.resume,
        **({} if args.threads is None else {"threads": args.threads}),
    )
    return SessionOptions(
        name=name,
        frames=args.frames,
        seconds=args.seconds,
        every=args.every,
        warm_up=max(0, warm_up),
        sensor=args.sensor,
        writer=writer,
    )


def _settings(args: argparse.Namespace) -> CameraSettings:
    from sensors.record.camera_settings import CameraSettings

    return CameraSettings(
        exposure=args.exposure,
        white_balance=args.white_balance,
        gain=args.gain,
        infrared_exposure=args.infrared_exposure,
        laser=args.laser,
        preset=args.preset,
    )


def _summary(scene: Path, session: Session) -> str:
    import shlex

    lost = max(session.lost.values(), default=0)
    single = sum(session.single.values())
    lines = [
        f"{session.frames} frames in {session.seconds:.1f} s written to {scene}",
        f"dropped: {session.dropped} because writing was behind, {lost} lost before they arrived, "
        f"{single} images without a partner",
    ]
    if session.dropped:
        lines.append(
            "to drop none: more --threads, --color-format jpg, a lower --fps, a faster disk"
        )
    return "\n".join([*lines, f"next: std-curate poses {shlex.quote(str(scene))}"])


def _list(devices: Sequence[Any] | None) -> int:
    from sensors.record.realsense import connected, device_info

    found = [device_info(d) for d in (connected() if devices is None else devices)]
    for info in found:
        usb = f", USB {info.usb}" if info.usb else ""
        print(f"{info.serial}  {info.name}, firmware {info.firmware or 'unknown'}{usb}")
    if not found:
        print("no RealSense camera is connected")
    return 0


def _recover(root: Path) -> int:
    from sensors.record.frame_table import recovered
    from std_toolkit.io.atomic import scene_lock
    from std_toolkit.scene.scene import Scene

    before = len(Scene.open(root).frames)
    with scene_lock(root):
        after = len(recovered(root).frames)
    print(f"{after} frames in {root}, {after - before} of them brought back")
    return 0


def _size(text: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(p.isdigit() and int(p) > 0 for p in parts):
        raise argparse.ArgumentTypeError(f"not a size such as 1280x720: {text}")
    return int(parts[0]), int(parts[1])


def _count(text: str) -> int:
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"not a whole number above 0: {text}")
    return int(text)


def _quality(text: str) -> int:
    if not text.isdigit() or not 50 <= int(text) <= 100:
        raise argparse.ArgumentTypeError(f"not a whole number from 50 to 100: {text}")
    return int(text)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"not a number above 0: {text}")
    return value


def _word_or_number(*words: str) -> Any:
    def parse(text: str) -> str | float:
        if text in words:
            return text
        try:
            return _positive(text)
        except argparse.ArgumentTypeError:
            raise argparse.ArgumentTypeError(
                f"not {', '.join(words)} or a number above 0: {text}"
            ) from None

    return parse


if __name__ == "__main__":
    sys.exit(main())
