"""Instance-level pose as a task: result files in BOP's format, scored image by image."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd

from benchmark.data.splits import FrameKey
from benchmark.evaluation.config import BopConfig
from benchmark.evaluation.engine import Task
from benchmark.evaluation.frames import Base, FramesRun
from benchmark.evaluation.manifest import (
    BOP_FILE,
    BOP_MANIFEST,
    BopManifest,
    BopSetup,
    circumstances,
)
from benchmark.evaluation.results import ERROR, INDEX, SCENE, read_table
from benchmark.metrics.bop import (
    BopDataset,
    BopScorer,
    BopTarget,
    found_of,
    mean_recalls,
    open_bop,
    read_bop_results,
    seconds_per_image,
)
from benchmark.metrics.bop.bop_dataset import BopImage
from benchmark.metrics.significance import mean_interval
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import text_table
from std_toolkit.io.documents import read_document, write_document

FOLDER, ERRORS = "bop", "errors.parquet"
RENDERER = "raycast"
RECALLS = ("vsd", "mssd", "mspd")
FOUND = tuple(f"found_{name}" for name in RECALLS)


class BopResult(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One result file.

    Attributes:
        results: name of the file.
        data, split: folder of the data set, and of its scenes.
        targets: number of target instances.
        estimates: number of lines of the file.
        ar: mean of the three average recalls, 0 to 1.
        ar_vsd, ar_mssd, ar_mspd: the average recalls, 0 to 1.
        seconds_per_image: run time of the method; None if the file does not give it.
    """

    results: str
    data: str
    split: str
    targets: int
    estimates: int
    ar: float
    ar_vsd: float
    ar_mssd: float
    ar_mspd: float
    seconds_per_image: float | None


class BopFigures(BopResult, frozen=True, kw_only=True):
    """A result file with its intervals.

    Attributes:
        intervals: ends of the 95 % interval by the name of the figure, such as `ar_vsd`; empty
            with one image, or for results without a table of errors.
        intervals_over: unit of resampling: "scenes", or "images" if there is one scene.
    """

    intervals: dict[str, tuple[float, float]] = {}
    intervals_over: str = ""


class BopData:
    """Images with targets, and the estimates of a result file."""

    def __init__(self, root: Path, split: str, results: Path) -> None:
        self.dataset: BopDataset = open_bop(root, split)
        estimates = read_bop_results(results)
        self.scorer = BopScorer(self.dataset, estimates, renderer=RENDERER)
        if not self.scorer.targets:
            raise ToolkitError("there is no true pose to be found", path=root)
        self.images: dict[tuple[int, int], list[BopTarget]] = {}
        for target in self.scorer.targets:
            self.images.setdefault((target.scene_id, target.im_id), []).append(target)

    def __len__(self) -> int:
        return len(self.images)

    def keys(self) -> list[FrameKey]:
        """Scene and image, as their files are named."""
        return [FrameKey(f"{scene:06d}", f"{image:06d}") for scene, image in self.images]


@dataclass(frozen=True, kw_only=True)
class BopRun(FramesRun[BopData, None]):
    """A result file on a data set.

    Attributes:
        data, split: folder of the data set, and of its scenes.
        results: CSV file in BOP's format.
        out: folder of results.
    """

    manifest_name, table_name, unit = BOP_MANIFEST, ERRORS, "images"
    beside = (BOP_FILE,)
    data: Path
    split: str
    results: Path
    out: Path
    devices: tuple[str, ...] = ("cpu",)
    batch_size: int = 1

    @property
    def folder(self) -> Path:
        return self.out / FOLDER / self.data.resolve().name / self.split / self.results.stem

    @property
    def title(self) -> str:
        return f"{self.results.stem} on {self.data.name}, {self.split}"

    def open(self) -> BopData:
        return BopData(self.data, self.split, self.results)

    def make(self, device: str) -> None:
        """Create nothing: the poses are in the result file."""

    def manifest(self, data: BopData, methods: None) -> BopManifest:  # noqa: ARG002
        lines = [f"{t.scene_id} {t.im_id} {t.obj_id} {t.inst_count}" for t in data.scorer.targets]
        setup = BopSetup(
            data=self.data.resolve().name,
            split=self.split,
            results=self.results.stem,
            results_sha256=hashlib.sha256(self.results.read_bytes()).hexdigest(),
            targets=len(lines),
            targets_sha256=hashlib.sha256("\n".join(lines).encode()).hexdigest(),
            renderer=RENDERER,
        )
        return BopManifest(setup=setup, root=str(self.data), **circumstances())

    def load(self, data: BopData, index: int) -> BopImage:
        return data.dataset.image(*list(data.images)[index])

    def rows(
        self,
        data: BopData,
        methods: None,  # noqa: ARG002
        frames: Sequence[tuple[Base, BopImage | str]],
    ) -> list[dict[str, Any]]:
        """Return a row for each target; without figures if its image cannot be read."""
        images, rows = list(data.images.values()), []
        for base, image in frames:
            for target in images[base[INDEX]]:
                found, estimates, error = np.full(3, np.nan), 0, image
                if not isinstance(image, str):
                    errors = data.scorer.errors(target, image)
                    found, estimates, error = found_of(errors), len(errors.mssd), ""
                estimate = {ERROR: error, "obj_id": target.obj_id, "n_estimates": estimates}
                figures = dict(zip(FOUND, found.tolist(), strict=True))
                rows.append(base | estimate | {"n_valid": target.inst_count} | figures)
        return rows

    def after(self) -> None:
        """Write the figures; an error if an image could not be scored."""
        table = read_table(self.folder / ERRORS)
        failed = table[table[ERROR] != ""]
        if len(failed):
            raise ToolkitError(
                f"{failed[INDEX].nunique()} images could not be scored, the first with: "
                f"{failed[ERROR].iloc[0]}",
                hint="no figure leaves targets out: repair them, and run the same command again",
            )
        estimates = read_bop_results(self.results)
        scores = mean_recalls(table[list(FOUND)].to_numpy(), table["n_valid"].tolist())
        result = BopResult(
            results=self.results.stem,
            data=str(self.data),
            split=self.split,
            targets=scores.targets,
            estimates=len(estimates),
            ar=scores.ar,
            ar_vsd=scores.vsd,
            ar_mssd=scores.mssd,
            ar_mspd=scores.mspd,
            seconds_per_image=seconds_per_image(estimates),
        )
        write_document(self.folder / BOP_FILE, result)

    def read(self) -> BopFigures:
        return read_bop_run(self.folder)


def plan_runs(config: BopConfig) -> list[BopRun]:
    """Return the runs, one for each result file."""
    assert config.out is not None
    return [
        BopRun(data=config.data, split=config.bop_split, results=path, out=config.out)
        for path in config.results
    ]


TASK = Task(
    plan=plan_runs,
    table=lambda results, _: bop_table(results),
    records=lambda results, _: results,
)


def read_bop_run(folder: Path) -> BopFigures:
    """Read the figures of a result file.

    Raises:
        ToolkitError: a file is missing or damaged.
    """
    figures = msgspec.structs.asdict(read_document(folder / BOP_FILE, BopResult))
    path = folder / ERRORS
    intervals, over = bop_intervals(read_table(path)) if path.exists() else ({}, "")
    return BopFigures(**figures, intervals=intervals, intervals_over=over)


def bop_intervals(table: pd.DataFrame) -> tuple[dict[str, tuple[float, float]], str]:
    """Return the 95 % intervals of the figures, and the unit of resampling.

    Args:
        table: table of errors. Every target instance has the same weight, as in the figures.
    """
    scenes, images = table[SCENE], table[INDEX]
    groups, over = (scenes, "scenes") if scenes.nunique() > 1 else (images, "images")
    if groups.nunique() < 2:
        return {}, ""
    times = table["n_valid"].to_numpy()
    shares = table[list(FOUND)].to_numpy() / times[:, None]
    values = np.column_stack([shares.mean(axis=1), shares])
    found = mean_interval(np.repeat(values, times, axis=0), np.repeat(groups.to_numpy(), times))
    names = ("ar", *(f"ar_{name}" for name in RECALLS))
    ends = zip(found.low.tolist(), found.high.tolist(), strict=True)
    return dict(zip(names, ends, strict=True)), over


def read_bop_figures(folders: Iterable[Path]) -> list[BopFigures]:
    """Read all figures below some folders of results.

    Raises:
        ToolkitError: a file is damaged.
    """
    paths = sorted(path for folder in folders for path in folder.rglob(BOP_FILE))
    return [read_bop_run(path.parent) for path in dict.fromkeys(paths)]


def bop_table(results: Sequence[BopResult]) -> str:
    """Format the figures in percent for a terminal."""
    heads = ("results", "data", "targets", "AR", "VSD", "MSSD", "MSPD", "s/image")
    lines = []
    for r in results:
        shares = [f"{100 * x:.1f}" for x in (r.ar, r.ar_vsd, r.ar_mssd, r.ar_mspd)]
        seconds = "" if r.seconds_per_image is None else f"{r.seconds_per_image:.2f}"
        data = f"{Path(r.data).name}, {r.split}"
        lines.append([r.results, data, str(r.targets), *shares, seconds])
    return text_table(heads, lines).terminal()
