"""The built-in splits, and the search for the folder of a split below the data root.

Pages and counts: the papers (DREDS and STD: arXiv 2208.03792; ClearGrasp: arXiv 1910.02550) and the
README files of github.com/PKU-EPIC/DREDS and github.com/Shreeyak/cleargrasp. They contradict each
other about STD.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.data import cleargrasp, dreds_std, loading, splits, toolkit_scenes
from std_toolkit.errors import ToolkitError

# Folder names that identify one split of one data set; other splits skip these folders.
_NAMES = (
    ("dreds-catknown", "dreds-catnovel", "std-catknown", "std-catnovel"),
    ("train", "val", "test"),
    ("real-val", "real-known", "real-test", "real-novel", "synthetic-val", "synthetic-test"),
)

# Folders between the root and the data sets, as created by archives and users.
_WRAPPERS = (
    "", "dreds", "std", "cleargrasp", "cleargrasp-dataset-test-val", "data", "data/dreds",
    "data/std", "data/cleargrasp", "data/cleargrasp-dataset-test-val",
    "cleargrasp/cleargrasp-dataset-test-val",
)  # fmt: skip

_DREDS_PAGE = "https://pku-epic.github.io/DREDS/"

_DREDS_FILES = "https://mirrors.pku.edu.cn/dl-release/DREDS_ECCV2022/data/"

_CLEARGRASP_PAGE = "https://sites.google.com/view/cleargrasp"

_CLEARGRASP_FILES = "https://storage.googleapis.com/cleargrasp/cleargrasp-dataset-test-val.tar"


@dataclass(frozen=True)
class Place:
    """Possible folders of the scenes of a split.

    Attributes:
        folders: names in the root or in one of the wrapper folders in it, preferred first; levels
            are separated by "/". Case is ignored, and `-` and `_` are equal.
        data_set: folder name of the data set, "" for any.
        part: whether the data set has parts, so that the folder must not have the name of another
            part.
    """

    folders: tuple[str, ...]
    data_set: str = ""
    part: bool = False

    def find(self, root: Path) -> Path | None:
        """Return the folder, or None.

        The root itself is returned unless it belongs to another split or contains several splits.
        """
        for wrapper in _WRAPPERS:
            for folder in self.folders:
                found = _descend(root, (*wrapper.split("/"), *folder.split("/")))
                if found is not None and not self._is_rival(found):
                    return found
        if not root.is_dir() or self._is_rival(root):
            return None
        every = {name for names in (*_NAMES, *(w.split("/") for w in _WRAPPERS)) for name in names}
        if any(_plain(p.name) in every for p in _folders(root)):
            return None
        return root

    def _is_rival(self, folder: Path) -> bool:
        parts = [_plain(p) for p in folder.resolve().parts[-3:]]
        data_sets = {p for p in parts if p in _NAMES[0]}
        if data_sets and _plain(self.data_set) not in data_sets:
            return True
        if not self.part:
            return False
        known = [p for p in parts if p in (*_NAMES[1], *_NAMES[2])]
        own = {_plain(f.rsplit("/", 1)[-1]) for f in self.folders}
        return bool(known) and known[-1] not in own


def find_all(root: Path, folders: Sequence[str]) -> list[Path]:
    """Return those folders that exist in the root, or else in a wrapper folder in it."""
    for wrapper in _WRAPPERS:
        found = [_descend(root, (*wrapper.split("/"), f)) for f in folders]
        if any(found):
            return [f for f in found if f is not None]
    return []


def _descend(root: Path, parts: tuple[str, ...]) -> Path | None:
    place = root
    for part in parts:
        if not part:
            continue
        below = next((p for p in _folders(place) if _plain(p.name) == _plain(part)), None)
        if below is None:
            return None
        place = below
    return place if place.is_dir() else None


def _folders(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            return sorted(folder / e.name for e in entries if e.is_dir())
    except OSError:
        return []


def _plain(name: str) -> str:
    return name.lower().replace("_", "-")


def _layout_scenes(name: str, layout: str, place: Place) -> Callable[[Path], splits.DepthSource]:
    def open_root(root: Path) -> splits.DepthSource:
        top = place.find(root)
        index = (
            loading.list_scenes(top, dreds_std.frame_suffixes(dreds_std.LAYOUTS[layout]))
            if top
            else loading.FrameIndex(())
        )
        if top is None or not len(index):
            raise _nothing(name, top or root)
        _check_layout(name, layout, index)
        return dreds_std.LayoutScenes(name, layout, index)

    return open_root


def _open_exports(root: Path) -> splits.DepthSource:
    layout = dreds_std.LAYOUTS["std"]
    # Exports for other tools may be in the same folder; NOCS has equal names for colour and masks.
    depth = (layout.raw, *layout.ground_truth)
    index = loading.list_scenes(root, dreds_std.frame_suffixes(layout), telling=depth)
    if not len(index):
        raise _nothing("std-export", root)
    return dreds_std.LayoutScenes("std-export", "std", index)


def _check_layout(name: str, layout: str, index: loading.FrameIndex) -> None:
    """Check the layout by its depth files: other files have the same names in both layouts."""
    ours = dreds_std.LAYOUTS[layout]
    other = next(x for x in dreds_std.LAYOUTS.values() if x.name != layout)
    folder = Path(index.scenes[0].path)
    names = {p.name for p in folder.iterdir()}
    stems = index.scenes[0].stems
    if any(s + x in names for s in stems for x in (ours.raw, *ours.ground_truth)):
        return
    if any(s + x in names for s in stems for x in (other.raw, *other.ground_truth)):
        raise ToolkitError(
            f"{name} has *{ours.raw} and *{ours.ground_truth[0]}; "
            f"here are files of the layout {other.name}",
            path=folder,
            hint="another split?",
        )


def _captures(name: str, place: Place) -> Callable[[Path], splits.DepthSource]:
    def open_root(root: Path) -> splits.DepthSource:
        top = place.find(root)
        index = (
            loading.list_scenes(top, cleargrasp.SUFFIXES, depth=1)
            if top
            else loading.FrameIndex(())
        )
        if not len(index):
            raise _nothing(name, top or root)
        return cleargrasp.ClearGraspReal(name, index)

    return open_root


def _rendered(name: str) -> Callable[[Path], splits.DepthSource]:
    def open_root(root: Path) -> splits.DepthSource:
        index = cleargrasp.list_rendered(
            find_all(root, ("synthetic-val", "synthetic-test")) or [root]
        )
        if not len(index):
            raise _nothing(name, root)
        return cleargrasp.ClearGraspSynthetic(name, index)

    return open_root


def _nothing(name: str, place: Path) -> ToolkitError:
    return ToolkitError(
        "nothing of this split is here",
        path=place,
        value=name,
        hint=splits.where_to_get(splits.get_split(name)),
    )


def _dreds(
    name: str, part: str, about: str, published: tuple[splits.Published, ...]
) -> splits.Split:
    # Folders in the archives of the parts.
    inside = {"val": ("shapenet_generate_1216",), "test": ("shapenet_generate_1216_val_novel",)}
    folders = (f"DREDS-CatKnown/{part}", part, *inside.get(part, ()))
    place = Place(folders, data_set="DREDS-CatKnown", part=True)
    return splits.Split(
        name=name,
        about=about,
        layout=f"ROOT/DREDS-CatKnown/{part}/<scene>/0000_simDepthImage.exr",
        open=_layout_scenes(name, "dreds", place),
        page=_DREDS_PAGE,
        download=(f"{_DREDS_FILES}DREDS-CatKnown/",),
        published=published,
    )


_TRAIN_AND_VAL = splits.Published(
    "paper and the README", 100_200, 3340, of_more="training and validation"
)

DREDS_CATKNOWN_TRAIN = _dreds(
    "dreds-catknown-train", "train", "simulated, training shapes of 7 categories", (_TRAIN_AND_VAL,)
)

DREDS_CATKNOWN_VAL = _dreds(
    "dreds-catknown-val", "val", "simulated, training shapes in other scenes", (_TRAIN_AND_VAL,)
)

DREDS_CATKNOWN_TEST = _dreds(
    "dreds-catknown-test",
    "test",
    "simulated, new shapes of 7 categories",
    (splits.Published("paper and the README", 19_380, 646),),
)

DREDS_CATNOVEL = splits.Split(
    name="dreds-catnovel",
    about="simulated, 60 objects of other categories",
    layout="ROOT/DREDS-CatNovel/<scene>/0000_simDepthImage.exr",
    open=_layout_scenes(
        "dreds-catnovel", "dreds", Place(("DREDS-CatNovel",), data_set="DREDS-CatNovel")
    ),
    page=_DREDS_PAGE,
    download=(f"{_DREDS_FILES}DREDS-CatNovel/",),
    published=(splits.Published("paper and the README", 11_520),),
)

STD_CATKNOWN = splits.Split(
    name="std-catknown",
    about="real D415, 42 objects of 7 categories in 25 scenes",
    layout="ROOT/STD-CatKnown/<scene>/0000_depth_415.exr",
    open=_layout_scenes("std-catknown", "std", Place(("STD-CatKnown",), data_set="STD-CatKnown")),
    page=_DREDS_PAGE,
    download=(f"{_DREDS_FILES}STD-CatKnown/",),
    published=(splits.Published("paper", 22_500, 25), splits.Published("README", 27_000, 25)),
)

STD_CATNOVEL = splits.Split(
    name="std-catnovel",
    about="real D415, 8 objects of other categories in 5 scenes, all specular or transparent",
    layout="ROOT/STD-CatNovel/<scene>/0000_depth_415.exr",
    open=_layout_scenes(
        "std-catnovel", "std", Place(("STD-CatNovel", "real_data_novel"), data_set="STD-CatNovel")
    ),
    page=_DREDS_PAGE,
    download=(f"{_DREDS_FILES}STD-CatNovel/",),
    published=(splits.Published("paper", 4_500, 5), splits.Published("README", 11_000, 5)),
)

CLEARGRASP_REAL_KNOWN = splits.Split(
    name="cleargrasp-real-known",
    about="real D435, transparent objects of the training set (real-val)",
    layout="ROOT/real-val/d435/000000000-transparent-depth-img.exr",
    open=_captures("cleargrasp-real-known", Place(("real-val", "real-known"), part=True)),
    page=_CLEARGRASP_PAGE,
    download=(_CLEARGRASP_FILES,),
    published=(splits.Published("paper", 173),),
)

CLEARGRASP_REAL_NOVEL = splits.Split(
    name="cleargrasp-real-novel",
    about="real D415 and D435, transparent objects that are new (real-test)",
    layout="ROOT/real-test/d415/000000000-transparent-depth-img.exr",
    open=_captures("cleargrasp-real-novel", Place(("real-test", "real-novel"), part=True)),
    page=_CLEARGRASP_PAGE,
    download=(_CLEARGRASP_FILES,),
    published=(splits.Published("paper", 113),),
)

CLEARGRASP_SYNTHETIC = splits.Split(
    name="cleargrasp-synthetic",
    about="rendered transparent objects, known (synthetic-val) and novel (synthetic-test)",
    layout="ROOT/synthetic-val/<object>-val/rgb-imgs/000000000-rgb.jpg",
    open=_rendered("cleargrasp-synthetic"),
    page=_CLEARGRASP_PAGE,
    download=(_CLEARGRASP_FILES,),
)

SCENES = splits.Split(
    name="scenes",
    about="scene folders of this toolkit, recorded, imported or simulated",
    layout="ROOT/<scene>/scene.json with ground truth (`std-curate render`)",
    open=lambda root: toolkit_scenes.open_scenes("scenes", root),
)

STD_EXPORT = splits.Split(
    name="std-export",
    about="exports of `std-curate export --format std`, several below one folder too",
    layout="ROOT/<export>/<scene>/0000_depth_415.exr",
    open=_open_exports,
)
