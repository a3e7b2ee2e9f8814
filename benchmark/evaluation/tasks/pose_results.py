"""Results of pose runs: reading, scores by protocol and material with intervals, tables."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import Material
from benchmark.evaluation.config import AS_FILED, FITS
from benchmark.evaluation.manifest import POSE_MANIFEST, PoseManifest
from benchmark.evaluation.results import (
    FAILED,
    Result,
    check_columns,
    find_runs,
    read_known,
    read_table,
)
from benchmark.evaluation.submission import read_submission
from benchmark.evaluation.tasks.pose_table import COLUMNS, POSES, frames_of
from benchmark.metrics.pose import (
    BoxIoU,
    PoseMatches,
    PoseProtocol,
    PoseScores,
    PoseScoring,
    get_pose_protocol,
    match_poses,
    score_matches,
)
from benchmark.metrics.pose.resampling import resampled_scores, scene_weights
from std_toolkit.errors import check_known
from std_toolkit.html.table import text_table
from std_toolkit.io.documents import read_document

# Method, depth and fit of a run, as shown in tables.
RunName = tuple[str, str, str]

ALL, HARD = "all", "specular+transparent"

SUBSETS: dict[str, frozenset[Material]] = {
    ALL: frozenset(),
    HARD: frozenset({Material.SPECULAR, Material.TRANSPARENT}),
    "transparent": frozenset({Material.TRANSPARENT}),
    "specular": frozenset({Material.SPECULAR}),
    "diffuse": frozenset({Material.RAW, Material.DIFFUSE}),
}

SAMPLES = 1000

LEVEL = 0.95

# Overlap that both published evaluations require before they count angle and distance.
FOUND_MEANS_OVERLAP = 0.1

_TEXTS = ("method", "depth", "fit", "objects")


def wanted_protocols(
    names: Sequence[str],
    *,
    iou: str | None = None,
    score: str | None = None,
    gates: str | None = None,
) -> list[PoseProtocol]:
    """Return protocols with some options replaced; their names list the changes.

    Args:
        names: names of `pose_protocols`.
        iou: `oriented`, `aabb` or `nocs2019`; by default that of the protocol.
        score: `ap` or `accuracy`; by default that of the protocol.
        gates: whether angle and distance are counted for `all` predictions, or for `found` ones,
            which overlap a true box; by default that of the protocol.

    Raises:
        ToolkitError: unknown protocol.

    >>> [p.name for p in wanted_protocols(["strict"], iou="aabb", score="ap")]
    ['strict, iou aabb']
    """
    found = []
    for name in names:
        protocol = get_pose_protocol(name)
        parts = [name]
        if iou is not None and BoxIoU(iou) is not protocol.iou:
            protocol = replace(protocol, iou=BoxIoU(iou))
            parts.append(f"iou {iou}")
        if score is not None and PoseScoring(score) is not protocol.score:
            protocol = replace(protocol, score=PoseScoring(score))
            parts.append(f"score {score}")
        if gates is not None and (gates == "found") != (protocol.pose_needs_iou is not None):
            least = FOUND_MEANS_OVERLAP if gates == "found" else None
            protocol = replace(protocol, pose_needs_iou=least)
            parts.append(f"gates {gates}")
        found.append(replace(protocol, name=", ".join(parts)))
    return found


@dataclass(frozen=True, eq=False)
class PoseResult(Result[PoseManifest]):
    """A method on a split with one depth and fit; see `benchmark.evaluation.tasks.pose_table`."""

    @property
    def split(self) -> str:
        """Name of the data set on pages."""
        return self.place or self.named

    @property
    def name(self) -> RunName:
        """Method, depth and fit."""
        return self.manifest.label, self.manifest.depth_label, self.manifest.fit

    @property
    def title(self) -> str:
        return f"{', '.join(self.name)} on {self.split}"

    @property
    def given_truth(self) -> bool:
        """Whether the method receives ground truth, and is a bound and no competitor."""
        return self.manifest.setup.given_truth


def read_pose_run(folder: Path) -> PoseResult:
    """Read the results of one run.

    Raises:
        ToolkitError: a file is missing or damaged.
    """
    manifest = read_document(folder / POSE_MANIFEST, PoseManifest)
    known = (*FITS, AS_FILED)
    check_known(manifest.fit, known, "not a fit of poses", path=folder / POSE_MANIFEST, field="fit")
    table = read_table(folder / POSES)
    check_columns(table, COLUMNS, folder / POSES)
    said = read_submission(folder)
    return PoseResult(folder, manifest, table, said=said, data=read_known(folder))


def read_pose_results(folders: Iterable[Path]) -> list[PoseResult]:
    """Read all finished pose runs below some folders of results.

    Raises:
        ToolkitError: a folder has none, or two runs have the same name.
    """
    return find_runs(folders, POSE_MANIFEST, POSES, read_pose_run)


@dataclass(frozen=True, eq=False)
class Scored:
    """Figures of a run by one protocol for objects of some materials.

    Attributes:
        result: the run.
        subset: key of `SUBSETS`.
        scores: figures by class.
        matches: matches that the scores are computed from.
        scenes, names: (F,) scenes and names of the frames of the matches.
        low, high: (K,) ends of the 95 % intervals of the means, resampled over scenes; NaN with
            one scene or without samples.
    """

    result: PoseResult
    subset: str
    scores: PoseScores
    matches: PoseMatches
    scenes: NDArray[np.generic]
    names: NDArray[np.generic]
    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @property
    def objects(self) -> int:
        """Number of true objects of the classes."""
        return int(self.scores.true_objects.sum())

    @property
    def scene_count(self) -> int:
        """Number of scenes with frames."""
        return len(np.unique(self.scenes))

    @property
    def figures(self) -> dict[str, float]:
        """Means over classes; NaN where the method failed at every frame."""
        nowhere = self.result.failed_everywhere
        return {c: float("nan" if nowhere else v) for c, v in self.scores.mean.items()}

    def interval(self, column: str) -> tuple[float, float]:
        """Return the ends of the interval of a column."""
        place = self.scores.columns.index(column)
        return float(self.low[place]), float(self.high[place])


def score_run(
    result: PoseResult, protocol: PoseProtocol, subset: str = ALL, *, samples: int = 0
) -> Scored:
    """Score a run.

    Args:
        result: the run.
        protocol: the scoring protocol.
        subset: objects to score, a key of `SUBSETS`.
        samples: bootstrap samples of scenes for the intervals; 0 for none.

    Raises:
        ToolkitError: the table has invalid poses.
    """
    frames = frames_of(result.table, SUBSETS[subset])
    matches = match_poses(frames.truths, frames.found, protocol)
    low = high = np.full(len(protocol.columns), np.nan)
    if samples and len(np.unique(frames.scenes)) > 1:
        draws = scene_draws(len(np.unique(frames.scenes)), samples)
        drawn = resampled_scores(matches, scene_weights(frames.scenes, draws))
        low, high = interval_of(drawn)
    return Scored(
        result, subset, score_matches(matches), matches, frames.scenes, frames.names, low, high
    )


def score_runs(
    results: Sequence[PoseResult],
    protocol: PoseProtocol,
    subsets: Sequence[str] = (ALL, HARD),
    *,
    samples: int = 0,
) -> list[Scored]:
    """Score every run for every subset that has objects, see `score_run`."""
    scored = [score_run(r, protocol, s, samples=samples) for s in subsets for r in results]
    return [each for each in scored if each.objects]


def interval_of(drawn: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the ends (K,) of the intervals of resampled figures (D, K), ignoring NaN."""
    low, high = np.full((2, drawn.shape[1]), np.nan)
    for column, values in enumerate(drawn.T):
        there = values[~np.isnan(values)]
        if len(there):
            low[column], high[column] = np.quantile(there, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return low, high


def scene_draws(scenes: int, samples: int, *, seed: int = 0) -> NDArray[np.float64]:
    """Return how often each scene is drawn with replacement, (samples, scenes)."""
    rng = np.random.default_rng(seed)
    drawn = rng.integers(0, scenes, (samples, scenes)) + scenes * np.arange(samples)[:, None]
    counts = np.bincount(drawn.ravel(), minlength=samples * scenes)
    return counts.reshape(samples, scenes).astype(np.float64)


def poses_table(results: Sequence[PoseResult], protocols: Sequence[PoseProtocol]) -> str:
    """Format means over classes in percent, for all and for specular and transparent objects."""
    blocks = []
    for split in dict.fromkeys(result.split for result in results):
        mine = [result for result in results if result.split == split]
        for protocol in protocols:
            scored = score_runs(mine, protocol, (ALL, HARD))
            shown = _table(scored, protocol) if scored else "no true object in any frame"
            blocks.append(f"{split}, protocol {protocol.name}, poses right in %\n{shown}")
    return "\n\n".join(blocks)


def pose_records(
    results: Sequence[PoseResult], protocols: Sequence[PoseProtocol]
) -> list[dict[str, Any]]:
    """Return the figures of `poses_table`, as fractions."""
    return [
        {
            "split": split,
            "protocol": protocol.name,
            **dict(zip(_TEXTS, (*scored.result.name, scored.subset), strict=True)),
            "true": scored.objects,
            **{column: scored.figures[column] for column in protocol.columns},
        }
        for split in dict.fromkeys(result.split for result in results)
        for protocol in protocols
        for scored in score_runs([r for r in results if r.split == split], protocol, (ALL, HARD))
    ]


def _table(scored: Sequence[Scored], protocol: PoseProtocol) -> str:
    lines = []
    for each in scored:
        figures = each.figures
        numbers = [f"{100 * figures[c]:.1f}" for c in protocol.columns]
        if each.result.failed_everywhere:
            numbers = [FAILED, *("-" for _ in numbers[1:])]
        lines.append([*each.result.name, each.subset, str(each.objects), *numbers])
    heads = [*_TEXTS, "true", *map(heading, protocol.columns)]
    return text_table(heads, lines, texts=len(_TEXTS)).terminal()


def heading(column: str) -> str:
    """Return the heading of a column.

    >>> heading("iou25"), heading("10deg5cm")
    ('IoU25', '10°5cm')
    """
    return column.replace("iou", "IoU").replace("deg", "°")
