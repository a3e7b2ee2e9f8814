"""Runs a recipe from its plan to its page. Finished steps are not repeated."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.evaluation.engine import run_all
from benchmark.evaluation.tasks.depth import Run
from benchmark.evaluation.tasks.depth_results import RunResult
from benchmark.evaluation.tasks.pose import PoseRun
from benchmark.evaluation.tasks.pose_results import PoseResult
from benchmark.recipes.recipe_plan import Entry, Pack, RecipePlan
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document, write_document
from std_toolkit.io.locks import hold_lock
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

    Each step is a command of its own (`std-sim`, `std-train pack`, `std-train`, `std-bench`) and
    knows from its own files what is done. A variant that fails does not keep the others from
    running.

    Args:
        plan: all steps.
        machine: where networks are trained.
        jobs: where all else runs.
        after: called with the results so far after every variant.

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
    entries = [*plan.entries, *plan.poses.values()]
    outcome = Outcome(problems={e.title: e.problem for e in entries if e.problem})
    steps: list[tuple[str, Callable[[JobOptions], dict[str, str]]]] = [
        (f"set {frames.name}", frames.simulate)
        for frames in plan.sets.values()
        if frames.options is not None
    ]
    steps += [(f"pack {pack.folder.name}", partial(make_pack, pack)) for pack in plan.packs]
    for name, make in steps:
        with spent(plan.out, name):
            failed = make(jobs)
        outcome.problems |= {f"{name}, {k}": error for k, error in failed.items()}
    for entry in entries:
        try:
            _run_entry(plan, entry, machine, jobs, outcome)
        except ToolkitError as error:
            logger.error("%s: %s", entry.title, error)
            outcome.problems[entry.title] = str(error)
        if entry.training is not None or entry.problem:
            after(outcome)
    return outcome


def _run_entry(
    plan: RecipePlan, entry: Entry, machine: Machine, jobs: JobOptions, outcome: Outcome
) -> None:
    """Train an entry, unless another one did, and score it on one test after the other.

    A test that fails keeps no other from being scored.
    """
    if entry.problem:
        logger.error("%s: %s", entry.title, entry.problem)
        return
    key, scores = entry.name, f"scores {entry.label}"
    if entry.pose is not None:
        key, depth = f"pose {entry.name}", entry.pose.depth
        scores += f" on {depth}"
        if depth in plan.recipe.variants and depth not in outcome.trained:
            raise ToolkitError(f"the depth of {depth} is not there: it was not trained")
    if entry.training is not None:
        with spent(plan.out, f"training {entry.label}"):
            outcome.trained[key] = train(entry, machine)
    with spent(plan.out, scores):
        for target in plan.targets:
            if runs := plan.runs(entry, target):
                _score(entry, target.name, runs, jobs, outcome)


def _score(
    entry: Entry, target: str, runs: Sequence[Run | PoseRun], jobs: JobOptions, outcome: Outcome
) -> None:
    where = f"{entry.title} on {target}"
    try:
        report = run_all(runs, jobs)
    except ToolkitError as error:
        outcome.problems[where] = str(error)
        return
    outcome.problems |= {f"{k} ({target})": e for k, e in report.failed.items()}
    if report.failed_frames:
        outcome.problems[where] = (
            f"{report.failed_frames} frames failed; failures.csv beside the results tells why"
        )
    if entry.pose is None:
        outcome.results[entry.name, target] = []
    for found in (run.read() for run in report.finished):
        if isinstance(found, PoseResult):
            outcome.poses[entry.name, target] = found
        else:
            outcome.results[entry.name, target].append(found)


@contextmanager
def spent(out: Path, step: str) -> Iterator[None]:
    """Add the processor time of a step, and of the processes that it ended, to `COSTS`.

    An interrupted step counts; one that is killed does not.

    Args:
        out: folder of the scale.
        step: its kind (`set`, `pack`, `training`, `scores`) and name.
    """
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
        hint = "the frames are others than it was made of: choose another --out"
        raise error.revised(hint=hint) from error
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
    from benchmark.training.run_files import SCORES, is_trained, read_best

    assert entry.training is not None
    assert entry.folder is not None
    config, data, beginning = plan_training(entry.training)
    folder = entry.folder
    if (folder / CONFIG).is_file():
        begin(folder, config)
    if is_trained(folder):
        logger.info("%s: is trained", entry.label)
    else:
        logger.info(
            "%s: %d steps of %d frames", entry.label, config.steps, config.optimization.batch_size
        )
        fit(folder, config, data, machine, beginning)
    best = read_best(folder) if (folder / SCORES).is_file() else None
    return Trained(
        frames=len(data.of_training),
        scenes=len({data.training.scene(i) for i in data.of_training}),
        steps=config.steps,
        batch_size=config.optimization.batch_size,
        best_step=None if best is None else best.step,
    )


def scoring_devices(machine: Machine) -> tuple[str, ...]:
    """Torch devices to score on, where networks are trained on `machine`."""
    import torch

    if machine.accelerator != "cpu" and torch.cuda.is_available():
        return tuple(f"cuda:{i}" for i in range(torch.cuda.device_count()))
    return ("cpu",)
