"""The table clearing task: one planner on one depth over seeded rounds."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from benchmark.data.identity import SAVED_DEPTH
from benchmark.data.predictions import SUFFIXES
from benchmark.data.splits import FrameKey, Inputs
from benchmark.evaluation.config import GraspConfig, options_by_method
from benchmark.evaluation.depth_choice import DepthChoice, depth_choice
from benchmark.evaluation.manifest import GRASP_MANIFEST, GraspManifest, GraspSetup, circumstances
from benchmark.evaluation.results import write_part
from benchmark.evaluation.task_run import Task, TaskRun
from benchmark.evaluation.tasks import grasp_results
from benchmark.evaluation.tasks.grasp_dump import DumpRun, dump_records, dump_table, plan_dump
from benchmark.evaluation.tasks.grasp_inputs import FLAT_PATCHES, ORACLE, SUCTION, Methods
from benchmark.evaluation.tasks.grasp_pictures import attempt_strip
from benchmark.evaluation.tasks.grasp_table import ATTEMPTS, rows_of_round, scene_name
from benchmark.evaluation.values import checked_label, plain_label
from benchmark.methods.registry import MethodOptions, grasp_planners, weights_digest
from benchmark.methods.training_data import training_data, training_seed
from benchmark.metrics.grasp.gripper import PANDA, Gripper
from benchmark.metrics.grasp.suction import SuctionCup
from benchmark.tabletop import depth_model, round, sense
from benchmark.tabletop.arrange import arrange, round_seed
from benchmark.tabletop.saved_views import named_view, save_view
from benchmark.tabletop.scene_tables import open_scene_tables
from std_toolkit.errors import ToolkitError, check_known
from std_toolkit.io.documents import digest_file
from std_toolkit.io.images import write_color
from std_toolkit.log import logger
from std_toolkit.settings import changed

if TYPE_CHECKING:
    from sensors.assets import AssetSource

GRASP_FOLDER, STRIPS = "grasp", "strips"

_ROUNDS = 6

_OF_CONFIG = (
    "seed", "out", "camera", "attempts", "move", "meshes", "meshes_unit", "scenes",
    "devices", "save_views",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class GraspRun(TaskRun[None, Methods]):
    """A planner on a depth.

    Rounds and their noise depend only on the seed of the run and the index of the round. The table
    is therefore the same if rounds are interrupted, resumed or spread over workers.

    Attributes:
        depth: depth that grasps are planned on.
        planner, planner_options: a registered planner, or `oracle`.
        label: name of the planner in tables.
        rounds, seed: number of rounds, and their seed.
        out: folder of results.
        camera: `quick` or `simulated`.
        attempts: maximum number of attempts per round.
        move: `guarded` or `straight`.
        gripper: that executes the grasps.
        meshes, meshes_unit: folder of meshes for the tables and its unit; None for the built-in
            shapes.
        scenes: folder of labelled scenes as tables, instead of dropped objects.
        devices: torch devices; each worker uses one.
        strips: save pictures of every attempt.
        save_views: folder to which the views are written; None for none.
    """

    manifest_name, table_name, unit = GRASP_MANIFEST, ATTEMPTS, "rounds"
    network_shares_cpu = True
    depth: DepthChoice
    planner: str
    label: str | None = None
    rounds: int
    seed: int
    out: Path
    planner_options: MethodOptions = field(default_factory=MethodOptions)
    camera: sense.CameraKind = "quick"
    attempts: int = round.MOST_ATTEMPTS
    move: Literal["guarded", "straight"] = "guarded"
    gripper: Gripper | SuctionCup = PANDA
    meshes: Path | None = None
    meshes_unit: Literal["m", "cm", "mm"] | None = None
    scenes: Path | None = None
    devices: tuple[str, ...] = ("cpu",)
    strips: bool = True
    save_views: Path | None = None

    @property
    def depth_label(self) -> str:
        return self.depth.label

    @property
    def planner_label(self) -> str:
        return self.label or plain_label(self.planner)

    @property
    def folder(self) -> Path:
        own = self.meshes or self.scenes
        shapes = f"-{own.resolve().name}" if own else ""
        # Compared by name: in another process it is another object.
        tool = "" if self.gripper.name == PANDA.name else f"-{self.gripper.name}"
        seeded = f"{self.camera}-seed{self.seed}{shapes}{tool}"
        return self.out / GRASP_FOLDER / seeded / self.planner_label / self.depth_label

    @property
    def title(self) -> str:
        return f"{self.planner_label} on {self.depth_label} depth"

    @property
    def assets(self) -> AssetSource | None:
        """Source of the user's meshes.

        Raises:
            ToolkitError: no such folder, or no mesh in it.
        """
        if self.meshes is None:
            return None
        from sensors.assets import SourceOptions, open_source

        return open_source("folder", SourceOptions(root=self.meshes, unit=self.meshes_unit))

    def check_data(self) -> None:
        # Refused before anything runs.
        _ = self.assets
        if self.scenes is not None and self.rounds > (there := len(open_scene_tables(self.scenes))):
            raise ToolkitError(
                f"there is one table for each of {there} scenes", field="rounds", value=self.rounds
            )
        logger.info("%s: %d rounds", self.title, self.rounds)

    def open(self) -> None:
        """Open nothing: the tables are generated."""

    def make(self, device: str) -> Methods:
        depth = replace(self.depth, options=replace(self.depth.options, device=device))
        options = replace(self.planner_options, device=device)
        return Methods(depth, self.planner, options, self.gripper)

    def parts(self, methods: Methods) -> tuple[object, ...]:
        return methods.depths.restorer, methods.planner

    def begin_worker(self) -> None:
        """Use one thread: rounding of sums over threads depends on the number of threads."""
        if (torch := sys.modules.get("torch")) is not None:
            torch.set_num_threads(1)

    def manifest(self, data: None, methods: Methods) -> GraspManifest:  # noqa: ARG002
        planner, depth = self.planner_options, self.depth.options
        is_quick = self.camera == "quick"
        # Precision, compile and device are the same for both.
        network = depth if self.depth.is_restored else planner
        setup = GraspSetup(
            limits=changed(),
            seed=self.seed,
            attempts=self.attempts,
            camera=self.camera,
            depth_model_sha256=digest_file(depth_model.MODEL_FILE) if is_quick else "",
            gripper=self.gripper.name,
            planner=self.planner,
            planner_preset=planner.preset,
            planner_settings=dict(planner.settings),
            planner_weights_sha256=weights_digest(self.planner, methods.planner, planner),
            **methods.depths.setup(),
            precision=network.precision,
            compile=network.compile,
            device=self.devices[0].partition(":")[0],
            move=self.move,
            meshes="" if self.meshes is None else self.meshes.resolve().name,
            meshes_sha256="" if self.meshes is None else _files_digest(self.meshes),
            meshes_unit=self.meshes_unit or "",
            scenes="" if self.scenes is None else self.scenes.resolve().name,
            scenes_sha256="" if self.scenes is None else open_scene_tables(self.scenes).digest(),
        )
        return GraspManifest(
            depth_label=self.depth_label,
            planner_label=self.planner_label,
            setup=setup,
            planner_weights=str(planner.weights or ""),
            depth_weights=str(depth.weights or ""),
            planner_training_data=training_data(self.planner, methods.planner, planner),
            depth_training_data=methods.depths.training_data,
            planner_training_seed=training_seed(self.planner, methods.planner, planner),
            depth_training_seed=methods.depths.training_seed,
            **circumstances(),
        )

    def frames_there(self, data: None) -> int:  # noqa: ARG002
        return self.rounds

    def inputs(self, data: None) -> Iterator[tuple[int, FrameKey, Inputs]]:  # noqa: ARG002
        """Yield the saved depth of the views of each round: which views come, grasps decide."""
        if self.depth.folder is None:
            return
        for index in range(self.rounds):
            folder = self.depth.folder / scene_name(index)
            paths = sorted(p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES)
            found = {f"{SAVED_DEPTH} {path.relative_to(folder)}": path for path in paths}
            yield index, FrameKey(scene_name(index), ""), found

    def items(self, data: None, done: set[int], workers: int) -> list[int]:  # noqa: ARG002
        return [i for i in range(self.rounds) if i not in done]

    def item_title(self, item: int) -> str:
        return scene_name(item)

    def work(self, data: None, methods: Methods, item: int) -> int:  # noqa: ARG002
        """Clear the table of one round, and write its rows and pictures."""
        from sensors.simulation.simulated_set import parts_cache

        seed, cache = round_seed(self.seed, item), parts_cache()
        if self.scenes is None:
            arrangement = arrange(seed, assets=self.assets, parts_cache=cache)
        else:
            arrangement = open_scene_tables(self.scenes).arrange(item, seed, parts_cache=cache)
        camera = sense.make_camera(self.camera, arrangement, parts_cache=cache)
        plan: round.Plan = methods.plan

        def given(observation: sense.Observation) -> round.GivenDepth:
            frame = named_view(observation.frame, scene_name(item))
            if self.save_views is not None:
                save_view(self.save_views, frame, camera.T_world_cam)
            return methods.given(frame)

        attempts = list(
            round.clear_table(
                arrangement, camera, given, plan,
                color=methods.looks_at_color or self.save_views is not None,
                gripper=self.gripper, attempts=self.attempts, guarded=self.move == "guarded",
            )
        )  # fmt: skip
        if self.strips:
            for attempt in attempts:
                name = f"{scene_name(item)}-attempt-{attempt.number:02d}.png"
                write_color(
                    self.folder / STRIPS / name, attempt_strip(attempt, gripper=self.gripper)
                )
        judged = not isinstance(self.gripper, SuctionCup)
        rows = rows_of_round(item, arrangement, attempts, camera.T_world_cam, judged=judged)
        write_part(self.folder, item, item, rows)
        return len(attempts)

    def read(self) -> grasp_results.GraspResult:
        return grasp_results.read_grasp_run(self.folder, rounds=self.rounds)


def _files_digest(folder: Path) -> str:
    """Hash of the names and contents of all files of a folder."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    lines = [f"{path.relative_to(folder)} {digest_file(path)}" for path in files]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def plan_runs(config: GraspConfig) -> Sequence[GraspRun | DumpRun]:
    """Return the runs, grouped by planner, or that of a dump.

    Raises:
        ToolkitError: weights or settings for a method that is not requested, an unknown planner,
            or a label that cannot be the name of a folder.
    """
    if config.dump is not None:
        return plan_dump(config.dump, config)
    if config.data is not None:
        raise ToolkitError("belongs to --dump", field="--data", value=str(config.data))
    suction = config.gripper == SUCTION
    planners = config.planners or ((FLAT_PATCHES,) if suction else ("antipodal",))
    if suction and ORACLE in planners:
        raise ToolkitError(
            "plans for the jaw alone",
            field="--planner",
            value=ORACLE,
            hint="flat-patches with --depth gt",
        )
    gripper = SuctionCup(radius=config.cup_radius or SuctionCup.radius) if suction else PANDA
    for name in planners:
        if ":" not in name:
            known = [*grasp_planners.names(), ORACLE]
            check_known(name, known, "no such planner", field="--planner", told="known:")
    depths = [depth_choice(text) for text in config.depths]
    names = [
        *(d.name for d in depths if d.is_restored),
        *(p for p in planners if p != ORACLE),
    ]
    options = options_by_method(config, names)
    for name in (*(d.name for d in depths), *planners):
        checked_label(plain_label(name))
    labels = config.labels
    if "" in labels:
        labels = {planners[0]: labels[""]}
    rounds = config.rounds or (len(open_scene_tables(config.scenes)) if config.scenes else _ROUNDS)
    depths = [replace(d, options=options[d.name]) if d.is_restored else d for d in depths]
    return [
        GraspRun(
            **{name: getattr(config, name) for name in _OF_CONFIG},
            depth=depth,
            planner=planner,
            label=labels.get(planner),
            rounds=rounds,
            planner_options=options.get(planner, MethodOptions()),
            gripper=gripper,
            strips=config.gallery,
        )
        for planner, depth in product(planners, depths)
    ]


def _table(results: Sequence[Any], config: GraspConfig) -> str:
    is_dump = config.dump is not None
    return dump_table(results) if is_dump else grasp_results.grasp_table(results)


def _records(results: Sequence[Any], config: GraspConfig) -> Sequence[Any]:
    is_dump = config.dump is not None
    return dump_records(results) if is_dump else grasp_results.grasp_records(results)


TASK = Task(plan=plan_runs, table=_table, records=_records)
