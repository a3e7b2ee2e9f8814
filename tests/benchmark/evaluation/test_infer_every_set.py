"""From the list of frames to a verified score, with every reader of the field's sets.

The program of the test knows `frames.csv` alone: it fills holes of raw depth with their median.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.data.splits import open_split
from benchmark.evaluation.config import BenchJobs
from benchmark.evaluation.query_options import VerifyOptions
from benchmark.evaluation.results import TABLE
from benchmark.evaluation.verify import verify
from tests.benchmark.data import field_sets, todd_sets
from tests.benchmark.data.stereo_set import write_stereo_scene
from tests.benchmark.data.test_gn_trans_set import write_gn_trans
from tests.benchmark.data.test_phocal_set import write_phocal
from tests.benchmark.data.test_transpose_set import write_transpose

pytestmark = pytest.mark.slow
FULL, STRICT = "full-frame", "strict"

SETS: list[tuple[str, str, Callable[[Path], object]]] = [
    ("dreds-catknown-test", STRICT, lambda r: write_stereo_scene(r / "DREDS-CatKnown/test/00000")),
    ("hammer-d435-test", FULL, field_sets.write_hammer),
    ("clearpose-train", "clearpose", field_sets.write_clearpose),
    ("transcg-d435-test", "transcg", field_sets.write_transcg),
    ("transcg-l515-test", "transcg", field_sets.write_transcg),
    ("xyzibd-val-realsense", STRICT,
     lambda r: field_sets.write_bop_sensors(r / "xyzibd", "realsense")),
    ("ipd-val-photoneo", STRICT, lambda r: field_sets.write_bop_sensors(r / "ipd", "photoneo")),
    ("pace-test", STRICT, lambda r: field_sets.write_pace(r / "pace", "test", 0.001, 1)),
    ("housecat6d-test", STRICT, field_sets.write_housecat),
    ("phocal-test", STRICT, write_phocal),
    ("real275-test", STRICT, lambda r: field_sets.write_nocs(r, "Real", "test", pickled=True)),
    ("camera25-val", STRICT, lambda r: field_sets.write_nocs(r, "CAMERA", "val", pickled=True)),
    ("robi-ensenso", FULL, lambda r: field_sets.write_robi(r, "GT_Depth_Raw")),
    ("transpose-left-train", STRICT, write_transpose),
    ("todd-test", STRICT, todd_sets.write_todd),
    ("gn-trans-test-seen", FULL, write_gn_trans),
]  # fmt: skip


def restore(listed: Path) -> int:
    """What a program of another environment does; returns the number of frames."""
    with listed.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        color = cv2.imread(row["color"])
        raw = cv2.imread(row["raw"], cv2.IMREAD_UNCHANGED) * float(row["raw_unit_m"])
        assert color.shape[:2] == (int(row["height"]), int(row["width"])) and (raw > 0).any()
        Path(row["out"]).parent.mkdir(parents=True, exist_ok=True)
        np.save(row["out"], np.where(raw > 0, raw, np.median(raw[raw > 0])).astype(np.float32))
    return len(rows)


@pytest.mark.parametrize(("split", "protocol", "write"), SETS, ids=[s[0] for s in SETS])
def test_a_folder_of_a_program_is_scored_and_verified(
    tmp_path: Path, split: str, protocol: str, write: Callable[[Path], object]
) -> None:
    root, todo, out = tmp_path / "data", tmp_path / "todo", tmp_path / "results"
    root.mkdir()
    write(root)
    words = ["--data", str(root), "--split", split, "--engine", "serial"]
    assert main(["infer-list", *words, "--out", str(todo)]) == 0
    source = open_split(split, root)
    assert restore(todo / "frames.csv") == len(source)
    frame = source.load(0)
    with (todo / "frames.csv").open(newline="") as file:
        first = next(csv.DictReader(file))
    camera = frame.camera.resized(frame.color.shape[1], frame.color.shape[0])
    assert [float(first[k]) for k in ("fx", "fy", "cx", "cy")] == [
        camera.fx, camera.fy, camera.cx, camera.cy
    ]  # fmt: skip
    more = ["--no-gallery", "--no-speed", "--protocol", protocol, "--out", str(out)]
    assert main(["depth", "--method", f"mine={todo / 'predictions'}", *words, *more]) == 0
    table = pd.read_parquet(out / split / "mine" / protocol / TABLE)
    assert (table["error"] == "").all() and np.isfinite(table["rmse"]).any()
    jobs = BenchJobs(engine="serial", progress=False)
    (run,) = verify(VerifyOptions(results=(out,), data=(str(root),), jobs=jobs)).runs
    assert run.holds and run.grade == "recomputed", run.lines()
    assert any("equal to the last bit" in check.about for check in run.checks)
