"""BOP scenes that other tools wrote: units, directions, instances, damage."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, rotation_angle, so3_exp
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.importer import detect_format
from std_toolkit.importers.options import ImportRequest
from std_toolkit.scene.model import pose_from_list

CAMERAS = [SE3(so3_exp([0.0, 0.1 * i, 0.0]), np.array([-0.05 * i, 0.0, 0.0])) for i in range(3)]
OBJECTS = [
    (5, SE3(so3_exp([0.3, 0.0, 0.1]), np.array([0.05, 0.0, 0.6]))),
    (9, SE3(so3_exp([0.0, 0.5, 0.0]), np.array([-0.1, 0.02, 0.7]))),
    (5, SE3(so3_exp([0.0, 0.0, 1.0]), np.array([0.0, 0.05, 0.65]))),
]


def write(folder: Path, **documents) -> None:
    for name, content in documents.items():
        (folder / f"{name}.json").write_text(json.dumps(content))


@pytest.fixture
def dataset(tmp_path) -> Path:
    """Three images; the order of objects differs from image to image; depth in 0.1 mm."""
    top = tmp_path / "ycbx"
    folder = top / "test/000048"
    (folder / "rgb").mkdir(parents=True)
    (folder / "depth").mkdir()
    cameras, gt = {}, {}
    rng = np.random.default_rng(1)
    for i, T_world_cam in enumerate(CAMERAS):
        im_id = 10 * i + 1
        image = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"rgb/{im_id:06d}.png"), image)
        cv2.imwrite(str(folder / f"depth/{im_id:06d}.png"), np.full((48, 64), 7000, np.uint16))
        w2c = T_world_cam.inverse()
        cameras[str(im_id)] = {
            "cam_K": [70, 0, 31.5, 0, 71, 23.5, 0, 0, 1],
            "depth_scale": 0.1,
            "cam_R_w2c": w2c.R.ravel().tolist(),
            "cam_t_w2c": (1000 * w2c.t).tolist(),
            "view_level": 2,
        }
        rows = []
        for obj_id, T in OBJECTS if i != 1 else OBJECTS[::-1]:
            m2c = w2c @ T
            rows.append(
                {
                    "obj_id": obj_id,
                    "cam_R_m2c": m2c.R.ravel().tolist(),
                    "cam_t_m2c": (1000 * m2c.t).tolist(),
                }
            )
        gt[str(im_id)] = rows
    write(folder, scene_camera=cameras, scene_gt=gt)
    (top / "models").mkdir()
    for obj_id in (5, 9):
        trimesh.creation.box((60, 80, 100)).export(
            top / f"models/obj_{obj_id:06d}.ply", encoding="ascii"
        )
    symmetry = {"symmetries_continuous": [{"axis": [0, 0, 2], "offset": [0, 0, 30]}]}
    write(top / "models", models_info={"5": {"diameter": 141.4, **symmetry}, "9": {}})
    return top


def run(dataset: Path, out: Path, **changes):
    source = changes.pop("source", dataset / "test/000048")
    return import_recording(ImportRequest(source=source, name="bop", **changes), out)


def test_millimetres_become_metres(dataset, tmp_path):
    scene = run(dataset, tmp_path / "scene")
    assert [f.id for f in scene.frames] == [1, 11, 21]
    assert scene.read_depth(scene.frames[0])[0, 0] == pytest.approx(0.7)
    np.testing.assert_allclose(scene.mesh("obj_000005").extents, [0.06, 0.08, 0.1], atol=1e-7)
    np.testing.assert_allclose(scene.objects.model("obj_000005").size_m, [0.06, 0.08, 0.1])
    for i, T in enumerate(CAMERAS):
        found = scene.T_world_cam(10 * i + 1)
        np.testing.assert_allclose(found.matrix(), T.matrix(), atol=1e-9)


def test_objects_are_told_apart_by_their_place_not_by_their_order(dataset, tmp_path):
    scene = run(dataset, tmp_path / "scene")
    assert [o.model for o in scene.objects.objects] == ["obj_000005", "obj_000009", "obj_000005"]
    for thing, (_, T) in zip(scene.objects.objects, OBJECTS, strict=True):
        found = scene.T_world_obj(thing.id)
        np.testing.assert_allclose(found.matrix(), T.matrix(), atol=1e-8)


def test_symmetries_become_metres_with_unit_axes(dataset, tmp_path):
    symmetry = run(dataset, tmp_path / "scene").objects.model("obj_000005").symmetry
    assert symmetry.continuous[0].axis == [0, 0, 1]
    np.testing.assert_allclose(symmetry.continuous[0].offset, [0, 0, 0.03])


def test_a_data_set_of_one_scene_is_enough(dataset, tmp_path):
    assert detect_format(dataset) == detect_format(dataset / "test/000048") == "bop"
    assert len(run(dataset, tmp_path / "scene", source=dataset).frames) == 3


def test_materials_can_be_told(dataset, tmp_path):
    scene = run(dataset, tmp_path / "scene", material="transparent")
    assert {o.material for o in scene.objects.objects} == {"transparent"}


def test_without_camera_poses_labels_stay_in_their_frames(dataset, tmp_path):
    folder = dataset / "test/000048"
    cameras = json.loads((folder / "scene_camera.json").read_text())
    for row in cameras.values():
        del row["cam_R_w2c"], row["cam_t_w2c"]
    write(folder, scene_camera=cameras)
    scene = run(dataset, tmp_path / "scene")
    assert scene.poses is None
    label = scene.labels.of(2)
    assert label.T_world_obj is None
    assert set(label.views) == {"11", "21"}
    truth = CAMERAS[2].inverse() @ OBJECTS[1][1]
    found = pose_from_list(label.views["21"])
    assert rotation_angle(found.R.T @ truth.R) < 1e-7
    np.testing.assert_allclose(found.t, truth.t, atol=1e-9)


def test_depth_in_two_units_is_brought_to_metres(dataset, tmp_path):
    folder = dataset / "test/000048"
    cameras = json.loads((folder / "scene_camera.json").read_text())
    cameras["11"]["depth_scale"] = 1.0
    cv2.imwrite(str(folder / "depth/000011.png"), np.full((48, 64), 800, np.uint16))
    write(folder, scene_camera=cameras)
    scene = run(dataset, tmp_path / "scene")
    assert scene.read_depth(scene.frame(11))[0, 0] == pytest.approx(0.8)
    assert scene.read_depth(scene.frame(21))[0, 0] == pytest.approx(0.7)


def edit(path: Path, change) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def set_at(*keys, value):
    def change(content):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


HOSTILE = {
    "camera garbage": ("scene_camera", None, "not valid JSON"),
    "K of strings": ("scene_camera", set_at("1", "cam_K", value="640"), "cam_K"),
    "K of 8": ("scene_camera", set_at("1", "cam_K", value=[1] * 8), "length >= 9"),
    "K of another size": (
        "scene_camera",
        set_at("1", "cam_K", value=[700, 0, 320, 0, 700, 240, 0, 0, 1]),
        "1.cam_K",
    ),
    "skewed K": (
        "scene_camera", set_at("1", "cam_K", value=[70, 5, 31, 0, 70, 23, 0, 0, 1]), "skew",
    ),
    "fisheye": ("scene_camera", set_at("1", "cam_model", value={}), "pinhole"),
    "depth scale zero": ("scene_camera", set_at("1", "depth_scale", value=0), "depth_scale"),
    "depth in metres": ("scene_camera", set_at("1", "depth_scale", value=100.0), "plausible|scale"),
    "path as id": ("scene_camera", set_at("../../etc/passwd", value={}), "cam_K|number"),
    "negative id": ("scene_gt", set_at("-1", value=[]), "number"),
    "unknown image": ("scene_gt", set_at("77", value=[]), "no such image"),
    "a mirror": (
        "scene_gt", set_at("1", 0, "cam_R_m2c", value=[1, 0, 0, 0, 1, 0, 0, 0, -1]), "rotation",
    ),
    "a scaled rotation": (
        "scene_gt", set_at("1", 0, "cam_R_m2c", value=[2, 0, 0, 0, 2, 0, 0, 0, 2]), "rotation",
    ),
    "behind the camera": (
        "scene_gt", set_at("1", 0, "cam_t_m2c", value=[0, 0, -700]), "behind",
    ),
    "translation in metres": (
        "scene_gt", set_at("1", 0, "cam_t_m2c", value=[0.01, 0, 0.7]), "millimetres",
    ),
    "NaN pose": (
        "scene_gt", set_at("1", 0, "cam_t_m2c", value=[float("nan"), 0, 0]), "JSON|finite",
    ),
    "huge id": ("scene_gt", set_at("1", 0, "obj_id", value=10**12), "obj_id"),
    "text id": ("scene_gt", set_at("1", 0, "obj_id", value="../../x"), "obj_id"),
    "missing model": ("scene_gt", set_at("1", 0, "obj_id", value=6), "obj_000006"),
    "a list": ("scene_gt", set_at("1", value={"obj_id": 1}), "Expected"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_documents_are_one_line(case, dataset, tmp_path):
    name, change, problem = HOSTILE[case]
    path = dataset / f"test/000048/{name}.json"
    if change is None:
        path.write_text('{"1": {"cam_K": [')
    else:
        edit(path, change)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ToolkitError, match=problem) as error:
        run(dataset, tmp_path / "scene")
    assert "\n" not in str(error.value)
    assert sorted(tmp_path.rglob("*")) == before


def test_models_in_metres_are_refused(dataset, tmp_path):
    """An all-black mask is what others get from them."""
    trimesh.creation.box((0.06, 0.08, 0.1)).export(dataset / "models/obj_000005.ply")
    with pytest.raises(ToolkitError, match="implausibly small"):
        run(dataset, tmp_path / "scene")


def test_images_named_but_missing(dataset, tmp_path):
    (dataset / "test/000048/rgb/000011.png").unlink()
    with pytest.raises(ToolkitError, match=r"000011\.png"):
        run(dataset, tmp_path / "scene")
    assert not (tmp_path / "scene").exists()


def renamed(dataset: Path, sensors: tuple[str, ...]) -> Path:
    """The scene with several sensors, as IPD and XYZ-IBD have it; their images differ by 10."""
    folder = dataset / "test/000048"
    for kind in ("rgb", "depth"):
        for i, sensor in enumerate(sensors):
            target = folder / f"{kind}_{sensor}"
            target.mkdir()
            for path in (folder / kind).iterdir():
                image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
                cv2.imwrite(str(target / path.name), np.minimum(image, 200 if i else 100))
            if kind == "depth":
                for path in (folder / kind).iterdir():
                    cv2.imwrite(str(target / path.name), np.full((48, 64), 7000 + i, np.uint16))
        for path in (folder / kind).iterdir():
            path.unlink()
        (folder / kind).rmdir()
    for name in ("scene_camera", "scene_gt"):
        for sensor in sensors:
            text = (folder / f"{name}.json").read_text()
            (folder / f"{name}_{sensor}.json").write_text(text)
        (folder / f"{name}.json").unlink()
    return folder


def test_one_of_several_sensors(dataset, tmp_path):
    folder = renamed(dataset, ("photoneo", "realsense"))
    assert detect_format(folder) == "bop"
    with pytest.raises(ToolkitError, match=r"2 sensors.*--camera: photoneo, realsense"):
        run(dataset, tmp_path / "a")
    with pytest.raises(ToolkitError, match=r"--camera: no such sensor.*photoneo"):
        run(dataset, tmp_path / "a", camera="xyz")
    scene = run(dataset, tmp_path / "a", camera="realsense")
    assert scene.read_color(scene.frames[0]).max() == 200
    assert scene.read_depth(scene.frames[0]).max() == np.float32(0.7001)
    assert len(scene.objects.objects) == 3


@pytest.mark.parametrize("suffix", [".tif", ".tiff", ".jpeg", ".jpg"])
def test_grey_images_of_any_suffix(dataset, tmp_path, suffix):
    folder = dataset / "test/000048"
    (folder / "rgb").rename(folder / "gray")
    grey = np.full((48, 64), 90, np.uint8)
    for path in list((folder / "gray").iterdir()):
        cv2.imwrite(str(path.with_suffix(suffix)), grey)
        path.unlink()
        depth = folder / "depth" / path.name
        if suffix.startswith(".ti"):
            cv2.imwrite(str(depth.with_suffix(suffix)), np.full((48, 64), 7000, np.uint16))
            depth.unlink()
    scene = run(dataset, tmp_path / "scene")
    assert np.abs(scene.read_color(scene.frames[0]).astype(int) - 90).max() <= 1
    assert np.allclose(scene.read_depth(scene.frames[0]), 0.7)
