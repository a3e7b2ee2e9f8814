"""How the check judges right and wrong labels of many kinds of objects.

    python perf/world.py --seeds 0:20 --kinds judging [--faults 6] [--no-refine] [--csv FILE]

Each seed is a scene of `sensors.synthetic.world_scene`. Measured are its right labels; wrong labels
of 4 mm or 3 deg, 8 mm or 5 deg, 12 mm or 8 deg, half and quarter turns of each object; and the
labels of `propagate --refine` from starts 3 to 12 mm and 1 to 7 deg off. The tables give, by
surface and by kind, the shares of each verdict, and how far refined labels lie from the truth in
units of their deviations (68 % within 1 and 95 % within 2 are wanted).

Use `--kinds setting` to set a limit and `--kinds judging` to judge it: they share no kind. Finished
scenes are kept in the work folder under the source and the options that made them, so that a run
that was stopped goes on where it was, and a changed check is measured again.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import cache, partial
from pathlib import Path
from typing import Any, get_args

import msgspec
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/std_toolkit/checks"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/std_toolkit/labels"))

import deviation_study
import fault_table
from deviation_study import pose_error
from fault_table import FaultCase, Study

import std_toolkit
from sensors.synthetic.kinds import JUDGING, SETTING, Kind
from sensors.synthetic.world_faults import label_faults
from sensors.synthetic.world_scene import World, draw_world, world_cache
from std_toolkit.checks import result
from std_toolkit.geometry import SE3, mssd, so3_exp
from std_toolkit.geometry.mesh import hull_vertices
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.options import PropagateOptions
from std_toolkit.scene import Scene
from std_toolkit.scene.model import Label, Labels

KINDS: dict[str, tuple[Kind, ...]] = {"setting": SETTING, "judging": JUDGING}
VERDICTS = get_args(result.Verdict)
# Those that the tables ask for; a check with other words is noticed here.
FITS, WRONG = (VERDICTS[VERDICTS.index(word)] for word in ("fits", "wrong"))
LEVELS = ("4 mm, 3 deg", "8 mm, 5 deg", "12 mm, 8 deg", "half, quarter, over")


@dataclass(frozen=True, kw_only=True)
class Row:
    """What the check says of one label.

    Attributes:
        trial: "right", "refined", or the kind of the fault.
        level: of the fault, see `LabelFault`; -1 for other trials.
        size: of the fault, mm or degrees.
        mssd_mm: largest distance of a surface point from the truth.
        verdict: of the object; gates: those that failed in the scene, separated by blanks.
        scene_passed: whether the scene passed.
        others_wrong: number of other objects that this trial made wrong.
        z, mm, deg, std_mm, std_deg: of refined labels, see `deviation_study.Row`.
    """

    seed: int
    object: str
    kind: str
    look: str
    exact: bool
    sensor: str
    camera_noise: bool
    trial: str
    level: int = -1
    size: float = 0.0
    mssd_mm: float = 0.0
    verdict: str
    gates: str
    scene_passed: bool
    others_wrong: int = 0
    z: list[float] = field(default_factory=list)
    mm: float = 0.0
    deg: float = 0.0
    std_mm: float = 0.0
    std_deg: float = 0.0


def measure(world: World, *, faults: int, refine: bool) -> list[Row]:
    """All rows of one scene."""
    scene = world.scene()
    things = {t.name: t for t in world.things()}
    study = Study(scene)
    rows: list[Row] = []

    def row(
        item: result.ObjectCheck, trial: str, report: result.CheckReport, **more: object
    ) -> Row:
        thing = things[item.name]
        return Row(
            seed=world.seed,
            object=item.name,
            kind=thing.kind.name,
            look=thing.look,
            exact=thing.is_exact,
            sensor=world.sensor,
            camera_noise=world.camera_noise,
            trial=trial,
            verdict=item.verdict,
            gates=" ".join(g.key for g in report.failed_gates()),
            scene_passed=report.passed,
            **more,  # type: ignore[arg-type]
        )

    right = study.report(FaultCase("right", "pass", scene, frames=()))
    rows += [row(item, "right", right) for item in right.objects]
    was_wrong = {o.object for o in right.objects if o.verdict == WRONG}
    for item in right.objects:
        every = list(label_faults(scene, item.object, seed=world.seed))
        rng = np.random.default_rng([world.seed, item.object, 9])
        chosen = sorted(rng.permutation(len(every))[: faults if faults >= 0 else None])
        for fault in (every[k] for k in chosen):
            case = FaultCase(fault.name, "fail", fault.apply(scene), objects=(item.object,))
            report = study.report(case)
            now = {o.object: o for o in report.objects}
            others = sum(
                o.verdict == WRONG and o.object not in was_wrong
                for o in report.objects
                if o.object != item.object
            )
            rows.append(
                row(
                    now[item.object],
                    fault.kind,
                    report,
                    level=fault.level,
                    size=fault.size,
                    mssd_mm=1000 * fault.mssd_m,
                    others_wrong=others,
                )
            )
    if refine:
        rows += _refined(scene, row)
    return rows


def _refined(scene: Scene, row: Callable[..., Row]) -> Iterator[Row]:
    """Labels after `propagate --refine` from wrong starts, in a copy of the scene."""
    truth = {x.object: SE3.from_matrix(x.T_world_obj) for x in scene.labels.labels}
    rng = np.random.default_rng([len(scene.frames), *scene.root.name.encode()])
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary) / scene.root.name
        shutil.copytree(scene.root, root)
        copy = Scene.open(root)
        T_world_cam = copy.T_world_cam(copy.frames[0].id)
        assert T_world_cam is not None
        starts = [
            Label(
                object=i,
                frame=copy.frames[0].id,
                T_cam_obj=(T_world_cam.inverse() @ _moved(T, rng)).flat(),
                method="gui",
            )
            for i, T in truth.items()
        ]
        copy.save_labels(Labels(labels=starts))
        propagate_labels(Scene.open(root), PropagateOptions(refine=True))
        copy = Scene.open(root)
        report = Study(copy).report(FaultCase("refined", "pass", copy, frames=()))
        for item in report.objects:
            label = copy.labels.of(item.object)
            if label is None or label.T_world_obj is None or label.covariance is None:
                continue
            model = copy.objects.model_of(item.object)
            mesh, symmetry = copy.mesh(model.id), model.symmetry.symmetry()
            pose = SE3.from_matrix(label.T_world_obj)
            C = np.reshape(label.covariance, (6, 6))
            error = pose_error(pose, C, truth[item.object], mesh, symmetry)
            off = mssd(pose, truth[item.object], hull_vertices(mesh), symmetry)
            yield row(item, "refined", report, mssd_mm=1000 * off, **asdict(error))


def _moved(T: SE3, rng: np.random.Generator) -> SE3:
    shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn = so3_exp(np.deg2rad(rng.uniform(1, 7)) * axis)
    return SE3(turn @ T.R, T.t + rng.uniform(0.003, 0.012) * shift)


def measured(work: Path, world: World, faults: int, refine: bool) -> list[Row]:
    """The rows of a scene, from the work folder if they are there."""
    key = f"{_source()} {world} {faults} {refine}".encode()
    path = work / f"{world.seed:05d}_{hashlib.sha256(key).hexdigest()[:12]}.json"
    if not path.is_file():
        started = time.process_time()
        rows = measure(world, faults=faults, refine=refine)
        write_bytes_atomic(path, msgspec.json.encode(rows))
        print(
            f"seed {world.seed}: {len(rows)} rows, {time.process_time() - started:.0f} s",
            flush=True,
        )
    return msgspec.json.decode(path.read_bytes(), type=list[Row])


@cache
def _source() -> str:
    """Digest of the source that measures and judges."""
    digest = hashlib.sha256()
    roots = Path(std_toolkit.__file__).parent, Path(__file__).parent.parent / "sensors/synthetic"
    studies = [Path(str(module.__file__)) for module in (deviation_study, fault_table)]
    for path in sorted([*studies, *(p for root in roots for p in root.rglob("*.py"))]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def groups(rows: list[Row]) -> Iterator[tuple[str, list[Row]]]:
    """Rows by surface, by kind and by what is known to matter."""
    yield "all", rows
    for name in ("look", "kind", "sensor"):
        for value in sorted({getattr(r, name) for r in rows}):
            yield value, [r for r in rows if getattr(r, name) == value]
    for name, exact in (("mesh exact", True), ("mesh other", False)):
        yield name, [r for r in rows if r.exact == exact]
    for name, noise in (("cameras exact", False), ("cameras off", True)):
        yield name, [r for r in rows if r.camera_noise == noise]


def print_tables(rows: list[Row]) -> None:
    right = [r for r in rows if r.trial == "right"]
    scenes = {r.seed: r.scene_passed for r in right}
    print(f"\n{len(scenes)} scenes, {sum(scenes.values())} pass with right labels")
    print(f"\nright labels{'':8}{'labels':>8}" + "".join(f"{w:>10}" for w in VERDICTS))
    for name, mine in groups(right):
        if mine:
            shares = "".join(f"{_share(mine, w):>10.0%}" for w in VERDICTS)
            print(f"{name:<20}{len(mine):>8}{shares}")
    wrong = [r for r in rows if r.level >= 0]
    if wrong:
        print("\nwrong labels: share called wrong / not told (fits) of n")
        print(f"{'':<20}" + "".join(f"{name:>22}" for name in LEVELS))
        by_trial = [
            (t, [r for r in wrong if r.trial == t]) for t in sorted({r.trial for r in wrong})
        ]
        for name, mine in (*groups(wrong), *by_trial):
            if mine:
                cells = [_caught([r for r in mine if r.level == k]) for k in range(len(LEVELS))]
                print(f"{name:<20}" + "".join(f"{cell:>22}" for cell in cells))
        blamed = sum(r.others_wrong > 0 for r in wrong)
        print(f"another object was called wrong, too: {blamed} of {len(wrong)}")
    _print_refined([r for r in rows if r.trial == "refined"])


def _print_refined(rows: list[Row]) -> None:
    if not rows:
        return
    print(
        f"\nrefined labels{'':6}{'labels':>8}{'within 1':>10}{'within 2':>10}{'mm':>7}{'std mm':>8}"
        f"{'deg':>7}{'std deg':>9}{'MSSD mm':>9}   up to 2 mm / beyond 4 mm called {FITS}"
    )
    for name, mine in groups(rows):
        if not mine:
            continue
        z = np.abs(np.concatenate([r.z for r in mine]))
        middle = [
            float(np.median([getattr(r, f) for r in mine]))
            for f in ("mm", "std_mm", "deg", "std_deg", "mssd_mm")
        ]
        near = [r for r in mine if r.mssd_mm <= 2]
        far = [r for r in mine if r.mssd_mm > 4]
        print(
            f"{name:<20}{len(mine):>8}{(z <= 1).mean():>10.0%}{(z <= 2).mean():>10.0%}"
            f"{middle[0]:>7.2f}{middle[1]:>8.2f}{middle[2]:>7.2f}{middle[3]:>9.2f}{middle[4]:>9.2f}"
            f"   {sum(r.verdict == FITS for r in near)} of {len(near)} / "
            f"{sum(r.verdict == FITS for r in far)} of {len(far)}"
        )


def _share(rows: list[Row], verdict: str) -> float:
    return sum(r.verdict == verdict for r in rows) / len(rows)


def _caught(rows: list[Row]) -> str:
    if not rows:
        return "-"
    return f"{_share(rows, WRONG):.0%} / {_share(rows, FITS):.0%} of {len(rows)}"


def write_csv(path: Path, rows: Sequence[Any]) -> None:
    """One line per row, a dataclass with `z`: whitened errors, which are separated by blanks."""
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, [f.name for f in fields(rows[0])], lineterminator="\n")
        table.writeheader()
        for row in rows:
            table.writerow({**asdict(row), "z": " ".join(f"{z:.3f}" for z in row.z)})


def world_options(text: str | None, seeds: str) -> argparse.ArgumentParser:
    """The options of a measurement of scenes; `text` is the docstring of its module."""
    parser = argparse.ArgumentParser(description=(text or "").partition("\n")[0])
    parser.add_argument("--seeds", default=seeds, help="first:end")
    parser.add_argument("--kinds", choices=tuple(KINDS), default="judging")
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument(
        "--work",
        type=Path,
        help="folder that keeps finished scenes' rows; another check needs another one",
    )
    parser.add_argument("--csv", type=Path, help="write all rows to this file")
    parser.add_argument("--workers", type=int, default=1, help="scenes measured at a time")
    return parser


def run_worlds(
    args: argparse.Namespace,
    name: str,
    measure: Callable[[Path, World], list[Any]],
    show: Callable[[list[Any]], None],
) -> int:
    """Measure the scenes of the options, show and write the rows.

    Args:
        args: of `world_options`.
        name: of the measurement; its folder of rows is called so.
        measure: the rows of a scene, from the folder of rows and the scene.
        show: prints the tables.

    Returns:
        Exit status 1 if a scene could not be measured.
    """
    first, _, end = args.seeds.partition(":")
    work = args.work or world_cache().with_name(f"{name}-rows")
    work.mkdir(parents=True, exist_ok=True)
    worlds = [
        draw_world(s, KINDS[args.kinds], frames=args.frames) for s in range(int(first), int(end))
    ]
    options = JobOptions(engine="serial") if args.workers < 2 else JobOptions(workers=args.workers)
    done = run_jobs(
        partial(measure, work),
        worlds,
        name=name,
        key=lambda world: str(world.seed),
        options=options,
    )
    rows = [row for found in done.results.values() for row in found]
    if rows:
        show(rows)
        if args.csv:
            write_csv(args.csv, rows)
    for seed, problem in done.failed.items():
        print(f"seed {seed}: {problem}", file=sys.stderr)
    return 1 if done.failed else 0


def main() -> int:
    """Measure what is missing, print the tables. Exit status 1: a scene could not be measured."""
    parser = world_options(__doc__, "0:10")
    parser.add_argument("--faults", type=int, default=-1, help="so many of each object; -1: all")
    parser.add_argument("--no-refine", action="store_true", help="do not refine labels")
    args = parser.parse_args()
    measure = partial(_rows_of, args.faults, not args.no_refine)
    return run_worlds(args, "world", measure, print_tables)


def _rows_of(faults: int, refine: bool, work: Path, world: World) -> list[Row]:
    return measured(work, world, faults, refine)


if __name__ == "__main__":
    sys.exit(main())
