"""Labels of sets as the audit reads them: poses, meshes, materials and images belong together."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmark.data.field.label_sets import open_labels
from benchmark.data.labelled import LabelledSet
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.camera import Camera
from tests.benchmark.bop_on_disk import write_bop
from tests.benchmark.data import field_sets as sets
from tests.benchmark.data.field_sets import BOXES

# What the sensor of these sets reads too far on either box.
RAW_ERRORS_M = (0.0, 0.02)


def falls_on_its_depth(source: LabelledSet, index: int = 0) -> None:
    """The surface of each mesh that the camera sees has the sensor's depth there."""
    frame, images = source.labels(index), source.images(index)
    assert frame.objects
    assert images.depth is not None
    for item, error in zip(frame.objects, RAW_ERRORS_M, strict=True):
        assert item.mesh is not None
        points, _ = trimesh.sample.sample_surface(item.mesh.load(), 3000, seed=0)
        points = item.T_cam_obj @ np.asarray(points)
        uv = np.rint(images.camera.project(points)).astype(int)
        inside = (uv >= 0).all(axis=1) & (uv < images.camera.size).all(axis=1)
        seen = images.depth[uv[inside, 1], uv[inside, 0]]
        behind = (seen - points[inside, 2])[seen > 0]
        # A half or more is on the far side, or hidden.
        near = float((np.abs(behind - error) < 0.003).mean())
        assert near > 0.2, (item.name, near)


def test_housecat(tmp_path: Path) -> None:
    sets.write_housecat(tmp_path)
    source = open_labels(tmp_path, "housecat6d-test")
    frame = source.labels(0)
    assert [(o.model, o.material) for o in frame.objects] == [
        ("glass-new_3", "transparent"), ("cutlery-fork_1", "specular"),
    ]  # fmt: skip
    for item, box in zip(frame.objects, BOXES, strict=True):
        assert np.allclose(item.T_cam_obj.t, box.centre, atol=1e-6)
    falls_on_its_depth(source)


def test_clearpose_needs_meshes_by_number(tmp_path: Path) -> None:
    sets.write_clearpose(tmp_path / "clearpose")
    bare = open_labels(tmp_path, "clearpose-train").labels(0)
    assert bare.objects
    assert all(o.mesh is None for o in bare.objects)
    assert bare.objects[0].material == "transparent"
    models = tmp_path / "meshes"
    models.mkdir()
    numbers = [o.name.rpartition("_")[2] for o in bare.objects]
    for number, box in zip(numbers, BOXES, strict=True):
        box.save(models / f"{number}.obj")
    falls_on_its_depth(open_labels(tmp_path, "clearpose-train", models=models))


def test_transcg_names_objects_by_the_list_of_the_set(tmp_path: Path) -> None:
    sets.write_transcg(tmp_path / "transcg")
    for sensor in ("d435", "l515"):
        frame = open_labels(tmp_path, f"transcg-{sensor}-test").labels(0)
        assert frame.objects
        assert {o.material for o in frame.objects} == {"transparent"}


def test_bop_with_a_sensor(tmp_path: Path) -> None:
    sets.write_bop_sensors(tmp_path / "xyzibd", "realsense")
    source = open_labels(tmp_path, "xyzibd-val-realsense")
    assert {o.material for o in source.labels(0).objects} == {"specular"}
    falls_on_its_depth(source)


def test_bop_without_images(tmp_path: Path) -> None:
    R = np.eye(3) + np.array([[0.0, 0.004, 0], [0.004, 0, 0], [0, 0, 0]])
    first = (1, SE3(np.eye(3), np.array([0.0, 0, 0.8])))
    root = write_bop(tmp_path, {0: [first, first], 7: [first, (2, first[1])]}, camera=True)
    path = root / "test/000001/scene_gt.json"
    gt = json.loads(path.read_text())
    gt["0"][1]["cam_R_m2c"] = R.ravel().tolist()
    path.write_text(json.dumps(gt))
    source = open_labels(root, "bop")
    assert [str(k) for k in source.keys()]  # noqa: SIM118 == ["000001/000000", "000001/000007"]
    frame = source.labels(0)
    assert [o.name for o in frame.objects] == ["obj_000001_1", "obj_000001_2"]
    assert not frame.has_images
    assert frame.objects[0].rotation_off == 0
    assert frame.objects[1].rotation_off == pytest.approx(0.008, abs=1e-4)
    mesh = frame.objects[0].mesh
    assert mesh is not None
    assert np.allclose(mesh.load().extents, (0.06, 0.04, 0.1))
    seen = source.labels(1).T_world_cam
    assert seen is not None
    assert np.allclose(seen.t, (-0.07, 0, 0))
    with pytest.raises(ToolkitError, match="no colour image of this frame"):
        source.images(0)
    # The split folder and the scene name the same set.
    for part in ("test", "test/000001"):
        assert [o.mesh for o in open_labels(root / part, "bop").labels(0).objects] == [
            o.mesh for o in frame.objects
        ]


@pytest.mark.parametrize(
    ("split", "said"),
    [
        ("bop", "no scene_gt.json here"),
        ("nothing", "nothing"),
        ("hammer-d435-test", "no labels that can be audited"),
    ],
)
def test_what_cannot_be_audited_is_refused(tmp_path: Path, split: str, said: str) -> None:
    sets.write_hammer(tmp_path)
    with pytest.raises(ToolkitError, match=said):
        open_labels(tmp_path, split)
    with pytest.raises(ToolkitError, match="no such folder"):
        open_labels(tmp_path / "away", split)


def test_a_camera_of_another_size_is_refused(tmp_path: Path) -> None:
    """Depth that is not of the colour image's size is not the depth of its pixels."""
    place = SE3(np.eye(3), np.array([0.0, 0, 0.8]))
    root = write_bop(tmp_path, {0: [(1, place)]})
    camera = Camera(640, 480, 500, 500, 320, 240)
    sets.put_color(root / "test/000001/rgb/000000.png", camera.size)
    sets.put_depth(root / "test/000001/depth/000000.png", np.full((240, 320), 0.8), 0.001)
    with pytest.raises(ToolkitError, match="not of the colour image's size"):
        open_labels(root, "bop").images(0)
