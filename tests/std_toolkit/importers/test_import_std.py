"""STD and DREDS downloads: made here in the form that their loaders tell."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, rotation_angle, so3_exp
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.importer import detect_format
from std_toolkit.importers.options import ImportRequest
from std_toolkit.importers.std_objects import read_meta
from std_toolkit.io.exr import write_exr
from std_toolkit.rendering.choose import get_renderer
from std_toolkit.rendering.maps import render_scene_maps
from std_toolkit.rendering.renderer import PlacedMesh
from std_toolkit.scene.model import pose_from_list

POSES = {
    1: SE3(so3_exp([0.4, 0.2, 0.1]), np.array([-0.08, 0.02, 0.6])),
    2: SE3(so3_exp([-0.3, 0.9, 0.2]), np.array([0.1, -0.03, 0.7])),
}
SCALES = {1: 0.2, 2: 0.15}


def unit_mesh() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=1)
    v = np.array(mesh.vertices)
    v[:, 0] += 0.5 * np.maximum(v[:, 1], 0) + np.maximum(v[:, 2], 0) ** 2
    low, high = v.min(0), v.max(0)
    mesh.vertices = (v - (low + high) / 2) / np.linalg.norm(high - low)
    return mesh


def three(values: np.ndarray) -> dict[str, np.ndarray]:
    values = values.astype(np.float32)
    return {"R": values, "G": values, "B": values}


def make(top: Path, layout: str, frames: int = 3) -> Path:
    """A scene with maps at 320x180 and colour at twice that."""
    folder = top / "shapenet/00007"
    folder.mkdir(parents=True)
    focal = 446.31 if layout == "dreds" else 918.295 / 2
    focal_y = 446.31 if layout == "dreds" else 917.544 / 2
    camera = Camera(320, 180, focal / 2, focal_y / 2, 159.5, 89.5)
    mesh = unit_mesh()
    for i in range(frames):
        shift = SE3(so3_exp([0, 0, 0.05 * i]), np.zeros(3))
        placed = [
            PlacedMesh(k, mesh.copy().apply_scale(SCALES[k]), shift @ T) for k, T in POSES.items()
        ]
        maps = render_scene_maps(get_renderer("raycast"), camera, placed)
        stem = str(folder / f"{i:04d}")
        rng = np.random.default_rng(i)
        color = rng.integers(0, 255, (360, 640, 3), dtype=np.uint8)
        cv2.imwrite(stem + "_color.png", color)
        nocs = maps.nocs.copy()
        nocs[..., 2] = 1 - nocs[..., 2]
        picture = np.rint(nocs * 255).astype(np.uint8)
        picture[maps.mask == 0] = 0
        cv2.imwrite(stem + "_coord.png", picture[..., ::-1])
        mask = np.where(maps.mask == 0, 255, maps.mask).astype(np.uint8)
        if layout == "dreds":
            raw = np.where(maps.depth > 0, maps.depth, 1.2)
            raw[:9] = -0.001
            write_exr(Path(stem + "_simDepthImage.exr"), three(raw))
            write_exr(Path(stem + "_depth_120.exr"), three(np.where(raw > 0, raw, 1.2)))
            half = {"R": (mask / 255).astype(np.float16)}
            write_exr(Path(stem + "_mask.exr"), half)
        else:
            raw = np.full((360, 640), 0.8, np.float32)
            raw[:9] = 0
            write_exr(Path(stem + "_depth_415.exr"), three(raw))
            write_exr(Path(stem + "_gt_depth.exr"), three(maps.depth))
            cv2.imwrite(stem + "_mask.png", mask)
        lines = [
            # Rotations of the files are not to be trusted: here they are plainly wrong.
            f"{k} {c} {s} inst{k} {SCALES[k]} {m} 1 0 0 0 {x} {y} {z} "
            for k, c, s, m in ((1, 6, "03797390", 2), (2, 1, "02876657", 3))
            for x, y, z in [(shift @ POSES[k]).t]
        ]
        Path(stem + "_meta.txt").write_text("\n".join(lines) + "\n")
    for k, synset in ((1, "03797390"), (2, "02876657")):
        cad = top / f"cad_model/syn_test/{synset}/inst{k}"
        cad.mkdir(parents=True)
        mesh.export(cad / "model.obj")
    return folder


@pytest.mark.parametrize("layout", ["std", "dreds"])
def test_downloads_become_scenes(layout, tmp_path):
    folder = make(tmp_path / layout, layout)
    assert detect_format(folder) == layout
    scene = import_recording(ImportRequest(source=folder, name="s"), tmp_path / "scene")
    camera = scene.camera(scene.frames[0])
    # DREDS renders its depth at half the size of its colour: colour is reduced to it.
    assert camera.size == ((320, 180) if layout == "dreds" else (640, 360))
    assert camera.cx == camera.width / 2 - 0.5
    expected = 446.31 / 2 if layout == "dreds" else 918.295 / 2
    assert camera.fx == pytest.approx(expected)
    assert scene.read_color(scene.frames[0]).shape[:2] == (camera.height, camera.width)
    depth = scene.read_depth(scene.frames[0])
    assert (depth[:9] == 0).all()
    assert depth[20, 20] > 0.5
    things = {o.id: o for o in scene.objects.objects}
    assert (things[1].material, things[2].material) == ("transparent", "specular")
    assert scene.objects.model_of(1).category == "mug"
    assert scene.poses is None
    for object_id, T in POSES.items():
        diagonal = np.linalg.norm(scene.objects.model_of(object_id).size_m)
        assert diagonal == pytest.approx(SCALES[object_id], rel=1e-6)
        label = scene.labels.of(object_id)
        found = pose_from_list(label.T_cam_obj)
        assert rotation_angle(found.R.T @ T.R) < np.radians(0.5)
        assert np.linalg.norm(found.t - T.t) < 1e-3
        assert set(label.views) == {"1", "2"}
    masks = cv2.imread(str(scene.root / "reference/mask/0000.png"), cv2.IMREAD_UNCHANGED)
    assert set(np.unique(masks)) == {0, 1, 2}
    assert (scene.root / "reference/depth/0000.exr").is_file()


def test_half_float_masks_are_rounded_not_truncated(tmp_path):
    """The public loader truncates: with half floats 131 of 255 ids come out one too small."""
    from std_toolkit.importers.foreign_files import read_mask_source

    ids = np.arange(256, dtype=np.uint8).reshape(16, 16)
    values = (ids / 255).astype(np.float16)
    write_exr(tmp_path / "m.exr", {"R": values, "G": values, "B": values})
    np.testing.assert_array_equal(read_mask_source(tmp_path / "m.exr", size=(16, 16)), ids)
    truncated = (values.astype(np.float32) * 255).astype(np.int32)
    assert np.count_nonzero(truncated != ids) > 100


def test_without_cad_models_frames_and_maps_still_come(tmp_path, caplog):
    folder = make(tmp_path / "d", "std", frames=1)
    (tmp_path / "d/cad_model").rename(tmp_path / "elsewhere")
    scene = import_recording(ImportRequest(source=folder, name="s"), tmp_path / "scene")
    assert scene.objects.objects == []
    assert "--models" in caplog.text
    models = tmp_path / "elsewhere/syn_test"
    again = import_recording(
        ImportRequest(source=folder, name="s", models=models), tmp_path / "again"
    )
    assert len(again.objects.objects) == 2
    with pytest.raises(ToolkitError, match="CAD model not found"):
        import_recording(
            ImportRequest(source=folder, name="s", models=tmp_path), tmp_path / "third"
        )


def test_meta_short_form(tmp_path):
    path = tmp_path / "0000_meta.txt"
    path.write_text("1 0 2 \n3 0 3\n")
    first, second = read_meta(path)
    assert (first.mask_id, first.material, first.scale) == (1, "transparent", None)
    assert (second.mask_id, second.material) == (3, "specular")


@pytest.mark.parametrize(
    "text",
    [
        "1 6",
        "1 6 a b",
        "x 6 a b 0.2 1",
        "0 6 a b 0.2 1 1 0 0 0 0 0 1",
        "255 6 a b 0.2 1 1 0 0 0 0 0 1",
        "1 9 a b 0.2 1 1 0 0 0 0 0 1",
        "1 6 a b 0.2 7 1 0 0 0 0 0 1",
        "1 6 .. ../../etc 0.2 1 1 0 0 0 0 0 1",
        "1 6 a b nan 1 1 0 0 0 0 0 1",
        "1 6 a b 200 1 1 0 0 0 0 0 1",
        "1 6 a b 0.2 1 1 0 0 0 0 0 1\n1 6 a b 0.2 1 1 0 0 0 0 0 1",
    ],
)
def test_malformed_meta_lines_are_refused(text, tmp_path):
    path = tmp_path / "0000_meta.txt"
    path.write_text(text)
    with pytest.raises(ToolkitError, match=r"0000_meta\.txt") as error:
        read_meta(path)
    assert "\n" not in str(error.value)


def test_missing_files_of_a_frame_are_named(tmp_path):
    folder = make(tmp_path / "d", "std", frames=2)
    (folder / "0001_color.png").unlink()
    with pytest.raises(ToolkitError, match="0001"):
        import_recording(ImportRequest(source=folder, name="s"), tmp_path / "scene")


def test_images_of_another_shape_need_intrinsics(tmp_path):
    folder = make(tmp_path / "d", "std", frames=1)
    write_exr(folder / "0000_depth_415.exr", three(np.full((480, 640), 0.8)))
    cv2.imwrite(str(folder / "0000_color.png"), np.zeros((480, 640, 3), np.uint8))
    with pytest.raises(ToolkitError, match="give --intrinsics"):
        import_recording(ImportRequest(source=folder, name="s"), tmp_path / "scene")
