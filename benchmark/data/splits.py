"""Splits of data sets: frames by index, the registry of names, splits with saved restored depth."""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from benchmark.data.frame import DepthFrame
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import digest_of
from std_toolkit.plugins import Registry

# Suffix of raw depth files by prefix of the split name.
_SUFFIXES = {
    "dreds": "_simDepthImage.exr",
    "std": "_depth_415.exr",
    "cleargrasp": "-transparent-depth-img.exr",
}

_OTHERS = "_depth.exr"


class FrameKey(NamedTuple):
    """Key of a frame; `str(key)` is `DepthFrame.key`, unique within a split."""

    scene: str
    name: str

    def __str__(self) -> str:
        return f"{self.scene}/{self.name}"


class SceneFiles(NamedTuple):
    """Files of a scene on disk.

    Attributes:
        scene: its name.
        folder: its folder.
        frames: number of frames.
        missing: names of missing files by content, such as "raw depth".
    """

    scene: str
    folder: str
    frames: int
    missing: dict[str, list[str]]


# Files of a frame by content; a text is the digest of what is in no file of its own.
Inputs = Mapping[str, Path | str]


class DepthSource(Protocol):
    """Frames of a split. Sources can be pickled and sent to worker processes.

    They list their frames when created and keep no images: memory does not grow with the number of
    frames read.
    """

    @property
    def name(self) -> str:
        """Name of the split."""
        ...

    def __len__(self) -> int: ...

    def keys(self) -> list[FrameKey]:
        """Return the keys of all frames, in order."""
        ...

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> DepthFrame:
        """Read a frame.

        Args:
            index: index of the frame, from 0.
            sensor: also read colour and raw depth. Otherwise `color` is (0, 0, 3) and `depth_raw`
                (0, 0), which is enough to score depth restored earlier and takes a third of the
                time.
            nocs: also read the NOCS map, if the data set has one.

        Raises:
            ToolkitError: a file is missing, damaged or inconsistent with another.
            IndexError: index out of range.
        """
        ...

    def inputs(self, index: int, *, nocs: bool = False) -> Inputs:
        """Return the files that `load` and `known_boxes` read for a frame, by content.

        A source of a third party may lack this method: its frames are then known by their arrays.

        Args:
            index: index of the frame, from 0.
            nocs: also those that only poses need.
        """
        ...

    def files(self) -> Iterator[SceneFiles]:
        """Yield the files of every scene, for `check_split`."""
        ...


def inputs_of(source: DepthSource, index: int, *, nocs: bool = False) -> Inputs:
    """Return what a source reads for a frame.

    Args:
        source: of a third party, it may lack `inputs`; its frames are then known by their arrays.
        index: of the frame.
        nocs: also what poses need.
    """
    named = getattr(source, "inputs", None)
    if named is not None:
        return dict(named(index, nocs=nocs))
    try:
        frame = source.load(index, nocs=nocs)
    except Exception:  # what is wrong with it, scoring says
        return {"frame": ""}
    arrays = (frame.color, frame.depth_raw, frame.depth_true, frame.mask, frame.nocs)
    known = [None if a is None else [a.shape, a.dtype.str, a.tobytes()] for a in arrays]
    camera = frame.camera
    focal = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]
    objects = [[i.mask_id, i.class_id, int(i.material)] for i in frame.instances]
    return {"frame": digest_of(known, focal, objects, versioned=False)}


def names_digest(keys: Iterable[FrameKey]) -> str:
    """Return the SHA-256 hash of the frame names, in order."""
    return hashlib.sha256("\n".join(map(str, keys)).encode()).hexdigest()


def iterate(
    source: DepthSource, *, start: int = 0, stop: int | None = None
) -> Iterator[DepthFrame]:
    """Yield the frames in order; only one is in memory at a time."""
    for index in range(start, len(source) if stop is None else min(stop, len(source))):
        yield source.load(index)


@dataclass(frozen=True)
class Published:
    """A published number of frames of a split.

    Attributes:
        source: source of the number.
        scenes: number of scenes, if published.
        of_more: description of what the number includes, if more than the split.
    """

    source: str
    frames: int
    scenes: int | None = None
    of_more: str = ""


@dataclass(frozen=True)
class Split:
    """A named part of a data set.

    Attributes:
        name: name on the command line.
        about: description in one line.
        layout: expected location of its files, shown if there are none.
        open: opens the source in a root folder; it may search below it.
        page: URL of the page of the data set.
        download: URLs of the files.
        published: frame counts of papers and pages, which may differ.
        card: what is known of the data: what true depth is, which pixels its authors score, the
            licence, and what was not verified.
    """

    name: str
    about: str
    layout: str
    open: Callable[[Path], DepthSource]
    page: str = ""
    download: tuple[str, ...] = ()
    published: tuple[Published, ...] = ()
    card: tuple[str, ...] = ()


_MODULE = "benchmark.data.known_splits"

_FIELD_MODULE = "benchmark.data.field.field_splits"

# Splits of the field's sets; `field_splits` has each as an attribute.
_FIELD = (
    *(f"hammer-{sensor}-test" for sensor in ("d435", "l515", "tof")),
    *(f"hammer-{sensor}-train" for sensor in ("d435", "l515", "tof")),
    "clearpose-train", "clearpose-test", "clearpose-heavy-occlusion", "clearpose-new-background",
    "clearpose-opaque-distractor", "clearpose-translucent-cover", "clearpose-non-planar",
    "clearpose-filled-liquid",
    *(f"transcg-{sensor}-{part}" for sensor in ("d435", "l515")
      for part in ("test", "test-2022-10", "train")),
    "xyzibd-val-realsense", "xyzibd-val-xyz", "xyzibd-val-photoneo", "ipd-val-photoneo",
    "pace-test", "pace-val-inst", "pace-val-pbr-cat", "pace-train-pbr-cat", "pace-train-pbr-inst",
    "housecat6d-train", "housecat6d-val", "housecat6d-test", "robi-ensenso",
    "phocal-train", "phocal-test",
    *(f"transpose-{side}-{part}" for side in ("right", "left") for part in ("test", "train")),
    *(f"{name}-{part}" for name in ("syn-todd", "todd") for part in ("train", "val", "test")),
    "syn-todd-rendered",
    *(f"gn-trans-{part}" for part in ("train", "test-seen", "test-similar", "test-novel")),
    "real275-test", "real275-train", "camera25-val", "camera25-train",
)  # fmt: skip

splits: Registry[Split] = Registry(
    "std_toolkit.splits",
    {
        "dreds-catknown-train": f"{_MODULE}:DREDS_CATKNOWN_TRAIN",
        "dreds-catknown-val": f"{_MODULE}:DREDS_CATKNOWN_VAL",
        "dreds-catknown-test": f"{_MODULE}:DREDS_CATKNOWN_TEST",
        "dreds-catnovel": f"{_MODULE}:DREDS_CATNOVEL",
        "std-catknown": f"{_MODULE}:STD_CATKNOWN",
        "std-catnovel": f"{_MODULE}:STD_CATNOVEL",
        "cleargrasp-real-known": f"{_MODULE}:CLEARGRASP_REAL_KNOWN",
        "cleargrasp-real-novel": f"{_MODULE}:CLEARGRASP_REAL_NOVEL",
        "cleargrasp-synthetic": f"{_MODULE}:CLEARGRASP_SYNTHETIC",
        "scenes": f"{_MODULE}:SCENES",
        "std-export": f"{_MODULE}:STD_EXPORT",
        **{name: f"{_FIELD_MODULE}:{name.upper().replace('-', '_')}" for name in _FIELD},
    },
)


def get_split(name: str) -> Split:
    """Return a split by name, or by `package.module:SPLIT`.

    Raises:
        ToolkitError: unknown split; the known ones are listed.
    """
    split = splits.get(name)
    if not isinstance(split, Split):
        raise ToolkitError("is no benchmark.data.splits.Split", field="split", value=name)
    return split


def open_split(name: str, root: Path | str) -> DepthSource:
    """Open the frames of a split below a folder; see `Place` for the search.

    Raises:
        ToolkitError: unknown split, missing folder, or no data of the split below it.
    """
    split = get_split(name)
    root = Path(root)
    if not root.is_dir():
        raise ToolkitError("no such folder", path=root, hint=where_to_get(split))
    return split.open(root)


def where_to_get(split: Split) -> str:
    """Return the instructions for a missing split."""
    text = f"{split.name} is expected as {split.layout}"
    return f"{text}; download: {split.page}" if split.page else text


def saved_depth_path(folder: Path, split: str, key: FrameKey) -> Path:
    """Return the path of restored depth of a frame: FOLDER/SCENE/NAME + suffix of the data set."""
    suffix = _SUFFIXES.get(split.partition("-")[0], _OTHERS)
    return folder / key.scene / f"{key.name}{suffix}"
