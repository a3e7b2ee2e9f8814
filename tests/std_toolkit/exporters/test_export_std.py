"""The STD export through a loader written in the style of the public ones."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from scene_factory import MODELS_OF, SERIAL, make_scene

from std_toolkit.errors import ToolkitError
from std_toolkit.exporters import ExportOptions, export_scene
from std_toolkit.exporters.frame_maps import _hidden, _row
from std_toolkit.exporters.std_exporter import nocs_image
from std_toolkit.geometry import SE3, Camera, rotation_angle, umeyama
from std_toolkit.geometry.mesh import nocs_frame
from std_toolkit.io.exr import read_exr
from std_toolkit.io.images import image_size
from std_toolkit.rendering.choose import get_renderer
from std_toolkit.rendering.ground_truth import ObjectTruth, read_ground_truth
from std_toolkit.rendering.maps import Composition, compose
from std_toolkit.rendering.renderer import PlacedMesh
from std_toolkit.scene import Scene

SUFFIXES = ("color.png", "depth_415.exr", "gt_depth.exr", "coord.png", "mask.png", "meta.txt")


class PublicLoader:
    """Globs per suffix, pairs by position, takes channel 0 of BGR, truncates masks."""

    def __init__(self, root: Path) -> None:
        self.files = {s: sorted(root.glob(f"*/*_{s}")) for s in SUFFIXES}
        assert len({len(f) for f in self.files.values()}) == 1

    def __len__(self) -> int:
        return len(self.files["color.png"])

    def __getitem__(self, i: int) -> dict:
        path = {s: f[i] for s, f in self.files.items()}
        nocs = cv2.imread(str(path["coord.png"]))[:, :, ::-1].astype(np.float32) / 255
        nocs[:, :, 2] = 1 - nocs[:, :, 2]
        mask = cv2.imread(str(path["mask.png"]), cv2.IMREAD_UNCHANGED)
        meta = [line.split(" ") for line in path["meta.txt"].read_text().splitlines()]
        return {
            "color": cv2.imread(str(path["color.png"]))[:, :, ::-1],
            "raw": self._depth(path["depth_415.exr"]),
            "depth": self._depth(path["gt_depth.exr"]),
            "nocs": nocs - 0.5,
            "mask": (mask.astype(np.float32) / 255 * 255).astype(np.int32),
            "meta": meta,
            "stem": path["color.png"].name.split("_")[0],
        }

    @staticmethod
    def _depth(path: Path) -> np.ndarray:
        channels = read_exr(path)
        bgr = np.stack([channels[c] for c in "BGR"], axis=-1)
        assert bgr.dtype == np.float32
        depth = bgr[:, :, 0].copy()
        depth[depth <= 0] = 0
        return depth


def fitted(sample: dict, mask_id: int, K: np.ndarray):
    """The authors' advice for poses: Umeyama from NOCS and ground-truth depth."""
    v, u = np.nonzero((sample["mask"] == mask_id) & (sample["depth"] > 0))
    z = sample["depth"][v, u].astype(float)
    points = np.stack([(u - K[0, 2]) * z / K[0, 0], (v - K[1, 2]) * z / K[1, 1], z], axis=1)
    return umeyama(sample["nocs"][v, u].astype(float), points)


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Scene:
    """1280x720: the size at which STD's labels are half as large."""
    return make_scene(tmp_path_factory.mktemp("std") / "scene", size=(1280, 720), frames=2)


@pytest.fixture(scope="module")
def root(scene, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("std") / "std"
    export_scene(scene, "std", out, jobs=SERIAL)
    return out


def test_sizes_are_those_of_std(root):
    sizes = {s: {image_size(p) for p in root.glob(f"*/*_{s}")} for s in SUFFIXES[:5]}
    assert sizes["color.png"] == sizes["depth_415.exr"] == {(1280, 720)}
    assert sizes["gt_depth.exr"] == sizes["coord.png"] == sizes["mask.png"] == {(640, 360)}


def test_a_public_loader_recovers_every_pose_at_label_size(scene, root):
    loader = PublicLoader(root)
    assert len(loader) == 2
    K = scene.camera(scene.frames[0]).resized(640, 360).K
    for i, frame in enumerate(scene.frames):
        sample = loader[i]
        assert sample["mask"].max() == 255
        for mask_id, object_id in enumerate((1, 4, 7), start=1):
            mesh = scene.mesh(MODELS_OF[object_id])
            centre, diagonal = nocs_frame(mesh)
            fit = fitted(sample, mask_id, K)
            truth = scene.T_cam_obj(frame.id, object_id)
            # 8-bit NOCS is quantised to 0.4 % of the diagonal; the mean over the pixels is finer.
            assert fit.scale == pytest.approx(diagonal, rel=0.01)
            assert rotation_angle(fit.R.T @ truth.R) < np.radians(0.5)
            assert np.linalg.norm(fit.t - truth @ centre) < 1e-3


def test_maps_at_half_size_are_exact_not_picked_from_full_size(scene, root):
    """Back-projected label depth lies on the mesh: a half-pixel slip would be 0.4 mm."""
    import open3d as o3d

    sample = PublicLoader(root)[0]
    camera = scene.camera(scene.frames[0]).resized(640, 360)
    v, u = np.nonzero(sample["mask"] == 2)
    points = camera.unproject(np.stack([u, v], axis=1), sample["depth"][v, u])
    mesh = scene.mesh("can")
    T = scene.T_cam_obj(0, 4)
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(
        o3d.core.Tensor((T @ mesh.vertices).astype(np.float32)),
        o3d.core.Tensor(mesh.faces.astype(np.uint32)),
    )
    off = caster.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()
    assert off.max() < 1e-5


def test_meta_lines_have_thirteen_fields(scene, root):
    for i, frame in enumerate(scene.frames):
        sample = PublicLoader(root)[i]
        assert [line[0] for line in sample["meta"]] == ["1", "2", "3"]
        for line, object_id in zip(sample["meta"], (1, 4, 7), strict=True):
            fields = line[:-1]
            assert (len(fields), line[-1]) == (13, "")
            _, label, category, instance, scale, material, *numbers = fields
            model = scene.objects.model_of(object_id)
            centre, diagonal = nocs_frame(scene.mesh(model.id))
            assert (int(label), category, instance) == (model.class_id, model.category, model.id)
            assert (root / "cad_model" / category / instance / "model.obj").is_file()
            assert float(scale) == pytest.approx(diagonal, abs=1e-8)
            assert int(material) == {1: 1, 4: 2, 7: 3}[object_id]
            q, t = np.array(numbers[:4], float), np.array(numbers[4:], float)
            truth = scene.T_cam_obj(frame.id, object_id)
            # The DREDS generator writes the inverse rotation.
            np.testing.assert_allclose(SE3.from_quat(q, t).R, truth.R.T, atol=1e-7)
            np.testing.assert_allclose(t, truth @ centre, atol=1e-8)


@pytest.mark.slow
def test_plain_quaternions_on_request(scene, tmp_path):
    out = tmp_path / "std"
    sidecar = export_scene(
        scene, "std", out, options=ExportOptions(quaternion="plain"), jobs=SERIAL
    )
    line = PublicLoader(out)[0]["meta"][0]
    R = SE3.from_quat(np.array(line[6:10], float), np.zeros(3)).R
    np.testing.assert_allclose(R, scene.T_cam_obj(0, 1).R, atol=1e-7)
    assert "object to camera" in sidecar.quaternion


def test_cad_models_have_a_unit_diagonal_and_their_box(scene, root):
    for category, instance in (("other", "brick"), ("can", "can"), ("mug", "mug")):
        folder = root / "cad_model" / category / instance
        high, low = np.loadtxt(folder / "bbox.txt")
        assert np.linalg.norm(high - low) == pytest.approx(1, abs=1e-6)
        lines = (folder / "model.obj").read_text().splitlines()
        vertices = np.array([s.split()[1:4] for s in lines if s.startswith("v ")], float)
        np.testing.assert_allclose(vertices.max(0), high, atol=1e-6)
        np.testing.assert_allclose(vertices.min(0), low, atol=1e-6)


def test_raw_depth_is_in_metres_and_zero_where_missing(scene, root):
    raw = PublicLoader(root)[0]["raw"]
    np.testing.assert_allclose(raw, scene.read_depth(scene.frames[0]), atol=1e-6)
    assert (raw[:80] == 0).all()


def test_a_scene_without_depth_still_has_every_file(tmp_path):
    scene = make_scene(tmp_path / "scene", depth=False, frames=2)
    sidecar = export_scene(scene, "std", tmp_path / "std", jobs=SERIAL)
    loader = PublicLoader(tmp_path / "std")
    assert len(loader) == 2
    assert not loader[0]["raw"].any()
    assert not any(f.sensor_depth for f in sidecar.frames)


def test_label_size_is_an_option_that_keeps_the_aspect(tmp_path):
    scene = make_scene(tmp_path / "scene", frames=1)
    export_scene(
        scene, "std", tmp_path / "a", options=ExportOptions(label_size=(80, 60)), jobs=SERIAL
    )
    assert {image_size(p) for p in (tmp_path / "a").glob("*/*_mask.png")} == {(80, 60)}
    with pytest.raises(ToolkitError, match="aspect"):
        export_scene(scene, "std", tmp_path / "b", options=ExportOptions(label_size=(80, 80)))


def test_distorted_images_are_undistorted(tmp_path):
    """The layouts know no distortion: depth and NOCS must fit the pinhole that is told."""
    scene = make_scene(
        tmp_path / "scene", size=(640, 480), frames=1, distortion=(0.08, -0.05, 0.001, -0.001)
    )
    sidecar = export_scene(scene, "std", tmp_path / "std", jobs=SERIAL)
    assert sidecar.scene.cameras["color"].distortion == []
    sample = PublicLoader(tmp_path / "std")[0]
    fit = fitted(sample, 1, sidecar.label_cameras["color"].camera().K)
    truth = scene.T_cam_obj(0, 1)
    centre, _ = nocs_frame(scene.mesh("brick"))
    assert np.linalg.norm(fit.t - truth @ centre) < 1e-3
    assert rotation_angle(fit.R.T @ truth.R) < np.radians(0.5)


def test_pixels_at_the_border_are_compared_with_those_inside() -> None:
    """Of the 2x2 pixels around the last row and column, one row and one column do not exist."""
    camera = Camera(16, 12, 20.0, 20.0, 7.5, 5.5)
    index = np.zeros((12, 16), np.int16)
    index[:, :3] = -1
    nothing = np.zeros((12, 16), np.float32)
    composition = Composition(nothing, index, index.astype(np.int32), [])
    for shown, missing in ((1, 0), (2, 13 * 12)):
        mask = np.full((12, 16), shown, np.uint8)
        hidden = _hidden(composition, [1], camera, camera, mask)
        assert np.count_nonzero(hidden) == missing
        assert not hidden[:, :3].any()


def test_valid_pixels_are_those_with_sensor_depth() -> None:
    camera = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    plate = trimesh.creation.box((0.4, 0.2, 1e-4))
    placed = PlacedMesh(1, plate, SE3(np.eye(3), np.array([0, 0, 1.0])))
    composition = compose(get_renderer("raycast"), camera, [placed])
    old = ObjectTruth(
        object=1,
        T_cam_obj=placed.T_cam_obj.flat(),
        px_all=0,
        px_valid=0,
        px_visible=0,
        visible_fraction=0.0,
        bbox_amodal=None,
        bbox_visible=None,
    )
    sensor = np.ones((48, 64), np.float32)
    sensor[:24] = 0
    row = _row(old, composition, 0, camera, sensor)
    assert row.px_all == 24 * 12
    assert row.px_valid == 24 * 6
    assert _row(old, composition, 0, camera, None).px_valid == 24 * 12


def test_what_hides_objects_is_taken_over_to_the_labels_size(tmp_path):
    """Policy "sensor": what the sensor saw in front of an object hides it at half size too."""
    scene = make_scene(
        tmp_path / "scene", size=(640, 480), frames=1, near_strip=True, policy="sensor"
    )
    options = ExportOptions(label_size=(320, 240))
    sidecar = export_scene(scene, "std", tmp_path / "std", options=options, jobs=SERIAL)
    mask = PublicLoader(tmp_path / "std")[0]["mask"]
    full = read_ground_truth(scene, 0).mask
    for mask_id, object_id in ((1, 1), (2, 4), (3, 7)):
        shown, expected = np.count_nonzero(mask == mask_id), np.count_nonzero(full == object_id)
        assert shown == pytest.approx(expected / 4, rel=0.02, abs=4)
    assert not (mask[:, 214:] != 255).any()
    mug = next(o for o in sidecar.frames[0].objects if o.object == 7)
    assert mug.visible_fraction < 0.9


def test_the_background_of_a_nocs_picture_is_black() -> None:
    mask = np.array([[0, 3]], np.uint8)
    picture = nocs_image(np.full((1, 2, 3), 0.2, np.float32), mask)
    assert picture.tolist() == [[[0, 0, 0], [51, 51, 204]]]
