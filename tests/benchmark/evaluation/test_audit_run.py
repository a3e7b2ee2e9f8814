"""`std-bench audit` on sets without images: labels against each other, and what the page says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.cli.report import main as report
from benchmark.evaluation.audit.record import Audit
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.io.documents import read_document
from tests.benchmark.bop_on_disk import write_bop


def pose(x: float, y: float = 0.0) -> SE3:
    return SE3(np.eye(3), np.array([x, y, 0.8]))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Six images of two boxes; in one they reach 20 mm into each other, in one both are apart."""
    rows = {i: [(1, pose(-0.1)), (2, pose(0.1))] for i in range(6)}
    rows[2] = [(1, pose(0.0)), (2, pose(0.04))]
    found = write_bop(tmp_path / "set <b>", rows)
    path = found / "test/000001/scene_gt.json"
    gt = json.loads(path.read_text())
    rough = np.eye(3) + np.array([[0.0, 0.002, 0], [0.002, 0, 0], [0, 0, 0]])
    gt["4"][0]["cam_R_m2c"] = rough.ravel().tolist()
    path.write_text(json.dumps(gt))
    return found


def run(root: Path, out: Path, *words: str) -> int:
    return main(["audit", str(root), "--out", str(out), "--engine", "serial", *words])


def test_labels_without_images(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run(root, out) == 0
    said = capsys.readouterr().out
    audit = read_document(out / "audit.json", Audit)
    assert len(audit.labels) == 12
    # How deep two labels may touch is the judge's; what is deeper than that is told.
    assert audit.counts() == {"fits": 0, "unknown": 12, "doubtful": 0, "wrong": 0}
    deep = {x.frame: x.overlap_mm for x in audit.labels if x.overlap_mm is not None}
    assert deep == {"000002": pytest.approx(20, abs=0.5)}
    told = [(d.frame, d.what.split(" mm into ")[0]) for d in audit.disagreements]
    assert told == [("000002", f"reaches {deep['000002']:.1f}")] * 2
    # Nothing that was not measured has a size.
    assert all(x.error_mm is None and x.error_deg is None for x in audit.labels)
    assert "no image shows it" in audit.labels[0].reason
    (scene,) = audit.scenes
    assert (scene.rough, scene.rough_most) == (1, pytest.approx(0.004, abs=1e-4))
    assert scene.without_images == 6
    assert any("12 of 12 labels: nothing says" in text for text in audit.unseen)
    assert "12 labels judged: 0 wrong" in said
    table = pd.read_csv(out / "audit_labels.csv")
    assert list(table["overlap_mm"].dropna().round()) == [20, 20]
    assert table["error_mm_low"].isna().all()
    objects = pd.read_csv(out / "audit_objects.csv")
    assert list(objects["labels"]) == [6, 6]
    assert list(objects["measured"]) == [0, 0]
    frames = pd.read_csv(out / "audit_frames.csv", dtype=str)
    assert list(frames["frame"]) == ["000002", "000002"]
    page = (out / "report.html").read_text()
    assert "What this audit cannot see" in page
    assert "Labels of set _b_" in page
    assert "set <b>" not in page


def test_the_page_is_made_by_the_report_of_all_results(root: Path, tmp_path: Path) -> None:
    assert run(root, tmp_path / "out", "--name", "my set", "--frames", "2") == 0
    before = (tmp_path / "out" / "report.html").read_bytes()
    assert report([str(tmp_path / "out"), "--out", str(tmp_path / "page")]) == 0
    assert (tmp_path / "page" / "report.html").read_bytes() == before
    assert "my set" in before.decode()
    rows = pd.read_csv(tmp_path / "page" / "labels.csv")
    assert set(rows["frame"].astype(str).str.zfill(6)) == {"000001", "000004"}
    audit = read_document(tmp_path / "out" / "audit.json", Audit)
    assert "4 of 6 frames were not read (--frames)." in audit.unseen


def test_a_label_that_leaves_its_place_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a scene that stands still, without images: 6 mm and 3 deg in one frame of eight."""
    rows = {}
    off = SE3(so3_exp([0, np.deg2rad(3.0), 0]), np.array([0.006, 0, 0]))
    for i in range(8):
        camera = SE3(so3_exp([0, 0.1 * i, 0]), np.array([0.0, 0, 0]))
        centre = SE3(np.eye(3), np.array([0, 0, 0.8]))
        T = centre @ camera
        placed = [(1, T @ SE3(np.eye(3), np.array([x, 0, 0]))) for x in (-0.15, 0.15)]
        placed.append((2, T @ SE3(np.eye(3), np.array([0, 0.15, 0]))))
        if i == 5:
            placed[2] = (2, placed[2][1] @ off)
        rows[i] = placed
    root = write_bop(tmp_path / "still", rows)
    assert run(root, tmp_path / "out") == 0
    audit = read_document(tmp_path / "out" / "audit.json", Audit)
    (scene,) = audit.scenes
    assert (scene.cameras, scene.alone) == ("from the labels", 0)
    assert scene.off_mm == pytest.approx(0, abs=0.01)
    assert scene.off_most_mm == pytest.approx(6, abs=0.05)
    assert scene.off_most_deg == pytest.approx(3, abs=0.05)
    (found,) = audit.disagreements
    assert (found.frame, found.object) == ("000005", "obj_000002_1")
    assert found.what == "6.0 mm and 3.0 deg from its other frames: it is off, or was moved"
    assert [x.frame for x in audit.labels] == [""] * 3
    capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scene", "000009"], "no such scene in this set"),
        (["--split", "std-catnovel"], "std-catnovel"),
        (["--models", "nowhere"], "the models of the set are missing"),
        (["--frames", "0"], "frames"),
    ],
)
def test_one_line_says_what_is_wrong(
    root: Path, tmp_path: Path, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(root, tmp_path / "out", *words) != 0
    lines = [x for x in capsys.readouterr().err.splitlines() if "error" in x.lower()]
    assert len(lines) == 1
    assert said in lines[0]
    assert not (tmp_path / "out" / "audit.json").exists()


def test_a_damaged_document_names_its_file(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (root / "test/000001/scene_gt.json").write_text("{")
    assert run(root, tmp_path / "out") != 0
    assert "scene_gt.json" in capsys.readouterr().err


def test_a_mesh_that_is_missing_is_said(root: Path, tmp_path: Path) -> None:
    (root / "models/obj_000002.ply").unlink()
    assert run(root, tmp_path / "out") == 0
    audit = read_document(tmp_path / "out" / "audit.json", Audit)
    assert {x.object for x in audit.labels} == {"obj_000001_1"}
    assert any("1 objects have no mesh here" in text for text in audit.unseen)
