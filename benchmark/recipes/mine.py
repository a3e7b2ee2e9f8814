"""`std-train mine`: shipped weights fine-tuned on your objects, scored before and after."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from benchmark.data.splits import open_split
from benchmark.evaluation.engine import run_all
from benchmark.evaluation.tasks.depth import Run
from benchmark.evaluation.tasks.depth_results import (
    RunResult,
    read_run,
    summarise,
    summarise_seen,
)
from benchmark.methods.registry import MethodOptions, shipped_weights
from benchmark.metrics.depth import harm
from benchmark.recipes.frame_sets import FrameSet
from benchmark.recipes.recipe_plan import Entry, Pack
from benchmark.recipes.recipe_run import Trained, make_pack, scoring_devices, train
from benchmark.training.options import BatchNormStatistics, MineOptions, TrainOptions
from benchmark.training.run_files import BEST
from std_toolkit.errors import ToolkitError, check_known
from std_toolkit.settings import Settings, limit

PRESET = "compact"
# Seeds of the scenes that are scored begin this far from those that are trained on.
_TEST_SEEDS = 60_000
_FEWEST_OBJECTS, _MOST_OBJECTS = 4, 8
_HELD_OUT = 0.2
# Size of the packs that the shipped weights were trained on.
_PACK = (224, 126)


@dataclass(frozen=True, kw_only=True)
class MineSettings(Settings):
    """When fine-tuned weights are not recommended."""

    harm: float = limit(0.01, source="what std-restore may spoil of good depth, in any place")
    """larger harm than this, and than that of the shipped weights"""


@dataclass(frozen=True)
class Tuning:
    """Settings of the training of the shipped weights; see their cards."""

    settings: Mapping[str, str] = field(default_factory=dict)
    loss: Mapping[str, str] = field(default_factory=dict)
    batch_norm: BatchNormStatistics = "running"


TUNINGS: dict[str, Tuning] = {
    "swindrnet": Tuning(
        {"dropout": "0", "drop_path": "0"},
        {"squared": "2", "slopes": "0.1", "normals": "0.03", "confidence": "0.15", "near": "1"},
        batch_norm="recomputed",
    ),
    "nlspn": Tuning(loss={"absolute": "1", "squared": "10", "farthest": "1.5", "objects": "4"}),
    "dfnet": Tuning(loss={"objects": "4"}),
}


@dataclass(frozen=True)
class Score:
    """RMSE on the objects of scored frames at 224x126, metres, holes counted as errors.

    Attributes:
        frames: number of frames.
        before, after: means over frames, of the shipped and of the fine-tuned weights.
        interval_before, interval_after: 95 % intervals over scenes; not finite of one scene.
        harm_before, harm_after: share of the pixels that the sensor had right and `std-restore`
            makes wrong, where it is worst: on opaque objects, on the background or around glass
            and metal; NaN if nobody can tell.
    """

    frames: int
    before: float
    after: float
    interval_before: tuple[float, float]
    interval_after: tuple[float, float]
    harm_before: float = math.nan
    harm_after: float = math.nan

    @property
    def drawback(self) -> str:
        """In what the fine-tuned weights are worse than the shipped ones; empty if in nothing."""
        allowed = max(self.harm_before, MineSettings.current().harm)
        if not self.after < self.before:
            return f"RMSE {1000 * self.before:.1f} mm before, {1000 * self.after:.1f} mm after"
        if self.harm_after > allowed:
            return f"harm {self.harm_before:.1%} before, {self.harm_after:.1%} after"
        return ""


@dataclass
class MineReport:
    """Outcome of a run.

    Attributes:
        weights: the fine-tuned weights.
        results: folder that `std-report` reads.
        trained: what was trained on.
        scores: by test set: `simulated`, `scenes`.
        problems: error lines of scenes and frames that failed.
    """

    weights: Path
    results: Path
    trained: Trained
    scores: dict[str, Score] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)

    @property
    def recommended(self) -> Path | None:
        """The fine-tuned weights, or None where the shipped ones are better on any test set."""
        return None if any(score.drawback for score in self.scores.values()) else self.weights


def fine_tune(options: MineOptions) -> MineReport:
    """Simulate, pack, train and score what is not done yet.

    Raises:
        ToolkitError: no shipped weights of the method, meshes or scenes that cannot be used, a
            simulator that cannot run, or a folder that belongs to other options.
    """
    problem, told = "no fine-tuning of this method", "choose one of"
    check_known(options.method, TUNINGS, problem, field="--method", told=told)
    shipped = shipped_weights(options.method, PRESET)
    training, tests = plan_sets(options)
    if options.meshes is not None:
        read_meshes(options.meshes)
    problems: dict[str, str] = {}
    for frames in [*training, *tests.values()]:
        if frames.options is not None:
            problems |= frames.simulate(options.jobs)
    packs = [
        Pack(folder=options.out / "packs" / frames.name, frames=frames, size=_PACK, raw="sensor")
        for frames in training
    ]
    for pack in packs:
        problems |= make_pack(pack, options.jobs)
    tuning = TUNINGS[options.method]
    entry = Entry(
        name="mine",
        title="fine-tuned",
        label="fine-tuned",
        method=options.method,
        settings=tuning.settings,
        folder=options.out / "training",
        training=TrainOptions(
            method=options.method,
            data=tuple(pack.folder for pack in packs),
            # The best weights are chosen on scenes that are neither trained on nor scored.
            hold_out=_HELD_OUT,
            preset=PRESET,
            settings=tuning.settings,
            loss=tuning.loss,
            batch_norm=tuning.batch_norm,
            weights=shipped,
            steps=options.steps,
            batch_size=options.batch_size,
            learning_rate=options.learning_rate,
            seed=options.seed,
        ),
    )
    trained = train(entry, options.machine)
    weights = options.out / "training" / BEST
    report = MineReport(weights, options.out / "results", trained, problems=problems)
    for name, frames in tests.items():
        report.scores[name] = _score(frames, options, weights, tuning, report)
    return report


def read_meshes(folder: Path) -> int:
    """Read every mesh before any is simulated; returns their number.

    Raises:
        ToolkitError: a mesh cannot be used; names its file.
    """
    from sensors.assets.asset_source import SourceOptions
    from sensors.assets.mesh_sources import FolderSource

    source = FolderSource(SourceOptions(root=folder.absolute(), split="all"))
    for asset_id in source.ids():
        source.load(asset_id)
    return len(source.ids())


def plan_sets(options: MineOptions) -> tuple[list[FrameSet], dict[str, FrameSet]]:
    """Sets to train on, and those to score by name.

    Raises:
        ToolkitError: no meshes, or too few labelled scenes with ground truth.
    """
    training, tests = [], {}
    if options.meshes is not None:
        for part, scenes, first in (
            ("train", options.simulated, options.seed),
            ("test", options.tests, options.seed + _TEST_SEEDS),
        ):
            frames = _simulated(options, part, tuple(range(first, first + scenes)))
            if part == "train":
                training.append(frames)
            else:
                tests["simulated"] = frames
    if options.scenes is not None:
        kept, scored = _own_scenes(
            options.scenes, options.out / "scenes", fewest=3 if options.meshes is None else 2
        )
        training.append(kept)
        tests["scenes"] = scored
    return training, tests


def _simulated(options: MineOptions, part: str, seeds: tuple[int, ...]) -> FrameSet:
    from sensors.simulation.options import SimulationOptions

    assert options.meshes is not None
    if not options.meshes.is_dir():
        raise ToolkitError("no such folder of meshes", path=options.meshes, field="--meshes")
    made = SimulationOptions(
        views=options.views,
        width=options.size[0],
        height=options.size[1],
        min_objects=_FEWEST_OBJECTS,
        max_objects=_MOST_OBJECTS,
        assets="folder",
        assets_root=str(options.meshes.absolute()),
        # All of your objects, in training and tests; light, floors and poses differ.
        split="all",
        quality=options.quality,
    )
    return FrameSet(
        name=f"simulated-{part}",
        root=options.out / "sets" / part,
        split=f"dreds-catknown-{part}",
        options=made,
        seeds=seeds,
    )


def _own_scenes(root: Path, links: Path, fewest: int) -> tuple[FrameSet, FrameSet]:
    """Labelled scenes to train on and to score, as folders of links.

    Raises:
        ToolkitError: too few scenes have ground truth.
    """
    source = open_split("scenes", root)
    keys = source.keys()
    names = sorted({key.scene for key in keys})
    if len(names) < fewest:
        raise ToolkitError(
            f"at least {fewest} labelled scenes are needed: one is scored and not trained on",
            path=root,
            value=names,
            hint="label another scene, or give --meshes",
        )
    first_scored = len(names) - max(1, len(names) // 3)
    sets = []
    for part, chosen in (("train", names[:first_scored]), ("test", names[first_scored:])):
        folder = links / part
        folder.mkdir(parents=True, exist_ok=True)
        for name in chosen:
            link = folder / name
            if not link.is_symlink():
                link.symlink_to((root / name).resolve(), target_is_directory=True)
        if {p.name for p in folder.iterdir()} != set(chosen):
            raise ToolkitError(
                "the scenes are others than before", path=folder, hint="choose another --out"
            )
        sets.append(FrameSet(name=f"scenes-{part}", root=folder, split="scenes"))
    return sets[0], sets[1]


def _score(
    frames: FrameSet, options: MineOptions, weights: Path, tuning: Tuning, report: MineReport
) -> Score:
    runs = [
        Run(
            split=frames.split,
            root=frames.root,
            method=options.method,
            options=given,
            protocol="strict",
            label=label,
            out=report.results / frames.name,
            devices=scoring_devices(options.machine)[:1],
            limit=None,
            speed=False,
        )
        for label, given in (
            ("shipped", MethodOptions(preset=PRESET)),
            ("fine-tuned", MethodOptions(preset=PRESET, weights=weights, settings=tuning.settings)),
        )
    ]
    done = run_all(runs, options.jobs)
    if done.failed:
        raise ToolkitError(next(iter(done.failed.values())), path=report.results)
    before, after = (read_run(run.folder) for run in done.finished)
    return _compared(before, after)


def _compared(before: RunResult, after: RunResult) -> Score:
    figures, harms = [], []
    for result in (before, after):
        harms.append(float(summarise_seen(result.table)[list(harm.NAMES)].max(axis=1).iloc[0]))
        rows = summarise(result.table, samples=1000)
        row = rows[rows["subset"] == "all"].iloc[0]
        figures.append(
            (int(row["frames"]), float(row["rmse"]), (row["rmse_low"], row["rmse_high"]))
        )
    (count, rmse_before, low_high), (_, rmse_after, after_low_high) = figures
    return Score(count, rmse_before, rmse_after, low_high, after_low_high, *harms)


def report_lines(report: MineReport, method: str) -> list[str]:
    """The scores and the next command, for the terminal."""
    lines = [
        f"trained on {report.trained.frames} frames of {report.trained.scenes} scenes, "
        f"{report.trained.steps} steps of {report.trained.batch_size}"
    ]
    for name, score in report.scores.items():
        change = 100 * (score.after / score.before - 1)
        lines.append(
            f"{name}: RMSE {_mm(score.before, score.interval_before)} before, "
            f"{_mm(score.after, score.interval_after)} after ({change:+.0f} %), "
            f"{score.frames} frames, holes counted as errors"
        )
        if not math.isnan(score.harm_after):
            lines[-1] += f"; harm {score.harm_before:.1%} before, {score.harm_after:.1%} after"
    for name, score in report.scores.items():
        if score.drawback:
            lines.append(f"{name}: the shipped weights are better and stay: {score.drawback}")
    weights = f"--weights {report.weights} " if report.recommended else ""
    lines.append(
        f"next: std-restore RECORDING --method {method} --preset {PRESET} {weights}--out restored/"
    )
    return lines


def _mm(value: float, interval: tuple[float, float]) -> str:
    if not all(math.isfinite(bound) for bound in interval):  # of one scene
        return f"{1000 * value:.1f} mm"
    return f"{1000 * value:.1f} mm ({1000 * interval[0]:.1f} to {1000 * interval[1]:.1f})"
