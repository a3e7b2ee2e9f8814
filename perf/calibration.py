"""Whether the probabilities and deviations of the check are true on many kinds of objects.

    python perf/calibration.py --seeds 300:316 --kinds judging [--csv FILE]

Each seed is a scene of `sensors.synthetic.world_scene`. Of each object are judged: its right label;
one that is 0.5 mm and 0.3 deg off along each axis, as refined labels are; two that are 0 to 15 mm
and 0 to 10 deg off; and one fault of each of the sizes of `world_faults`. The tables give, by
surface: verdicts of right labels; faults that were caught; errors of the pose of the check in units
of its deviations (68 % within 1 and 95 % within 2 are wanted); and the probability that a label
lies within the limits against the share that does, in ten bins. Set limits with `--kinds setting`.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/std_toolkit/checks"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from fault_table import FaultCase, Study
from world import run_worlds, world_options

from sensors.synthetic.world_faults import label_faults
from sensors.synthetic.world_scene import World
from std_toolkit.arrays import Array
from std_toolkit.checks.inject.faults import Fault, apply_fault
from std_toolkit.checks.measure.contours import object_centre
from std_toolkit.checks.result import ObjectCheck
from std_toolkit.geometry import so3_log
from std_toolkit.geometry.mesh import hull_vertices
from std_toolkit.geometry.symmetry import nearest_variant
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.scene import Scene

SMALL_MM, SMALL_DEG = 0.5, 0.3
LARGEST_MM, LARGEST_DEG = 15.0, 10.0
LOOKS = ("bare", "printed", "glass", "steel")
BINS = 10


@dataclass(frozen=True)
class Trial:
    """A label to judge: `name` is "right", "small", "off" or "level 0" to "level 2"."""

    name: str
    scene: Scene


@dataclass(frozen=True, kw_only=True)
class Row:
    """What the check says of one label.

    Attributes:
        trial: see `Trial`.
        size_mm: diagonal of the bounding box of the mesh.
        mm, deg: how far the label is off, symmetry aware.
        verdict, probability: of the check; None: nothing says where the object is.
        z: errors of the pose of the check in units of its deviations.
    """

    seed: int
    object: str
    look: str
    exact: bool
    trial: str
    size_mm: float
    mm: float
    deg: float
    verdict: str
    probability: float | None
    z: list[float] = field(default_factory=list)


def trials(scene: Scene, object_id: int, seed: int) -> Iterator[Trial]:
    """The labels of one object that are judged, without the right one."""
    rng = np.random.default_rng([seed, object_id, 21])

    def moved(mm: float, deg: float) -> Scene:
        shift, axis = (tuple(v / np.linalg.norm(v)) for v in rng.normal(size=(2, 3)))
        first = apply_fault(scene, Fault("along", mm, object_id, along=shift))
        return apply_fault(first, Fault("turn", deg, object_id, up=axis))

    small = np.sqrt(rng.chisquare(3, size=2))
    yield Trial("small", moved(SMALL_MM * small[0], SMALL_DEG * small[1]))
    for _ in range(2):
        yield Trial("off", moved(rng.uniform(0, LARGEST_MM), rng.uniform(0, LARGEST_DEG)))
    faults = list(label_faults(scene, object_id, seed=seed))
    for level in range(3):
        mine = [f for f in faults if f.level == level]
        if mine:
            yield Trial(f"level {level}", mine[rng.integers(len(mine))].apply(scene))


def true_motion(scene: Scene, right: Scene, object_id: int) -> Array:
    """(6,) motion in mm and degrees from a label to the object, symmetry aware."""
    label, truth = scene.T_world_obj(object_id), right.T_world_obj(object_id)
    assert label is not None and truth is not None
    hull = hull_vertices(scene.mesh(scene.objects.object(object_id).model))
    symmetry = scene.objects.model_of(object_id).symmetry.symmetry()
    truth = nearest_variant(truth, label, hull, symmetry)
    centre = object_centre(scene, object_id)
    there = truth @ (label.inverse() @ centre)
    return np.concatenate([1000 * (there - centre), np.rad2deg(so3_log(truth.R @ label.R.T))])


def whitened(error: Array, covariance: Array) -> list[float]:
    """Errors in units of their deviations along the directions that are known at all."""
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    known = values > 1e-5 * values[-1]
    return [float(x) for x in (axes.T @ error)[known] / np.sqrt(values[known])]


def judged(item: ObjectCheck, trial: Trial, right: Scene, **about: object) -> Row:
    """The row of a label from that of the report."""
    motion = true_motion(trial.scene, right, item.object)
    pose = item.entry("pose_mm")
    z: list[float] = []
    if pose is not None and pose.motion is not None and pose.covariance is not None:
        error = np.array(pose.motion) - motion
        z = whitened(error, np.reshape(pose.covariance, (6, 6)))
    return Row(
        object=item.name,
        trial=trial.name,
        size_mm=round(1000 * (item.value("size_m") or 0.0), 1),
        mm=float(np.linalg.norm(motion[:3])),
        deg=float(np.linalg.norm(motion[3:])),
        verdict=item.verdict,
        probability=item.value("within"),
        z=z,
        **about,  # type: ignore[arg-type]
    )


def measure(world: World, looks: Collection[str] = LOOKS) -> list[Row]:
    """All rows of one scene, of objects with these surfaces."""
    scene, things = world.scene(), {t.name: t for t in world.things()}
    chosen = {o.id for o in scene.objects.objects if things[o.name].look in looks}
    if not chosen:
        return []
    study = Study(scene, textured=chosen)

    def row(item: ObjectCheck, trial: Trial) -> Row:
        thing = things[item.name]
        return judged(item, trial, scene, seed=world.seed, look=thing.look, exact=thing.is_exact)

    first = study.report(FaultCase("right", "pass", scene, frames=()))
    items = [item for item in first.objects if item.object in chosen]
    rows = [row(item, Trial("right", scene)) for item in items]
    for item in items:
        for trial in trials(scene, item.object, world.seed):
            case = FaultCase(trial.name, "fail", trial.scene, objects=(item.object,))
            (now,) = (o for o in study.report(case).objects if o.object == item.object)
            rows.append(row(now, trial))
    return rows


def calibration(rows: Sequence[Row], mm: float = 4.0, deg: float = 2.5) -> tuple[Array, float]:
    """(BINS, 3) labels, mean probability and share within the limits by bin, and the mean error.

    Right labels and those that are off at random count.

    The error is the expected calibration error of M. P. Naeini et al. (2015).
    """
    # Faults of fixed sizes near the limits are no sample of labels.
    known = [r for r in rows if r.probability is not None and not r.trial.startswith("level")]
    p = np.array([r.probability for r in known], dtype=np.float64)
    inside = np.array([r.mm <= mm and r.deg <= deg for r in known], dtype=np.float64)
    which = np.minimum((p * BINS).astype(int), BINS - 1)
    table = np.zeros((BINS, 3))
    for k in range(BINS):
        mine = which == k
        if mine.any():
            table[k] = mine.sum(), p[mine].mean(), inside[mine].mean()
    error = float((table[:, 0] * np.abs(table[:, 1] - table[:, 2])).sum() / max(len(p), 1))
    return table, error


def print_tables(rows: Sequence[Row]) -> None:
    print(f"{len({r.seed for r in rows})} scenes, {len(rows)} labels")
    print(
        f"\n{'':<10}{'right labels: fits, unknown, refused':>38}"
        + "".join(f"{f'level {k}: caught, missed, of':>28}" for k in range(3))
        + f"{'within 1, 2':>14}{'ECE':>8}"
    )
    for name, mine in (*((x, [r for r in rows if r.look == x]) for x in LOOKS), ("all", rows)):
        if not mine:
            continue
        verdicts = [r.verdict for r in mine if r.trial == "right"]
        fits, unknown = verdicts.count("fits"), verdicts.count("unknown")
        cells = f"{fits}, {unknown}, {len(verdicts) - fits - unknown} of {len(verdicts)}"
        line = f"{name:<10}{cells:>38}"
        for level in range(3):
            said = [r.verdict for r in mine if r.trial == f"level {level}"]
            caught = sum(v in ("doubtful", "wrong") for v in said)
            cells = f"{caught}, {said.count('fits')}, {len(said)}"
            line += f"{cells:>28}"
        z = np.abs([x for r in mine for x in r.z])
        within = f"{100 * (z <= 1).mean():.0f}, {100 * (z <= 2).mean():.0f} %" if len(z) else "-"
        print(line + f"{within:>14}{100 * calibration(mine)[1]:>7.1f}%")
    print_sizes(rows)
    table, error = calibration(rows)
    print("\nprobability that a label is within the limits, and share that is")
    for count, p, share in table:
        if count:
            print(f"{p:>8.3f}{share:>8.3f}  of {count:.0f}")
    print(f"expected calibration error {100 * error:.1f} %")


def print_sizes(rows: Sequence[Row]) -> None:
    """Faults of printed and bare objects by five sizes: caught, missed, and all."""
    opaque = [r for r in rows if r.look in ("printed", "bare") and r.trial.startswith("level")]
    if not opaque:
        return
    columns = [(look, f"level {k}") for look in ("printed", "bare") for k in range(3)]
    print(f"\n{'size, mm':<16}" + "".join(f"{f'{x} {y}':>20}" for x, y in columns))
    edges = np.quantile([r.size_mm for r in opaque], np.linspace(0, 1, 6))
    place = np.clip(np.searchsorted(edges, [r.size_mm for r in opaque]), 1, 5)
    for k in range(1, 6):
        line = f"{f'{edges[k - 1]:.0f} to {edges[k]:.0f}':<16}"
        for column in columns:
            mine = [r for r, p in zip(opaque, place, strict=True) if p == k]
            said = [r.verdict for r in mine if (r.look, r.trial) == column]
            caught = sum(v in ("doubtful", "wrong") for v in said)
            cells = f"{caught}, {said.count('fits')}, {len(said)}"
            line += f"{cells:>20}"
        print(line)


def _measured(looks: Sequence[str], work: Path, world: World) -> list[Row]:
    path = work / f"{world.seed:05d}_{'_'.join(sorted(looks))}.json"
    if not path.is_file():
        write_bytes_atomic(path, msgspec.json.encode(measure(world, looks)))
        print(f"seed {world.seed}", flush=True)
    return msgspec.json.decode(path.read_bytes(), type=list[Row])


def main() -> int:
    """Measure, print the tables. Exit status 1: a scene could not be measured."""
    parser = world_options(__doc__, "300:316")
    parser.add_argument("--looks", choices=LOOKS, nargs="+", default=list(LOOKS))
    args = parser.parse_args()
    return run_worlds(args, "calibration", partial(_measured, args.looks), print_tables)


if __name__ == "__main__":
    sys.exit(main())
