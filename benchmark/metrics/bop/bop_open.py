"""Opening a BOP data set: its scenes, the sensor, and what is to be found."""

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from benchmark.metrics.bop.bop_dataset import BopDataset, BopTarget, ImageTarget, ViewGroup
from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.bop_metadata import TARGET_VISIBLE
from std_toolkit.importers import bop_documents
from std_toolkit.io.documents import read_document

_GT_FILE = re.compile(r"scene_gt(?:_(?!info|coco)(?P<sensor>[^.]+))?\.json")
# What bop_toolkit scores of data sets with several sensors; HOT3D has the last two.
USUAL_SENSORS = ("", "photoneo", "xyz", "3dlong", "rgb", "gray1")


class _Visibility(msgspec.Struct, frozen=True, kw_only=True):
    visib_fract: float


def open_bop(
    root: Path | str,
    split: str = "test",
    *,
    sensors: Sequence[str] = (),
    symmetry_steps: int | None = None,
    multi_view: bool = False,
) -> BopDataset:
    """Open a split of a data set in BOP's layout.

    Args:
        root: of the data set.
        split: folder of the scenes.
        sensors: of a data set with several, such as `photoneo`; of each scene the first that it
            has. By default those that the BOP Challenge scores.
        symmetry_steps: samples of a turn about a continuous axis (315 in published figures); None
            for the exact minimum.
        multi_view: take the images of test_targets_multiview_bop25.json, for detection alone.

    Returns:
        The data set. Targets are those of test_targets_bop19.json, images those of
        test_targets_bop24.json; without these files, all instances of which a tenth is visible.

    Raises:
        ToolkitError: documents are missing, break the format, or do not belong together.

    >>> open_bop("/nowhere")
    Traceback (most recent call last):
    std_toolkit.errors.ToolkitError: /nowhere/test: no scenes of a BOP data set here
    """
    root = Path(root)
    found = _scene_folders(root / split)
    if not found:
        raise ToolkitError("no scenes of a BOP data set here", path=root / split)
    chosen = _choose_sensors(sensors, found, root / split)
    scenes = {
        int(f.name): bop_documents.read_bop_scene(f, sensor, for_import=False)
        for f, sensor in chosen.items()
    }
    by_scene = {int(f.name): sensor for f, sensor in chosen.items()}
    visible = {number: _visibility(scene, by_scene[number]) for number, scene in scenes.items()}
    if multi_view:
        groups, targets = read_groups(root, split), list[BopTarget]()
        images = _views(groups, scenes, by_scene, _multi_view_path(root, split))
    else:
        groups = []
        targets, images = _single_views(root, split, scenes, visible)
    return BopDataset(
        root,
        split,
        by_scene,
        tuple(targets),
        tuple(dict.fromkeys(images)),
        scenes,
        visible,
        symmetry_steps,
        tuple(groups),
    )


def _single_views(
    root: Path,
    split: str,
    scenes: dict[int, bop_documents.BopScene],
    visible: dict[int, dict[int, list[float]]],
) -> tuple[list[BopTarget], list[tuple[int, int]]]:
    """Targets of the recalls, and images of detection."""
    # T-LESS has test_targets_bop19.json for test_primesense/.
    name = split.partition("_")[0]
    path19, path24 = (root / f"{name}_targets_bop{year}.json" for year in (19, 24))
    targets: list[BopTarget] = []
    if path19.is_file():
        targets = read_document(path19, list[BopTarget])
        _check_scenes(targets, scenes, path19)
    if path24.is_file():
        listed = read_document(path24, list[ImageTarget])
        _check_scenes(listed, scenes, path24)
        return targets, [(t.scene_id, t.im_id) for t in listed]
    if not path19.is_file():
        targets = _all_visible(scenes, visible)
    return targets, [(t.scene_id, t.im_id) for t in targets]


def read_groups(root: Path, split: str = "test") -> list[ViewGroup]:
    """Read the multi-view targets of a data set.

    Args:
        root: of the data set.
        split: folder of the scenes.

    Returns:
        The groups of views in the order of the file.

    Raises:
        ToolkitError: there are none, or they break the format.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "test_targets_multiview_bop25.json")
    ...     _ = path.write_text('[{"scene_id": 1, "im_id": [["photoneo", 3], ["photoneo", 7]]}]')
    ...     read_groups(Path(folder))[0].images("photoneo")
    [3, 7]
    """
    path = _multi_view_path(root, split)
    if not path.is_file():
        raise ToolkitError(
            "no multi-view targets here",
            path=path,
            hint="IPD, XYZ-IBD and ITODD-MV have them; without --multi-view single images count",
        )
    return read_document(path, list[ViewGroup])


def _multi_view_path(root: Path, split: str) -> Path:
    return root / f"{split.partition('_')[0]}_targets_multiview_bop25.json"


def _views(
    groups: Sequence[ViewGroup],
    scenes: dict[int, bop_documents.BopScene],
    sensors: dict[int, str],
    path: Path,
) -> list[tuple[int, int]]:
    """Scenes and images of the groups' views of the scored sensor."""
    _check_scenes(groups, scenes, path)
    images = [(g.scene_id, i) for g in groups for i in g.images(sensors[g.scene_id])]
    for scene, im_id in images:
        if im_id not in scenes[scene].cameras:
            raise ToolkitError("no such image", path=path, value=f"scene {scene}, image {im_id}")
    if not images:
        hint = "--sensor names another one"
        raise ToolkitError("no view is of the sensor that is scored", path=path, hint=hint)
    return images


def _scene_folders(folder: Path) -> dict[Path, set[str]]:
    """Scenes and the sensors of their true poses."""
    found: dict[Path, set[str]] = defaultdict(set)
    for path in sorted(folder.glob("*/scene_gt*.json")):
        match = _GT_FILE.fullmatch(path.name)
        if match and path.parent.name.isdigit():
            found[path.parent].add(match["sensor"] or "")
    return dict(found)


def _choose_sensors(
    wanted: Sequence[str], found: dict[Path, set[str]], path: Path
) -> dict[Path, str]:
    """The sensor of each scene; scenes without one of the wanted sensors are left out."""
    there = sorted(set().union(*found.values()))
    for sensor in wanted:
        if sensor not in there:
            raise ToolkitError(
                "no such sensor",
                path=path,
                field="sensor",
                value=sensor,
                hint="these are there: " + (", ".join(filter(None, there)) or "no named sensors"),
            )
    order = wanted or [s for s in USUAL_SENSORS if s in there]
    order = order or (there if len(there) == 1 else [])
    if not order:
        raise ToolkitError("several sensors", path=path, hint=f"--sensor: {', '.join(there)}")
    firsts = {f: next((s for s in order if s in sensors), None) for f, sensors in found.items()}
    return {f: sensor for f, sensor in firsts.items() if sensor is not None}


def _check_scenes(
    targets: Iterable[BopTarget | ImageTarget | ViewGroup], scenes: dict[int, Any], path: Path
) -> None:
    for target in targets:
        if target.scene_id not in scenes:
            raise ToolkitError("no such scene", path=path, value=target.scene_id)


def _visibility(scene: bop_documents.BopScene, sensor: str) -> dict[int, list[float]]:
    path = bop_documents.scene_file(scene.folder, "gt_info", sensor)
    infos = read_document(path, dict[str, list[_Visibility]])
    shares = {int(k): [row.visib_fract for row in rows] for k, rows in infos.items()}
    for im_id, rows in scene.gt.items():
        if len(shares.get(im_id, [])) != len(rows):
            gt = bop_documents.scene_file(scene.folder, "gt", sensor)
            raise ToolkitError(f"does not match {gt.name}", path=path, field=str(im_id))
    return shares


def _all_visible(
    scenes: dict[int, bop_documents.BopScene], visible: dict[int, dict[int, list[float]]]
) -> list[BopTarget]:
    counts: dict[tuple[int, int, int], int] = defaultdict(int)
    for number, scene in scenes.items():
        for im_id, rows in scene.gt.items():
            for row, share in zip(rows, visible[number][im_id], strict=True):
                if share >= TARGET_VISIBLE:
                    counts[number, im_id, row.obj_id] += 1
    return [
        BopTarget(scene_id=s, im_id=i, obj_id=o, inst_count=n)
        for (s, i, o), n in sorted(counts.items())
    ]
