"""Recordings of ROS: rosbag2 (SQLite and MCAP) and the .bag of ROS 1.

The recording contains colour, depth aligned to colour, and the camera's `camera_info`. Images are
written to files, JPEG and PNG as recorded; colour and depth are paired by their time stamps.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from std_toolkit.errors import ToolkitError, missing_extra
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.filed_cameras import camera_of_fields
from std_toolkit.geometry.intrinsics import Intrinsics
from std_toolkit.importers.foreign_files import (
    check_database,
    check_message_sizes,
    is_ros_recording,
    refuse_message,
)
from std_toolkit.importers.importer import Recording, SourceFile, SourceFrame
from std_toolkit.importers.intrinsics import read_intrinsics, told, with_distortion
from std_toolkit.importers.options import ImportRequest
from std_toolkit.importers.ros_images import (
    COLOR_ENCODINGS,
    DEPTH_ENCODINGS,
    GREY_ENCODINGS,
    RosImage,
    image_of,
    pair_stamps,
    write_image,
)
from std_toolkit.io.bounded_bags import LARGEST_MESSAGE_BYTES
from std_toolkit.jobs.door import regular
from std_toolkit.log import logger

_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
# REP 118: 16-bit depth is in millimetres, floating-point depth in metres.
_UNIT_M = 0.001
_TRANSPORTS = ("compressed", "compressedDepth")


@dataclass(frozen=True)
class ImageTopic:
    """A topic with images.

    Attributes:
        first: its first image, undecoded.
        connections: of the reader.
    """

    name: str
    first: RosImage
    connections: tuple[Any, ...]

    @property
    def base(self) -> str:
        """The name without the image transport."""
        stem, _, last = self.name.rpartition("/")
        return stem if last in _TRANSPORTS else self.name


class RosImporter:
    """Reads recordings of ROS. `--color` and `--depth` name topics if several could be meant."""

    def recognises(self, source: Path) -> bool:
        """See `Importer`."""
        return is_ros_recording(source)

    def read(self, request: ImportRequest) -> Recording:
        """See `Importer`. Images are written to `request.workspace`.

        Raises:
            ToolkitError: the package `rosbags` is missing, the recording is damaged or has no
                colour, topics cannot be told apart, depth is not aligned to colour, or the
                intrinsics are missing or do not fit.
        """
        assert request.workspace is not None, "images of ROS are written to files"
        with _opened(request.source) as reader:
            topics = _image_topics(reader, request.source)
            color = _chosen(topics, request.color, "color", request.source)
            depth = None
            if request.depth is not None or any(
                t.first.encoding in DEPTH_ENCODINGS or _looks_like_depth(t)
                for t in topics
                if t is not color
            ):
                near = color.first.frame_id
                depth = _chosen(topics, request.depth, "depth", request.source, near=near)
                _check_aligned(color, depth, request)
            camera = _camera(reader, color, request)
            frames, unpaired = _frames(reader, color, depth, request.workspace, request)
        scale = request.depth_scale or _UNIT_M
        units = any(f.depth is not None and f.depth.source.suffix == ".png" for f in frames)
        with_depth = "" if depth is None else f", depth of {depth.name}"
        logger.info("colour of %s%s", color.name, with_depth)
        for line in _not_taken(topics, color, depth):
            logger.info("%s", line, extra={"doctor": "ignored"})
        if unpaired:
            logger.warning("%d images without a partner of the same time are left out", unpaired)
        return Recording(
            source="import:ros",
            cameras={"color": camera},
            frames=tuple(frames),
            depth_scale=scale if units else None,
            depth_correction=request.depth_correction,
            depth_name="" if depth is None else f"{request.source}: {depth.name}",
        )


ROS = RosImporter()


@contextmanager
def _opened(source: Path) -> Iterator[Any]:
    """A reader of the recording.

    Raises:
        ToolkitError: it is damaged, or the package `rosbags` is not installed.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise missing_extra(error) or error from error
    for path in [source] if source.is_file() else sorted(source.iterdir()):
        regular(path)  # rosbags would wait for a pipe
        if path.suffix == ".db3":
            check_database(path)
            check_message_sizes(path, (*_IMAGES, _CAMERA_INFO))
    try:
        # Recordings before ROS 2 Iron do not have the definitions of their messages.
        with AnyReader([source], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except ToolkitError:
        raise
    except (AnyReaderError, OSError) as error:
        raise ToolkitError(
            f"not a readable recording of ROS: {str(error).rstrip('.')}",
            path=source,
            hint="`ros2 bag info` shows what it holds; `ros2 bag reindex` repairs a folder that "
            "was cut short",
        ) from error
    except Exception as error:  # damaged databases and messages raise anything
        raise ToolkitError(
            f"the recording is damaged: {type(error).__name__}: {error}", path=source
        ) from error


def _messages(reader: Any, connections: tuple[Any, ...]) -> Iterator[tuple[str, float, Any]]:
    """Topic, seconds of the header's stamp (or of the recorder) and message."""
    for connection, logged_ns, raw in reader.messages(connections=list(connections)):
        if len(raw) > LARGEST_MESSAGE_BYTES:
            refuse_message(reader.paths[0], connection.topic, logged_ns, len(raw))
        message = reader.deserialize(raw, connection.msgtype)
        stamp = message.header.stamp
        seconds = stamp.sec + 1e-9 * stamp.nanosec
        yield connection.topic, seconds if seconds > 0 else 1e-9 * logged_ns, message


def _image_topics(reader: Any, source: Path) -> list[ImageTopic]:
    by_name: dict[str, list[Any]] = {}
    for connection in reader.connections:
        if connection.msgtype in _IMAGES:
            by_name.setdefault(connection.topic, []).append(connection)
    found = []
    for name, connections in sorted(by_name.items()):
        first = next(_messages(reader, tuple(connections)), None)
        if first is not None:
            found.append(ImageTopic(name, image_of(first[2], name), tuple(connections)))
    if not found:
        raise ToolkitError(
            "the recording has no images",
            path=source,
            value=sorted({c.topic for c in reader.connections})[:6],
            hint="record the topics of colour, of depth aligned to it, and camera_info",
        )
    return found


def _chosen(
    topics: list[ImageTopic], wanted: str | None, role: str, source: Path, *, near: str = ""
) -> ImageTopic:
    """The topic of a role: the one that the user names, or the only one that fits.

    Args:
        near: frame of the colour camera; depth in this frame is preferred.
    """
    kinds = COLOR_ENCODINGS if role == "color" else DEPTH_ENCODINGS
    fitting = [t for t in topics if t.first.encoding in kinds]
    if wanted is not None:
        named = [t for t in [*fitting, *_on_request(topics, role)] if wanted in (t.name, t.base)]
        # Given the base, the recorded images are preferred to compressed ones.
        exact = [t for t in named if t.name == wanted] or named
        if not exact:
            raise ToolkitError(
                f"no such topic with {role} images",
                path=source,
                field=f"--{role}",
                value=wanted,
                hint=f"it has {', '.join(f'{t.name} ({t.first.encoding})' for t in topics)}",
            )
        return exact[0]
    if near and (aligned := [t for t in fitting if t.first.frame_id == near]):
        fitting = aligned
    # The same images by several transports count once, those as recorded before compressed ones.
    once = {t.base: t for t in sorted(fitting, key=lambda t: t.name != t.base, reverse=True)}
    if len(once) == 1:
        return next(iter(once.values()))
    raise ToolkitError(
        f"no topic with {role} images" if not once else f"several topics have {role} images",
        path=source,
        value=sorted(once) or [f"{t.name} ({t.first.encoding})" for t in topics][:6],
        hint=f"choose one with --{role} TOPIC" if once else _no_topic_hint(topics, role, kinds),
    )


def _no_topic_hint(topics: list[ImageTopic], role: str, kinds: tuple[str, ...]) -> str:
    grey = _on_request(topics, role)
    if grey:
        return f"grey images are taken as colour with --color {grey[0].name}"
    return f"read are {', '.join(kinds)}"


def _on_request(topics: list[ImageTopic], role: str) -> list[ImageTopic]:
    """Topics that are taken only if the user names them: grey images as colour."""
    return [t for t in topics if role == "color" and t.first.encoding in GREY_ENCODINGS]


def _looks_like_depth(topic: ImageTopic) -> bool:
    """Whether the name of a topic says depth, whatever its encoding."""
    words = re.split(r"[/_]", topic.base.lower())
    pictures = (*COLOR_ENCODINGS, *GREY_ENCODINGS)
    return "depth" in words and topic.first.encoding not in pictures


def _not_taken(
    topics: list[ImageTopic], color: ImageTopic, depth: ImageTopic | None
) -> Iterator[str]:
    for topic in topics:
        if topic not in (color, depth):
            encoding = topic.first.encoding
            if encoding in (*COLOR_ENCODINGS, *DEPTH_ENCODINGS):
                why = "another topic is taken"
            elif encoding in GREY_ENCODINGS:
                why = "grey images are taken as colour only with --color TOPIC"
            else:
                why = "an encoding that is not supported"
            yield f"topic {topic.name} ({encoding}) is not taken: {why}"


def _check_aligned(color: ImageTopic, depth: ImageTopic, request: ImportRequest) -> None:
    """Check that depth is in the frame of the colour camera.

    Raises:
        ToolkitError: it is in another frame, or has another size.
    """
    hint = "record depth aligned to colour (realsense2_camera: align_depth.enable:=true)"
    if depth.first.frame_id != color.first.frame_id and request.depth is None:
        raise ToolkitError(
            f"depth is in the frame {depth.first.frame_id!r}, colour in {color.first.frame_id!r}",
            path=request.source,
            field=depth.name,
            hint=f"{hint}; if it is aligned all the same: --depth {depth.name}",
        )
    sizes = [t.first.size for t in (color, depth)]
    if None not in sizes and sizes[0] != sizes[1]:
        raise ToolkitError(
            "depth has another size than colour",
            path=request.source,
            field=depth.name,
            value=sizes[1],
            hint=hint,
        )


def _camera(reader: Any, color: ImageTopic, request: ImportRequest) -> Camera:
    size = color.first.decoded_size(request.source)
    given = request.intrinsics
    if given is not None:
        intrinsics = read_intrinsics(given, size=size, camera=request.camera)
    else:
        intrinsics, given = _camera_info(reader, color, request.source, size)
    intrinsics = with_distortion(intrinsics, request.distortion)
    return intrinsics.camera(size, path=given, off_centre=request.off_centre)


def _camera_info(
    reader: Any, color: ImageTopic, source: Path, size: tuple[int, int]
) -> tuple[Intrinsics, str]:
    """Intrinsics of the colour camera, and the topic that they are from."""
    beside = f"{color.base.rpartition('/')[0]}/camera_info"
    connections = [c for c in reader.connections if c.msgtype == _CAMERA_INFO]
    for connection in sorted(connections, key=lambda c: c.topic != beside):
        for _, _, info in _messages(reader, (connection,)):
            if connection.topic == beside or info.header.frame_id == color.first.frame_id:
                name = connection.topic
                return _intrinsics_of(info, color, source, name, size), name
            break
    raise ToolkitError(
        "the recording has no camera_info of the colour camera",
        path=source,
        field=beside,
        hint="record it, or give --intrinsics FILE or --intrinsics fx,fy,cx,cy",
    )


def _intrinsics_of(
    info: Any, color: ImageTopic, source: Path, topic: str, size: tuple[int, int]
) -> Intrinsics:
    k = np.asarray(getattr(info, "k", getattr(info, "K", None)), float).reshape(3, 3)
    fields: dict[str, Any]
    d = [float(x) for x in getattr(info, "d", getattr(info, "D", ()))]
    if is_rectified := "rect" in color.base.rpartition("/")[2]:  # image_rect_color
        k = np.asarray(getattr(info, "p", getattr(info, "P", None)), float).reshape(3, 4)[:, :3]
        d = []
    fields = {"K": k.ravel().tolist(), "width": int(info.width), "height": int(info.height)}
    fields |= {name: int(getattr(info, name)) for name in ("binning_x", "binning_y")}
    sides = ("x_offset", "y_offset", "width", "height")
    fields["roi"] = {side: int(getattr(info.roi, side)) for side in sides}
    if not is_rectified:
        fields |= {"distortion_model": str(info.distortion_model), "D": d}
    if not (info.width and info.height):
        del fields["width"], fields["height"]
    try:
        found = camera_of_fields(fields, source, name=topic, size=size)
    except ToolkitError as error:
        hint = "record the rectified images (image_rect_color)"
        raise error.revised(hint=hint if "model" in error.problem else error.hint) from error
    return told(replace(found, name=""), topic)


def _frames(
    reader: Any, color: ImageTopic, depth: ImageTopic | None, folder: Path, request: ImportRequest
) -> tuple[list[SourceFrame], int]:
    """Write the images of all pairs; returns the frames and the number of unpaired images."""
    topics = [color] if depth is None else [color, depth]
    connections = tuple(c for t in topics for c in t.connections)
    stamps: dict[str, list[float]] = {t.name: [] for t in topics}
    for topic, seconds, _ in _messages(reader, connections):
        stamps[topic].append(seconds)
    pairs = [(i, -1) for i in range(len(stamps[color.name]))]
    if depth is not None:
        pairs = pair_stamps(stamps[color.name], stamps[depth.name])
        if not pairs:
            raise ToolkitError(
                "no colour image has a depth image of the same time", path=request.source
            )
    wanted = {color.name: {c: n for n, (c, _) in enumerate(pairs)}}
    if depth is not None:
        wanted[depth.name] = {d: n for n, (_, d) in enumerate(pairs)}
    files: dict[str, dict[int, Path]] = {t.name: {} for t in topics}
    counts = dict.fromkeys(files, 0)
    for topic, _, message in _messages(reader, connections):
        number = wanted[topic].get(counts[topic])
        counts[topic] += 1
        if number is not None:
            kind = "color" if topic == color.name else "depth"
            stem = folder / kind / f"{number:06d}"
            files[topic][number] = write_image(image_of(message, topic), stem, request.source)
    scale = request.depth_scale or _UNIT_M
    frames = [
        SourceFrame(
            id=number,
            name=f"{number:06d}",
            color=SourceFile(
                source=files[color.name][number], target=f"color/{number:06d}", kind="color"
            ),
            depth=None
            if depth is None
            else SourceFile(
                source=files[depth.name][number],
                target=f"depth/{number:06d}",
                kind="depth",
                depth_scale=scale,
            ),
            timestamp=stamps[color.name][c],
        )
        for number, (c, _) in enumerate(pairs)
    ]
    return frames, sum(len(times) - len(pairs) for times in stamps.values())
