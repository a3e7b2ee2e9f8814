"""The BOP export, derived again from its files alone by code that shares nothing with the exporter.

Several tests stand for a defect that was found in another tool's exporter; they say so.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import cv2
import msgspec
import numpy as np
import pytest
from scene_factory import SERIAL, WORLD_POSES, make_scene

from std_toolkit.exporters import export_scene
from std_toolkit.exporters.bop_exporter import _box, depth_units
from std_toolkit.exporters.bop_metadata import targets_19
from std_toolkit.exporters.std_exporter import write_depth_exr
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.scene import Scene

SIZE = (320, 240)
DELTA_MM = 15.0


@dataclass(frozen=True)
class Exported:
    """A scene and its BOP export, read with plain json."""

    scene: Scene
    top: Path

    @property
    def folder(self) -> Path:
        return self.top / "test/000001"

    def document(self, name: str):
        return json.loads((self.folder / f"{name}.json").read_text())

    def model(self, obj_id: int, folder: str = "models") -> tuple[np.ndarray, np.ndarray]:
        """Vertices in mm and faces of an ASCII PLY, parsed by hand."""
        lines = (self.top / folder / f"obj_{obj_id:06d}.ply").read_text().splitlines()
        end = lines.index("end_header")
        vertex_count, face_count = (
            int(re.search(rf"element {kind} (\d+)", "\n".join(lines[:end])).group(1))
            for kind in ("vertex", "face")
        )
        body = lines[end + 1 :]
        vertices = np.array([[float(x) for x in s.split()[:3]] for s in body[:vertex_count]])
        faces = [[int(x) for x in s.split()[1:4]] for s in body[vertex_count:][:face_count]]
        return vertices, np.array(faces)

    def distance(self, im_id: int, gt: dict, canvas: int) -> np.ndarray:
        """Distance (not z) in mm to one model on the canvas of canvas x canvas images; 0 = none."""
        import open3d as o3d

        K = np.reshape(self.document("scene_camera")[str(im_id)]["cam_K"], (3, 3))
        R, t = np.reshape(gt["cam_R_m2c"], (3, 3)), np.array(gt["cam_t_m2c"])
        vertices, faces = self.model(gt["obj_id"])
        caster = o3d.t.geometry.RaycastingScene()
        caster.add_triangles(
            o3d.core.Tensor((vertices @ R.T + t).astype(np.float32)),
            o3d.core.Tensor(faces.astype(np.uint32)),
        )
        w, h = SIZE
        half = (canvas - 1) // 2
        v, u = np.mgrid[-half * h : (half + 1) * h, -half * w : (half + 1) * w].astype(float)
        direction = np.stack(
            [(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], -1
        )
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        rays = np.concatenate([np.zeros_like(direction), direction], -1).astype(np.float32)
        hit = caster.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
        return np.where(np.isfinite(hit), hit, 0)

    def sensor_distance(self, im_id: int) -> np.ndarray:
        row = self.document("scene_camera")[str(im_id)]
        K = np.reshape(row["cam_K"], (3, 3))
        raw = cv2.imread(str(self.folder / f"depth/{im_id:06d}.png"), cv2.IMREAD_UNCHANGED)
        v, u = np.mgrid[: SIZE[1], : SIZE[0]]
        rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], -1)
        return raw * row["depth_scale"] * np.linalg.norm(rays, axis=-1)

    def mask(self, kind: str, im_id: int, gt_id: int) -> np.ndarray:
        path = self.folder / f"{kind}/{im_id:06d}_{gt_id:06d}.png"
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image.dtype == np.uint8
        assert set(np.unique(image)) <= {0, 255}
        return image > 0


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Exported:
    """Frame 0: all in view; frame 2: the brick half outside, one object behind the camera."""
    folder = tmp_path_factory.mktemp("bop")
    cameras = [
        SE3.identity(),
        SE3(so3_exp([0.0, 0.18, 0.05]), np.array([0.02, 0.0, 0.05])),
        SE3(so3_exp([0.0, 2.9, 0.0]), np.array([0.0, 0.0, 0.2])),
    ]
    poses = dict(WORLD_POSES)
    # The mug partly behind the can.
    poses[7] = SE3(poses[7].R, np.array([0.06, 0.02, 0.72]))
    scene = make_scene(
        folder / "scene",
        size=SIZE,
        camera_poses=cameras,
        world_poses=poses,
        policy="sensor",
        depth_correction=0.98,
    )
    export_scene(scene, "bop", folder / "bop", jobs=SERIAL)
    return Exported(scene, folder / "bop")


def bbox(mask: np.ndarray, offset: tuple[int, int] = (0, 0)) -> list[int]:
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    x, y = columns[0] - offset[0], rows[0] - offset[1]
    return [int(n) for n in (x, y, columns[-1] - columns[0], rows[-1] - rows[0])]


@pytest.mark.slow
def test_masks_counts_and_boxes_follow_from_the_exported_files_alone(exported):
    gt, info = exported.document("scene_gt"), exported.document("scene_gt_info")
    w, h = SIZE
    seen = 0
    for key, rows in gt.items():
        full = [exported.distance(int(key), row, 3) for row in rows]
        inside = [d[h : 2 * h, w : 2 * w] for d in full]
        nearest = np.min([np.where(d > 0, d, np.inf) for d in inside], axis=0)
        sensor = exported.sensor_distance(int(key))
        for gt_id, row in enumerate(info[key]):
            own = inside[gt_id]
            amodal = own > 0
            unhidden = (sensor == 0) | (own - sensor <= DELTA_MM)
            visible = amodal & (own == nearest) & unhidden
            mask, mask_visib = (exported.mask(k, int(key), gt_id) for k in ("mask", "mask_visib"))
            for ours, again in ((mask, amodal), (mask_visib, visible)):
                union = np.count_nonzero(ours | again)
                assert union == 0 or np.count_nonzero(ours & again) / union >= 0.999
            for field, again in (
                ("px_count_all", np.count_nonzero(full[gt_id])),
                ("px_count_valid", np.count_nonzero(amodal & (sensor > 0))),
                ("px_count_visib", np.count_nonzero(visible)),
            ):
                assert abs(row[field] - again) <= max(1, 0.001 * again), (key, gt_id, field)
            if row["px_count_visib"]:
                seen += 1
                np.testing.assert_allclose(row["bbox_obj"], bbox(full[gt_id] > 0, (w, h)), atol=1)
                np.testing.assert_allclose(row["bbox_visib"], bbox(visible), atol=1)
                assert row["visib_fract"] == pytest.approx(
                    row["px_count_visib"] / row["px_count_all"]
                )
            else:
                assert row["bbox_obj"] == row["bbox_visib"] == [-1] * 4
    assert seen >= 5


def test_ground_truth_as_results_has_no_error(exported):
    """MSSD and MSPD of the exported poses against the scene's own poses and meshes are zero."""
    gt, cameras = exported.document("scene_gt"), exported.document("scene_camera")
    for frame in exported.scene.frames:
        for row, object_id in zip(gt[str(frame.id)], (1, 4, 7), strict=True):
            mesh = exported.scene.mesh(exported.scene.objects.object(object_id).model)
            truth = 1000 * (exported.scene.T_cam_obj(frame.id, object_id) @ mesh.vertices)
            vertices, _ = exported.model(row["obj_id"])
            R, t = np.reshape(row["cam_R_m2c"], (3, 3)), np.array(row["cam_t_m2c"])
            estimate = vertices @ R.T + t
            assert len(estimate) == len(truth)
            assert np.linalg.norm(estimate - truth, axis=1).max() < 1e-3  # mm
            if truth[:, 2].min() > 0:
                K = np.reshape(cameras[str(frame.id)]["cam_K"], (3, 3))
                pixels = (estimate @ K.T)[:, :2] / estimate[:, 2:]
                expected = exported.scene.camera(frame).project(truth / 1000)
                assert np.abs(pixels - expected).max() < 1e-3


def test_poses_map_the_model_into_the_camera_in_millimetres(exported):
    """Another exporter wrote camera to model, and metres: 89.7 degrees and 600 mm off."""
    row = exported.document("scene_gt")["0"][1]
    truth = exported.scene.T_cam_obj(0, 4)
    np.testing.assert_allclose(np.reshape(row["cam_R_m2c"], (3, 3)), truth.R, atol=1e-9)
    assert 500 < row["cam_t_m2c"][2] < 700


def test_camera_poses_map_the_world_into_the_camera(exported):
    """Another exporter wrote camera to world under the name w2c."""
    for frame in exported.scene.frames:
        row = exported.document("scene_camera")[str(frame.id)]
        T = exported.scene.T_world_cam(frame.id).inverse()
        np.testing.assert_allclose(np.reshape(row["cam_R_w2c"], (3, 3)), T.R, atol=1e-9)
        np.testing.assert_allclose(row["cam_t_w2c"], 1000 * T.t, atol=1e-6)


def test_depth_scale_turns_units_into_millimetres(exported):
    """Another exporter's depth_scale was 1000 times off. The sensor's correction is in ours."""
    row = exported.document("scene_camera")["0"]
    assert row["depth_scale"] == pytest.approx(0.25 * 0.98)
    raw = cv2.imread(str(exported.folder / "depth/000000.png"), cv2.IMREAD_UNCHANGED)
    assert raw.dtype == np.uint16
    depth = exported.scene.read_depth(exported.scene.frames[0])
    np.testing.assert_allclose(raw * row["depth_scale"], 1000 * depth, rtol=1e-6)


def test_every_entry_has_both_masks_even_where_nothing_is_visible(exported):
    """Another exporter skipped the entry of an unseen object, which shifted all later masks."""
    gt, info = exported.document("scene_gt"), exported.document("scene_gt_info")
    unseen = 0
    for key, rows in gt.items():
        assert [r["obj_id"] for r in rows] == [1, 2, 3]
        for gt_id in range(3):
            visible = exported.mask("mask_visib", int(key), gt_id)
            assert np.count_nonzero(visible) == info[key][gt_id]["px_count_visib"]
            unseen += not exported.mask("mask", int(key), gt_id).any()
        files = sorted(p.name for p in (exported.folder / "mask").glob(f"{int(key):06d}_*"))
        assert files == [f"{int(key):06d}_{i:06d}.png" for i in range(3)]
    assert unseen >= 3  # the third camera looks away


def test_boxes_reach_beyond_the_image(exported):
    """Another exporter clipped its boxes to the image."""
    boxes = [r["bbox_obj"] for rows in exported.document("scene_gt_info").values() for r in rows]
    assert any(b[0] < 0 and b[2] > 0 for b in boxes if b != [-1] * 4)


def test_visibility_compares_distances_with_bops_tolerance(exported):
    """Another exporter knew own models only, to 1e-6; and z is not the distance."""
    truth = json.loads((exported.top / "dataset_info.json").read_text())["visibility"]
    assert truth == [{"delta_mm": 15.0, "policy": "sensor", "renderer": "raycast"}]


@pytest.mark.slow
def test_models_are_centred_in_millimetres_with_normals(exported):
    info = json.loads((exported.top / "models/models_info.json").read_text())
    for obj_id in (1, 2, 3):
        header = (exported.top / f"models/obj_{obj_id:06d}.ply").read_text().split("end_header")[0]
        assert "format ascii 1.0" in header
        for name in ("nx", "ny", "nz"):
            assert f"property float {name}" in header
        for folder in ("models", "models_eval"):
            vertices, _ = exported.model(obj_id, folder)
            row = info[str(obj_id)]
            low, size = vertices.min(0), np.ptp(vertices, axis=0)
            np.testing.assert_allclose(low + size / 2, 0, atol=1e-3)
            np.testing.assert_allclose([row[f"min_{a}"] for a in "xyz"], low, atol=1e-3)
            np.testing.assert_allclose([row[f"size_{a}"] for a in "xyz"], size, atol=1e-3)
            far = np.linalg.norm(vertices[:, None] - vertices[None], axis=-1).max()
            assert row["diameter"] == pytest.approx(far, abs=1e-3)


def test_symmetries_are_kept_in_the_centred_frame(exported):
    """Another tool's script rewrote models_info.json without them."""
    for folder in ("models", "models_eval"):
        info = json.loads((exported.top / folder / "models_info.json").read_text())
        half_turn = np.reshape(info["1"]["symmetries_discrete"][0], (4, 4))
        np.testing.assert_allclose(half_turn, np.diag([-1, -1, 1, 1]), atol=1e-4)
        axis = info["2"]["symmetries_continuous"][0]
        np.testing.assert_allclose(axis["axis"], [0, 0, 1])
        np.testing.assert_allclose(axis["offset"], 0, atol=1e-4)
        assert "symmetries_discrete" not in info["3"]


def test_documents_of_the_data_set(exported):
    camera = json.loads((exported.top / "camera.json").read_text())
    assert set(camera) == {"cx", "cy", "depth_scale", "fx", "fy", "height", "width"}
    info = exported.document("scene_gt_info")
    expected = {
        (int(key), gt_id + 1)
        for key, rows in info.items()
        for gt_id, row in enumerate(rows)
        if row["visib_fract"] >= 0.1
    }
    targets = json.loads((exported.top / "test_targets_bop19.json").read_text())
    assert {(t["im_id"], t["obj_id"]) for t in targets} == expected
    assert all(t["scene_id"] == 1 and t["inst_count"] == 1 for t in targets)
    images = json.loads((exported.top / "test_targets_bop24.json").read_text())
    assert images == [{"im_id": i, "scene_id": 1} for i in (0, 2, 4)]
    row = exported.document("scene_camera")["0"]
    assert "cam_model" not in row  # never both kinds of camera
    assert (exported.top / "dataset_info.md").is_file()


def test_coco_boxes_count_pixels_and_are_clipped(exported):
    coco = exported.document("scene_gt_coco")
    images = {i["id"]: i for i in coco["images"]}
    assert len(coco["annotations"]) >= 5
    for a in coco["annotations"]:
        im_id, gt_id = a["image_id"], a["category_id"] - 1
        amodal = exported.mask("mask", im_id, gt_id)
        x, y, w, h = bbox(amodal)
        assert a["bbox"] == [x, y, w + 1, h + 1]
        counts, size = a["segmentation"]["counts"], a["segmentation"]["size"]
        bits = np.repeat(np.arange(len(counts)) % 2, counts).reshape(size, order="F")
        np.testing.assert_array_equal(bits > 0, exported.mask("mask_visib", im_id, gt_id))
        assert a["area"] == np.count_nonzero(bits)
        assert (exported.folder / images[im_id]["file_name"]).is_file()
    assert len({a["id"] for a in coco["annotations"]}) == len(coco["annotations"])
    modal = exported.document("scene_gt_coco_modal")
    hidden = 0
    for a, m in zip(coco["annotations"], modal["annotations"], strict=True):
        x, y, w, h = bbox(exported.mask("mask_visib", a["image_id"], a["category_id"] - 1))
        assert m == {**a, "bbox": [x, y, w + 1, h + 1]}
        hidden += m["bbox"] != a["bbox"]
    assert hidden and {k: v for k, v in modal.items() if k != "annotations"} == {
        k: v for k, v in coco.items() if k != "annotations"
    }


def test_depth_beyond_16_bits_is_dropped_and_not_clipped(tmp_path):
    """65,535 mm are the last that fit; what is farther is no reading, not a wall at 65.5 m."""
    scene = make_scene(tmp_path / "scene", frames=1, depth=False, render=False)
    frame = scene.frames[0]
    width, height = scene.camera(frame).size
    depth = np.full((height, width), 0.9, np.float32)
    depth[3, 4:10] = 65.534, 65.535, 65.536, 70.0, 131.071, 1000.0
    path = scene.root / "depth/view_0.exr"
    path.parent.mkdir()
    write_depth_exr(path, depth)
    units = depth_units(scene, msgspec.structs.replace(frame, depth="depth/view_0.exr"))
    assert units.scale_mm == 1.0 and units.values.dtype == np.uint16
    assert units.values[3, 4:10].tolist() == [65534, 65535, 0, 0, 0, 0]
    assert np.count_nonzero(units.values == 900) == width * height - 6


def test_the_box_of_what_is_not_seen() -> None:
    assert _box(None) == [-1, -1, -1, -1]
    assert _box([3, 4, 10, 20]) == [3, 4, 7, 16]


@pytest.mark.parametrize(("farthest_m", "unit_mm"), [(6.55, 0.1), (6.56, 1.0)])
def test_depth_is_as_fine_as_its_range_allows(tmp_path, farthest_m, unit_mm):
    scene = make_scene(tmp_path / "scene", frames=1, depth=False, render=False)
    frame = scene.frames[0]
    width, height = scene.camera(frame).size
    depth = np.full((height, width), 0.9, np.float32)
    depth[3, 4] = farthest_m
    path = scene.root / "depth/view_0.exr"
    path.parent.mkdir()
    write_depth_exr(path, depth)
    units = depth_units(scene, msgspec.structs.replace(frame, depth="depth/view_0.exr"))
    assert units.scale_mm == unit_mm
    assert units.values[0, 0] == 900 / unit_mm
    assert units.values[3, 4] == round(1000 * farthest_m / unit_mm)


def test_targets_count_the_instances_of_which_a_tenth_is_visible() -> None:
    def row(frame: int, *objects: tuple[int, float]) -> SimpleNamespace:
        gt = [{"obj_id": number} for number, _ in objects]
        info = [{"visib_fract": share} for _, share in objects]
        return SimpleNamespace(frame=SimpleNamespace(id=frame), extra={"gt": gt, "gt_info": info})

    rows = [row(3, (2, 0.1), (1, 1.0), (2, 0.9), (5, 0.0999)), row(4, (5, 0.05))]
    target = SimpleNamespace(options=SimpleNamespace(scene_number=7))
    assert targets_19(target, rows) == [
        {"im_id": 3, "inst_count": 1, "obj_id": 1, "scene_id": 7},
        {"im_id": 3, "inst_count": 2, "obj_id": 2, "scene_id": 7},
    ]
