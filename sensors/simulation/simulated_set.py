"""A simulated data set on disk: many scenes, made in parallel, each complete or absent."""

import os
import shutil
from collections.abc import Sequence
from contextlib import ExitStack
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal

import msgspec

from sensors.output.dreds import (
    NOVEL,
    SPLITS,
    Split,
    dreds_scene,
    novel_folder,
    record_path,
    scene_folder,
)
from sensors.output.scene_record import SceneRecord
from sensors.output.toolkit_scene import read_simulation, toolkit_scene
from sensors.render.sim_renderer import SIM_RENDERERS, quality_of
from sensors.simulation.equipment import Equipment
from sensors.simulation.options import Layout, SimulationOptions
from sensors.simulation.simulator import Simulator
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import refuse_links
from std_toolkit.io.documents import read_document
from std_toolkit.jobs import JobOptions, JobReport, run_jobs
from std_toolkit.jobs.artefact import begin
from std_toolkit.log import logger
from std_toolkit.options import usable_cores
from std_toolkit.scene.document import Document

LAYOUTS: tuple[Layout, ...] = ("dreds", "novel", "scene")
SET_FILE = "simulation.json"
# Measured on 640x360 frames; textures that compress worse need more.
BYTES_PER_PIXEL = {"dreds": 18.0, "novel": 16.0, "scene": 16.0}
# Always left free: a full disk harms other programs.
SPARE_BYTES = 500e6


class SetRecord(Document, frozen=True, kw_only=True):
    """simulation.json of a data set: the options shared by all of its scenes."""

    format: Literal["std-sim-set"] = "std-sim-set"
    version: Literal[1] = 1
    version_of_tool: str
    renderer: str
    options: SimulationOptions


class SceneTimes(msgspec.Struct, frozen=True, kw_only=True):
    """Time that a scene took.

    Attributes:
        frames: made in this run; 0 if the scene existed.
        seconds: by part of the work.
    """

    frames: int
    seconds: dict[str, float]


def simulate_set(
    out: Path,
    options: SimulationOptions,
    seeds: Sequence[int],
    *,
    split: Split = "train",
    layouts: Sequence[Layout] = ("dreds",),
    renderer: str = "mitsuba",
    cache: Path | None = None,
    jobs: JobOptions | None = None,
) -> JobReport[SceneTimes]:
    """Make the missing scenes, and check the others; one process and one scene per job.

    A scene depends only on its seed and the options: the set is the same after an interruption, or
    if it is made on several machines. A job fails if a file of a finished scene is not as written.

    Args:
        out: top of the data set.
        options: must be those of the existing scenes of the set.
        seeds: of the scenes, which are named after them.
        split: part of the data set in the DREDS layout.
        layouts: "dreds", "novel" (DREDS-CatNovel) and "scene" (toolkit scenes in OUT/scenes).
        renderer: plug-in.
        cache: folder of the objects' convex parts, shared by all sets; default: the user's cache.
        jobs: where it runs.

    Raises:
        ToolkitError: another set exists at `out`, a seed is duplicated or out of range, the disk
            has too little room, or the sensor, sources or renderer cannot be used.
    """
    jobs = jobs or JobOptions()
    _check(seeds, split, layouts)
    begin_set(out, options, renderer)
    missing = [s for s in seeds if _missing(out, s, split, layouts)]
    check_room(out, options, len(missing), layouts)
    simulate = partial(
        _simulate_scene,
        out=out,
        options=options,
        split=split,
        layouts=tuple(layouts),
        renderer=renderer,
        cache=cache or parts_cache(),
        threads=threads_each(jobs, len(missing)),
    )
    if kept := len(seeds) - len(missing):
        logger.info("%d of %d scenes are there already", kept, len(seeds))
    return run_jobs(simulate, list(seeds), name="simulate", key=scene_name, options=jobs)


def begin_set(out: Path, options: SimulationOptions, renderer: str) -> None:
    """Check once, not once per scene, what the options name, and record them in the set.

    Raises:
        ToolkitError: another set exists at `out`, or the sensor, the quality or the renderer cannot
            be used.
    """
    Equipment.of(options)
    quality_of(options.quality)
    SIM_RENDERERS.get(renderer)
    begin(
        out / SET_FILE,
        SetRecord(version_of_tool=__version__, renderer=renderer, options=options),
        within=("options", "renderer"),
        what="this set was",
        hint="choose another folder, or the options that it was begun with",
    )
    refuse_links(out)


def threads_each(jobs: JobOptions, count: int) -> int:
    """Threads for each of the scenes that are made at a time, of `count`."""
    return max(1, usable_cores() // max(1, min(jobs.worker_count, count or 1)))


def parts_cache() -> Path:
    """Default cache of convex parts: each takes seconds to compute."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "std-toolkit" / "convex-parts"


def scene_name(seed: int) -> str:
    """Five digits, as in the public data set."""
    return f"{seed:05d}"


def _simulate_scene(
    seed: int,
    *,
    out: Path,
    options: SimulationOptions,
    split: Split,
    layouts: tuple[Layout, ...],
    renderer: str,
    cache: Path,
    threads: int,
) -> SceneTimes:
    pending = _missing(out, seed, split, layouts)
    for layout in layouts:
        if layout not in pending:
            _check_kept(out, seed, split, layout)
    if not pending:
        return SceneTimes(frames=0, seconds={})
    simulator = _simulator(options, renderer, threads, cache)
    simulator.stopwatch.seconds.clear()
    name = scene_name(seed)
    world = simulator.world(seed, name)
    with ExitStack() as stack:
        writers: list[Any] = []
        if "scene" in pending:
            writers.append(stack.enter_context(toolkit_scene(out / "scenes" / name, world.record)))
        for layout in ("dreds", "novel"):
            if layout in pending:
                writer = dreds_scene(out, world.record, split=split, novel=layout == "novel")
                writers.append(stack.enter_context(writer))
        for frame in simulator.frames(world):
            with simulator.stopwatch.part("write"):
                for writer in writers:
                    writer.add(frame)
    return SceneTimes(frames=options.views, seconds=dict(simulator.stopwatch.seconds))


@lru_cache(maxsize=1)
def _simulator(options: SimulationOptions, renderer: str, threads: int, cache: Path) -> Simulator:
    """One per worker process, because the renderer compiles its kernels once per process."""
    return Simulator(options, renderer=renderer, parts_cache=cache, threads=threads)


def _missing(out: Path, seed: int, split: Split, layouts: Sequence[Layout]) -> list[Layout]:
    name = scene_name(seed)
    there = {
        "dreds": scene_folder(out, split, name).is_dir(),
        "novel": novel_folder(out, name).is_dir(),
        "scene": (out / "scenes" / name).is_dir(),
    }
    return [layout for layout in layouts if not there[layout]]


def _check_kept(out: Path, seed: int, split: Split, layout: Layout) -> None:
    """Check the files of a finished scene against its record.

    Raises:
        ToolkitError: a file is missing or changed, or the record is damaged.
    """
    name = scene_name(seed)
    if layout == "scene":
        read_simulation(out / "scenes" / name).verify(out / "scenes" / name)
    else:
        path = record_path(out, NOVEL if layout == "novel" else split, name)
        read_document(path, SceneRecord).verify(out)


def _check(seeds: Sequence[int], split: str, layouts: Sequence[str]) -> None:
    if split not in SPLITS:
        raise ToolkitError("unknown split", field="split", value=split, hint=f"one of {SPLITS}")
    if not layouts or not set(layouts) <= set(LAYOUTS):
        raise ToolkitError(
            "unknown layout", field="layouts", value=list(layouts), hint=f"some of {LAYOUTS}"
        )
    if not seeds:
        raise ToolkitError("there is no scene to make", field="scenes", value=0)
    if min(seeds) < 0 or max(seeds) > 99_999:
        raise ToolkitError(
            "seeds are 0 to 99999: scenes are named after them in five digits",
            field="seed",
            value=(min(seeds), max(seeds)),
        )


def check_room(
    out: Path, options: SimulationOptions, scenes: int, layouts: Sequence[Layout]
) -> None:
    """Refuse a disk with too little room for some scenes.

    Raises:
        ToolkitError: the disk has too little room.
    """
    per_frame = options.width * options.height * sum(BYTES_PER_PIXEL[x] for x in layouts)
    needed = per_frame * options.views * scenes + SPARE_BYTES
    free = shutil.disk_usage(out).free
    if scenes and needed > free:
        raise ToolkitError(
            f"{scenes} scenes need about {needed / 1e9:.1f} GB and {free / 1e9:.1f} GB are free",
            path=out,
            hint="make room, or fewer scenes",
        )
