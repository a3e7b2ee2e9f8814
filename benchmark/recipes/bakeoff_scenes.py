"""Scenes of a bake-off: frames of a user's recordings with truth of objects and of what is around.

Labels give true depth of objects alone. What stands around them is harmed most by methods that
doubt too much, so its truth is what other views of the same recording measured there, where they
agree. Frames, truth and the camera's own restored depth are copied: the recordings are only read.
"""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND
from benchmark.data.prediction_files import FrameFiles
from benchmark.data.predictions import DepthFolder
from benchmark.data.splits import FrameKey
from benchmark.data.toolkit_scenes import ToolkitScenes, open_scenes, scene_folders
from benchmark.evaluation.frames import chosen_frames
from benchmark.metrics.depth.figures import tolerance
from std_toolkit.arrays import Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, pixel_rays
from std_toolkit.geometry.se3 import SE3, rotation_angle
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_png
from std_toolkit.log import logger
from std_toolkit.scene.model import Frame, Frames
from std_toolkit.scene.scene import Scene
from std_toolkit.settings import Settings, limit

SCENES, VENDOR = "scenes", "vendor"
# A folder of a recording beside `depth`: depth that the camera's own software restored.
_STREAM = "depth_"


@dataclass(frozen=True, kw_only=True)
class BakeoffSceneSettings(Settings):
    """What counts as truth around the objects, and as another view."""

    views: int = limit(16, source="more change under 1 % of the pixels of the demo's scene")
    """other views that are asked what stands around the objects, evenly chosen"""
    agreeing: int = limit(3, source="two may err alike, as neighbours do")
    """views that must agree within max(3 mm, 1 %) of their median"""
    moved_deg: float = limit(5.0, unit="deg", source="reflections in glass have changed by then")
    """a camera that turned by more, or moved by as much of the depth, sees another view"""


@dataclass(frozen=True)
class StagedScenes:
    """What is scored.

    Attributes:
        root: folder of the scenes.
        views: name of the view of each frame: frames of one view are not independent.
        vendor: folder and metres per number of each stream that the recordings hold, by name.
        around: share of the pixels around objects that have truth.
    """

    root: Path
    views: dict[FrameKey, str]
    vendor: dict[str, tuple[Path, float]] = field(default_factory=dict)
    around: float = 0.0


def stage_scenes(recordings: Sequence[Path], out: Path, limit: int) -> StagedScenes:
    """Copy frames with their truth; those that are there are kept.

    Args:
        recordings: scenes with ground truth, or folders above some.
        out: folder for the copies.
        limit: most frames of all, evenly spaced in each scene.

    Raises:
        ToolkitError: a recording is no scene or has no truth, or two have one name.
    """
    sources = _sources(recordings)
    each = max(1, limit // len(sources))
    views: dict[FrameKey, str] = {}
    streams: dict[str, set[float]] = {}
    known = there = 0
    for name, source in sources.items():
        path = Path(source.index.scenes[0].path)
        scene = Scene.open(path)
        keys = source.keys()
        stems = [key.name for key in keys]
        chosen = [stems[i] for i in chosen_frames(len(stems), each)]
        with_truth, without = _stage(scene, source, chosen, out / SCENES / name)
        known, there = known + with_truth, there + with_truth + without
        frames = [f for f in scene.frames if f.name in set(chosen)]
        for frame, view in zip(frames, views_of(scene, frames), strict=True):
            views[FrameKey(name, frame.name)] = f"{name} {view}"
        unit = (scene.info.depth_scale or 0.001) * scene.info.depth_correction
        for folder in sorted(p for p in path.glob(f"{_STREAM}*") if p.is_dir()):
            stream = folder.name.removeprefix(_STREAM)
            files = DepthFolder(folder, SCENES, keys=[FrameKey(name, s) for s in chosen])
            if _copy_stream(files, out / VENDOR / stream / name):
                streams.setdefault(stream, set()).add(unit)
    _check_no_others(out / SCENES, set(sources))
    for stream, units in streams.items():
        if len(units) > 1:
            raise ToolkitError(
                "recordings have it in different units",
                path=out / VENDOR / stream,
                value=sorted(units),
                hint="score them apart",
            )
    vendor = {name: (out / VENDOR / name, units.pop()) for name, units in streams.items()}
    return StagedScenes(out / SCENES, views, vendor, known / there if there else 0.0)


def _sources(recordings: Sequence[Path]) -> dict[str, ToolkitScenes]:
    found: dict[str, ToolkitScenes] = {}
    seen: set[Path] = set()
    for recording in recordings:
        paths = scene_folders(recording)
        if not paths:
            raise ToolkitError(
                "no toolkit scene here: no folder holds a scene.json",
                path=recording,
                hint="import and label it: `std-curate import`, `std-annotate`, `std-curate run`",
            )
        for path in paths:
            if path.resolve() in seen:
                raise ToolkitError("the recording is given twice", path=path)
            seen.add(path.resolve())
            source = open_scenes(SCENES, path)
            if not len(source):
                raise ToolkitError(
                    "no frame has sensor depth and ground truth",
                    path=path,
                    hint="label its objects, then `std-curate run` renders their depth",
                )
            name = path.resolve().name
            if name in found:
                name = f"{path.resolve().parent.name}_{name}"
            if name in found:
                raise ToolkitError("two recordings have this name", path=path, value=name)
            found[name] = source
    return found


def _check_no_others(folder: Path, names: set[str]) -> None:
    if strange := sorted({p.name for p in folder.iterdir()} - names):
        raise ToolkitError(
            "the folder holds frames of another recording",
            path=folder,
            value=strange[0],
            hint="choose another --out",
        )


def _stage(scene: Scene, source: ToolkitScenes, chosen: Sequence[str], to: Path) -> tuple[int, int]:
    """Write one scene; returns pixels around objects with and without truth."""
    rows = [f for f in scene.frames if f.name in set(chosen)]
    keys = source.keys()
    index = {key.name: i for i, key in enumerate(keys)}
    around = Surroundings.of(scene)
    known = unknown = 0
    for frame in rows:
        loaded = source.load(index[frame.name])
        true, objects = loaded.depth_true.copy(), loaded.mask != BACKGROUND
        empty = ~objects & (true == 0)
        true[empty] = around.seen_by(loaded.camera, scene.T_world_cam(frame.id), without=frame.id)[
            empty
        ]
        known += int((true[~objects] > 0).sum())
        unknown += int((true[~objects] == 0).sum())
        write_exr(to / "reference" / "depth" / f"{frame.name}.exr", {"Y": true})
        ids = np.where(objects, loaded.mask, 0).astype(np.uint8)
        write_png(to / "reference" / "mask" / f"{frame.name}.png", ids)
        for name in (frame.color, frame.depth or ""):
            _copy(scene.root / name, to / name)
    if (scene.root / "poses.json").is_file():
        _copy(scene.root / "poses.json", to / "poses.json")
    if (to / "scene.json").exists():
        (to / "scene.json").unlink()  # the same command again, perhaps of a changed recording
    Scene.create(to, scene.info, Frames(frames=rows), scene.objects)
    logger.info("%s: %d frames", scene.root, len(rows))
    return known, unknown


def _copy(source: Path, to: Path) -> None:
    to.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy2(source, to)  # with its time, so that digests of unchanged files are kept


def _copy_stream(files: FrameFiles, to: Path) -> int:
    """Copy the files of a stream; returns how many there are."""
    there = [path for key in files.keys if (path := files.path(key)).is_file()]
    for path in there:
        _copy(path, to / path.name)
    return len(there)


def views_of(scene: Scene, frames: Sequence[Frame]) -> list[int]:
    """Return the number of the view of each frame, of frames in recording order.

    A view ends where the camera has turned by more than `moved_deg` since its first frame, or
    moved by as much of the median depth. Frames without camera poses are one view.

    Args:
        scene: whose poses and depth count.
        frames: some of it.
    """
    limits = BakeoffSceneSettings.current()
    least = np.deg2rad(limits.moved_deg)
    found: list[int] = []
    first: SE3 | None = None
    number, distance = 0, 1.0
    for frame in frames:
        T = scene.T_world_cam(frame.id)
        if first is None and T is not None:
            first = T
            depth = scene.read_depth(frame)
            if depth is not None and (depth > 0).any():
                distance = float(np.median(depth[depth > 0]))
        elif first is not None and T is not None:
            moved = float(np.linalg.norm(T.t - first.t)) / distance
            if max(moved, rotation_angle(first.R.T @ T.R)) > least:
                number, first = number + 1, T
        found.append(number)
    return found


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What several views of a recording measured.

    Attributes:
        points: (N, 3) metres in the frame of the world, of each view by frame id.
    """

    points: dict[int, Floats]

    @staticmethod
    def of(scene: Scene) -> "Surroundings":
        """Read some views of a scene, evenly chosen; none without camera poses.

        Raises:
            ToolkitError: a depth image cannot be read.
        """
        frames = [f for f in scene.registered_frames() if f.depth is not None]
        most = BakeoffSceneSettings.current().views
        found: dict[int, Floats] = {}
        for i in chosen_frames(len(frames), most):
            depth, T = scene.read_depth(frames[i]), scene.T_world_cam(frames[i].id)
            assert depth is not None and T is not None
            there = depth > 0
            rays = pixel_rays(scene.camera(frames[i]))[there]
            found[frames[i].id] = (T @ (rays * depth[there][:, None])).astype(np.float32)
        return Surroundings(found)

    def seen_by(self, camera: Camera, T_world_cam: SE3 | None, without: int = -1) -> Floats:
        """Depth where views agree.

        Args:
            camera: that looks.
            T_world_cam: its pose; without one nothing is known.
            without: id of a frame that is not asked, such as the one that is judged.

        Returns:
            (H, W) metres: the median of the views that see something behind a pixel, 0 where too
            few are within max(3 mm, 1 %) of it.
        """
        asked = [points for frame, points in self.points.items() if frame != without]
        fewest = BakeoffSceneSettings.current().agreeing
        if T_world_cam is None or len(asked) < fewest:
            return np.zeros((camera.height, camera.width), np.float32)
        T = T_world_cam.inverse()
        layers = np.stack([_drawn(T @ points, camera) for points in asked])
        layers.sort(axis=0)
        seen = np.isfinite(layers).sum(axis=0)
        median = np.take_along_axis(layers, np.maximum(seen - 1, 0)[None] // 2, axis=0)[0]
        median[seen == 0] = 0
        agree = (np.abs(layers - median) <= tolerance(np.where(median > 0, median, 1))).sum(axis=0)
        return np.where(agree >= fewest, median, np.float32(0))


def _drawn(points: NDArray[np.floating], camera: Camera) -> Floats:
    """The nearest of points (N, 3) in each pixel, infinite where there is none."""
    depth = np.full(camera.height * camera.width, np.inf, np.float32)
    points = points[points[:, 2] > 0]
    uv = np.rint(camera.project(points))
    inside = (uv >= 0).all(axis=1) & (uv < camera.size).all(axis=1)
    u, v = uv[inside].astype(np.intp).T
    np.minimum.at(depth, v * camera.width + u, points[inside, 2].astype(np.float32))
    return depth.reshape(camera.height, camera.width)
