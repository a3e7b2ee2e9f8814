"""PhoCaL: unit, axes and ids, proved by a mesh at its pose."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmark.data.check import check_split
from benchmark.data.field.label_sets import open_labels
from benchmark.data.frame import BACKGROUND, Material
from benchmark.data.splits import open_split
from std_toolkit.errors import ToolkitError
from tests.benchmark.data.field_sets import (
    BOXES,
    Drawn,
    draw,
    put,
    put_color,
    put_depth,
    with_holes,
)
from tests.benchmark.data.test_field_sets import check_geometry, check_raw, names, opened

SIZE, K = (274, 213), [188.0, 189.0, 136.5, 106.0]
# The first object of the list is in no picture: ids count places in the list all the same.
HIDDEN = {"cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0, 0, -5.0]}


def write_phocal(root: Path, *, scale: float = 1000.0, key: str = "{}") -> Drawn:
    """A sequence of three frames, of which number 4 is for tests."""
    drawn = draw(K, SIZE)
    top, fx, fy, cx, cy = root / "sequence_2", *K
    labels = [HIDDEN | {"class_id": 3, "inst_id": 0}] + [
        {"cam_R_m2c": box.R.ravel().tolist(), "cam_t_m2c": list(box.centre), "class_id": c,
         "inst_id": i}
        for box, c, i in zip(BOXES, (7, 3), (2, 1), strict=True)
    ]  # fmt: skip
    for n in (3, 4, 5):
        put_color(top / f"rgb/{n:06d}.png", SIZE, n)
        put_depth(top / f"depth/{n:06d}.png", with_holes(drawn), 1 / scale)
        mask = np.where(drawn.index >= 0, drawn.index + 2, 0)
        put(top / f"mask/{n:06d}.png", mask.astype(np.uint8))
    every = {key.format(n): labels for n in (3, 4, 5)}
    (top / "rgb_scene_gt.json").write_text(json.dumps(every))
    camera = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "depth_scale": scale}
    (top / "scene_camera.json").write_text(json.dumps({"rgb": camera}))
    np.savez(top / "train_test_split.npz", train_idxs=[3, 5], test_idxs=[4])
    classes = {
        "7": {"class_name": "glass", "objs": {"2": "glass_tall"}, "scales": {"2": [1, 1, 1]}},
        "3": {"class_name": "cutlery", "objs": {"0": "fork", "1": "spoon"}, "scales": {}},
    }
    (root / "class_obj_taxonomy.json").write_text(json.dumps(classes))
    for box, name in zip(BOXES, ("glass/glass_tall", "cutlery/spoon"), strict=True):
        box.save(root / f"obj_models_small_size/{name}.obj")
    BOXES[0].save(root / "obj_models_small_size/cutlery/fork.obj")
    return drawn


@pytest.mark.parametrize(("scale", "key"), [(1000.0, "{}"), (4000.0, "{:06d}")])
def test_a_frame_and_its_labels(tmp_path: Path, scale: float, key: str) -> None:
    drawn = write_phocal(tmp_path / "PhoCAL_release", scale=scale, key=key)
    source = opened("phocal-test", tmp_path)
    assert names(source) == ["sequence_2/000004"]
    assert names(opened("phocal-train", tmp_path)) == ["sequence_2/000003", "sequence_2/000005"]
    frame = source.load(0)
    check_raw(frame, drawn)
    poses = {i: T for i, T in source.poses(0).items() if i > 1}
    check_geometry(frame, poses, [[2], [3]])
    assert np.abs(frame.depth_true - drawn.depth)[frame.depth_true > 0].max() < 1e-4
    assert set(np.unique(frame.mask)) == {2, 3, BACKGROUND}
    named = {i.mask_id: (i.category, i.model, i.material) for i in frame.instances}
    assert named[2] == ("glass", "glass_tall", Material.TRANSPARENT)
    assert named[3] == ("cutlery", "spoon", Material.SPECULAR)
    assert all(mesh.path.is_file() for mesh in source.meshes(0).values())


def test_labels_can_be_audited_and_the_set_checked(tmp_path: Path) -> None:
    write_phocal(tmp_path)
    labels = open_labels(tmp_path, "phocal-test").labels(0)
    assert [o.model for o in labels.objects] == ["fork", "glass_tall", "spoon"]
    report = check_split(tmp_path, "phocal-test")
    assert report.is_complete and "experimental" in report.text()
    (tmp_path / "sequence_2/depth/000004.png").unlink()
    assert "no raw depth: 1 of the frames" in check_split(tmp_path, "phocal-test").text()
    (tmp_path / "empty").mkdir()
    with pytest.raises(ToolkitError, match="nothing of this split is here"):
        opened("phocal-test", tmp_path / "empty")


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (lambda top: (top / "sequence_2/train_test_split.npz").unlink(), "train_test_split"),
        (lambda top: np.savez(top / "sequence_2/train_test_split.npz", other=[4]), "test_idxs"),
        (lambda top: edit(top / "class_obj_taxonomy.json", '"2": "glass_tall"', '"9": "x"'),
         "has not"),
        (lambda top: edit(top / "class_obj_taxonomy.json", "glass_tall", "../../x"), "name of"),
        (lambda top: edit(top / "sequence_2/rgb_scene_gt.json", '"4"', '"40"'), "no labels"),
        (lambda top: edit(top / "sequence_2/scene_camera.json", "1000.0", "0"), "depth_scale"),
        (lambda top: (top / "sequence_2/rgb_scene_gt.json").write_text("{"), "rgb_scene_gt"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path: Path, harm: Callable[[Path], object], told: str) -> None:
    write_phocal(tmp_path)
    harm(tmp_path)
    with pytest.raises(ToolkitError) as error:
        open_split("phocal-test", tmp_path).load(0)
    assert told in str(error.value)


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
