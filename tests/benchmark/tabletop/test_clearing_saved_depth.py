"""`--save-views` and `--depth NAME=DIR`: depth that another program restores, view by view."""

import numpy as np
import pandas as pd
import pytest
import trimesh

from benchmark.cli.bench import main
from benchmark.data.frame import BACKGROUND, DepthFrame
from benchmark.data.identity import answers_digest
from benchmark.evaluation.depth_choice import DepthChoice
from benchmark.evaluation.renewal import renew
from benchmark.evaluation.results import read_known
from benchmark.evaluation.tasks.grasp import GraspRun
from benchmark.evaluation.tasks.grasp_inputs import Methods
from benchmark.evaluation.tasks.grasp_table import ATTEMPTS
from benchmark.methods.registry import MethodOptions
from benchmark.tabletop.saved_views import check_saved_depth, named_view, save_view
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.exr import read_exr, write_exr
from std_toolkit.scene.scene import Scene
from tests.benchmark.tabletop.clearing_cases import CAMERA

SIZE = (CAMERA.height, CAMERA.width)


def a_view(depth=0.5, scene="round-0000"):
    maps = np.full(SIZE, depth, np.float32)
    mask, color = np.full(SIZE, BACKGROUND, np.uint8), np.full((*SIZE, 3), 90, np.uint8)
    frame = DepthFrame("table", "00", color, maps, maps, mask, CAMERA, ())
    return named_view(frame, scene)


def test_views_are_scenes_that_grow(tmp_path):
    first, second = a_view(0.5), a_view(0.6)
    assert first.name != second.name and first.name.startswith("00-")
    T = SE3(np.eye(3), np.array([0.0, 0.1, 0.5]))
    for view in (first, second, first):
        save_view(tmp_path, view, T)
    scene = Scene.open(tmp_path / "round-0000")
    assert [f.name for f in scene.frames] == [first.name, second.name]
    np.testing.assert_array_equal(scene.read_depth(scene.frames[1]), second.depth_raw)
    np.testing.assert_array_equal(scene.read_color(scene.frames[0]), first.color)
    assert scene.camera(scene.frames[0]) == CAMERA
    assert scene.poses is not None and len(scene.poses.frames) == 2
    assert not (tmp_path / "round-0000" / "reference").exists()


def test_depth_of_another_state_or_size_is_refused(tmp_path):
    view, other = a_view(0.5), a_view(0.6)
    path = tmp_path / "round-0000" / f"{view.name}_depth.exr"
    with pytest.raises(ToolkitError, match="no saved depth of this view"):
        check_saved_depth(path, tmp_path, view)
    write_exr(path.with_name(f"{other.name}_depth.exr"), {"Y": other.depth_raw})
    with pytest.raises(ToolkitError, match="another state of the table"):
        check_saved_depth(path, tmp_path, view)
    write_exr(path, {"Y": view.depth_raw[::2, ::2]})
    with pytest.raises(ToolkitError, match=r"another size than the view.*106x60.*212x120"):
        check_saved_depth(path, tmp_path, view)
    write_exr(path, {"Y": view.depth_raw})
    check_saved_depth(path, tmp_path, view)


def test_the_planner_gets_the_saved_depth(tmp_path):
    view = a_view()
    methods = Methods(DepthChoice(name="mine", folder=tmp_path), "oracle", MethodOptions())
    with pytest.raises(ToolkitError, match="no saved depth"):
        methods.given(view)
    depth = np.full(SIZE, 0.4, np.float32)
    depth[0], depth[1] = np.nan, -1
    write_exr(tmp_path / "round-0000" / "depth" / f"{view.name}.exr", {"Y": depth})
    given = methods.given(view).depth
    assert (given[:2] == 0).all() and (given[2:] == np.float32(0.4)).all()


def test_rounds_whose_saved_depth_changed_are_cleared_again(tmp_path, caplog):
    depth = DepthChoice(name="mine", folder=tmp_path)
    run = GraspRun(depth=depth, planner="oracle", rounds=2, seed=0, out=tmp_path / "out")
    for scene in ("round-0000", "round-0001"):
        write_exr(tmp_path / scene / "depth" / "00-aa.exr", {"Y": np.ones(SIZE, np.float32)})
    run.folder.mkdir(parents=True)
    none, rows = pd.DataFrame({"index": []}), pd.DataFrame({"index": [0, 1], "error": ["", ""]})
    renew(run, None).apply(run, None, none)
    assert len(renew(run, None).apply(run, None, rows)) == 2
    before = answers_digest(read_known(run.folder).content)
    write_exr(tmp_path / "round-0001" / "depth" / "00-aa.exr", {"Y": np.ones((2, 2), np.float32)})
    assert renew(run, None).apply(run, None, rows)["index"].tolist() == [0]
    assert "saved depth depth/00-aa.exr of round-0001" in caplog.text
    after = answers_digest(read_known(run.folder).content)
    assert before and after and before != after


@pytest.mark.long
def test_a_program_restores_view_after_view(tmp_path, capsys):
    """A program that gives the sensor's depth back clears the table as raw depth does."""
    pytest.importorskip("mujoco")
    pytest.importorskip("coacd")
    meshes, views, saved = tmp_path / "blocks", tmp_path / "views", tmp_path / "saved"
    (meshes / "block").mkdir(parents=True)
    trimesh.creation.box((0.04, 0.05, 0.07)).export(meshes / "block" / "block.ply")
    saved.mkdir()
    words = ["grasp", "--rounds", "1", "--attempts", "2", "--seed", "4", "--no-gallery"]
    words += ["--meshes", str(meshes), "--meshes-unit", "m", "--engine", "serial"]
    words += ["--out", str(tmp_path / "out"), "--depth"]
    assert main([*words, "raw"]) == 0
    capsys.readouterr()
    words += [f"mine={saved}", "--save-views", str(views)]
    for number in range(2):
        assert main(words) == 1
        errors = [x for x in capsys.readouterr().err.splitlines() if x.startswith("error")]
        assert len(errors) == 1 and "no saved depth of this view" in errors[0]
        scene = Scene.open(views / "round-0000")
        assert len(scene.frames) == number + 1
        name = scene.frames[number].name
        # As `std-bench depth --save-depth` names it, and as `std-restore` does.
        path = f"{name}_depth.exr" if number else f"depth/{name}.exr"
        depth = read_exr(views / "round-0000" / "depth" / f"{name}.exr")["Y"]
        write_exr(saved / "round-0000" / path, {"Y": depth})
    assert main(words) == 0
    folder = tmp_path / "out" / "grasp" / "quick-seed4-blocks" / "antipodal"
    raw, mine = (pd.read_parquet(folder / name / ATTEMPTS) for name in ("raw", "mine"))
    pd.testing.assert_frame_equal(raw, mine)
    assert main([*words[:-3], f"mine={tmp_path / 'nowhere'}"]) == 1
    assert "no such folder of saved depth" in capsys.readouterr().err
