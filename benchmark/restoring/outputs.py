"""Files of restored frames: depth, confidence, changed pixels, points, pictures, the record."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.evaluation.depth_panels import restored_strip
from benchmark.evaluation.manifest import circumstances
from benchmark.methods.registry import MethodOptions, weights_digest
from benchmark.metrics.depth.figures import tolerance
from benchmark.metrics.depth.harm import WRONG
from benchmark.metrics.depth.holes import right_without_truth
from benchmark.restoring.options import DepthFormat, MethodChoice, Where
from benchmark.restoring.recordings import FrameFiles
from benchmark.restoring.restorer import FINDER, RestoredFrame, Restorer, settings_of
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.depth_maps import unproject_depth
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import digest_file, digest_of, write_document
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import read_depth, read_png, write_color, write_depth_png16, write_png
from std_toolkit.jobs.artefact import Artefact, Record

RECORD = "restore.json"
# 16-bit PNG of depth that was an EXR: metres per unit.
_DEFAULT_UNIT = 0.001
_SPREAD_UNIT = 0.0001  # metres per number of `spread/`
_LARGEST = 65534  # the number above it means "too far" to some cameras
_POINT = np.dtype([("xyz", "<f4", (3,)), ("rgb", "u1", (3,))])


class RestoreSetup(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fields that determine the files; a run resumes only if they are unchanged.

    Attributes:
        method, preset, settings: the method and its options.
        weights_sha256: hash of the weight file (128-bit BLAKE2b, as in run.json of `std-bench`).
        size: (width, height) that the method works at; empty for the camera's.
        where: where the method answers; see `Restorer`.
        finder_sha256: hash of the weights of what looks for glass and metal; empty without.
        max_error_m: expected error from which on depth is left out, metres; None for no limit.
        multi_view: whether the frames are fused (`multi_view`), or restored alone.
        backend: `onnx` or `torch` for networks, empty for methods without weights.
        depth_format: `same`, `png` or `exr`.
        points, pictures: whether these are written.
    """

    method: str
    preset: str
    settings: dict[str, str]
    weights_sha256: str
    size: list[int]
    backend: str
    depth_format: DepthFormat
    points: bool
    pictures: bool
    where: Where = "everywhere"
    max_error_m: float | None = None
    multi_view: bool = False
    finder_sha256: str = ""


class RestoreRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`restore.json`: what made the files of a folder.

    Attributes:
        version_of_tool: version of this package.
        setup: what determines the files.
        source: the recording, as given.
        frames: number of its frames.
        packages: versions of the numerical libraries.
        hardware: processor and cores.
    """

    version_of_tool: str
    setup: RestoreSetup
    source: str
    frames: int
    packages: dict[str, str]
    hardware: dict[str, str]


def setup_of(
    choice: MethodChoice,
    restorer: Restorer,
    depth_format: DepthFormat,
    points: bool,
    pictures: bool,
) -> RestoreSetup:
    """What determines the files of a run with this restorer."""
    made = restorer.method
    backend = "torch" if hasattr(made, "network") else ""
    if type(made).__name__ == "OnnxNetwork":
        backend = "onnx"
    finder = ""
    if restorer.where == "glass-and-holes":
        finder = weights_digest(FINDER, restorer.finder(), MethodOptions(preset="compact"))
    return RestoreSetup(
        finder_sha256=finder,
        method=choice.method,
        preset=restorer.options.preset,
        settings=settings_of(choice.settings),
        weights_sha256=weights_digest(choice.method, made, restorer.options),
        size=list(made.input_size or ()),
        backend=backend,
        depth_format=depth_format,
        points=points,
        pictures=pictures,
        where=restorer.where,
        max_error_m=choice.max_error_m,
    )


def record_of(setup: RestoreSetup, source: str, frames: int) -> RestoreRecord:
    """The record of a run on this machine."""
    return RestoreRecord(setup=setup, source=source, frames=frames, **circumstances())


class FrameRecord(Record, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`frames/NAME.json`: record and outcome of a frame; written last.

    Attributes:
        unit: metres per number of the restored 16-bit PNG; 1 for EXR.
        measured: share of the pixels that the sensor measured.
        kept: share that keeps the sensor's depth.
        filled: share that the sensor did not measure and the method restored.
        replaced: share whose measurement was replaced.
        empty: share without depth.
        smooth: share on smooth, near surfaces that the sensor measured whole
            (`right_without_truth`).
        smooth_moved: share of these that the method moved by more than twice max(3 mm, 1 %).
    """

    unit: float
    measured: float
    kept: float
    filled: float
    replaced: float
    empty: float
    smooth: float = 0.0
    smooth_moved: float = 0.0


def _file(folder: str, suffix: str) -> property:
    return property(lambda paths: paths.out / folder / f"{paths.name}{suffix}")


@dataclass(frozen=True)
class FramePaths:
    """Where the files of a frame go.

    Attributes:
        out: folder of the recording's results.
        name: of the frame.
        exr: whether depth is an EXR.
        more: digests of what else the files are made of, by name.
    """

    out: Path
    name: str
    exr: bool
    more: Mapping[str, str] = field(default_factory=dict)

    color = _file("color", ".png")
    confidence = _file("confidence", ".png")
    spread = _file("spread", ".png")
    glass = _file("glass", ".png")
    changed = _file("changed", ".png")
    points = _file("points", ".ply")
    picture = _file("pictures", ".jpg")
    record = _file("frames", ".json")

    @property
    def depth(self) -> Path:
        return self.out / "depth" / f"{self.name}{'.exr' if self.exr else '.png'}"

    def artefact(self, frame: FrameFiles) -> Artefact:
        """What the files of a frame are made of; `RestoreSetup` is the same for all frames."""
        images = {"colour image": frame.color, "depth image": frame.depth}
        inputs = {name: digest_file(path) for name, path in images.items()}
        read = (asdict(frame.camera), frame.scale, frame.correction, frame.resize)
        inputs["camera and unit of depth"] = digest_of(*read, versioned=False)
        if frame.undistortion is not None:
            inputs["cameras of the undistortion"] = digest_of(
                repr(frame.undistortion), versioned=False
            )
        reading = [frame.scale, frame.correction, frame.missing.values, frame.missing.float_unit]
        inputs["reading of the depth"] = digest_of(reading, versioned=False)
        limits = ("benchmark.restoring.",)
        return Artefact(self.out, f"frame {frame.name}", inputs | dict(self.more), limits=limits)


def paths_of(out: Path, frame: FrameFiles, depth_format: DepthFormat) -> FramePaths:
    """Where the files of a frame go."""
    exr = depth_format == "exr" or (depth_format == "same" and not frame.is_png)
    return FramePaths(out, frame.name, exr)


def write_frame(
    paths: FramePaths,
    frame: FrameFiles,
    color: NDArray[np.uint8],
    sensor: NDArray[np.float32],
    restored: RestoredFrame,
    setup: RestoreSetup,
) -> FrameRecord:
    """Write all files of a frame, the record last.

    Raises:
        ToolkitError: a file cannot be written.
    """
    artefact, written = paths.artefact(frame), [paths.depth, paths.changed]
    depth = restored.depth
    if paths.exr:
        unit = 1.0
        write_exr(paths.depth, {"Y": depth})
        changed = depth != sensor
    else:
        unit = frame.unit if frame.is_png else _DEFAULT_UNIT
        # A wall beyond what the numbers can hold is no depth.
        numbers = np.rint(np.where(depth <= _LARGEST * unit, depth, 0) / unit)
        depth = (numbers * unit).astype(np.float32)
        write_depth_png16(paths.depth, depth, scale=unit)
        changed = numbers != np.rint(sensor / unit)
    write_png(paths.changed, changed.astype(np.uint8) * np.uint8(255))
    if restored.confidence is not None:
        written.append(paths.confidence)
        write_png(paths.confidence, np.rint(255 * restored.confidence).astype(np.uint8))
    if restored.spread is not None:
        written.append(paths.spread)
        most = np.minimum(restored.spread, np.float32(_LARGEST * _SPREAD_UNIT))
        write_depth_png16(paths.spread, most, scale=_SPREAD_UNIT)
    if restored.clear is not None:
        written.append(paths.glass)
        write_png(paths.glass, np.rint(255 * restored.clear).astype(np.uint8))
    if frame.undistortion is not None:
        written.append(paths.color)
        write_color(paths.color, color)
    if setup.points:
        written.append(paths.points)
        write_bytes_atomic(paths.points, point_cloud(color, depth, frame.camera))
    if setup.pictures:
        written.append(paths.picture)
        write_color(paths.picture, restored_strip(color, sensor, depth, restored.confidence))
    there = sensor > 0
    smooth = right_without_truth(sensor)
    moved = np.abs(depth[smooth] - sensor[smooth]) > WRONG * tolerance(sensor[smooth])
    record = FrameRecord(
        **msgspec.structs.asdict(artefact.record(written)),
        unit=unit,
        measured=_share(there),
        kept=_share(there & ~changed),
        filled=_share(~there & (depth > 0)),
        replaced=_share(there & changed & (depth > 0)),
        empty=_share(depth == 0),
        smooth=_share(smooth),
        smooth_moved=_share(moved) if moved.size else 0.0,
    )
    write_document(paths.record, record)
    return record


def read_frame(paths: FramePaths, record: FrameRecord) -> RestoredFrame:
    """What `write_frame` wrote, to the precision of the files.

    Raises:
        ToolkitError: a file is missing or damaged.
    """

    def share(path: Path) -> NDArray[np.float32] | None:
        return read_png(path).astype(np.float32) / np.float32(255) if path.exists() else None

    there = paths.spread.exists()
    return RestoredFrame(
        read_depth(paths.depth, scale=record.unit),
        share(paths.confidence),
        read_png(paths.changed).astype(bool),
        read_depth(paths.spread, scale=_SPREAD_UNIT) if there else None,
        share(paths.glass),
    )


def write_intrinsics(path: Path, camera: Camera) -> None:
    """Write a camera as `--intrinsics` reads it.

    Raises:
        ToolkitError: the file cannot be written.
    """
    names = ("width", "height", "fx", "fy", "cx", "cy")
    values = {name: getattr(camera, name) for name in names}
    write_document(path, {**values, "distortion": list(camera.distortion)})


def point_cloud(color: NDArray[np.uint8], depth: NDArray[np.float32], camera: Camera) -> bytes:
    """A binary PLY of the pixels with depth: camera frame, metres, RGB."""
    there = depth > 0
    table = np.empty(int(there.sum()), _POINT)
    table["xyz"], table["rgb"] = unproject_depth(depth, camera)[there], color[there]
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(table)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    )
    return header.encode() + table.tobytes()


def _share(pixels: NDArray[np.bool_]) -> float:
    return round(float(pixels.mean()), 6)
