"""Score grasps that another program planned: dumps of GraspNet-1Billion's test scenes.

A dump has the files that graspnetAPI evaluates: `scene_0100/realsense/0000.npy`, rows of 17 numbers
in the camera frame. AP is the mean over images, frictions of 0.2 to 1.2 and the best 1 to 50
grasps.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from benchmark.data.identity import SAVED_GRASPS
from benchmark.data.splits import FrameKey, Inputs
from benchmark.evaluation.config import GraspConfig
from benchmark.evaluation.frames import error_line
from benchmark.evaluation.manifest import DUMP_MANIFEST, DumpManifest, DumpSetup, circumstances
from benchmark.evaluation.results import (
    ERROR,
    FRAME,
    INDEX,
    SCENE,
    Result,
    check_columns,
    find_runs,
    read_known,
    read_table,
    write_part,
)
from benchmark.evaluation.submission import keep_submission, read_submission
from benchmark.evaluation.task_run import TaskRun
from benchmark.evaluation.values import checked_label
from benchmark.metrics.grasp.ap import (
    TOP,
    ContactKind,
    JudgedObject,
    judge_grasps,
    precision_at,
)
from benchmark.metrics.grasp.force_closure import FRICTIONS
from benchmark.metrics.grasp.grasp import DumpKey, read_grasps
from benchmark.metrics.significance import mean_interval
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import text_table
from std_toolkit.io.documents import read_document

DUMP_FOLDER, PRECISIONS = "graspnet", "precisions.parquet"
SPLITS = {"seen": range(100, 130), "similar": range(130, 160), "novel": range(160, 190)}
SplitName = Literal["test", "seen", "similar", "novel"]
# Precision at each friction, mean over the best 1 to 50 grasps.
_COLUMNS = tuple(f"precision_{mu:g}" for mu in FRICTIONS)
HEADINGS = ("grasps", "camera", "contacts", "images", "AP", "AP0.8", "AP0.4", "seen", "similar",
            "novel")  # fmt: skip


class GraspNetData:
    """Test scenes, their annotated images, and models as they are judged."""

    def __init__(self, root: Path, camera: str, split: SplitName) -> None:
        from sensors.physics.graspnet import GraspNetScenes

        self.scenes = GraspNetScenes(root, camera=camera)
        self._root = root
        names = SPLITS if split == "test" else (split,)
        wanted = {scene for name in names for scene in SPLITS[name]}
        self.images = [
            DumpKey(scene, camera, image)
            for scene in self.scenes.scenes()
            if scene in wanted
            for image in self.scenes.images(scene)
        ]
        if not self.images:
            raise ToolkitError(
                f"no annotated image of the split {split!r}",
                path=root / "scenes",
                hint="test scenes are scene_0100 to scene_0189",
            )
        self.judged = cache(self._judged)

    def mesh_paths(self, number: int) -> list[Path]:
        """Files of a model, which need not exist."""
        folder = self._root / "models" / f"{number:03d}"
        return [folder / name for name in ("nontextured.ply", "textured.obj")]

    def _judged(self, number: int) -> JudgedObject:
        """A model: its mesh for contacts; the vertices of its scan for collisions, as there."""
        from std_toolkit.geometry.mesh import load_mesh

        there = [path for path in self.mesh_paths(number) if path.is_file()]
        if not there:
            folder = self._root / "models" / f"{number:03d}"
            raise ToolkitError("no mesh of the model", path=folder)
        points, mesh = load_mesh(there[0]), load_mesh(there[-1])
        return JudgedObject(
            np.asarray(mesh.vertices), np.asarray(mesh.faces), np.asarray(points.vertices)
        )


@dataclass(frozen=True, kw_only=True)
class DumpRun(TaskRun[GraspNetData, None]):
    """A dump on test scenes of GraspNet-1Billion.

    Attributes:
        dump, data: folders of the grasps and of the data set.
        split, camera: images to score.
        contacts: how contacts are found.
        label: name of the grasps.
        out: folder of results.
    """

    manifest_name, table_name, unit = DUMP_MANIFEST, PRECISIONS, "images"
    dump: Path
    data: Path
    split: SplitName
    camera: str
    contacts: ContactKind
    label: str
    out: Path
    devices: tuple[str, ...] = ("cpu",)

    @property
    def folder(self) -> Path:
        return self.out / DUMP_FOLDER / f"{self.split}-{self.camera}" / self.contacts / self.label

    @property
    def title(self) -> str:
        return f"{self.label} on GraspNet's {self.split}, {self.camera}, {self.contacts} contacts"

    def open(self) -> GraspNetData:
        if not self.dump.is_dir():
            raise ToolkitError("the folder of grasps is not there", path=self.dump)
        read_submission(self.dump)  # a wrong one is refused before any work
        return GraspNetData(self.data, self.camera, self.split)

    def make(self, device: str) -> None:
        """Create nothing: the grasps are in files."""

    def manifest(self, data: GraspNetData, methods: None) -> DumpManifest:  # noqa: ARG002
        setup = DumpSetup(
            split=self.split,
            camera=self.camera,
            contacts=self.contacts,
            frames=len(data.images),
        )
        return DumpManifest(
            label=self.label,
            setup=setup,
            root=str(self.data),
            dump=str(self.dump),
            **circumstances(),
        )

    def frames_there(self, data: GraspNetData) -> int:
        return len(data.images)

    def inputs(self, data: GraspNetData) -> Iterator[tuple[int, FrameKey, Inputs]]:
        for index, key in enumerate(data.images):
            folder = self.data / "scenes" / f"scene_{key.scene:04d}" / key.camera
            found = {
                SAVED_GRASPS: key.found(self.dump),
                "annotation": folder / "annotations" / f"{key.frame:04d}.xml",
                "camera pose": folder / "camera_poses.npy",
                "table": folder / "cam0_wrt_table.npy",
            }
            try:
                models = {p.model for p in data.scenes.placed(key.scene, image=key.frame)}
            except ToolkitError:  # scoring says what is wrong
                models = set()
            for number in sorted(models):
                found |= {f"{p.name} of {number}": p for p in data.mesh_paths(number)}
            yield index, FrameKey(f"scene_{key.scene:04d}", f"{key.frame:04d}"), found

    def items(self, data: GraspNetData, done: set[int], workers: int) -> list[int]:  # noqa: ARG002
        return [i for i in range(len(data.images)) if i not in done]

    def item_title(self, item: int) -> str:
        return f"image {item}"

    def work(self, data: GraspNetData, methods: None, item: int) -> int:  # noqa: ARG002
        key = data.images[item]
        name = FrameKey(f"scene_{key.scene:04d}", f"{key.frame:04d}")
        row: dict[str, Any] = {INDEX: item, SCENE: name.scene, FRAME: name.name, ERROR: ""}
        row |= dict.fromkeys(_COLUMNS, np.nan) | {"grasps": -1}
        try:
            grasps = read_grasps(key.found(self.dump))
        except ToolkitError as error:
            # Without an answer nothing is precise.
            row |= {ERROR: error_line(error), **dict.fromkeys(_COLUMNS, 0.0)}
            write_part(self.folder, item, item, [row])
            return 1
        try:
            T_cam_table = data.scenes.camera_pose(key.scene, image=key.frame).inverse()
            placed = data.scenes.placed(key.scene, image=key.frame)
            judged = judge_grasps(
                grasps,
                [data.judged(p.model) for p in placed],
                [T_cam_table @ p.T_world_model for p in placed],
                T_cam_table,
                contacts=self.contacts,
            )
        except ToolkitError as error:
            row[ERROR] = error_line(error)
        else:
            shares = precision_at(judged.friction).mean(axis=0)
            row |= dict(zip(_COLUMNS, shares.tolist(), strict=True)) | {"grasps": len(grasps)}
        write_part(self.folder, item, item, [row])
        return 1

    def after(self) -> None:
        """Keep what the author of the grasps says of them."""
        keep_submission(self.dump, self.folder)

    def read(self) -> DumpResult:
        return read_dump_run(self.folder)


class DumpFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of a dump in percent, each with its 95 % interval over scenes.

    Attributes:
        label, camera, contacts: what was scored, and how.
        images: number of scored images, of which those without grasps count 0.
        unanswered: images without grasps, or that could not be read.
        ap, ap08, ap04: over all images.
        seen, similar, novel: AP over the images of each part; absent without any.
    """

    label: str
    camera: str
    contacts: str
    images: int
    ap: tuple[float, float, float]
    ap08: tuple[float, float, float]
    ap04: tuple[float, float, float]
    unanswered: int = 0
    seen: tuple[float, float, float] | None = None
    similar: tuple[float, float, float] | None = None
    novel: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class DumpResult(Result[DumpManifest]):
    """Results of a dump."""

    @property
    def title(self) -> str:
        s = self.manifest.setup
        place = self.place or s.split
        return f"{self.manifest.label} on GraspNet's {place}, {s.camera}, {s.contacts} contacts"

    @property
    def figures(self) -> DumpFigures:
        """Means and intervals."""
        good = self.table[self.table[_COLUMNS[0]].notna()]
        ap = 100 * good[list(_COLUMNS)].mean(axis=1)
        scenes = good[SCENE]
        number = scenes.str[-4:].astype(int)
        parts = {
            name: _mean(ap[mine], scenes[mine])
            for name, group in SPLITS.items()
            if (mine := number.isin(group)).any()
        }
        setup = self.manifest.setup
        return DumpFigures(
            label=self.manifest.label,
            camera=setup.camera,
            contacts=setup.contacts,
            images=len(good),
            unanswered=self.failed + self.missing,
            ap=_mean(ap, scenes),
            ap08=_mean(100 * good["precision_0.8"], scenes),
            ap04=_mean(100 * good["precision_0.4"], scenes),
            **parts,
        )


def _mean(values: Any, scenes: Any) -> tuple[float, float, float]:
    found = mean_interval(np.asarray(values), np.asarray(scenes))
    return float(found.mean), float(found.low), float(found.high)


def read_dump_run(folder: Path) -> DumpResult:
    """Read the results of a dump.

    Raises:
        ToolkitError: a file is missing or damaged, or no image could be scored.
    """
    manifest = read_document(folder / DUMP_MANIFEST, DumpManifest)
    path = folder / PRECISIONS
    table = read_table(path)
    check_columns(table, (INDEX, SCENE, FRAME, ERROR, *_COLUMNS), path)
    if not (table[ERROR] == "").any():
        raise ToolkitError("no image could be scored", path=path, value=table[ERROR].iloc[0])
    said = read_submission(folder)
    return DumpResult(folder, manifest, table, said=said, data=read_known(folder))


def read_dump_results(folders: Iterable[Path]) -> list[DumpResult]:
    """Read all dumps below some folders of results.

    Raises:
        ToolkitError: a folder has none, or two have the same name.
    """
    return find_runs(folders, DUMP_MANIFEST, PRECISIONS, read_dump_run)


def plan_dump(dump: Path, config: GraspConfig) -> list[DumpRun]:
    """Return the run that scores a dump.

    Raises:
        ToolkitError: no data, or a label that cannot be the name of a folder.
    """
    if config.data is None:
        raise ToolkitError("needs the folder of GraspNet-1Billion", field="--data")
    return [
        DumpRun(
            dump=dump,
            data=config.data,
            split=config.graspnet_split,
            camera=config.graspnet_camera,
            contacts=config.contacts,
            label=config.labels.get("dump") or checked_label(dump.resolve().name),
            out=config.out,
        )
    ]


def dump_table(results: Iterable[DumpResult]) -> str:
    """Format the figures in percent; 95 % intervals over scenes in brackets."""
    rows: list[Sequence[str]] = []
    for result in results:
        f = result.figures
        shares = (f.ap, f.ap08, f.ap04, f.seen, f.similar, f.novel)
        images = f"{f.images} ({f.unanswered} unanswered)" if f.unanswered else str(f.images)
        rows.append([f.label, f.camera, f.contacts, images, *map(_percent, shares)])
    title = f"GraspNet's average precision in percent, best {TOP} grasps"
    return text_table(HEADINGS, rows, title=title).terminal()


def _percent(figure: tuple[float, float, float] | None) -> str:
    if figure is None:
        return "-"
    mean, low, high = figure
    return f"{mean:.2f}" if np.isnan(low) else f"{mean:.2f} [{low:.2f}, {high:.2f}]"


def dump_records(results: Iterable[DumpResult]) -> list[Any]:
    """Return the figures, for JSON."""
    return [msgspec.to_builtins(result.figures) for result in results]
