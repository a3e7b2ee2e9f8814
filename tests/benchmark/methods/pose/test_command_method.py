"""Pose methods that are programs: what they are given, what they answer, how they fail."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmark.cli.bench import main
from benchmark.methods.protocol import PoseView
from benchmark.methods.registry import MethodOptions, make_pose_method
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from tests.benchmark.evaluation.pose_set import SPLIT, write_pose_split

# Where the measured points are, seen as a bottle. What the program is given is BOP's layout.
PROGRAM = """
import json, sys
from pathlib import Path
import cv2, numpy as np
folder = Path(sys.argv[-1])
assert (folder / "models/obj_000001.ply").is_file()
assert (folder / "models/models_info.json").is_file()
scene = folder / "test/000001"
cameras = json.loads((scene / "scene_camera.json").read_text())
lines = ["scene_id,im_id,obj_id,score,R,t,time"]
for target in json.loads((folder / "test_targets_bop24.json").read_text()):
    number = target["im_id"]
    camera = cameras[str(number)]
    depth = cv2.imread(str(scene / f"depth/{number:06d}.png"), -1) * camera["depth_scale"]
    color = cv2.imread(str(scene / f"rgb/{number:06d}.png"))
    assert color.shape[:2] == depth.shape
    v, u = np.nonzero(depth)
    if len(u) == 0:
        continue
    K, z = np.reshape(camera["cam_K"], (3, 3)), depth[v, u]
    t = [((u - K[0, 2]) * z / K[0, 0]).mean(), ((v - K[1, 2]) * z / K[1, 1]).mean(), z.mean()]
    lines.append(f"1,{number},1,0.5,1 0 0 0 1 0 0 0 1,{t[0]} {t[1]} {t[2]},-1")
(folder / "results.csv").write_text("\\n".join(lines))
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bottle 8 x 20 x 8 cm whose frame is not in its middle, and a box of no class."""
    root = tmp_path_factory.mktemp("data")
    (root / "models").mkdir()
    for number, sides in ((1, (80, 200, 80)), (2, (50, 50, 50))):
        mesh = trimesh.creation.box(sides)
        mesh.apply_translation((0, 100, 0))
        mesh.export(root / "models" / f"obj_{number:06d}.ply")
    (root / "models" / "models_info.json").write_text("{}")
    info = {"objects": [{"obj_id": 1, "category": "bottle"}, {"obj_id": 2, "category": "other"}]}
    (root / "dataset_info.json").write_text(json.dumps(info))
    return root


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("program") / "my method.py"
    path.write_text(PROGRAM)
    return path


def view(depth_m: float) -> PoseView:
    camera = Camera(64, 48, 60, 60, 31.5, 23.5)
    depth = np.zeros((48, 64), np.float32)
    depth[20:28, 40:48] = depth_m
    return PoseView(np.zeros((48, 64, 3), np.uint8), depth + 1, depth, camera)


def command(*words: object, **settings: object):
    text = "command:" + " ".join(f"'{word}'" for word in words)
    return make_pose_method(text, MethodOptions(settings={k: str(v) for k, v in settings.items()}))


def test_frames_in_poses_out(data: Path, program: Path) -> None:
    method = command(sys.executable, program, data=data, fit="paper")
    near, none, far = method.estimate([view(0.5), view(0.0), view(0.8)])
    assert [len(e.prediction.class_ids) for e in (near, none, far)] == [1, 0, 1]
    assert near.prediction.class_ids.tolist() == [1] and near.prediction.scores.tolist() == [0.5]
    sides = np.array([0.08, 0.2, 0.08])
    diagonal = np.linalg.norm(sides)
    np.testing.assert_allclose(near.prediction.sizes[0], sides / diagonal, atol=1e-9)
    for found, z in ((near, 0.5), (far, 0.8)):
        RT = found.prediction.RT[0]
        np.testing.assert_allclose(RT[:3, :3], diagonal * np.eye(3), atol=1e-9)
        # The box's centre: 10 cm along y from the model's origin.
        np.testing.assert_allclose(RT[:3, 3], [z * 12 / 60, 0.1, z], atol=1e-4)


@pytest.mark.parametrize(
    ("code", "problem"),
    [
        ("import sys; sys.exit('no weights here')", "status 1: no weights here"),
        ("pass", "wrote no results.csv"),
        ("open(F, 'w').write('1,0,9,1,1 0 0 0 1 0 0 0 1,0 0 500,-1')", "obj_id 9, im_id 0"),
        ("open(F, 'w').write('1,5,1,1,1 0 0 0 1 0 0 0 1,0 0 500,-1')", "obj_id 1, im_id 5"),
        ("open(F, 'w').write('nothing')", "needs 7 fields"),
        ("import time; time.sleep(60)", "longer than 2 s"),
    ],
)
def test_what_programs_get_wrong(code: str, problem: str, data: Path, tmp_path: Path) -> None:
    path = tmp_path / "bad.py"
    path.write_text(f"import sys; F = sys.argv[-1] + '/results.csv'\n{code}")
    with pytest.raises(ToolkitError) as caught:
        command(sys.executable, path, "{folder}", data=data, timeout_s=2).estimate([view(0.5)])
    assert problem in str(caught.value)


def test_what_users_get_wrong(data: Path, tmp_path: Path) -> None:
    for words, settings, problem in (
        ((), {"data": data}, "needs a program"),
        (("x",), {}, "needs the models"),
        (("x",), {"data": tmp_path}, "no models"),
        (("x",), {"data": data, "classes": "1"}, "class of the model"),
        (("x",), {"data": data, "color": "red"}, "no such setting"),
    ):
        with pytest.raises(ToolkitError, match=problem):
            command(*words, **settings)
    with pytest.raises(ToolkitError, match="not a command"):
        make_pose_method("command:'x", MethodOptions())
    with pytest.raises(ToolkitError, match="no such program"):
        command(tmp_path / "absent", data=data).estimate([view(0.5)])


@pytest.mark.slow
def test_rows_of_raw_and_true_depth(
    data: Path, program: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = write_pose_split(tmp_path / "dreds", scenes=1, frames=1)
    words = ["pose", "--method", f"command:{sys.executable} '{program}' {{folder}}"]
    words += ["--set", f"data={data}", "--depth", "raw", "gt", "--data", str(root)]
    words += ["--split", SPLIT, "--out", str(tmp_path / "out"), "--engine", "serial"]
    assert main([*words, "--no-gallery", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    names = {(row["method"], row["depth"]) for row in rows}
    assert names == {(f"command.{Path(sys.executable).name}", d) for d in ("raw", "gt")}
    assert main([*words, "--no-gallery", "--label", "centre"]) == 0
    assert "centre" in capsys.readouterr().out


def test_a_program_ends_with_all_that_it_started(data: Path, tmp_path: Path) -> None:
    file = tmp_path / "child"
    path = tmp_path / "starts.py"
    path.write_text(
        "import subprocess, sys, time\n"
        "child = subprocess.Popen(['sleep', '300'])\n"
        f"open({str(file)!r}, 'w').write(str(child.pid))\n"
        "sys.stdout.write('x' * 10**7)\n"  # a pipe would be full
        "time.sleep(300)\n"
    )
    with pytest.raises(ToolkitError, match="took longer than 2 s"):
        command(sys.executable, path, "{folder}", data=data, timeout_s=2).estimate([view(0.5)])
    status = Path(f"/proc/{file.read_text()}/status")
    assert not status.exists() or "State:\tZ" in status.read_text()


def test_a_container_is_named(data: Path, tmp_path: Path) -> None:
    docker = tmp_path / "docker"
    docker.write_text("#!/bin/sh\nsleep 60\n")
    docker.chmod(0o755)
    with pytest.raises(ToolkitError, match=f"its container may still run: see `{docker} ps`"):
        command(docker, "run", "{folder}", data=data, timeout_s=1).estimate([view(0.5)])
