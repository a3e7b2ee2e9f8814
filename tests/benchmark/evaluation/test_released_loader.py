"""`--released-loader`: frames as the authors' loader gives them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.data.frame import BACKGROUND
from benchmark.data.loading import read_id_mask
from benchmark.evaluation.config import DepthConfig
from benchmark.evaluation.engine import run_task
from benchmark.evaluation.tasks.depth import Run
from benchmark.methods.registry import MethodOptions
from benchmark.report.parts.depth_tables import run_table
from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import write_exr
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.pose_set import SPLIT, write_pose_split


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pose_split(tmp_path_factory.mktemp("data"), scenes=1, frames=5, cad=False)


def a_run(root: Path, out: Path, batch: int | None) -> Run:
    return Run(
        split=SPLIT, root=root, method="raw", options=MethodOptions(), protocol="paper",
        label="raw", out=out, released_loader=batch,
    )  # fmt: skip


def test_half_precision_truncates_every_second_id(tmp_path: Path) -> None:
    ids = np.arange(255, dtype=np.float64).reshape(15, 17)
    write_exr(tmp_path / "mask.exr", {"R": (ids / 255).astype(np.float16)})
    assert (read_id_mask(tmp_path / "mask.exr") == ids).all()
    wrong = read_id_mask(tmp_path / "mask.exr", truncated=True)
    stored = (ids / 255).astype(np.float16).astype(np.float64) * 255
    assert (wrong == np.floor(stored)).all()
    assert 100 < (wrong != ids).sum() < 155


def test_ids_and_the_last_batch(root: Path, tmp_path: Path) -> None:
    exact, released = a_run(root, tmp_path, None), a_run(root, tmp_path, 2)
    data, truncated = exact.open(), released.open()
    assert exact.chosen(data) == [0, 1, 2, 3, 4] and released.chosen(truncated) == [0, 1, 2, 3]
    # Masks in half precision: the pixels of id 3 become those of id 2, those of 0 stay.
    for path in (root / "DREDS-CatKnown" / "test" / "1").glob("*_mask.exr"):
        mask = read_id_mask(path)
        write_exr(path, {"R": (mask / 255.0).astype(np.float16)})
    known = {i.mask_id for i in data.load(0).instances}
    one, other = data.load(0).mask, truncated.load(0).mask
    expected = np.floor((one / 255.0).astype(np.float16).astype(np.float64) * 255).astype(np.uint8)
    expected[~np.isin(expected, list(known))] = BACKGROUND
    assert (other == expected).all() and (other != one).any()
    assert released.manifest(truncated, released.make()).setup.released_loader == 2
    with pytest.raises(ToolkitError, match="fewer frames than a batch"):
        replace(released, released_loader=6).check(truncated)


def test_the_report_says_so(root: Path, tmp_path: Path) -> None:
    run = a_run(root, tmp_path, 2)
    run_task(run, JobOptions(engine="serial"))
    assert "authors' loader, batches of 2" in run_table([run.read()]).terminal()


def test_it_is_for_the_paper_protocol_alone() -> None:
    options = {"out": Path("x"), "methods": ("raw",), "splits": (SPLIT,), "data": ("y",)}
    assert DepthConfig(**options, protocols=("paper",), released_loader=4).released_loader == 4
    with pytest.raises(ToolkitError, match="protocol paper alone"):
        DepthConfig(**options, released_loader=4)
