"""How `std-bench audit` judges right labels and labels with known faults.

    python perf/label_audit.py --seeds 204 210 224 [--modes set labels lone] [--csv FILE]

Each seed is a scene of `sensors.synthetic.world_scene` of kinds that set no limit, read as a
published set: with the camera poses of the set, without them (they follow from the labels), or as
lone frames. One object at a time gets a fault; in lone frames, which are judged apart, all do.
Printed are, by mode and fault: labels, labels of which nothing is known, refused ones (doubtful or
wrong), and those whose true error lies in the stated interval.
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
from benchmark.evaluation.audit.rigid import groups_of
from sensors.synthetic.kinds import JUDGING
from sensors.synthetic.world_scene import world_scene
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene

MODES = ("set", "labels", "lone")
# mm and degrees; right labels first.
FAULTS = ((0.0, 0.0), (5.0, 0.0), (0.0, 3.0), (10.0, 0.0), (0.0, 8.0), (10.0, 8.0))
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
    def within(self) -> bool | None:
        """Whether both parts of the fault lie in the stated intervals."""
        if self.mm_low is None or self.mm_high is None:
            return None
        assert self.deg_low is not None and self.deg_high is not None
        # Printed bounds are rounded.
        far = self.mm_low - 0.01 <= self.fault_mm <= self.mm_high + 0.01
        return far and self.deg_low - 0.01 <= self.fault_deg <= self.deg_high + 0.01


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
                        a, b = x.error_mm, x.error_deg
                        yield Row(
                            seed, mode, x.object, x.material, mm, deg, x.verdict,
                            *((a.value, a.low, a.high) if a else (None,) * 3),
                            *((b.value, b.low, b.high) if b else (None,) * 3),
                            round(spent, 2),
                        )  # fmt: skip


def print_table(rows: list[Row]) -> None:
    print(f"{'mode':8}{'fault':>16}{'labels':>8}{'unknown':>9}{'refused':>9}{'wrong':>7}"
          f"{'measured':>10}{'within':>8}{'cpu s':>7}")  # fmt: skip
    for mode in MODES:
        for mm, deg in FAULTS:
            mine = [r for r in rows if (r.mode, r.fault_mm, r.fault_deg) == (mode, mm, deg)]
            if not mine:
                continue
            known = [r for r in mine if r.within is not None]
            refused = sum(r.verdict in ("doubtful", "wrong") for r in mine)
            wrong = sum(r.verdict == "wrong" for r in mine)
            unknown = sum(r.verdict == "unknown" for r in mine)
            inside = sum(bool(r.within) for r in known)
            cpu = np.median([r.cpu_s for r in mine])
            print(f"{mode:8}{f'{mm:g} mm, {deg:g} deg':>16}{len(mine):8}{unknown:9}{refused:9}"
                  f"{wrong:7}{len(known):10}{inside:8}{cpu:7.1f}")  # fmt: skip


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
