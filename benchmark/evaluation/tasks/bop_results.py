"""Figures of BOP result files: recalls, precisions, objects and intervals, from the table."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd

from benchmark.evaluation.known_data import names_of_data
from benchmark.evaluation.manifest import BOP_FILE, Count, Name
from benchmark.evaluation.results import INDEX, SCENE, read_known, read_table
from benchmark.metrics.bop import (
    Detections,
    DetectionScores,
    detection_intervals,
    detection_scores,
    mean_recalls,
)
from benchmark.metrics.significance import mean_interval
from std_toolkit.html.table import text_table
from std_toolkit.io.documents import read_document, write_document

FOLDER, ERRORS = "bop", "errors.parquet"
RECALLS = ("vsd", "mssd", "mspd")
FOUND = tuple(f"found_{name}" for name in RECALLS)
PRECISIONS = ("mssd", "mspd", "mssd_mm")
# Figures, and what bop_toolkit calls them.
_FIGURES = {
    **{f"ar_{name}": f"bop19_average_recall_{name}" for name in RECALLS},
    "ar": "bop19_average_recall",
    **{f"ap_{name}": f"bop24_mAP_{name}" for name in PRECISIONS},
    "ap": "bop24_mAP",
}
# Those of tables, and their headings; the last ones are ranked by the challenge of 2025.
SHOWN = {
    "ar": "AR", "ar_vsd": "AR VSD", "ar_mssd": "AR MSSD", "ar_mspd": "AR MSPD", "ap": "mAP",
    "ap_mssd": "AP MSSD", "ap_mspd": "AP MSPD", "ap_mssd_mm": "AP MSSD 2-20 mm",
}  # fmt: skip
# Those that the challenge of 2025 ranks by.
_FIGURES_25 = {"ap_mssd": "bop25_mAP", "ap_mssd_mm": "bop25_mAP_mm"}
SCORES_19, SCORES_24 = "scores_bop19.json", "scores_bop24.json"


class BopObject(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Figures of one object, 0 to 1; None if not scored.

    Attributes:
        obj_id: number of the object.
        targets: instances to be found for the recalls.
        ar_vsd, ar_mssd, ar_mspd: average recalls.
        instances: visible instances to be found in detection.
        ap_mssd, ap_mspd, ap_mssd_mm: average precisions of detection.
    """

    obj_id: int
    targets: Count = 0
    ar_vsd: float | None = None
    ar_mssd: float | None = None
    ar_mspd: float | None = None
    instances: Count = 0
    ap_mssd: float | None = None
    ap_mspd: float | None = None
    ap_mssd_mm: float | None = None

    @property
    def ar(self) -> float | None:
        """Mean of the recalls; None if one is missing."""
        return _mean(self.ar_vsd, self.ar_mssd, self.ar_mspd)

    @property
    def ap(self) -> float | None:
        """Mean of the precisions of 2024; None if one is missing."""
        return _mean(self.ap_mssd, self.ap_mspd)


class BopResult(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One result file. Figures are 0 to 1; None if not scored.

    Attributes:
        results: name of the file.
        data, split: folder of the data set, and of its scenes.
        targets: number of target instances.
        estimates: number of lines of the file.
        ar: mean of the three average recalls.
        ar_vsd, ar_mssd, ar_mspd: the average recalls.
        ap: mean of the mean average precisions of MSSD and MSPD in detection.
        ap_mssd, ap_mspd, ap_mssd_mm: the mean average precisions; the last within 2 to 20 mm.
        seconds_per_image: run time of the method; None if the file does not give it.
        scores: the same figures under bop_toolkit's names.
        objects: figures of each object.
    """

    results: Name
    data: Name
    split: Name
    targets: Count
    estimates: Count
    ar: float | None
    ar_vsd: float | None
    ar_mssd: float | None
    ar_mspd: float | None
    ap: float | None = None
    ap_mssd: float | None = None
    ap_mspd: float | None = None
    ap_mssd_mm: float | None = None
    seconds_per_image: float | None
    scores: dict[str, float] = {}
    objects: list[BopObject] = []

    def write_scores(self, folder: Path) -> None:
        """Write scores_bop19.json and scores_bop24.json, as bop_toolkit does: the latter with the
        figures of 2025.

        Raises:
            ToolkitError: a file cannot be written.
        """
        for name, prefix in ((SCORES_19, "bop19_"), (SCORES_24, ("bop24_", "bop25_"))):
            scores = {k: v for k, v in self.scores.items() if k.startswith(prefix)}
            if any("time" not in key for key in scores):
                write_document(folder / name, scores)


class BopFigures(BopResult, frozen=True, kw_only=True):
    """A result file with its intervals.

    Attributes:
        intervals: ends of the 95 % interval by the name of the figure, such as `ar_vsd`; empty
            with one image, or for results without a table of errors.
        intervals_over: unit of resampling: "scenes", or "images" if there is one scene.
        place: name of the data set on pages, another one for other content.
    """

    place: str = ""
    intervals: dict[str, tuple[float, float]] = {}
    intervals_over: str = ""


def summarise(
    table: pd.DataFrame,
    *,
    results: str,
    data: str,
    split: str,
    estimates: int,
    seconds_per_image: float | None,
) -> BopResult:
    """Return the figures of a table of errors.

    Args:
        table: see data_spec.md.
        results, data, split, estimates, seconds_per_image: see `BopResult`.

    Raises:
        ToolkitError: there is nothing to find.
    """
    recalls = _recalls(table)
    detection = _detection(table)
    objects = {
        number: BopObject(
            obj_id=number,
            targets=int(rows["n_valid"].sum()),
            **dict(zip((f"ar_{n}" for n in RECALLS), _recalls(rows), strict=True)),
            instances=0 if detection is None else detection.instances.get(number, 0),
            **_of_object(detection, number),
        )
        for number, rows in table.groupby("obj_id")
    }
    ap = [None if detection is None else _known(getattr(detection, name)) for name in PRECISIONS]
    figures = dict(zip(_FIGURES, (*recalls, _mean(*recalls), *ap, _mean(*ap[:2])), strict=True))
    scores = {
        title: value
        for titles in (_FIGURES, _FIGURES_25)
        for name, title in titles.items()
        if (value := figures[name]) is not None
    }
    seconds = -1.0 if seconds_per_image is None else seconds_per_image
    return BopResult(
        results=results,
        data=data,
        split=split,
        targets=int(table["n_valid"].sum()),
        estimates=estimates,
        **figures,
        seconds_per_image=seconds_per_image,
        scores=scores | {f"bop{year}_average_time_per_image": seconds for year in (19, 24)},
        objects=list(objects.values()),
    )


def _recalls(table: pd.DataFrame) -> tuple[float | None, ...]:
    rows = table[table["n_valid"] > 0]
    if rows.empty:
        return None, None, None
    scores = mean_recalls(rows[list(FOUND)].to_numpy(), rows["n_valid"].tolist())
    return _known(scores.vsd), _known(scores.mssd), _known(scores.mspd)


def _detection(table: pd.DataFrame) -> DetectionScores | None:
    rows = detection_rows(table, INDEX)
    if not any((d.visible >= 0.1).any() for *_, d in rows):
        return None
    if all(d.mssd is None and d.mspd is None for *_, d in rows):
        return None
    return detection_scores(rows)


def detection_rows(table: pd.DataFrame, unit: str) -> list[tuple[int, int, Detections]]:
    """Return the detections of a table: image or scene, object and errors.

    Args:
        unit: column of the first number: `index`, or `scene`.
    """
    if "scores" not in table:
        return []
    places = pd.factorize(table[unit])[0] if unit == SCENE else table[unit]
    found = []
    for place, row in zip(places, table.itertuples(), strict=True):
        if row.scores is None:
            continue
        shape = len(row.scores), len(row.visible)
        mssd, mspd = (
            None if errors is None else np.asarray(errors, dtype=np.float64).reshape(shape)
            for errors in (row.mssd, row.mspd)
        )
        scores, visible = (np.asarray(x, dtype=np.float64) for x in (row.scores, row.visible))
        detections = Detections(scores, mssd, mspd, visible, row.diameter_m, int(row.width))
        found.append((int(place), int(row.obj_id), detections))
    return found


def _of_object(detection: DetectionScores | None, number: int) -> dict[str, float | None]:
    if detection is None or number not in detection.objects:
        return {}
    found = zip(PRECISIONS, detection.objects[number], strict=True)
    return {f"ap_{name}": _known(value) for name, value in found}


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def _mean(*values: float | None) -> float | None:
    known = [v for v in values if v is not None]
    return sum(known) / len(values) if len(known) == len(values) else None


def read_bop_run(folder: Path) -> BopFigures:
    """Read the figures of a result file.

    Raises:
        ToolkitError: a file is missing or damaged.
    """
    result = read_document(folder / BOP_FILE, BopResult)
    figures = {name: getattr(result, name) for name in BopResult.__struct_fields__}
    path = folder / ERRORS
    intervals, over = bop_intervals(read_table(path)) if path.exists() else ({}, "")
    intervals = {k: v for k, v in intervals.items() if figures[k] is not None}
    place = f"{Path(result.data).resolve().name}, {result.split}"
    return BopFigures(**figures, place=place, intervals=intervals, intervals_over=over)


def bop_intervals(table: pd.DataFrame) -> tuple[dict[str, tuple[float, float]], str]:
    """Return the 95 % intervals of the figures, and the unit of resampling.

    Args:
        table: table of errors. Every target instance has the same weight, as in the figures.
    """
    unit, over = (SCENE, "scenes") if table[SCENE].nunique() > 1 else (INDEX, "images")
    if table[unit].nunique() < 2:
        return {}, ""
    found: dict[str, tuple[float, float]] = {}
    rows = table[table["n_valid"] > 0]
    if rows[unit].nunique() > 1:
        times = rows["n_valid"].to_numpy()
        shares = rows[list(FOUND)].to_numpy() / times[:, None]
        values = np.column_stack([shares.mean(axis=1), shares])
        groups = np.repeat(rows[unit].to_numpy(), times)
        interval = mean_interval(np.repeat(values, times, axis=0), groups)
        names = ("ar", *(f"ar_{name}" for name in RECALLS))
        ends = zip(interval.low.tolist(), interval.high.tolist(), strict=True)
        found |= dict(zip(names, ends, strict=True))
    detections = detection_rows(table, unit)
    if any((d.visible >= 0.1).any() for *_, d in detections):
        low, high = detection_intervals(detections).tolist()
        names = (*(f"ap_{name}" for name in PRECISIONS), "ap")
        found |= {name: (low[i], high[i]) for i, name in enumerate(names)}
    return {k: v for k, v in found.items() if not math.isnan(v[0])}, over


def read_bop_figures(folders: Iterable[Path]) -> list[BopFigures]:
    """Read all figures below some folders of results.

    Raises:
        ToolkitError: a file is damaged.
    """
    paths = sorted(path for folder in folders for path in folder.rglob(BOP_FILE))
    places = [path.parent for path in dict.fromkeys(paths)]
    every = [read_bop_run(place) for place in places]
    names = names_of_data([r.place for r in every], [read_known(place) for place in places])
    return [msgspec.structs.replace(r, place=name) for r, name in zip(every, names, strict=True)]


def bop_table(results: Sequence[BopResult]) -> str:
    """Format the figures in percent for a terminal: of the files, then of their objects."""
    heads = ("results", "data", "targets", "AR", "VSD", "MSSD", "MSPD", "mAP", "AP MSSD", "AP mm",
             "s/image")  # fmt: skip
    lines = []
    for r in results:
        shares = [_percent(x) for x in _shown(r)]
        seconds = "" if r.seconds_per_image is None else f"{r.seconds_per_image:.2f}"
        data = getattr(r, "place", "") or f"{Path(r.data).name}, {r.split}"
        lines.append([r.results, data, str(r.targets), *shares, seconds])
    tables = [text_table(heads, lines).terminal()]
    columns = ("object", "targets", "VSD", "MSSD", "MSPD", "instances", "AP MSSD", "AP MSPD",
               "AP mm")  # fmt: skip
    for r in results:
        rows = [
            [
                str(o.obj_id),
                str(o.targets),
                *(_percent(x) for x in (o.ar_vsd, o.ar_mssd, o.ar_mspd)),
                str(o.instances),
                *(_percent(x) for x in (o.ap_mssd, o.ap_mspd, o.ap_mssd_mm)),
            ]
            for o in r.objects
        ]
        if rows:
            tables.append(f"{r.results}:\n{text_table(columns, rows).terminal()}")
    return "\n\n".join(tables)


def _shown(r: BopResult) -> tuple[float | None, ...]:
    return r.ar, r.ar_vsd, r.ar_mssd, r.ar_mspd, r.ap, r.ap_mssd, r.ap_mssd_mm


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.1f}"
