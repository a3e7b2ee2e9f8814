from __future__ import annotations

import json
import re

import numpy as np
import pytest
import trimesh
from PIL import Image
from tiny_camera import CAMERA

from std_toolkit.cli.command_options import parse_options
from std_toolkit.cli.labelling import label
from std_toolkit.commands import LabelArguments
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.entry.label import add_model, add_object, set_pose
from std_toolkit.labels.entry.pnp import read_correspondences
from std_toolkit.labels.entry.symmetry_argument import parse_symmetry
from std_toolkit.scene import Scene
from std_toolkit.scene.model import annotated_views

POSE = SE3.exp(np.array([0.0, 0.0, 0.7, 0.3, 0.2, 0.1]))


def run(*arguments) -> int:
    options, _ = parse_options(LabelArguments, [str(a) for a in arguments], "std-curate label")
    return label(options)


def snapshot(root):
    return {
        p: p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file() and ".std" not in p.parts
    }


def test_a_textured_obj_in_millimetres_comes_with_its_texture(scene, tmp_path):
    folder = tmp_path / "in put"
    folder.mkdir()
    Image.new("RGB", (4, 4), (200, 30, 30)).save(folder / "a tex.png")
    (folder / "m.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd a tex.png\nmap_Bump gone.png\n")
    box = trimesh.creation.box((60, 40, 100))
    lines = ["mtllib m.mtl", "usemtl a", *(f"v {x} {y} {z}" for x, y, z in box.vertices)]
    lines += ["vt 0 0", *("f " + " ".join(f"{i + 1}/1" for i in f) for f in box.faces)]
    (folder / "my mug.obj").write_text("\n".join(lines))
    model = add_model(scene, folder / "my mug.obj", mesh_unit="mm", category="mug")
    assert model.id == "my_mug" and model.class_id == 6
    assert np.allclose(model.size_m, [0.06, 0.04, 0.1])
    assert np.isclose(model.diameter_m, np.linalg.norm([0.06, 0.04, 0.1]))
    stored = {p.name for p in (scene.root / "models/my_mug").iterdir()}
    assert {re.sub("-[0-9a-f]{8}", "", n) for n in stored} == {"my_mug.obj", "m.mtl", "a_tex.png"}
    again = load_mesh(scene.root / model.mesh)
    assert np.allclose(again.vertices, box.vertices / 1000)
    assert again.visual.material.image.size == (4, 4)
    assert Scene.open(scene.root).objects == scene.objects


def test_a_mesh_in_millimetres_taken_for_metres_is_refused(scene, tmp_path):
    trimesh.creation.box((60, 40, 100)).export(tmp_path / "mug.ply")
    before = snapshot(scene.root)
    with pytest.raises(ToolkitError, match="millimetres"):
        run(scene.root, "--object", "mug", "--mesh", tmp_path / "mug.ply")
    assert snapshot(scene.root) == before
    assert (
        run(scene.root, "--object", "mug", "--mesh", tmp_path / "mug.ply", "--mesh-unit", "mm") == 0
    )
    assert np.allclose(Scene.open(scene.root).objects.models[0].size_m, [0.06, 0.04, 0.1])


@pytest.mark.parametrize("line", ["mtllib ../../secret.mtl", "mtllib /etc/passwd"])
def test_a_mesh_cannot_reach_outside_its_folder(scene, box_path, line):
    (box_path.parent.parent / "secret.mtl").write_text("newmtl a\n")
    box_path.write_text(line + "\n" + box_path.read_text())
    with pytest.raises(ToolkitError, match="outside its folder"):
        add_model(scene, box_path)


def test_what_is_not_said_again_about_a_model_stays(scene, box_path):
    add_model(scene, box_path, category="mug")
    run(scene.root, "--object", "second", "--mesh", box_path)
    again = Scene.open(scene.root).objects.models[0]
    assert (again.category, again.class_id) == ("mug", 6)
    assert add_model(scene, box_path, category="can").class_id == 4


def test_models_are_shared_and_not_replaced(scene, box_path):
    first = add_model(scene, box_path)
    assert add_model(scene, box_path) == first
    add_object(scene, "left", model="box")
    thing = add_object(scene, "right", model="box", material="transparent")
    assert thing.id == 2
    other = trimesh.creation.box((0.05, 0.05, 0.05))
    other.export(box_path)
    with pytest.raises(ToolkitError, match="another mesh"):
        add_model(scene, box_path)
    with pytest.raises(ToolkitError, match="unknown material"):
        add_object(scene, "x", model="box", material="glass")
    with pytest.raises(ToolkitError, match="safe name"):
        add_object(scene, "../x", model="box")


def test_the_command_sets_a_pose_and_more_views(scene, box_path, tmp_path):
    np.savetxt(tmp_path / "a.txt", POSE.matrix())
    np.savetxt(tmp_path / "b.txt", (SE3.exp(np.full(6, 0.01)) @ POSE).matrix())
    code = run(
        scene.root, "--object", "box", "--mesh", box_path, "--category", "box", "--material",
        "specular", "--symmetry", "fold:z:2", "--frame", 0, "--pose", tmp_path / "a.txt",
        "--frame", 1, "--pose", tmp_path / "b.txt", "--annotator", "me",
    )  # fmt: skip
    assert code == 0
    scene = Scene.open(scene.root)
    done = scene.labels.labels[0]
    assert done.frame == 0 and list(done.views) == ["1"] and done.annotator == "me"
    assert np.allclose(annotated_views(done)[0].matrix(), POSE.matrix(), atol=1e-9)
    assert scene.objects.objects[0].material == "specular"
    assert len(scene.objects.models[0].symmetry.discrete) == 1
    run(scene.root, "--object", "box", "--frame", 2, "--pose", tmp_path / "b.txt", "--add-view")
    assert list(Scene.open(scene.root).labels.labels[0].views) == ["1", "2"]
    run(scene.root, "--object", "box", "--frame", 2, "--pose", tmp_path / "b.txt")
    assert Scene.open(scene.root).labels.labels[0].views == {}


def test_the_command_solves_correspondences(scene, box_path, tmp_path, capsys):
    X = np.asarray(load_mesh(box_path).vertices)
    uv = CAMERA.project(POSE @ X)
    rows = ["u,v,x,y,z", *(",".join(f"{v:.6f}" for v in row) for row in np.hstack([uv, X]))]
    (tmp_path / "c.csv").write_text("\n".join(rows))
    run(scene.root, "--object", "box", "--mesh", box_path, "--frame", 0,
        "--correspondences", tmp_path / "c.csv")  # fmt: skip
    done = Scene.open(scene.root).labels.labels[0]
    assert done.method == "pnp"
    assert np.allclose(np.reshape(done.T_cam_obj, (4, 4)), POSE.matrix(), atol=1e-4)
    assert "8 of 8 correspondences fit" in capsys.readouterr().out


def test_the_command_takes_file_names_and_echoes_the_frame(scene, box_path, tmp_path, capsys):
    np.savetxt(tmp_path / "a.txt", POSE.matrix())
    run(scene.root, "--object", "box", "--mesh", box_path, "--frame", "000001.png",
        "--pose", tmp_path / "a.txt")  # fmt: skip
    assert Scene.open(scene.root).labels.labels[0].frame == 1
    assert "pose set in frame 1 = color/000001.png" in capsys.readouterr().out
    with pytest.raises(ToolkitError, match="given twice"):
        run(scene.root, "--object", "box", "--frame", "1", "--frame", "000001.png",
            "--pose", tmp_path / "a.txt")  # fmt: skip


def test_the_command_refuses_the_pose_of_another_image(scene, box_path, tmp_path):
    row = {"obj_id": 1, "cam_R_m2c": POSE.R.ravel().tolist(), "cam_t_m2c": (1e3 * POSE.t).tolist()}
    (tmp_path / "scene_gt.json").write_text(json.dumps({"5": [row]}))
    with pytest.raises(ToolkitError, match="image 5 alone, not frame 0 = "):
        run(scene.root, "--object", "box", "--mesh", box_path, "--frame", "0",
            "--pose", tmp_path / "scene_gt.json")  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--frame", "9", "--pose", "POSE"], "no such frame; .*ids 0 to 2"),
        (["--frame", "0", "--pose", "BAD"], "not a rotation"),
        (["--frame", "0"], "needs one --pose"),
        (["--frame", "0", "--correspondences", "FAR"], "outside the 160x120 image"),
        (["--symmetry", "spin:z"], "--symmetry: unknown symmetry"),
        (["--symmetry", "axis:z", "--symmetry", "none"], "contradicts"),
    ],
)
def test_a_bad_command_leaves_the_scene_as_it_was(scene, box_path, tmp_path, arguments, message):
    files = {"POSE": tmp_path / "p.txt", "BAD": tmp_path / "q.txt", "FAR": tmp_path / "r.json"}
    np.savetxt(files["POSE"], POSE.matrix())
    np.savetxt(files["BAD"], POSE.matrix() * 2 - np.diag([0, 0, 0, 1]))
    files["FAR"].write_text(json.dumps([[1000, 5, 0, 0, 0]] * 4))
    before = snapshot(scene.root)
    with pytest.raises(ToolkitError, match=message):
        run(
            scene.root, "--object", "box", "--mesh", box_path, *[files.get(a, a) for a in arguments]
        )
    assert snapshot(scene.root) == before


def test_an_object_keeps_its_model(scene, box_path):
    run(scene.root, "--object", "box", "--mesh", box_path)
    before = snapshot(scene.root)
    with pytest.raises(ToolkitError, match="object box has model box"):
        run(scene.root, "--object", "box", "--mesh", box_path, "--model", "other")
    assert snapshot(scene.root) == before


def test_an_unknown_object_needs_a_mesh(scene):
    with pytest.raises(ToolkitError, match="no such object"):
        run(scene.root, "--object", "ghost")


def test_set_pose_drops_what_was_derived(scene, box_path):
    add_model(scene, box_path)
    add_object(scene, "box", model="box")
    set_pose(scene, "box", 0, POSE)
    with pytest.raises(ToolkitError, match="behind the camera"):
        set_pose(scene, "box", 0, SE3(POSE.R, -POSE.t))


def test_correspondence_files(tmp_path):
    path = tmp_path / "c.csv"
    path.write_text("1,2,30,40,50\n3,4,60,70,80\n")
    X, uv = read_correspondences(path, unit="mm")
    assert np.allclose(X, [[0.03, 0.04, 0.05], [0.06, 0.07, 0.08]])
    assert np.allclose(uv, [[1, 2], [3, 4]])
    path.write_text("name,z,y,x,v,u\na,5,4,3,2,1\n")
    assert np.allclose(np.hstack(read_correspondences(path)[::-1]), [[1, 2, 3, 4, 5]])
    (tmp_path / "c.json").write_text('[{"u":1,"v":2,"x":3,"y":4,"z":5}]')
    assert np.allclose(
        np.hstack(read_correspondences(tmp_path / "c.json")[::-1]), [[1, 2, 3, 4, 5]]
    )
    for content, message in [
        ("", "no correspondences"),
        ("u,v,x,y\n1,2,3,4", "columns u, v, x, y, z"),
        ("1,2,3,4,5\n1,2,3", "five numbers"),
        ("1,2,3,4,nan", "not finite"),
        ("u,v,x,y,z\n1,2,3,4,a", "five numbers"),
    ]:
        path.write_text(content)
        with pytest.raises(ToolkitError, match=message):
            read_correspondences(path)


def test_symmetry_arguments(tmp_path):
    symmetry = parse_symmetry(["fold:x:2", "fold:z:2"], centre=(0, 0, 0.1)).symmetry()
    assert len(symmetry.transforms()) == 4  # the half turn about y follows
    turn = parse_symmetry(["axis:z"], centre=(0.1, 0.2, 0.3)).continuous[0]
    assert turn.axis == [0, 0, 1] and turn.offset == [0.1, 0.2, 0]
    assert parse_symmetry(["axis:z@origin"], centre=(1, 1, 1)).continuous[0].offset == [0, 0, 0]
    assert parse_symmetry(["none"], centre=(0, 0, 0)).symmetry().is_trivial
    bop = tmp_path / "s.json"
    half = np.diag([-1.0, -1, 1, 1])
    half[0, 3] = 20
    bop.write_text(
        json.dumps(
            {
                "symmetries_discrete": [half.ravel().tolist()],
                "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [10, 0, 0]}],
            }
        )
    )
    read = parse_symmetry([str(bop)], centre=(0, 0, 0))
    assert np.isclose(read.discrete[0][3], 0.02) and read.continuous[0].offset == [0.01, 0, 0]
    bop.write_text("{}")
    with pytest.raises(ToolkitError, match="no symmetry"):
        parse_symmetry([str(bop)], centre=(0, 0, 0))
