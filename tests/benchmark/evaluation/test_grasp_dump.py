"""`std-bench grasp --dump`: grasps in GraspNet's files, scored on scenes in its layout."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh

from benchmark.cli.bench import main
from benchmark.cli.report import main as report
from benchmark.metrics.grasp.grasp import Grasps, write_grasps
from std_toolkit.geometry.se3 import SE3

ZOOM = 0.6  # metres from the camera to the table


def write_scene(root: Path, scene: int, poses: dict[int, SE3], T_cam_table: SE3) -> None:
    """A scene of one image; poses are T_cam_model by object number."""
    folder = root / "scenes" / f"scene_{scene:04d}" / "realsense"
    (folder / "annotations").mkdir(parents=True)
    np.save(folder / "cam0_wrt_table.npy", T_cam_table.inverse().matrix())
    np.save(folder / "camera_poses.npy", np.eye(4)[None])
    rows = ""
    for number, T in poses.items():
        t, q = (" ".join(repr(float(x)) for x in v) for v in (T.t, T.quat()))
        rows += (
            f"<obj><obj_id>{number}</obj_id><obj_name/><obj_path/><pos_in_world>{t}</pos_in_world>"
            f"<ori_in_world>{q}</ori_in_world></obj>"
        )
    (folder / "annotations" / "0000.xml").write_text(f"<scene>{rows}</scene>")


def write_model(root: Path, number: int, mesh: trimesh.Trimesh, points: np.ndarray) -> None:
    folder = root / "models" / f"{number:03d}"
    folder.mkdir(parents=True)
    mesh.export(folder / "textured.obj", digits=17)
    # The scan: its vertices matter, and any faces.
    faces = np.arange(len(points) // 3 * 3).reshape(-1, 3)
    scan = trimesh.Trimesh(points, faces, process=False)
    data = scan.export(file_type="ply", encoding="ascii")
    (folder / "nontextured.ply").write_bytes(data.encode() if isinstance(data, str) else data)


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, list[dict], str]:
    capsys.readouterr()
    status = main(["grasp", *map(str, words), "--json", "--engine", "serial"])
    told = capsys.readouterr()
    return status, json.loads(told.out or "[]"), told.err


@pytest.mark.slow
def test_a_dump_scores_as_in_graspnetapi(
    test_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = test_data.parent / "reference" / "graspnet_oracle_lumpy.npz"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    known = np.load(path)
    root, dump = tmp_path / "graspnet", tmp_path / "mine"
    poses = {k: SE3.from_matrix(known["poses"][k]) for k in range(3)}
    write_scene(root, 100, poses, SE3.from_matrix(known["table"]))
    for k in range(3):
        mesh = trimesh.Trimesh(known[f"vertices_{k}"], known[f"faces_{k}"], process=False)
        write_model(root, k, mesh, known[f"points_{k}"])
    write_grasps(dump / "scene_0100/realsense/0000.npy", Grasps.from_array(known["grasps"]))
    words = ("--dump", dump, "--data", root, "--out", tmp_path / "out", "--contacts", "sdf")
    status, (row,), _ = run(capsys, *words)
    assert status == 0
    assert row["ap"][0] == pytest.approx(float(known["ap"]), abs=1e-6)
    assert row["seen"] == row["ap"] and row["novel"] is None
    assert (row["label"], row["images"], row["contacts"]) == ("mine", 1, "sdf")


def two_scenes(root: Path) -> None:
    """A box alone on a table, seen from above, in a seen and a novel scene."""
    box = trimesh.creation.box((0.04, 0.04, 0.08))
    write_model(root, 7, box, trimesh.sample.sample_surface(box, 3000, seed=0)[0])
    down = SE3(np.diag([1.0, -1.0, -1.0]), np.array([0, 0, ZOOM]))
    for scene in (100, 165):
        pose = down @ SE3(np.eye(3), np.array([0, 0, 0.04]))
        write_scene(root, scene, {7: pose}, down)


def from_above(x: float) -> Grasps:
    """A grasp of the box, in the camera's frame."""
    R = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
    R = np.diag([1.0, -1, -1]) @ R
    return Grasps.make(R[None], [[x, 0, ZOOM - 0.08]], widths=0.06, depths=0.03, scores=1.0)


@pytest.mark.slow
def test_scenes_parts_and_missing_images(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root, dump = tmp_path / "graspnet", tmp_path / "mine"
    two_scenes(root)
    write_grasps(dump / "scene_0100/realsense/0000.npy", from_above(0.0))
    words = ("--dump", dump, "--data", root, "--out", tmp_path / "out")
    status, (row,), told = run(capsys, *words)
    # One of two images has no file: it is listed, and counts as nothing found.
    assert status == 1 and "scene_0165" in told
    assert (row["images"], row["unanswered"]) == (2, 1) and row["novel"][0] == 0
    # One grasp that holds: 1/1, 1/2, ... 1/50.
    alone = 100 * np.mean(1 / np.arange(1, 51))
    assert row["seen"][0] == pytest.approx(alone)
    assert row["ap"][0] == pytest.approx(alone / 2)
    write_grasps(dump / "scene_0165/realsense/0000.npy", from_above(0.0))
    status, (row,), _ = run(capsys, *words)
    assert status == 0 and row["novel"][0] == pytest.approx(alone)
    write_grasps(dump / "scene_0165/realsense/0000.npy", from_above(0.2))
    status, (row,), _ = run(capsys, *words)  # goes on where it was
    assert status == 0 and row["images"] == 2
    assert row["novel"][0] == 0 and row["ap"][0] == pytest.approx(alone / 2)
    status, (row,), _ = run(capsys, *words, "--graspnet-split", "novel", "--label", "other")
    assert row["label"] == "other" and row["images"] == 1


@pytest.mark.slow
def test_dumps_stand_on_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root, out = tmp_path / "graspnet", tmp_path / "out"
    two_scenes(root)
    for name, x in (("good", 0.0), ("far", 0.2), ("half", 0.0)):
        write_grasps(tmp_path / name / "scene_0100/realsense/0000.npy", from_above(x))
        if name != "half":
            write_grasps(tmp_path / name / "scene_0165/realsense/0000.npy", from_above(x))
        if name == "good":
            said = {"training_data": "GraspNet, kinect", "citation": "@misc{good}"}
            (tmp_path / name / "submission.json").write_text(json.dumps(said))
        run(capsys, "--dump", tmp_path / name, "--data", root, "--out", out)
    assert report([str(out)]) == 0
    text = capsys.readouterr().out
    rows = [line.split() for line in text.splitlines() if line.startswith(("good", "far", "half"))]
    assert [row[0] for row in rows] == ["good", "far", "half"]  # ranked ones, then those that lack
    assert "(1 unanswered)" in next(line for line in text.splitlines() if line.startswith("half"))
    page = (out / "report.html").read_text()
    assert "GraspNet test, realsense, exact contacts: 2 images" in page
    assert "Highest AP: good" in page
    assert "exact contacts, trained on GraspNet, kinect" in page
    assert "@misc{good}" in (out / "citations.bib").read_text()
    table = pd.read_csv(out / "graspnet.csv")
    alone = np.mean(1 / np.arange(1, 51))
    assert table.set_index("grasps").loc["good", "ap"] == pytest.approx(alone)
    assert table.set_index("grasps").loc["half", "ap"] == pytest.approx(alone / 2)


@pytest.mark.slow
def test_arrays_of_anygrasp(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """float32, without a folder of the camera."""
    root, dump = tmp_path / "graspnet", tmp_path / "any"
    two_scenes(root)
    for scene in (100, 165):
        (dump / f"scene_0{scene}").mkdir(parents=True)
        grasps = from_above(0.0).to_array().astype(np.float32)
        np.save(dump / f"scene_0{scene}/0000.npy", grasps)
    words = ("--dump", dump, "--data", root, "--out", tmp_path / "out")
    status, (row,), _ = run(capsys, *words)
    assert status == 0 and row["unanswered"] == 0
    assert row["ap"][0] == pytest.approx(100 * np.mean(1 / np.arange(1, 51)))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--dump", "mine"], "--data"),
        (["--dump", "nowhere", "--data", "graspnet"], "folder of grasps"),
        (["--dump", "mine", "--data", "graspnet", "--graspnet-split", "similar"], "no annotated"),
        (["--dump", "mine", "--data", "mine"], "not a GraspNet-1Billion folder"),
        (["--data", "graspnet"], "--dump"),
        (["--dump", "mine", "--data", "graspnet", "--label", "a/b"], "folder's name"),
    ],
)
def test_wrong_input_is_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    told: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    write_scene(tmp_path / "graspnet", 100, {7: SE3.identity()}, SE3.identity())
    status, rows, error = run(capsys, *words, "--out", "out")
    assert status == (2 if "--label" in words else 1) and not rows
    lines = [line for line in error.splitlines() if line.startswith("error")]
    assert len(lines) == 1 and told in lines[0]
