"""TransCG: transparent objects seen by a D435 and an L515 from 240 perspectives.

<root>/metadata.json                    test and train scenes, numbers of samples
<root>/camera_intrinsics/1-camIntrinsics-D435.npy, 2-camIntrinsics-L515.npy
<root>/T_camera2_camera1.npy            L515 from D435
<root>/sceneN/metadata.json             type, objects, valid perspectives of each camera
<root>/sceneN/P/rgbC.png, depthC.png, depthC-gt.png, depthC-gt-mask.png, corrected_pose/K.npy

C is 1 (D435, millimetres) or 2 (L515, quarter millimetres). True depth is the nearer of the
rendered object and the sensor, or whichever is there: off the objects it is the sensor. The mask is
the silhouette of all objects, 0 or 1, not cut by opaque occluders.

`prepared` frames are as the loader of the release of October 2022 gives them at 320x240: raw depth
cut to its mean and k times its deviation, true depth cut to the same range, holes of raw depth
filled by the nearest pixel. Whether holes count in that mean is not verified; here they do.

Source: github.com/Galaxies99/TransCG (`datasets/transcg.py`, `utils/`, README) and
github.com/Galaxies99/TransCG-data-collector.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.data.field.places import camera_of
from benchmark.data.field.source import (
    COLOR,
    MASK,
    RAW,
    TRUTH,
    FieldFrames,
    Files,
    Maps,
    read_field_depth,
    read_ids,
)
from benchmark.data.frame import BACKGROUND, DepthFrame, Instance, Material, resize_nearest
from benchmark.data.loading import FrameIndex, SceneFolder, check_same_size
from benchmark.data.splits import SceneFiles
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.documents import read_document
from std_toolkit.io.foreign_files import read_npy

Sensor = Literal["d435", "l515"]
Part = Literal["train", "test"]

_CAMERA = {"d435": 1, "l515": 2}
_UNIT = {"d435": 1 / 1000, "l515": 1 / 4000}
_INTRINSICS = {"d435": "1-camIntrinsics-D435.npy", "l515": "2-camIntrinsics-L515.npy"}
_SIZE = (320, 240)
_OBJECTS = Instance(1, 0, Material.TRANSPARENT)
_Number = Annotated[int, msgspec.Meta(ge=0, le=100_000)]


class _Set(msgspec.Struct, frozen=True):
    train: list[_Number]
    test: list[_Number]
    train_samples: _Number = 0
    test_samples: _Number = 0


class _Scene(msgspec.Struct, frozen=True):
    type: str = ""
    D435_valid_perspective_list: list[_Number] = []
    L515_valid_perspective_list: list[_Number] = []

    def valid(self, sensor: Sensor) -> list[int]:
        """Perspectives that count."""
        lists = (self.D435_valid_perspective_list, self.L515_valid_perspective_list)
        return lists[_CAMERA[sensor] - 1]


@dataclass(frozen=True)
class TransCG(FieldFrames):
    """Frames of one camera.

    Attributes:
        root: of the set.
        sensor: the camera.
        prepared: frames are those of the release's loader.
        absent: scenes that the set lists and that are not there.
        said, counted: samples of the part by the set's document, and by the lists of the scenes,
            of both cameras.
    """

    root: Path = Path()
    sensor: Sensor = "d435"
    prepared: bool = False
    absent: tuple[str, ...] = ()
    said: int = 0
    counted: int = 0

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        top, camera = Path(scene.path) / stem, _CAMERA[self.sensor]
        names = {COLOR: "rgb{}", RAW: "depth{}", TRUTH: "depth{}-gt", MASK: "depth{}-gt-mask"}
        return {what: top / f"{name.format(camera)}.png" for what, name in names.items()}

    def documents(self, scene: SceneFolder, stem: str) -> Files:  # noqa: ARG002
        return {"camera": self._intrinsics}

    @property
    def _intrinsics(self) -> Path:
        return self.root / "camera_intrinsics" / _INTRINSICS[self.sensor]

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:  # noqa: ARG002
        true, inside = read_field_depth(files[TRUTH], self.unit), read_ids(files[MASK])
        check_same_size(files[MASK], inside, true, "mask")
        mask = np.where(inside > 0, 1, BACKGROUND).astype(np.uint8)  # written as 0 and 1
        K = read_npy(self._intrinsics)
        camera = camera_of(K, (true.shape[1], true.shape[0]), self._intrinsics)
        return Maps(true, mask, camera, (_OBJECTS,) if inside.any() else ())

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> DepthFrame:
        """See `DepthSource`; `prepared` frames are cut by their raw depth, which is then read."""
        frame = super().load(index, sensor=sensor or self.prepared, nocs=nocs)
        if not self.prepared:
            return frame
        raw, true = resize_nearest(frame.depth_raw, _SIZE), resize_nearest(frame.depth_true, _SIZE)
        k = 1 + int(frame.name) // 20 / 12 if self.sensor == "d435" else 1.0
        raw, true = cut_as_released(raw, true, k)
        return replace(
            frame,
            depth_raw=raw,
            depth_true=true,
            mask=resize_nearest(frame.mask, _SIZE),
            camera=frame.camera.resized(*_SIZE),
        )

    def poses(self, index: int) -> dict[int, SE3]:
        """Return `T_cam_obj` by the line of the object in the set's list, from 0.

        The mask of a frame holds all objects as 1.
        """
        scene, stem = self.index.at(index)
        shift = SE3.identity()
        if self.sensor == "l515":
            path = self.root / "T_camera2_camera1.npy"
            shift = _pose(path)
        found = {}
        for path in sorted((Path(scene.path) / stem / "corrected_pose").glob("*.npy")):
            if path.stem.isdigit():
                found[int(path.stem)] = shift @ _pose(path)
        return found

    def files(self) -> Iterator[SceneFiles]:
        """See `DepthSource`; scenes that the set lists and that are not there lack themselves."""
        yield from super().files()
        for name in self.absent:
            yield SceneFiles(name, str(self.root / name), 0, {"scene": ["metadata.json"]})

    def notes(self) -> Sequence[str]:
        """See `FieldFrames`."""
        if self.said == self.counted:
            return (f"both cameras: {self.counted} samples, as metadata.json of the set says",)
        return (
            f"both cameras: {self.counted} samples in the lists of the scenes, {self.said} in "
            "metadata.json of the set",
        )


def _pose(path: Path) -> SE3:
    try:
        return SE3.from_matrix(read_npy(path))
    except ToolkitError as error:
        raise error.revised(path=path) from error


def cut_as_released(
    raw: NDArray[np.float32], true: NDArray[np.float32], k: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Cut depth as the loader of October 2022 does.

    Args:
        raw: (h, w) metres, 0 where nothing was measured.
        true: (h, w) metres.
        k: how many deviations from the mean of raw depth are kept.

    Returns:
        Raw depth with all holes filled by the nearest pixel, and true depth with holes.
    """
    from scipy.ndimage import distance_transform_edt

    low, high = raw.mean() - k * raw.std(), raw.mean() + k * raw.std()
    raw, true = (np.where((d < low) | (d > high), 0, d).astype(np.float32) for d in (raw, true))
    if (raw > 0).any():
        nearest = distance_transform_edt(raw == 0, return_distances=False, return_indices=True)
        raw = raw[tuple(nearest)]
    return raw, true


def open_transcg(
    name: str, root: Path, sensor: Sensor, part: Part, *, prepared: bool = False
) -> TransCG:
    """List the valid perspectives of a camera.

    Args:
        name: of the split.
        root: folder of `metadata.json` and the scenes, or one above it.
        sensor: the camera.
        part: of the set.
        prepared: give frames as the release of October 2022 does.

    Raises:
        ToolkitError: a document is damaged.
    """
    tops = (root, *sorted(p for p in root.iterdir() if p.is_dir()))
    top = next((p for p in tops if (p / "metadata.json").is_file() and _has_scenes(p)), None)
    if top is None:
        return TransCG(name, FrameIndex(()), root=root, sensor=sensor)
    listed = read_document(top / "metadata.json", _Set)
    numbers, said = (
        (listed.train, listed.train_samples) if part == "train"
        else (listed.test, listed.test_samples)
    )  # fmt: skip
    scenes, absent, counted = [], [], 0
    for number in numbers:
        folder = top / f"scene{number}"
        if not (folder / "metadata.json").is_file():
            absent.append(folder.name)
            continue
        document = read_document(folder / "metadata.json", _Scene)
        counted += sum(len(document.valid(s)) for s in ("d435", "l515"))
        stems = tuple(str(p) for p in sorted(document.valid(sensor)))
        if stems:
            scenes.append(SceneFolder(folder.name, str(folder), stems))
    return TransCG(
        name,
        FrameIndex(tuple(scenes)),
        unit=_UNIT[sensor],
        root=top,
        sensor=sensor,
        prepared=prepared,
        absent=tuple(absent),
        said=said,
        counted=counted,
    )


def _has_scenes(folder: Path) -> bool:
    return any(p.is_dir() for p in folder.glob("scene*"))
