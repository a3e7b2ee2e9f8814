"""How `std-bench audit` judges right labels and labels with known faults.

    python perf/label_audit.py --seeds 204 210 224 [--modes set labels lone] [--csv FILE]

Each seed is a scene of `sensors.synthetic.world_scene` of kinds that set no limit, read as a
published set: with the camera poses of the set, without them (they follow from the labels), or as
lone frames. One object at a time gets a fault; in lone frames, which are judged apart, all do.
Printed are, by mode, material and fault: labels, those of which nothing is known, refused ones
(doubtful or wrong), wrong ones, measured ones, those whose true error in mm and in deg lies in the
stated interval, the medians of the measured errors, and processor seconds a label.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmark.data.labelled import FrameImages, LabelledFrame, LabelledObject, MeshFile
from benchmark.data.splits import FrameKey
from benchmark.evaluation.audit.judged import audited
from benchmark.evaluation.audit.record import Size
from benchmark.evaluation.audit.rigid import groups_of
from sensors.synthetic.kinds import JUDGING
from sensors.synthetic.world_scene import world_scene
from std_toolkit.checks.gates.gate import REFUSED
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene
from std_toolkit.scene.model import DIFFUSE_MATERIALS

MODES = ("set", "labels", "lone")
# mm and degrees; right labels first.
FAULTS = ((0.0, 0.0), (5.0, 0.0), (0.0, 3.0), (10.0, 8.0))
_MOST_OBJECTS, _LONE_FRAMES = 3, 2


@dataclass(frozen=True)
class SceneLabels:
    """The labels of a scene with faults, as a data set; see `LabelledSet`."""

    scene: Scene
    faults: dict[int, SE3]
    cameras: bool

    def keys(self) -> list[FrameKey]:
        return [FrameKey("world", f.name) for f in self.scene.frames]

    def labels(self, index: int) -> LabelledFrame:
        frame, objects = self.scene.frames[index], []
        for item in self.scene.objects.objects:
            model, pose = (
                self.scene.objects.model(item.model),
                self.scene.T_cam_obj(frame.id, item.id),
            )
            if pose is None:
                continue
            mesh = MeshFile(self.scene.mesh_path(model))
            pose = pose @ self.faults.get(item.id, SE3.identity())
            objects.append(
                LabelledObject(item.name, model.id, mesh, pose, item.material, model.symmetry)
            )
        camera = self.scene.T_world_cam(frame.id) if self.cameras else None
        return LabelledFrame(index, FrameKey("world", frame.name), tuple(objects), camera)

    def images(self, index: int) -> FrameImages:
        frame = self.scene.frames[index]
        read = self.scene.read_color(frame), self.scene.read_depth(frame)
        return FrameImages(self.scene.camera(frame), *read)


@dataclass(frozen=True)
class Row:
    """One label: the fault, what was stated, and whether the fault lies in it."""

    seed: int
    mode: str
    object: str
    material: str
    fault_mm: float
    fault_deg: float
    verdict: str
    mm: float | None
    mm_low: float | None
    mm_high: float | None
    deg: float | None
    deg_low: float | None
    deg_high: float | None
    cpu_s: float

    @property
    def is_opaque(self) -> bool:
        return self.material in DIFFUSE_MATERIALS

    @property
    def is_measured(self) -> bool:
        return self.mm is not None

    def within(self, part: str) -> bool:
        """Whether a part of the fault, "mm" or "deg", lies in its stated interval."""
        low, high = getattr(self, f"{part}_low"), getattr(self, f"{part}_high")
        # Printed bounds are rounded.
        return low - 0.01 <= getattr(self, f"fault_{part}") <= high + 0.01


def fault_of(scene: Scene, object_id: int, mm: float, deg: float, seed: int) -> SE3:
    """A motion about the centre of the mesh, in a direction by chance that symmetry keeps."""
    rng = np.random.default_rng([seed, object_id, round(10 * mm), round(10 * deg)])
    model = scene.objects.model_of(object_id)
    along, axis = rng.normal(size=3), rng.normal(size=3)
    for turn in model.symmetry.continuous:
        free = np.asarray(turn.axis)
        axis = axis - (axis @ free) * free
    R = so3_exp(np.deg2rad(deg) * axis / np.linalg.norm(axis))
    centre = np.asarray(scene.mesh(model.id).bounds).mean(axis=0)
    return SE3(R, centre - R @ centre + mm / 1000 * along / np.linalg.norm(along))


def measure(seed: int, folder: Path, modes: list[str], *, drawn: bool) -> Iterator[Row]:
    chosen = {} if drawn else {"sensor": "stereo", "camera_noise": False, "shape_errors": False}
    scene = world_scene(seed, JUDGING, frames=8, folder=folder, **chosen)  # type: ignore[arg-type]
    objects = scene.objects.objects
    for mode in modes:
        for mm, deg in FAULTS:
            single = mode != "lone" and (mm or deg)
            subjects = [[o] for o in objects[:_MOST_OBJECTS]] if single else [objects]
            for mine in subjects:
                start = time.process_time()
                faults = {o.id: fault_of(scene, o.id, mm, deg, seed) for o in mine}
                source = SceneLabels(scene, faults, cameras=mode == "set")
                count = len(scene.frames)
                step = count // _LONE_FRAMES if mode == "lone" else 1
                frames = [source.labels(i) for i in range(0, count, step)]
                found = [x for g in groups_of(frames)
                         for x in audited("world", g, source, CheckOptions()).labels]  # fmt: skip
                spent = (time.process_time() - start) / max(len(found), 1)
                names = {o.name for o in mine}
                for x in found:
                    if x.object in names:
                        m, m_low, m_high = numbers(x.error_mm)
                        d, d_low, d_high = numbers(x.error_deg)
                        yield Row(
                            seed, mode, x.object, x.material, mm, deg, x.verdict,
                            m, m_low, m_high, d, d_low, d_high, round(spent, 2),
                        )  # fmt: skip


def numbers(size: Size | None) -> tuple[float | None, float | None, float | None]:
    return (None, None, None) if size is None else (size.value, size.low, size.high)


def print_table(rows: list[Row]) -> None:
    heads = (
        "labels",
        "unknown",
        "refused",
        "wrong",
        "measured",
        "mm in",
        "deg in",
        "mm",
        "deg",
        "s",
    )
    print(f"{'mode':8}{'material':>10}{'fault':>16}" + "".join(f"{h:>9}" for h in heads))
    for mode in MODES:
        for opaque in (True, False):
            for mm, deg in FAULTS:
                fault = (mode, mm, deg, opaque)
                mine = [r for r in rows if (r.mode, r.fault_mm, r.fault_deg, r.is_opaque) == fault]
                if not mine:
                    continue
                known = [r for r in mine if r.is_measured]
                counts = (
                    len(mine),
                    sum(r.verdict == "unknown" for r in mine),
                    sum(r.verdict in REFUSED for r in mine),
                    sum(r.verdict == "wrong" for r in mine),
                    len(known),
                    sum(r.within("mm") for r in known),
                    sum(r.within("deg") for r in known),
                )
                sizes = [np.median([getattr(r, part) for r in known]) if known else np.nan
                         for part in ("mm", "deg")]  # fmt: skip
                spent = np.median([r.cpu_s for r in mine])
                kind, size = "opaque" if opaque else "other", f"{mm:g} mm, {deg:g} deg"
                print(f"{mode:8}{kind:>10}{size:>16}"
                      + "".join(f"{c:9}" for c in counts)
                      + "".join(f"{x:9.1f}" for x in (*sizes, spent)))  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[204, 210])
    parser.add_argument("--modes", nargs="+", choices=MODES, default=list(MODES))
    parser.add_argument("--drawn", action="store_true",
                        help="sensor, camera errors and shapes as drawn (no errors)")  # fmt: skip
    parser.add_argument("--csv", type=Path, help="all rows")
    parser.add_argument("--work", type=Path, help="folder that keeps the scenes")
    args = parser.parse_args()
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as temporary:
        for seed in args.seeds:
            for row in measure(seed, args.work or Path(temporary), args.modes, drawn=args.drawn):
                rows.append(row)
                if args.csv:
                    with args.csv.open("w", newline="") as file:
                        writer = csv.DictWriter(file, list(asdict(row)), lineterminator="\n")
                        writer.writeheader()
                        writer.writerows(map(asdict, rows))
    print_table(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
