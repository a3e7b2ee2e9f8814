"""Scenes of a bake-off: frames of a user's recordings with truth of objects and of what is around.

Labels give true depth of objects alone. What stands around them is harmed most by methods that
doubt too much, so its truth is what other views of the same recording measured there, where they
agree. Frames, truth and the camera's own restored depth are copied: the recordings are only read.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND
from benchmark.data.infrared import infrared_inputs
from benchmark.data.prediction_files import FrameFiles
from benchmark.data.predictions import DepthFolder
from benchmark.data.splits import FrameKey
from benchmark.data.toolkit_scenes import ToolkitScenes, open_scenes, scene_folders
from benchmark.evaluation.batches import chosen_frames
from benchmark.recipes.bakeoff_sprayed import SPRAYED, SPRAYED_MODEL, Sprayed, match_sprayed
from benchmark.recipes.bakeoff_surroundings import Surroundings, views_of
from std_toolkit.arrays import Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_png
from std_toolkit.log import logger
from std_toolkit.scene.model import Frame, Frames, ObjectTable
from std_toolkit.scene.scene import Scene

SCENES, VENDOR = "scenes", "vendor"
# A folder of a recording beside `depth`: depth that the camera's own software restored.
_STREAM = "depth_"


@dataclass(frozen=True)
class StagedScenes:
    """What is scored.

    Attributes:
        root: folder of the scenes.
        views: name of the view of each frame: frames of one view are not independent.
        vendor: folder and metres per number of each stream that the recordings hold, by name.
        around: share of the pixels around objects that have truth.
        sprayed: whether truth is of sprayed recordings.
    """

    root: Path
    views: dict[FrameKey, str]
    vendor: dict[str, tuple[Path, float]] = field(default_factory=dict)
    around: float = 0.0
    sprayed: bool = False


@dataclass(frozen=True, eq=False)
class _Recording:
    """A scene, what it has of ground truth, and its sprayed twin, if any."""

    scene: Scene
    labelled: ToolkitScenes
    sprayed: Sprayed | None

    def frames(self) -> list[Frame]:
        """Frames that can be scored."""
        names = {key.name for key in self.labelled.keys()}  # noqa: SIM118
        if self.sprayed is None:
            return [f for f in self.scene.frames if f.name in names]
        found = [f for f in self.scene.registered_frames() if f.depth is not None]
        # The objects of a frame without labels would count as what stands around them.
        return [f for f in found if f.name in names] if names else found

    @property
    def objects(self) -> ObjectTable:
        """Objects of the masks."""
        if self.sprayed is None or len(self.labelled):
            return self.scene.objects
        return ObjectTable(models=[SPRAYED_MODEL], objects=[SPRAYED])

    def truth(self, frame: Frame, around: Surroundings) -> tuple[Floats, NDArray[np.uint8]]:
        """True depth (H, W), metres, and ids (H, W), 0 around objects."""
        T_world_cam = self.scene.T_world_cam(frame.id)
        keys = self.labelled.keys()
        index = {key.name: i for i, key in enumerate(keys)}
        if frame.name not in index:
            assert self.sprayed is not None and T_world_cam is not None
            camera = self.scene.camera(frame)
            true = self.sprayed.depth(camera, T_world_cam)
            return true, self.sprayed.objects(true, camera, T_world_cam)
        loaded = self.labelled.load(index[frame.name], sensor=False)
        ids = np.where(loaded.mask != BACKGROUND, loaded.mask, 0).astype(np.uint8)
        if self.sprayed is not None:
            return self.sprayed.depth(loaded.camera, T_world_cam), ids
        true = loaded.depth_true.copy()
        empty = (ids == 0) & (true == 0)
        true[empty] = around.seen_by(loaded.camera, T_world_cam, without=frame.id)[empty]
        return true, ids


def stage_scenes(
    recordings: Sequence[Path], out: Path, limit: int, sprayed: Sequence[Path] = ()
) -> StagedScenes:
    """Copy frames with their truth.

    Args:
        recordings: scenes with ground truth, or folders above some.
        out: folder for the copies.
        limit: most frames of all, evenly spaced in each scene.
        sprayed: a recording of the same scene, sprayed, for each of `recordings`; none for truth
            of labels.

    Raises:
        ToolkitError: a recording is no scene or has no truth, or two have one name.
    """
    sources = _recordings(recordings, sprayed)
    each = max(1, limit // len(sources))
    views: dict[FrameKey, str] = {}
    streams: dict[str, set[float]] = {}
    known = there = 0
    chosen_of: dict[str, list[Frame]] = {}
    for name, source in sources.items():
        frames = source.frames()
        chosen_of[name] = [frames[i] for i in chosen_frames(len(frames), each)]
        _check_same_frames(out / SCENES / name, chosen_of[name])
    for name, source in sources.items():
        scene, chosen = source.scene, chosen_of[name]
        with_truth, without = _stage(source, chosen, out / SCENES / name)
        known, there = known + with_truth, there + with_truth + without
        keys = [FrameKey(name, frame.name) for frame in chosen]
        for key, view in zip(keys, views_of(scene, chosen), strict=True):
            views[key] = f"{name} {view}"
        unit = (scene.info.depth_scale or 0.001) * scene.info.depth_correction
        for folder in sorted(p for p in scene.root.glob(f"{_STREAM}*") if p.is_dir()):
            stream = folder.name.removeprefix(_STREAM)
            files = DepthFolder(folder, SCENES, keys=keys)
            if _copy_stream(files, out / VENDOR / stream / name):
                streams.setdefault(stream, set()).add(unit)
    _check_no_others(out / SCENES, set(sources))
    return StagedScenes(
        out / SCENES,
        views,
        _vendor(out / VENDOR, streams),
        known / there if there else 0.0,
        sprayed=bool(sprayed),
    )


def _recordings(recordings: Sequence[Path], sprayed: Sequence[Path]) -> dict[str, _Recording]:
    if sprayed and len(sprayed) != len(recordings):
        raise ToolkitError(
            "needs one for each recording, in their order",
            field="--sprayed",
            value=f"{len(sprayed)} of {len(recordings)}",
        )
    twins = dict(zip(recordings, sprayed, strict=True)) if sprayed else {}
    found: dict[str, _Recording] = {}
    seen: set[Path] = set()
    for recording in recordings:
        paths = scene_folders(recording)
        if not paths or (twins and len(paths) > 1):
            raise ToolkitError(
                "several scenes here: name one" if paths else "no toolkit scene here: no folder "
                "holds a scene.json",
                path=recording,
                hint="import and label it: `std-curate import`, `std-annotate`, `std-curate run`",
            )  # fmt: skip
        for path in paths:
            if path.resolve() in seen:
                raise ToolkitError("the recording is given twice", path=path)
            seen.add(path.resolve())
            name = path.resolve().name
            if name in found:
                name = f"{path.resolve().parent.name}_{name}"
            if name in found:
                raise ToolkitError("two recordings have this name", path=path, value=name)
            found[name] = _open(path, twins.get(recording))
    return found


def _open(path: Path, twin: Path | None) -> _Recording:
    scene, labelled = Scene.open(path), open_scenes(SCENES, path)
    sprayed = None if twin is None else match_sprayed(scene, Scene.open(twin))
    found = _Recording(scene, labelled, sprayed)
    if not found.frames():
        raise ToolkitError(
            "no frame has sensor depth and ground truth",
            path=path,
            hint="label its objects, then `std-curate run` renders their depth",
        )
    return found


def _check_same_frames(folder: Path, chosen: Sequence[Frame]) -> None:
    """Check that earlier results there, if any, are of the same frames."""
    if not (folder / "scene.json").is_file():
        return
    there = {frame.name for frame in Scene.open(folder).frames}
    if there != {frame.name for frame in chosen}:
        raise ToolkitError(
            "the folder holds results of other frames of this recording",
            path=folder,
            value=f"{len(there)} frames, now {len(chosen)}",
            hint="give the --limit of before, or another --out",
        )


def _check_no_others(folder: Path, names: set[str]) -> None:
    if strange := sorted({p.name for p in folder.iterdir()} - names):
        raise ToolkitError(
            "the folder holds frames of another recording",
            path=folder,
            value=strange[0],
            hint="choose another --out",
        )


def _stage(source: _Recording, chosen: Sequence[Frame], to: Path) -> tuple[int, int]:
    """Write one scene; returns pixels around objects with and without truth."""
    scene = source.scene
    around = Surroundings({}) if source.sprayed is not None else Surroundings.of(scene)
    known = unknown = 0
    for frame in chosen:
        true, ids = source.truth(frame, around)
        known += int((true[ids == 0] > 0).sum())
        unknown += int((true[ids == 0] == 0).sum())
        write_exr(to / "reference" / "depth" / f"{frame.name}.exr", {"Y": true})
        write_png(to / "reference" / "mask" / f"{frame.name}.png", ids)
        files = [scene.root / name for name in (frame.color, frame.depth or "")]
        files += infrared_inputs(scene.root, frame.name).values()  # for stereo methods
        for path in files:
            if path.is_file():
                _copy(path, to / path.relative_to(scene.root))
    for name in ("scene.json", "poses.json"):  # the same command again, of a changed recording
        (to / name).unlink(missing_ok=True)
    copy = Scene.create(to, scene.info, Frames(frames=list(chosen)), source.objects)
    if scene.poses is not None:
        of = {frame.id for frame in chosen}
        kept = [pose for pose in scene.poses.frames if pose.frame in of]
        copy.save_poses(msgspec.structs.replace(scene.poses, frames=kept))
    logger.info("%s: %d frames", scene.root, len(chosen))
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


def _vendor(folder: Path, streams: Mapping[str, set[float]]) -> dict[str, tuple[Path, float]]:
    for name, units in streams.items():
        if len(units) > 1:
            raise ToolkitError(
                "recordings have it in different units",
                path=folder / name,
                value=sorted(units),
                hint="score them apart",
            )
    return {name: (folder / name, min(units)) for name, units in streams.items()}
