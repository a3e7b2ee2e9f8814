"""GN-Trans: images and truth of one camera or of two, and a pair that a stereo method can use."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from benchmark.cli.bench import main
from benchmark.data.check import check_split
from benchmark.data.field.label_sets import open_labels
from benchmark.data.frame import BACKGROUND, Material
from benchmark.data.infrared import InfraredSource
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import unproject_depth
from tests.benchmark.data.field_sets import (
    BOXES,
    WALL_M,
    Box,
    Drawn,
    draw,
    put,
    put_color,
    put_depth,
)
from tests.benchmark.data.test_field_sets import check_geometry, names, opened, rendered

# The description at a quarter: 160x90 for 640x360, and truth of twice that size.
SIZE, TRUE_SIZE = (160, 90), (320, 180)
COLOR_K = [910.814 / 8, 910.814 / 8, 79.5, 44.5]
INFRARED_K = [896.866 / 8, 896.866 / 8, 79.5, 44.5]
# A quarter of GraspNet's own 1280x720.
GRASPNET_K = [927.17 / 4, 927.37 / 4, 651.32 / 4, 349.62 / 4]
# Places of the infrared cameras beside the colour camera, along x.
LEFT_M, RIGHT_M = 0.0151, 0.0701
CLASSES = (18, 6)
GREYS = np.array([40, 120, 200], np.uint8)  # of the wall and the boxes
CAM0_TABLE = Box((1, 1, 1), (180, 20, 0), (0.1, 0.2, 0.6)).T


def larger(K: list[float], factor: int) -> list[float]:
    """The camera of an image that is larger, pixel centres at whole numbers."""
    return [*(f * factor for f in K[:2]), *((c + 0.5) * factor - 0.5 for c in K[2:])]


def measured(depth: np.ndarray) -> np.ndarray:
    """What the sensor gives: holes on the left, 2 mm of noise elsewhere."""
    raw = depth + np.random.default_rng(0).normal(0, 0.002, depth.shape)
    raw[:, :20] = 0
    return raw


def write_gn_trans(
    root: Path, scene: int = 100, *, two_cameras: bool = False, frames: int = 2
) -> Drawn:
    """A scene; truth of GraspNet's camera with `two_cameras`, else of that of the images."""
    images, name = root / f"GN-Trans/scenes/{scene:05d}", f"scene_{scene:04d}/realsense"
    boxes = [BOXES[0], BOXES[1]]
    drawn = draw(COLOR_K, SIZE, boxes)
    K = GRASPNET_K if two_cameras else larger(COLOR_K, 2)
    true = draw(K, TRUE_SIZE, boxes)
    eyes = []
    for at in (LEFT_M, RIGHT_M):
        moved = [Box(b.sides, b.turn, (b.centre[0] - at, *b.centre[1:])) for b in boxes]
        eyes.append(draw(INFRARED_K, SIZE, moved))
    filed = GRASPNET_K
    for i in range(frames):
        stem = f"{i:04d}"
        put_color(images / f"{stem}_color.png", SIZE, i)
        put_depth(images / f"{stem}_depth_sim.png", measured(drawn.depth), 0.001)
        for eye, end in zip(eyes, ("l", "r"), strict=True):
            put(images / f"{stem}_ir_{end}.png", GREYS[eye.index + 1])
        virtual = root / "graspnet/virtual_scenes" / name
        put_depth(virtual / f"{stem}_depth.png", true.depth, 0.001)
        put(virtual / f"{stem}_label.png", np.array([0, *CLASSES], np.uint8)[true.index + 1])
        meta = root / "graspnet/scenes" / name / "meta"
        meta.mkdir(parents=True, exist_ok=True)
        fx, fy, cx, cy = filed
        savemat(meta / f"{stem}.mat", {
            "intrinsic_matrix": np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
            "cls_indexes": np.array(CLASSES)[None], "factor_depth": 1000,
            "poses": np.stack([b.T[:3] for b in boxes], axis=-1),
        })  # fmt: skip
    top = root / "graspnet/scenes" / name
    np.save(top / "cam0_wrt_table.npy", CAM0_TABLE)
    moves = [Box((1, 1, 1), (0, 3 * i, 0), (0.02 * i, 0, 0)).T for i in range(256)]
    np.save(top / "camera_poses.npy", np.stack(moves))
    for box, number in zip(boxes, CLASSES, strict=True):
        box.save(root / f"graspnet/models/{number - 1:03d}/nontextured.ply")
    return drawn


@pytest.mark.parametrize("two_cameras", [False, True])
def test_gn_trans(tmp_path: Path, two_cameras: bool) -> None:
    drawn = write_gn_trans(tmp_path / "data", two_cameras=two_cameras)
    source = opened("gn-trans-test-seen", tmp_path / "data")
    assert names(source) == ["00100/0000", "00100/0001"]
    frame = source.load(1)
    assert np.abs(frame.depth_raw - measured(drawn.depth)).max() < 6e-4
    assert frame.camera.size == TRUE_SIZE and frame.color.shape == (SIZE[1], SIZE[0], 3)
    assert list(source.poses(1)) == list(CLASSES)
    if two_cameras:
        # Depth of another camera is that of the nearest pixel at edges, interpolated elsewhere.
        depth, index = rendered(frame.camera, list(source.poses(1).values()))
        for i, mask_id in enumerate(CLASSES):
            both = (index == i) & (frame.mask == mask_id)
            assert both.sum() > 0.97 * (index == i).sum() > 200
            error = np.abs(depth - frame.depth_true)[both]
            assert np.median(error) < 4e-4 and np.quantile(error, 0.9) < 2e-3
    else:
        check_geometry(frame, source.poses(1), [[CLASSES[0]], [CLASSES[1]]])
    # Truth and raw depth are of one place: four pixels of the one on each of the other.
    inner = drawn.depth[:, 20:] == WALL_M
    there = frame.depth_true[::2, ::2][:, 20:] > 0
    apart = np.abs(frame.depth_raw - frame.depth_true[::2, ::2])[:, 20:]
    assert there.mean() > 0.93 and np.quantile(apart[there & inner], 0.95) < 0.006
    found = {i.mask_id: (i.model, i.material) for i in frame.instances}
    assert found == {18: ("017", Material.RAW), 6: ("005", Material.RAW)}
    assert all(mesh.path.is_file() for mesh in source.meshes(1).values())
    assert set(np.unique(frame.mask)) == {BACKGROUND, *CLASSES}
    text = check_split(tmp_path / "data", "gn-trans-test-seen").text()
    how = "is sampled from GraspNet's camera" if two_cameras else "lies as raw depth"
    assert f"true depth {how}" in text and "all 256 frames of GraspNet: 1" in text


def test_the_pair_of_gn_trans(tmp_path: Path) -> None:
    """Points of each object, and of the wall, project to its grey in both images."""
    write_gn_trans(tmp_path)
    source = opened("gn-trans-test-seen", tmp_path)
    assert isinstance(source, InfraredSource)
    frame, pair = source.load(0), source.infrared(0)
    points = unproject_depth(frame.depth_true, frame.camera)
    index = np.select([frame.mask == c for c in CLASSES], [1, 2], 0)
    in_left = pair.T_color_left.inverse() @ points.reshape(-1, 3)
    for image, shift in ((pair.left, 0.0), (pair.right, pair.baseline_m)):
        uv = np.rint(pair.camera.project(in_left - [shift, 0, 0])).astype(int)
        inside = ((uv >= 0) & (uv < pair.camera.size)).all(axis=1)
        seen = image[uv[inside, 1], uv[inside, 0]]
        wanted = GREYS[index.ravel()[inside]]
        for grey in GREYS[1:]:
            # What the colour camera sees of a side, the infrared ones may not.
            assert (seen[wanted == grey] == grey).mean() > 0.9
        assert (seen == wanted).mean() > 0.94
    assert np.allclose(pair.T_color_left.t, [0.0151, 0, 0])


def test_programs_elsewhere_are_given_the_pair(tmp_path: Path) -> None:
    write_gn_trans(tmp_path / "data", frames=1)
    words = ["infer-list", "--data", str(tmp_path / "data"), "--split", "gn-trans-test-seen"]
    assert main([*words, "--out", str(tmp_path / "list")]) == 0
    with (tmp_path / "list/frames.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert row["ir_left"].endswith("0000_ir_l.png") and row["ir_right"].endswith("0000_ir_r.png")
    assert float(row["baseline_m"]) == 0.055


def test_parts_and_cameras_of_gn_trans(tmp_path: Path) -> None:
    for scene in (0, 99, 130, 189):
        write_gn_trans(tmp_path, scene, frames=1)
    assert names(opened("gn-trans-train", tmp_path)) == ["00000/0000", "00099/0000"]
    assert names(opened("gn-trans-test-similar", tmp_path)) == ["00130/0000"]
    source = opened("gn-trans-test-novel", tmp_path)
    pose = source.camera_pose(0)
    assert pose is not None and np.allclose(pose.matrix(), CAM0_TABLE)
    with pytest.raises(ToolkitError, match="nothing of this split is here"):
        opened("gn-trans-test-seen", tmp_path)
    falls_on_its_depth_within_noise(tmp_path)


def falls_on_its_depth_within_noise(root: Path) -> None:
    labels = open_labels(root, "gn-trans-test-novel").labels(0)
    assert [o.model for o in labels.objects] == ["005", "017"]
    assert all(o.mesh is not None and o.mesh.path.is_file() for o in labels.objects)


def test_what_gn_trans_lacks_is_told(tmp_path: Path) -> None:
    write_gn_trans(tmp_path)
    virtual = tmp_path / "graspnet/virtual_scenes/scene_0100/realsense"
    (virtual / "0001_depth.png").unlink()
    (virtual / "0001_label.png").unlink()
    report = check_split(tmp_path, "gn-trans-test-seen")
    top = "00100/graspnet/virtual_scenes/scene_0100/realsense"
    assert report.missing == {
        "ground-truth depth": [f"{top}/0001_depth.png"], "mask": [f"{top}/0001_label.png"],
    }  # fmt: skip
    assert "issue 4" in report.text()
    # GraspNet's own label stands in for one that was not rendered.
    put(tmp_path / "graspnet/scenes/scene_0100/realsense/label/0001.png",
        np.zeros((TRUE_SIZE[1], TRUE_SIZE[0]), np.uint8))  # fmt: skip
    assert "mask" not in check_split(tmp_path, "gn-trans-test-seen").missing
    (tmp_path / "GN-Trans/scenes/00100/0000_ir_r.png").unlink()
    source = opened("gn-trans-test-seen", tmp_path)
    assert source.infrared_images(0) is None
    assert isinstance(source, InfraredSource)
    with pytest.raises(ToolkitError, match="no infrared pair"):
        source.infrared(0)
    (tmp_path / "graspnet/scenes/scene_0100/realsense/meta/0000.mat").write_bytes(b"x" * 200)
    with pytest.raises(ToolkitError, match="no file of MATLAB 5"):
        opened("gn-trans-test-seen", tmp_path).load(0)
