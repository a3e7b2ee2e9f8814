"""Instance-level pose as a task: result files in BOP's format, scored image by image."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.data.splits import FrameKey, Inputs
from benchmark.evaluation.config import BopConfig
from benchmark.evaluation.frames import Base, FramesRun
from benchmark.evaluation.manifest import (
    BOP_FILE,
    BOP_MANIFEST,
    BopManifest,
    BopSetup,
    circumstances,
)
from benchmark.evaluation.results import ERROR, INDEX, read_table
from benchmark.evaluation.task_run import Task
from benchmark.evaluation.tasks.bop_program import run_on
from benchmark.evaluation.tasks.bop_results import (
    ERRORS,
    FOLDER,
    FOUND,
    BopFigures,
    bop_table,
    read_bop_run,
    summarise,
)
from benchmark.metrics.bop import (
    BopDataset,
    BopError,
    BopScorer,
    ObjectErrors,
    found_of,
    open_bop,
    read_bop_results,
    seconds_per_image,
)
from benchmark.metrics.bop.bop_dataset import BopImage
from std_toolkit.errors import ToolkitError
from std_toolkit.importers.bop_documents import count_rough
from std_toolkit.importers.bop_packed import is_packed, unpack_data_set
from std_toolkit.io.documents import write_document
from std_toolkit.log import logger

RENDERER = "raycast"
UNPACKED = "unpacked"  # folder of packed data sets
NO_VSD = "no VSD: "  # errors of images that have everything else
_COLUMNS = 2  # version of the table


class BopData:
    """Images with something to find, and the estimates of a result file."""

    def __init__(self, run: BopRun) -> None:
        self.dataset: BopDataset = open_bop(
            run.data, run.split, sensors=run.sensors, symmetry_steps=run.symmetry_steps,
            multi_view=run.multi_view,
        )  # fmt: skip
        self.errors = run.errors
        if "vsd" in self.errors and not self.dataset.has_depth:
            self.errors = tuple(e for e in self.errors if e != "vsd")
        self.estimates = read_bop_results(run.results)
        self.scorer = BopScorer(
            self.dataset,
            self.estimates,
            renderer=RENDERER,
            errors=self.errors,
            delta_m=run.vsd_delta_mm / 1000,
        )
        if not self.scorer.images:
            raise ToolkitError("there is no true pose to be found", path=run.data)
        self.images = self.scorer.images

    def __len__(self) -> int:
        return len(self.images)

    def keys(self) -> list[FrameKey]:
        """Scene and image, as their files are named."""
        return [FrameKey(f"{scene:06d}", f"{image:06d}") for scene, image in self.images]


def digest_of_results(path: Path) -> str:
    """Return the SHA-256 of a result file.

    Raises:
        ToolkitError: it cannot be read.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ToolkitError(f"cannot be read: {error.strerror}", path=path) from error


@dataclass(frozen=True, kw_only=True)
class BopRun(FramesRun[BopData, None]):
    """A result file on a data set.

    Attributes:
        data, split: folder of the data set, and of its scenes.
        results: CSV file in BOP's format.
        out: folder of results.
        sensors, errors, symmetry_steps, vsd_delta_mm, multi_view: see `BopConfig`.
    """

    manifest_name, table_name, unit = BOP_MANIFEST, ERRORS, "images"
    beside = (BOP_FILE,)
    derived = (BOP_FILE,)
    data: Path
    split: str
    results: Path
    out: Path
    sensors: tuple[str, ...] = ()
    errors: tuple[BopError, ...] = ("vsd", "mssd", "mspd")
    symmetry_steps: int | None = None
    vsd_delta_mm: float = 15.0
    multi_view: bool = False
    devices: tuple[str, ...] = ("cpu",)
    batch_size: int = 1

    @property
    def folder(self) -> Path:
        return self.out / FOLDER / self.data.resolve().name / self.place / self.results.stem

    @property
    def place(self) -> str:
        """Name of the split, another one with multi-view targets."""
        return f"{self.split}-multiview" if self.multi_view else self.split

    @property
    def title(self) -> str:
        return f"{self.results.stem} on {self.data.name}, {self.place}"

    @property
    def data_key(self) -> object:
        return self.results, self.data, self.place

    def open(self) -> BopData:
        return BopData(self)

    def check(self, data: BopData) -> None:
        """Say once what is unusual."""
        if len(data.errors) < len(self.errors):
            logger.warning("%s: VSD is not scored: the data set has no depth", self.data)
        for path, poses in (
            (self.data, data.dataset.poses()),
            (self.results, [e.T_cam_obj for e in data.estimates]),
        ):
            count, largest = count_rough(poses)
            if count:
                logger.warning(
                    "%s: %d of %d rotations are not exactly orthonormal (by up to %.1e); they are "
                    "used as filed",
                    path, count, len(poses), largest,
                )  # fmt: skip

    def make(self, device: str) -> None:
        """Create nothing: the poses are in the result file."""

    def manifest(self, data: BopData, methods: None) -> BopManifest:  # noqa: ARG002
        lines = [
            f"{scene} {image} {obj} {data.scorer.count(scene, image, obj)}"
            for scene, image in data.images
            for obj in data.scorer.objects(scene, image)
        ]
        setup = BopSetup(
            data=self.data.resolve().name,
            split=self.split,
            results=self.results.stem,
            results_sha256=digest_of_results(self.results),
            targets=len(lines),
            targets_sha256=hashlib.sha256("\n".join(lines).encode()).hexdigest(),
            renderer=RENDERER,
            sensors=tuple(dict.fromkeys(s for s in data.dataset.sensors.values() if s)),
            errors=data.errors,
            symmetry_steps=self.symmetry_steps,
            vsd_delta_mm=self.vsd_delta_mm,
            multi_view=self.multi_view,
            columns=_COLUMNS,
        )
        return BopManifest(setup=setup, root=str(self.data), **circumstances())

    def inputs(self, data: BopData) -> Iterator[tuple[int, FrameKey, Inputs]]:
        for index, (key, image) in enumerate(zip(data.keys(), data.images, strict=True)):
            yield index, key, data.dataset.files(*image, data.scorer.objects(*image))

    def load(self, data: BopData, index: int) -> BopImage:
        return data.scorer.image(*data.images[index])

    def rows(
        self,
        data: BopData,
        methods: None,  # noqa: ARG002
        frames: Sequence[tuple[Base, BopImage | str]],
    ) -> list[dict[str, Any]]:
        """Return a row for each object of an image; without figures if it cannot be read."""
        rows = []
        for base, image in frames:
            scene, number = data.images[base[INDEX]]
            for obj_id in data.scorer.objects(scene, number):
                if isinstance(image, str):
                    found, error = ObjectErrors(None, None), image
                else:
                    found = data.scorer.errors(scene, number, obj_id, image)
                    # The rest is kept, and VSD is tried again.
                    no_depth = image.why_no_depth and image.camera is not None
                    error = f"{NO_VSD}{image.why_no_depth}" if no_depth else ""
                count = data.scorer.count(scene, number, obj_id)
                rows.append(
                    base | {ERROR: error, "obj_id": obj_id, "n_valid": count} | _figures(found)
                )
        return rows

    def after(self) -> None:
        """Write the figures; an error if an image could not be scored."""
        table = read_table(self.folder / ERRORS)
        failed = table[table[ERROR] != ""]
        unread = failed[~failed[ERROR].str.startswith(NO_VSD)]
        if len(unread):
            raise ToolkitError(
                f"{unread[INDEX].nunique()} images could not be scored, the first with: "
                f"{unread[ERROR].iloc[0]}",
                hint="no figure leaves targets out: repair them, and run the same command again",
            )
        estimates = read_bop_results(self.results)
        result = summarise(
            table,
            results=self.results.stem,
            data=str(self.data),
            split=self.place,
            estimates=len(estimates),
            seconds_per_image=seconds_per_image(estimates),
        )
        write_document(self.folder / BOP_FILE, result)
        result.write_scores(self.folder)

    def read(self) -> BopFigures:
        return read_bop_run(self.folder)


def _figures(found: ObjectErrors) -> dict[str, Any]:
    """Columns of the table, see data_spec.md."""
    shares = np.full(3, np.nan) if found.target is None else found_of(found.target)
    counted = (
        0
        if found.target is None
        else _length(found.target.vsd, found.target.mssd, found.target.mspd)
    )
    detections = found.detections
    lists: dict[str, Any] = dict.fromkeys(("scores", "visible", "mssd", "mspd"))
    scale = {"diameter_m": np.nan, "width": 0}
    if detections is not None:
        lists["scores"] = detections.scores.tolist()
        lists["visible"] = detections.visible.tolist()
        for name in ("mssd", "mspd"):
            errors = getattr(detections, name)
            lists[name] = None if errors is None else errors.ravel().tolist()
        scale = {"diameter_m": detections.diameter_m, "width": detections.width}
    return {
        "n_estimates": counted,
        **dict(zip(FOUND, shares.tolist(), strict=True)),
        **scale,
    } | lists


def _length(*errors: Any) -> int:
    return next((len(e) for e in errors if e is not None), 0)


def plan_runs(config: BopConfig) -> list[BopRun]:
    """Return the runs, one for each result file; packed images are laid out as scenes before."""
    assert config.out is not None
    folder = config.out / FOLDER
    split = config.data / config.bop_split
    if is_packed(split):
        data = folder / UNPACKED / config.data.resolve().name
        shutil.rmtree(data, ignore_errors=True)
        unpack_data_set(split, data)
        config = replace(config, data=data)
    names = ("data", "sensors", "errors", "symmetry_steps", "vsd_delta_mm", "multi_view", "out")
    options = {name: getattr(config, name) for name in names}
    results = list(config.results)
    if config.program:
        dataset = open_bop(
            config.data, config.bop_split, sensors=config.sensors, multi_view=config.multi_view
        )
        results.append(
            run_on(
                dataset,
                config.program,
                folder,
                detections=config.detections,
                timeout_s=config.timeout_s,
            )
        )
    return [BopRun(split=config.bop_split, results=path, **options) for path in results]


TASK = Task(
    plan=plan_runs,
    table=lambda results, _: bop_table(results),
    records=lambda results, _: results,
)
