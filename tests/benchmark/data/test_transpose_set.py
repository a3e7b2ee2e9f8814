"""TRansPose: unit, axes, masks by place and parts, on a set written from its description alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmark.data.check import check_split
from benchmark.data.field.label_sets import open_labels
from benchmark.data.frame import BACKGROUND, Material
from std_toolkit.errors import ToolkitError
from tests.benchmark.data.field_sets import (
    BOXES,
    Box,
    Drawn,
    draw,
    put,
    put_color,
    put_depth,
    with_holes,
)
from tests.benchmark.data.test_field_sets import check_geometry, check_raw, names, opened
from tests.benchmark.data.test_labelled_sets import falls_on_its_depth

SIZE = (160, 120)
# That of the description at a quarter of 640x480.
K = [603.776 / 4, 604.632 / 4, (329.259 + 0.5) / 4 - 0.5, (246.485 + 0.5) / 4 - 0.5]
# Places in the list of a frame are no ids of models.
PLACES = (3, 7)
NAMES = ("beaker 500", "wine_glass")
# The left camera beside the right one, and both on a hand that moves.
SHIFT = Box((1, 1, 1), (0, 5, 0), (0.06, 0, 0.01)).T
HAND = [Box((1, 1, 1), (0, 10 * i, 5), (0.3, 0.1 * i, 0.4)).T for i in range(3)]
MOUNTED = Box((1, 1, 1), (0, 0, 90), (0.07, 0.05, 0.06)).T


def turned(box: Box, T: np.ndarray) -> Box:
    from scipy.spatial.transform import Rotation

    moved = T @ box.T
    turn = Rotation.from_matrix(moved[:3, :3]).as_euler("xyz", degrees=True)
    return Box(box.sides, tuple(turn), tuple(moved[:3, 3]))


def write_transpose(
    root: Path, sequence: str = "sequences/seq_H_01", *, unit: float = 0.001, channels: int = 3
) -> dict[str, Drawn]:
    """Two frames by both cameras; `unit` is metres per number of the poses."""
    top, drawn = root / sequence, {}
    for camera, boxes in (("R", BOXES), ("L", [turned(b, np.linalg.inv(SHIFT)) for b in BOXES])):
        one = drawn[camera] = draw(K, SIZE, boxes)
        at = top / f"cam_{camera}"
        for stem in ("000001", "000002"):
            put_color(at / f"rgb/{stem}.png", SIZE)
            put_depth(at / f"depth/raw/{stem}.png", with_holes(one), 0.001)
            put_depth(at / f"depth/fixed/{stem}.png", one.depth + 0.05, 0.001)
            truth = np.where(one.objects, one.depth, 0)
            put_depth(at / f"depth/rendered/{stem}.png", truth, 0.001)
            poses = {}
            for i, (place, box, name) in enumerate(zip(PLACES, boxes, NAMES, strict=True)):
                inside = 255 * (one.index == i).astype(np.uint8)
                image = np.stack([inside] * 3, axis=-1) if channels == 3 else inside
                put(at / f"mask/{stem}_{place:06d}.png", image)
                poses[str(place)] = {
                    "obj_id": 40 + i, "obj_name": name, "rot": box.R.ravel().tolist(),
                    "tra": (np.array(box.centre) / unit).tolist(), "bb": [0, 0, 1, 1],
                    "mask_img": f"{stem}_{place:06d}.png",
                }  # fmt: skip
            (at / "pose").mkdir(exist_ok=True)
            (at / f"pose/{stem}.json").write_text(json.dumps(poses))
        fx, fy, cx, cy = K
        info = {"intrinsic": [fx, 0, cx, 0, fy, cy, 0, 0, 1], "width": SIZE[0]}
        (at / "camera_info.json").write_text(json.dumps(info))
    mounted = {"T_EE2cam_R": MOUNTED, "T_EE2cam_L": MOUNTED @ SHIFT, "T_EE2cam_T": np.eye(4)}
    (top / "extrinsic.json").write_text(
        json.dumps({name: T.ravel().tolist() for name, T in mounted.items()})
    )
    hands = {
        f"{i:06d}": {"rot": T[:3, :3].ravel().tolist(), "tra": T[:3, 3].tolist()}
        for i, T in enumerate(HAND)
    }
    (top / "World2EEs.json").write_text(json.dumps(hands))
    for box, name in zip(BOXES, NAMES, strict=True):
        box.save(root / f"models/{name}/{name}.obj")
    (root / "models/object_label.json").write_text(json.dumps({NAMES[0]: 40, NAMES[1]: 41}))
    return drawn


@pytest.mark.parametrize("unit", [0.001, 1.0])
@pytest.mark.parametrize(("side", "camera"), [("right", "R"), ("left", "L")])
def test_transpose(tmp_path: Path, side: str, camera: str, unit: float) -> None:
    drawn = write_transpose(tmp_path / "TRansPose", unit=unit)[camera]
    source = opened(f"transpose-{side}-train", tmp_path)
    assert names(source) == ["seq_H_01/000001", "seq_H_01/000002"]
    frame = source.load(1)
    check_raw(frame, drawn)
    assert list(source.poses(1)) == list(PLACES)
    check_geometry(frame, source.poses(1), [[PLACES[0]], [PLACES[1]]])
    assert (frame.mask == BACKGROUND).sum() == (~drawn.objects).sum()
    found = {i.mask_id: (i.model, i.material) for i in frame.instances}
    assert found == {p: (n, Material.TRANSPARENT) for p, n in zip(PLACES, NAMES, strict=True)}
    assert all(mesh.path.is_file() for mesh in source.meshes(1).values())


def test_the_unit_of_poses_is_told_and_is_one(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_transpose(tmp_path)
    source = opened("transpose-right-train", tmp_path)
    source.poses(0)
    source.poses(1)
    assert caplog.text.count("does not state the unit of its poses") == 1
    assert "000001.json tells millimetres" in caplog.text
    path = tmp_path / "sequences/seq_H_01/cam_R/pose/000002.json"
    poses = json.loads(path.read_text())
    poses["7"]["tra"] = [x / 1000 for x in poses["7"]["tra"]]
    path.write_text(json.dumps(poses))
    with pytest.raises(ToolkitError, match="a place in metres, where 000001"):
        source.poses(1)


def test_both_cameras_of_transpose_see_the_objects_in_one_place(tmp_path: Path) -> None:
    write_transpose(tmp_path)
    right, left = (opened(f"transpose-{side}-train", tmp_path) for side in ("right", "left"))
    for index in range(2):
        poses = []
        for source in (right, left):
            camera = source.camera_pose(index)
            assert camera is not None
            poses.append({i: camera @ pose for i, pose in source.poses(index).items()})
        for place in PLACES:
            assert np.allclose(poses[0][place].matrix(), poses[1][place].matrix(), atol=1e-9)
    first, second = right.camera_pose(0), right.camera_pose(1)
    assert first is not None and second is not None
    assert np.allclose((first.inverse() @ second).matrix(),
                       np.linalg.inv(HAND[1] @ MOUNTED) @ HAND[2] @ MOUNTED)  # fmt: skip


def test_parts_of_transpose(tmp_path: Path) -> None:
    write_transpose(tmp_path, "test/seq_test_02/sequences/seq_test_02", channels=1)
    write_transpose(tmp_path, "sequences/train/seq_L_04")
    write_transpose(tmp_path, "sequences/test/seq_9")
    test = opened("transpose-right-test", tmp_path)
    assert [s.name for s in test.index.scenes] == ["seq_9", "seq_test_02"]
    assert test.load(2).mask.min() == PLACES[0]
    train = opened("transpose-right-train", tmp_path)
    assert [s.name for s in train.index.scenes] == ["seq_L_04"]
    # The folder of one sequence is a root as well.
    alone = tmp_path / "test/seq_test_02/sequences"
    assert len(opened("transpose-left-test", alone)) == 2


def test_labels_of_transpose(tmp_path: Path) -> None:
    write_transpose(tmp_path)
    source = open_labels(tmp_path, "transpose-right-train")
    assert [o.model for o in source.labels(0).objects] == list(NAMES)
    assert {o.material for o in source.labels(0).objects} == {"transparent"}
    falls_on_its_depth(source)


def test_what_transpose_lacks_is_told(tmp_path: Path) -> None:
    write_transpose(tmp_path)
    report = check_split(tmp_path, "transpose-right-train")
    assert report.is_complete and report.frames == 2
    assert "meshes: 2 here; the set has 99 objects" in report.text()
    assert "third parties" in report.text() and "CC BY-NC-SA" in report.text()
    top = tmp_path / "sequences/seq_H_01/cam_R"
    (top / "mask/000002_000007.png").unlink()
    (top / "pose/000001.json").unlink()
    report = check_split(tmp_path, "transpose-right-train")
    assert report.missing == {
        "poses": ["seq_H_01/cam_R/pose/000001.json"],
        "mask 7": ["seq_H_01/cam_R/mask/000002_000007.png"],
    }


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("tra", [0.0, 0.1, 25.0], "in metres or in millimetres"),
        ("tra", [0.0, 0.1, -0.8], "in metres or in millimetres"),
        ("rot", [1.0, 0, 0, 0, 1, 0, 0, 0, 2], "no pose"),
        ("obj_name", "../../other", "expected the name of a model"),
    ],
)
def test_damaged_poses_of_transpose_are_one_line(
    tmp_path: Path, name: str, value: object, said: str
) -> None:
    write_transpose(tmp_path)
    path = tmp_path / "sequences/seq_H_01/cam_R/pose/000001.json"
    document = json.loads(path.read_text())
    document["3"][name] = value
    path.write_text(json.dumps(document))
    source = opened("transpose-right-train", tmp_path)
    with pytest.raises(ToolkitError, match=said) as error:
        source.load(0)
        source.poses(0)
    assert "000001.json" in str(error.value) and "\n" not in str(error.value)
