"""Runs a recipe from its plan to its page. Finished steps are not repeated."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.evaluation.engine import run_all
from benchmark.evaluation.tasks.depth_results import RunResult, read_run
from benchmark.evaluation.tasks.pose_results import PoseResult
from benchmark.recipes.frame_sets import FrameSet, simulate
from benchmark.recipes.recipe_plan import Entry, Pack, RecipePlan
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from std_toolkit.log import logger

if TYPE_CHECKING:
    from benchmark.training.options import Machine

# Processor seconds of all steps in the folder of a scale, by step.
COSTS = "costs.json"


@dataclass(frozen=True)
class Trained:
    """What a training was.

    Attributes:
        frames, scenes: that it was trained on.
        steps, batch_size: how long.
        best_step: step of the best weights; None if unknown.
    """

    frames: int
    scenes: int
    steps: int
    batch_size: int
    best_step: int | None


@dataclass
class Outcome:
    """What has been done so far.

    Attributes:
        trained: by entry.
        results: by entry and test.
        poses: of pose networks, by name and test.
        problems: error lines, by what they are of.
    """

    trained: dict[str, Trained] = field(default_factory=dict)
    results: dict[tuple[str, str], list[RunResult]] = field(default_factory=dict)
    poses: dict[tuple[str, str], PoseResult] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)


def run_recipe(
    plan: RecipePlan,
    machine: Machine,
    jobs: JobOptions | None = None,
    *,
    after: Callable[[Outcome], None] = lambda outcome: None,  # noqa: ARG005
) -> Outcome:
    """Simulate, pack, train and score what is not done yet.

    A variant that fails does not keep the others from running.

    Args:
        plan: all steps.
        machine: where networks are trained.
        jobs: where all else runs.
        after: called with the results so far after every variant, at least once.

    Raises:
        ToolkitError: no test is available, or a set or a pack cannot be made, or is another than it
            was.
    """
    jobs = jobs or JobOptions()
    if all(plan.place(target) is None for target in plan.targets):
        first = plan.targets[0]
        raise ToolkitError(
            "no test of this recipe is available: nothing could be scored",
            value=[target.name for target in plan.targets],
            hint=f"{first.absent} (`--plan` tells about all tests)",
        )
    outcome = Outcome(problems={e.title: e.problem for e in plan.entries if e.problem})
    for frames in plan.sets.values():
        if frames.options is None:
            continue
        with spent(plan.out, f"set {frames.name}"):
            failed = make_set(frames, jobs)
        outcome.problems |= {f"set {frames.name}, scene {k}": e for k, e in failed.items()}
    for pack in plan.packs:
        with spent(plan.out, f"pack {pack.folder.name}"):
            failed = make_pack(pack, jobs)
        outcome.problems |= {f"pack {pack.folder.name}, {k}": e for k, e in failed.items()}
    for entry in plan.entries:
        if entry.problem:
            logger.error("%s: %s", entry.title, entry.problem)
            continue
        try:
            if entry.training is not None:
                with spent(plan.out, f"training {entry.label}"):
                    outcome.trained[entry.name] = train(entry, machine)
            with spent(plan.out, f"scores {entry.label}"):
                _score(plan, entry, jobs, outcome)
        except ToolkitError as error:
            logger.error("%s: %s", entry.title, error)
            outcome.problems[entry.title] = str(error)
        if entry.training is not None:
            after(outcome)
    for name, entry in plan.poses.items():
        _pose(plan, name, entry, machine, jobs, outcome)
        after(outcome)
    if not outcome.trained:
        after(outcome)
    return outcome


@contextmanager
def spent(out: Path, step: str) -> Iterator[None]:
    """Add the processor time of a step, and of the processes that it ended, to `COSTS`.

    An interrupted step counts; one that is killed does not.

    Args:
        out: folder of the scale.
        step: its kind (`set`, `pack`, `training`, `scores`) and name.
    """
    from std_toolkit.io.atomic import hold_lock
    from std_toolkit.io.documents import read_document, write_document

    begun = sum(os.times()[:4])
    try:
        yield
    finally:
        file, added = out / COSTS, sum(os.times()[:4]) - begun
        out.mkdir(parents=True, exist_ok=True)
        # Commands may run side by side in one folder.
        with hold_lock(out, "costs", doing="adding costs to", wait=True, what="folder"):
            costs = read_document(file, dict[str, float]) if file.is_file() else {}
            costs[step] = round(costs.get(step, 0.0) + added, 2)
            write_document(file, costs)


def _pose(
    plan: RecipePlan,
    name: str,
    entry: Entry,
    machine: Machine,
    jobs: JobOptions,
    outcome: Outcome,
) -> None:
    """Train a pose network, unless another variant did, and score it."""
    from benchmark.recipes.recipe_poses import score_poses

    if entry.problem:
        logger.error("%s: %s", entry.title, entry.problem)
        outcome.problems[entry.title] = entry.problem
        return
    depth = plan.recipe.poses[name].depth
    if depth in plan.recipe.variants and depth not in outcome.trained:
        outcome.problems[entry.title] = f"the depth of {depth} is not there: it was not trained"
        return
    try:
        with spent(plan.out, f"training {entry.label}"):
            outcome.trained[f"pose {name}"] = train(entry, machine)
        with spent(plan.out, f"scores {entry.label} on {depth}"):
            score_poses(plan, name, jobs, outcome)
    except ToolkitError as error:
        logger.error("%s: %s", entry.title, error)
        outcome.problems[entry.title] = str(error)


def make_set(frames: FrameSet, jobs: JobOptions) -> dict[str, str]:
    """Simulate what is missing of a set; error lines by scene.

    Raises:
        ToolkitError: the folder holds another set or scenes of other seeds, or the simulator cannot
            run.
    """
    from sensors.simulation.simulated_set import SET_FILE, SetRecord
    from std_toolkit.io.documents import read_document

    frames.check_scenes()
    record = frames.root / SET_FILE
    is_whole = record.is_file() and not frames.missing()
    if is_whole and read_document(record, SetRecord).options == frames.options:
        logger.info("set %s: %d frames are there", frames.name, frames.frames)
        return {}
    return simulate(frames, jobs)


def make_pack(pack: Pack, jobs: JobOptions) -> dict[str, str]:
    """Pack what is not packed yet; error lines by frame.

    Raises:
        ToolkitError: the folder holds another pack, or no frame could be packed.
    """
    from benchmark.training.options import PackOptions
    from benchmark.training.pack import pack_split
    from benchmark.training.shards import PackSetup

    options = PackOptions(size=pack.size, raw=pack.raw, nocs=pack.nocs)
    try:
        packed = pack_split(pack.folder, pack.frames.split, pack.frames.root, options, jobs)
    except ToolkitError as error:
        if error.field not in PackSetup.__struct_fields__:
            raise
        raise ToolkitError(
            error.problem,
            path=error.path,
            field=error.field,
            value=error.value,
            hint="the frames are others than it was made of: choose another --out",
        ) from error
    logger.info("pack %s: %d frames", pack.folder.name, packed.frames)
    return packed.failed


def train(entry: Entry, machine: Machine) -> Trained:
    """Train a variant, or go on with it; what is finished is left alone.

    Raises:
        ToolkitError: the training there was begun with another configuration, or it fails.
    """
    from benchmark.training.config import CONFIG, begin
    from benchmark.training.fit import fit
    from benchmark.training.plan import plan_training
    from benchmark.training.run_files import BEST, LAST, SCORES
    from std_toolkit.io.documents import read_document

    assert entry.training is not None
    assert entry.folder is not None
    config, data, beginning = plan_training(entry.training)
    folder = entry.folder
    if (folder / CONFIG).is_file():
        begin(folder, config)
    if all((folder / name).is_file() for name in (BEST, LAST)):
        logger.info("%s: is trained", entry.label)
    else:
        logger.info(
            "%s: %d steps of %d frames", entry.label, config.steps, config.optimization.batch_size
        )
        fit(folder, config, data, machine, beginning)
    scores_file = folder / SCORES
    best = read_document(scores_file, dict) if scores_file.is_file() else {}
    return Trained(
        frames=len(data.of_training),
        scenes=len({data.training.scene(i) for i in data.of_training}),
        steps=config.steps,
        batch_size=config.optimization.batch_size,
        best_step=best.get("step"),
    )


def _score(plan: RecipePlan, entry: Entry, jobs: JobOptions, outcome: Outcome) -> None:
    """Score on one test after the other: one that fails keeps no other from it."""
    runs = plan.runs(entry)
    for target in dict.fromkeys(target.name for target, _ in runs):
        mine = [run for of, run in runs if of.name == target]
        try:
            report = run_all(mine, jobs)
        except ToolkitError as error:
            outcome.problems[f"{entry.title} on {target}"] = str(error)
            continue
        outcome.problems |= {f"{k} ({target})": e for k, e in report.failed.items()}
        if report.failed_frames:
            outcome.problems[f"{entry.title} on {target}"] = (
                f"{report.failed_frames} frames failed; failures.csv beside the results tells why"
            )
        outcome.results[entry.name, target] = [read_run(run.folder) for run in report.finished]
