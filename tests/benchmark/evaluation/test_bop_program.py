"""A program on a BOP data set: images, views and default detections in, poses out; packed data."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from benchmark.cli.bench import main
from benchmark.evaluation.tasks.bop_program import read_detections
from benchmark.metrics.bop import open_bop
from std_toolkit.errors import ToolkitError
from tests.benchmark.metrics.bop.bop_set import BRICK, CAN, TRUTHS, write_bop

# Answers each detection with the true pose of its object; counts how often it ran.
PROGRAM = """
import csv, json, sys
from pathlib import Path
data, folder = Path(sys.argv[1]), Path(sys.argv[2])
(folder / "runs").open("a").write("x")
targets = json.loads((folder / "targets.json").read_text())
detections = json.loads((folder / "detections.json").read_text())
assert {(d["scene_id"], d["image_id"]) for d in detections} <= {
    (t["scene_id"], t["im_id"]) for t in targets}
with (folder / "results.csv").open("w", newline="") as file:
    rows = csv.writer(file)
    rows.writerow("scene_id im_id obj_id score R t time".split())
    for d in detections:
        gt = json.loads((data / f"test/{d['scene_id']:06d}/scene_gt.json").read_text())
        for g in gt[str(d["image_id"])]:
            if g["obj_id"] == d["category_id"]:
                R, t = (" ".join(map(str, g[k])) for k in ("cam_R_m2c", "cam_t_m2c"))
                rows.writerow([d["scene_id"], d["image_id"], g["obj_id"], d["score"], R, t, 0.2])
"""


def detections(path: Path, *, extra: bool = True) -> Path:
    """Of the can in both images; with masks; one of another scene."""
    rows = [
        {"scene_id": 2, "image_id": i, "category_id": CAN, "score": 0.9 - 0.1 * i,
         "bbox": [10, 20, 30.5, 40], "segmentation": {"counts": [0, 5], "size": [240, 320]},
         "time": 0.1}
        for i in TRUTHS
    ]  # fmt: skip
    if extra:
        rows.append(rows[0] | {"scene_id": 9})
    path.write_text(json.dumps(rows))
    return path


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_bop(tmp_path / "set")


def bench(root: Path, *more: str) -> list[str]:
    words = ["bop", "--data", str(root), "--errors", "mssd", "mspd", "--engine", "serial"]
    return [*words, "--out", str(root.parent / "out"), *more]


def program(tmp_path: Path, text: str = PROGRAM) -> str:
    path = tmp_path / "poses.py"
    path.write_text(text)
    return f"mine={sys.executable} {path} {{data}} {{folder}}"


def test_it_gets_the_detections_of_the_scored_images(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--program", program(tmp_path), "--detections", str(detections(tmp_path / "d.json"))]
    assert main(bench(root, *given, "--json")) == 0
    said = capsys.readouterr()
    (record,) = json.loads(said.out)
    assert "2 of 3 detections are of the 2 images" in said.err
    assert record["results"] == "mine_set-test"
    # The can is found in both images; nobody detected the brick.
    assert record["scores"]["bop25_mAP"] == pytest.approx(0.5)
    assert record["scores"]["bop25_mAP_mm"] == pytest.approx(0.5)
    assert record["seconds_per_image"] == 0.2
    folder = tmp_path / "out/bop/programs/mine_set-test"
    handed = json.loads((folder / "detections.json").read_text())
    assert len(handed) == 2 and handed[0]["segmentation"]["size"] == [240, 320]
    # The same again runs nothing; other detections run it again.
    assert main(bench(root, *given)) == 0
    assert (folder / "runs").read_text() == "x"
    detections(tmp_path / "d.json", extra=False)
    main(bench(root, *given))
    assert (folder / "runs").read_text() == "xx"
    depth = next(root.rglob("depth/000003.png"))
    depth.write_bytes(depth.with_name("000004.png").read_bytes())
    main(bench(root, *given))
    assert (folder / "runs").read_text() == "xxx", "another image"


def test_views_that_belong_together_are_named(root: Path, tmp_path: Path) -> None:
    targets = [{"scene_id": 2, "im_id": [4, 3]}, {"scene_id": 2, "im_id": [4]}]
    (root / "test_targets_multiview_bop25.json").write_text(json.dumps(targets))
    given = ["--program", program(tmp_path), "--detections", str(detections(tmp_path / "d.json"))]
    assert main(bench(root, *given, "--multi-view")) == 0
    folder = tmp_path / "out/bop/programs/mine_set-test"
    assert json.loads((folder / "groups.json").read_text()) == targets
    assert (tmp_path / "out/bop/set/test-multiview/mine_set-test/bop.json").is_file()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--program", "mine"], "must be NAME=COMMAND"),
        (["--program", "mi ne=true"], "must be NAME=COMMAND"),
        (["--program", "mine="], "needs a command"),
        (["--program", "mine='"], "not a command"),
        (["--program", "mine=/no/such/program"], "no such program"),
        (["--program", "mine=true"], "wrote no results.csv"),
        (["--program", "mine=false"], "ended with status 1"),
        (
            ["--program", "mine=sh -c 'sleep 30 # {folder}'", "--timeout-s", "0.2"],
            "took longer than 0.2 s",
        ),
        ([], "needs at least one value"),
        (["--detections", "d.json"], "needs at least one value"),
        (["--results", "x.csv", "--detections", "d.json"], "belongs to --program"),
    ],
)
def test_wrong_programs_are_refused_in_one_line(
    root: Path, capsys: pytest.CaptureFixture[str], words: list[str], told: str
) -> None:
    assert main(bench(root, *words)) != 0
    text = capsys.readouterr().err
    assert told in text and "Traceback" not in text


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"bbox": [1, 2, 3]}, r"\[0\]\.bbox"),
        ({"bbox": [1, 2, 0, 4]}, r"\[0\]\.bbox.*width and a height|width and a height"),
        ({"category_id": -1}, r"\[0\]\.category_id"),
        ({"score": "high"}, r"\[0\]\.score"),
        ({"image_id": None}, r"\[0\]\.image_id"),
    ],
)
def test_wrong_detections_are_refused(tmp_path: Path, change: dict[str, object], told: str) -> None:
    path = detections(tmp_path / "d.json")
    rows = json.loads(path.read_text())
    path.write_text(json.dumps([rows[0] | change]))
    with pytest.raises(ToolkitError, match=told):
        read_detections(path)


def test_detections_of_other_data_are_refused(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = detections(tmp_path / "d.json")
    path.write_text(json.dumps([json.loads(path.read_text())[2]]))
    given = ["--program", program(tmp_path), "--detections", str(path)]
    assert main(bench(root, *given)) != 0
    assert "no detection is of an image that is scored" in capsys.readouterr().err


def test_image_wise_data_are_scored_as_folders(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same figures, whichever form the images have."""
    results = tmp_path / "all_set-test.csv"
    dataset = open_bop(root)
    lines = ["scene_id,im_id,obj_id,score,R,t,time"]
    for image, rows in TRUTHS.items():
        for number, T in rows[:2]:
            R, t = (" ".join(map(str, a)) for a in (T.R.ravel(), 1000 * T.t + 3))
            lines.append(f"2,{image},{number},0.5,{R},{t},-1")
    results.write_text("\n".join(lines))
    assert main([*bench(root, "--results", str(results)), "--json"]) == 0
    (wanted,) = json.loads(capsys.readouterr().out)
    scene = root / "test" / "000002"
    flat = tmp_path / "flat" / "set" / "test"
    flat.mkdir(parents=True)
    for name, part in (
        ("scene_gt", "gt"),
        ("scene_gt_info", "gt_info"),
        ("scene_camera", "camera"),
    ):
        for image, row in json.loads((scene / f"{name}.json").read_text()).items():
            (flat / f"000002_{int(image):06d}.{part}.json").write_text(json.dumps(row))
    for path in (scene / "depth").iterdir():
        (flat / f"000002_{path.stem}.depth.png").write_bytes(path.read_bytes())
    (root / "models").rename(flat.parent / "models")
    (root / "test_targets_bop19.json").rename(flat.parent / "test_targets_bop19.json")
    words = bench(flat.parent, "--results", str(results), "--json")
    assert main(words) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert found["scores"] == wanted["scores"] and BRICK in [o["obj_id"] for o in found["objects"]]
    assert 0 < found["scores"]["bop25_mAP_mm"] < 1
    assert dataset.root == root
    assert main(words) == 0, "the same again resumes"
