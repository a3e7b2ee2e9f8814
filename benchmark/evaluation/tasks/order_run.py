"""Runs of `std-bench order`: the order of points of LayeredDepth, a row for each photo and tuple
size and layer."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.data.field.layered_depth import (
    LAYERS,
    PAGE,
    SIZES,
    OrderedPhoto,
    Subset,
    read_photos,
)
from benchmark.data.identity import SAVED_DEPTH
from benchmark.data.splits import FrameKey, Inputs, names_digest
from benchmark.evaluation.batches import Batch, describe_frames, pieces_left, write_rows
from benchmark.evaluation.engine import Campaign, run_all
from benchmark.evaluation.frames import error_line
from benchmark.evaluation.manifest import ORDER_MANIFEST, OrderManifest, OrderSetup, circumstances
from benchmark.evaluation.order import ALL, OrderPredictions, count_order, list_predictions
from benchmark.evaluation.query_options import OrderOptions
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
)
from benchmark.evaluation.submission import keep_submission, read_submission
from benchmark.evaluation.task_run import TaskRun
from benchmark.evaluation.values import checked_label
from benchmark.metrics.significance import SAMPLES, mean_interval
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Cell, Column, Row, Table
from std_toolkit.io.documents import read_document

DATA: Literal["layered-depth"] = "layered-depth"
ORDERS = "order.parquet"
# Columns of a row beside those of every table: size and layer of the tuples, and their numbers.
TUPLES, LAYER, ASKED, RIGHT, LEFT_OUT = "tuples", "layer", "asked", "right", "left_out"
_ORDER = [(size, layer) for size in SIZES for layer in (*map(str, LAYERS), "mixed", ALL)]
_FIRST = {"layer_first": "first surfaces", "layer_all": "all layers"}


@dataclass(frozen=True)
class OrderData:
    """The photos, and the predictions of one program."""

    photos: list[OrderedPhoto]
    predictions: OrderPredictions


@dataclass(frozen=True, kw_only=True)
class OrderRun(TaskRun[OrderData, None]):
    """A folder of predictions on LayeredDepth.

    Attributes:
        data, predictions: folders of the set and of the predictions.
        subset: which tuples.
        layers, npy: see `OrderOptions`.
        label: name of the predictions.
        out: folder of results.
        only: keys of the photos to score; all if empty.
    """

    manifest_name, table_name, unit = ORDER_MANIFEST, ORDERS, "pieces of photos"
    data: Path
    predictions: Path
    subset: Subset
    layers: Literal["auto", "odd", "counted"]
    npy: Literal["inverse", "depth"]
    label: str
    out: Path
    only: tuple[str, ...] = ()
    devices: tuple[str, ...] = ("cpu",)

    @property
    def folder(self) -> Path:
        return self.out / DATA / self.label / self.subset

    @property
    def title(self) -> str:
        return f"{self.label} on LayeredDepth, {_FIRST[self.subset]}"

    def open(self) -> OrderData:
        if not self.data.is_dir():
            raise ToolkitError("no such folder", path=self.data)
        read_submission(self.predictions)  # a wrong one is refused before any work
        listed = list_predictions(self.predictions, self.layers, inverse=self.npy == "inverse")
        photos = read_photos(self.data, self.subset)
        return OrderData([p for p in photos if not self.only or p.key in self.only], listed)

    def make(self, device: str) -> None:
        """Create nothing: the predictions are in files."""

    def manifest(self, data: OrderData, methods: None) -> OrderManifest:  # noqa: ARG002
        setup = OrderSetup(
            split=DATA,
            subset=self.subset,
            frames=len(data.photos),
            frames_sha256=names_digest([_key(photo) for photo in data.photos]),
            layers=data.predictions.counted_as,
            npy=self.npy,
        )
        return OrderManifest(
            label=self.label,
            setup=setup,
            root=str(self.data),
            predictions=str(self.predictions),
            **circumstances(),
        )

    def frames_there(self, data: OrderData) -> int:
        return len(data.photos)

    def inputs(self, data: OrderData) -> Iterator[tuple[int, FrameKey, Inputs]]:
        for index, photo in enumerate(data.photos):
            files = data.predictions.files_of(photo.key)
            answers = {f"{SAVED_DEPTH} of layer {k}": path for k, path in files.items()}
            yield index, _key(photo), {**photo.digests, **answers}

    def items(self, data: OrderData, done: set[int], workers: int) -> list[tuple[Batch, ...]]:
        return pieces_left(range(len(data.photos)), 1, workers, done)

    def item_title(self, item: Sequence[Batch]) -> str:
        return describe_frames(item)

    def work(self, data: OrderData, methods: None, item: Sequence[Batch]) -> int:  # noqa: ARG002
        def read(batch: Batch) -> list[dict[str, Any]]:
            return [row for index in batch for row in _rows(data, index)]

        return write_rows(self.folder, item, read, lambda _, rows: rows)

    def after(self) -> None:
        """Keep what the author of the predictions says of them."""
        keep_submission(self.predictions, self.folder)

    def read(self) -> OrderResult:
        return read_order_run(self.folder)


def _key(photo: OrderedPhoto) -> FrameKey:
    """Photos show different places: each is a scene."""
    return FrameKey(photo.key, "image")


def _rows(data: OrderData, index: int) -> list[dict[str, Any]]:
    photo = data.photos[index]
    scene, name = _key(photo)
    error = ""
    layers: dict[int, NDArray[np.float64]] | None = None
    try:
        layers = data.predictions.layers(photo)
    except ToolkitError as wrong:
        error = error_line(wrong)
    base = {INDEX: index, SCENE: scene, FRAME: name, ERROR: error, LEFT_OUT: photo.left_out}
    found = count_order(photo, layers) or {("", ""): (0, 0)}
    return [
        base | {TUPLES: size, LAYER: layer, ASKED: asked, RIGHT: right}
        for (size, layer), (asked, right) in found.items()
    ]


class OrderScore(msgspec.Struct, frozen=True, kw_only=True):
    """Share of right tuples.

    Attributes:
        method: name of the predictions.
        tuples: pairs, trips or quads.
        layer: of all points, "mixed", or "all" for all tuples.
        count, right: numbers of tuples.
    """

    method: str
    tuples: str
    layer: str
    count: int
    right: int


class OrderRecord(msgspec.Struct, frozen=True, kw_only=True):
    """What was scored.

    Attributes:
        subset: which tuples.
        photos: number of photos; their tuples count whether answered or not.
        left_out: tuples with points outside their photo.
        unanswered: photos without a prediction that can be read, by method: all their tuples are
            wrong.
        scores: of each method, size and layer.
    """

    subset: str
    photos: int
    left_out: int
    unanswered: dict[str, int]
    scores: list[OrderScore]


@dataclass(frozen=True, eq=False)
class OrderResult(Result[OrderManifest]):
    """Results of a folder of predictions."""

    @property
    def title(self) -> str:
        place = self.place or self.manifest.setup.split
        return f"{self.manifest.label} on {place}, {_FIRST[self.manifest.setup.subset]}"

    @property
    def scores(self) -> list[OrderScore]:
        """Numbers of tuples by size and layer."""
        sums = self.table.groupby([TUPLES, LAYER])[[ASKED, RIGHT]].sum()
        return [
            OrderScore(
                method=self.manifest.label, tuples=size, layer=layer,
                count=int(sums.loc[(size, layer), ASKED]),
                right=int(sums.loc[(size, layer), RIGHT]),
            )
            for size, layer in _ORDER
            if (size, layer) in sums.index
        ]  # fmt: skip

    def shares(self, samples: int = SAMPLES) -> dict[tuple[str, str], tuple[float, float, float]]:
        """Share of right tuples by size and layer, with its 95 % interval over photos."""
        found = {}
        for key, rows in self.table[self.table[ASKED] > 0].groupby([TUPLES, LAYER]):
            times = rows[ASKED].to_numpy()
            values = np.repeat(rows[RIGHT].to_numpy() / times, times)
            over = mean_interval(values, np.repeat(rows[SCENE].to_numpy(), times), samples=samples)
            found[key] = float(over.mean), float(over.low), float(over.high)
        return found

    @property
    def left_out(self) -> int:
        """Tuples with points outside their photo."""
        return int(self.table.drop_duplicates(INDEX)[LEFT_OUT].sum())


def read_order_run(folder: Path) -> OrderResult:
    """Read the results of a folder of predictions.

    Raises:
        ToolkitError: a file is missing or damaged, or a photo has more right tuples than tuples.
    """
    manifest = read_document(folder / ORDER_MANIFEST, OrderManifest)
    path = folder / ORDERS
    table = read_table(path)
    check_columns(table, (INDEX, SCENE, FRAME, ERROR, TUPLES, LAYER, ASKED, RIGHT, LEFT_OUT), path)
    over = table[table[RIGHT] > table[ASKED]]
    if len(over):
        raise ToolkitError(
            "more right tuples than tuples", path=path, field=f"{RIGHT} of row {over.index[0]}",
            value=int(over[RIGHT].iloc[0]),
        )  # fmt: skip
    said = read_submission(folder)
    return OrderResult(folder, manifest, table, said=said, data=read_known(folder))


def read_order_results(folders: Iterable[Path]) -> list[OrderResult]:
    """Read all runs below some folders of results.

    Raises:
        ToolkitError: a folder has none, or two have the same name.
    """
    return find_runs(folders, ORDER_MANIFEST, ORDERS, read_order_run)


@dataclass(frozen=True)
class ScoredOrder:
    """Outcome of `score_order`.

    Attributes:
        record: what was scored, or counted.
        campaign: the runs.
    """

    record: OrderRecord
    campaign: Campaign[OrderRun]


def score_order(options: OrderOptions) -> ScoredOrder:
    """Score folders of predictions, or count what is there.

    Raises:
        ToolkitError: no data, or a folder whose names say two things.
    """
    if not options.folders:
        if not options.data.is_dir():
            raise ToolkitError("no such folder", path=options.data)
        return ScoredOrder(_counted(options), Campaign())
    with TemporaryDirectory() as place:
        runs = [
            OrderRun(
                data=options.data, predictions=folder, subset=options.subset,
                layers=options.layers, npy=options.npy, label=checked_label(name),
                out=options.out or Path(place),
            )
            for name, folder in options.folders.items()
        ]  # fmt: skip
        for run in runs:
            run.open()
        campaign = run_all(runs, options.jobs)
        results = [run.read() for run in campaign.finished]
    record = order_record(options.subset, results)
    return ScoredOrder(record, campaign)


def order_record(subset: str, results: Sequence[OrderResult]) -> OrderRecord:
    """Return the scores of some results of one subset."""
    return OrderRecord(
        subset=subset,
        photos=max((r.frames for r in results), default=0),
        left_out=max((r.left_out for r in results), default=0),
        unanswered={r.manifest.label: r.missing + r.failed for r in results},
        scores=[score for r in results for score in r.scores],
    )


def _counted(options: OrderOptions) -> OrderRecord:
    photos = read_photos(options.data, options.subset)
    counts = [count_order(photo, None) for photo in photos]
    sums = {key: sum(c.get(key, (0, 0))[0] for c in counts) for key in _ORDER}
    return OrderRecord(
        subset=options.subset, photos=len(photos), left_out=sum(p.left_out for p in photos),
        unanswered={},
        scores=[
            OrderScore(method="", tuples=size, layer=layer, count=count, right=0)
            for (size, layer), count in sums.items()
            if count
        ],
    )  # fmt: skip


def order_table(record: OrderRecord) -> Table:
    """Return the table of a record: a row for each method, a column for each size and layer."""
    cells = dict.fromkeys((s.tuples, s.layer) for s in record.scores)
    by_name: dict[str, dict[tuple[str, str], Cell]] = {}
    for s in record.scores:
        text = f"{100 * s.right / s.count:.2f}" if s.method and s.count else str(s.count)
        by_name.setdefault(s.method, {})[s.tuples, s.layer] = Cell(text=text)
    rows = [
        Row([Cell(text=name or "tuples"), *(mine.get(key, Cell(text="-")) for key in cells)])
        for name, mine in by_name.items()
    ]
    notes = [
        f"{record.photos} photos; share of tuples whose order is right, %",
        "order of points alone: never beside errors of metric depth",
    ]
    if record.left_out:
        notes.append(f"{record.left_out} tuples with points outside their photo are left out")
    notes += [f"{n}: {k} photos not answered, all wrong" for n, k in record.unanswered.items() if k]
    if not record.unanswered:
        notes.append(f"page: {PAGE}; benchmark CC0, synthetic part BSD-3-Clause")
    titles = [f"{size} {layer}" for size, layer in cells]
    columns = [Column(heading="method", numeric=False), *(Column(heading=t) for t in titles)]
    return Table(
        columns=columns, rows=rows, title=f"LayeredDepth, {_FIRST[record.subset]}", notes=notes
    )
