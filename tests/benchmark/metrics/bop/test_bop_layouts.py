"""Layouts of BOP's data sets: several sensors, fisheye cameras, targets, rough rotations."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from bop_set import BRICK, CAMERA, CAN, TRUTHS, write_bop
from PIL import Image

from benchmark.metrics.bop import (
    BopEstimate,
    open_bop,
    read_bop_results,
    score_bop,
    score_bop_detection,
    write_bop_results,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.images import read_png

ALL = [BopEstimate(2, i, n, 0.5, T) for i, rows in TRUTHS.items() for n, T in rows]
NAMES = ("scene_gt", "scene_gt_info", "scene_camera")


def several_sensors(root: Path, *sensors: str) -> Path:
    """BOP-Industrial: every document and folder of a scene has the sensor's name behind."""
    folder = write_bop(root) / "test" / "000002"
    for sensor in sensors:
        for name in NAMES:
            shutil.copy(folder / f"{name}.json", folder / f"{name}_{sensor}.json")
        shutil.copytree(folder / "depth", folder / f"depth_{sensor}")
    for name in NAMES:
        (folder / f"{name}.json").unlink()
    shutil.rmtree(folder / "depth")
    return folder


def test_several_sensors(tmp_path: Path) -> None:
    folder = several_sensors(tmp_path / "ipd", "cam1", "photoneo")
    path = folder / "scene_gt_cam1.json"
    gt = json.loads(path.read_text())
    gt["4"][0]["cam_t_m2c"][0] += 500  # seen from elsewhere
    path.write_text(json.dumps(gt))
    root = tmp_path / "ipd"
    assert open_bop(root).sensors == {2: "photoneo"}  # as the BOP Challenge scores it
    assert score_bop(open_bop(root), ALL).ar == 1
    other = score_bop(open_bop(root, sensors=["cam1"]), ALL)
    assert other.mssd == other.mspd == pytest.approx(2 / 3)
    with pytest.raises(ToolkitError, match="no such sensor") as caught:
        open_bop(root, sensors=["cam7"])
    assert "cam1, photoneo" in str(caught.value.hint)
    shutil.copytree(root, tmp_path / "other")
    for path in (tmp_path / "other" / "test" / "000002").glob("*photoneo*"):
        path.rename(str(path).replace("photoneo", "cam2"))
    with pytest.raises(ToolkitError, match="several sensors") as caught:
        open_bop(tmp_path / "other")
    assert "--sensor: cam1, cam2" in str(caught.value.hint)


def fisheye(root: Path, parameters: list[float]) -> Path:
    """HOT3D: cam_model in place of cam_K, documents named by modality, no depth."""
    folder = write_bop(root) / "test" / "000002"
    for name in NAMES:
        (folder / f"{name}.json").rename(folder / f"{name}_rgb.json")
    shutil.rmtree(folder / "depth")
    model = {
        "projection_model_type": "CameraModelType.FISHEYE624",
        "projection_params": parameters,
        "image_width": 1408,
        "image_height": 1408,
    }
    rows = {str(i): {"cam_model": model} for i in TRUTHS}
    (folder / "scene_camera_rgb.json").write_text(json.dumps(rows))
    return root


def test_fisheye_cameras(tmp_path: Path) -> None:
    """One focal length as of Aria, or two; no VSD, and the width is the camera's."""
    k = [0.4, -0.5, 0.3, -0.1, 0.02, -0.002, 0.001, -0.002, 0.003, -0.001, 0.002, 0.0005]
    root = fisheye(tmp_path / "hot3d", [610.0, 704.0, 704.0, *k])
    dataset = open_bop(root)
    assert dataset.sensors == {2: "rgb"} and not dataset.has_depth
    scores = score_bop(dataset, ALL)
    assert scores.mssd == scores.mspd == 1 and np.isnan(scores.vsd)
    image = dataset.image(2, 4)
    assert image.size == (1408, 1408) and image.camera is None
    T = TRUTHS[4][0][1]
    # 30 pixels sideways at 61 cm: thresholds are 11, 22, 33, ... at this width.
    aside = SE3(T.R, T.t + np.array([30 / 610 * T.t[2], 0, 0]))
    moved = score_bop(dataset, [*ALL[:2], BopEstimate(2, 4, CAN, 0.5, aside)])
    assert moved.mspd == pytest.approx((2 + 0.8) / 3)
    fisheye(tmp_path / "two", [610.0, 610.0, 704.0, 704.0, *k])
    assert score_bop(open_bop(tmp_path / "two"), ALL).mspd == 1
    fisheye(tmp_path / "three", [610.0, *k])
    with pytest.raises(ToolkitError, match="15 or 16 parameters"):
        open_bop(tmp_path / "three")


def test_detection_alone(tmp_path: Path) -> None:
    """Data sets of 2024 list images, not objects."""
    root = write_bop(tmp_path / "set")
    (root / "test_targets_bop19.json").unlink()
    (root / "test_targets_bop24.json").write_text('[{"scene_id": 2, "im_id": 3}]')
    dataset = open_bop(root)
    assert dataset.targets == () and dataset.images == ((2, 3),)
    assert score_bop_detection(dataset, ALL).instances == {CAN: 1, BRICK: 1}


def test_rotations_as_filed(tmp_path: Path) -> None:
    """True poses and estimates may be off by 5 %, and are not changed; more is refused."""
    root = write_bop(tmp_path / "set")
    path = root / "test" / "000002" / "scene_gt.json"
    gt = json.loads(path.read_text())
    gt["4"][0]["cam_R_m2c"] = (1.02 * np.eye(3)).ravel().tolist()
    path.write_text(json.dumps(gt))
    (pose,), _ = open_bop(root).truths(2, 4, CAN)
    assert (1.02 * np.eye(3) == pose.R).all()
    results = tmp_path / "mine_set-test.csv"
    T = pose.t * 1000
    row = "2,4,1,0.9,{} 0 0 0 {} 0 0 0 1.02,{},-1"
    results.write_text(row.format(1.02, 1.02, " ".join(map(str, T))))
    (estimate,) = read_bop_results(results)
    assert (estimate.T_cam_obj.R == pose.R).all()
    scores = score_bop(open_bop(root), [*ALL[:2], estimate])
    assert scores.mssd == scores.mspd == 1
    for bad in (1.05, -1.0):
        results.write_text(row.format(bad, 1, "0 0 700"))
        with pytest.raises(ToolkitError, match="not a rotation") as caught:
            read_bop_results(results)
        assert caught.value.field == "line 1, R or t"
    gt["4"][0]["cam_R_m2c"][0] = 1.06
    path.write_text(json.dumps(gt))
    with pytest.raises(ToolkitError, match="not a rotation") as caught:
        open_bop(root)
    assert caught.value.field == "4[0]"


def test_the_size_of_images_without_any(tmp_path: Path) -> None:
    root = write_bop(tmp_path / "set")
    shutil.rmtree(root / "test" / "000002" / "depth")
    with pytest.raises(ToolkitError, match="size of the image"):
        score_bop(open_bop(root), ALL)
    camera = {"width": CAMERA.width, "height": CAMERA.height}
    (root / "camera.json").write_text(json.dumps(camera))
    assert score_bop(open_bop(root), ALL).mspd == 1


@pytest.mark.parametrize("kind", ["uint16", "float32"])
def test_depth_and_grey_in_tiff_files(tmp_path: Path, kind: str) -> None:
    """ITODD: gray/*.tif and depth/*.tif; the same VSD as of PNG files."""
    root = write_bop(tmp_path / "itodd")
    folder = root / "test" / "000002"
    (folder / "gray").mkdir()
    for path in (folder / "depth").glob("*.png"):
        values = read_png(path)
        path.unlink()
        Image.fromarray(values.astype(kind)).save(path.with_suffix(".tif"))
        grey = Image.fromarray(np.zeros(values.shape, np.uint8))
        grey.save(folder / "gray" / f"{path.stem}.tif")
    assert score_bop(open_bop(root), ALL).ar == 1
    assert open_bop(root).image(2, 4, depth=False).size == CAMERA.size
    torn = folder / "depth" / "000004.tif"
    torn.write_bytes(torn.read_bytes()[:200])
    assert "not a readable TIFF" in open_bop(root).image(2, 4).why_no_depth
    Image.fromarray(np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)).save(torn)
    assert "one channel" in open_bop(root).image(2, 4).why_no_depth


def multi_view(root: Path, entries: list[dict[str, object]]) -> Path:
    (root / "test_targets_multiview_bop25.json").write_text(json.dumps(entries))
    return root


def test_multi_view_targets(tmp_path: Path) -> None:
    """Views are pairs of sensor and image, or images alone; those of the scored sensor count."""
    root = tmp_path / "ipd"
    several_sensors(root, "cam1", "photoneo")
    views = [["photoneo", 4], ["cam1", 3], ["cam1", 4]]
    multi_view(root, [{"scene_id": 2, "im_id": views}, {"scene_id": 2, "im_id": [["cam1", 3]]}])
    dataset = open_bop(root, multi_view=True)
    assert dataset.images == ((2, 4),) and dataset.targets == () and len(dataset.groups) == 2
    assert dataset.groups[0].images("cam1") == [3, 4]
    assert open_bop(root, sensors=["cam1"], multi_view=True).images == ((2, 3), (2, 4))
    found = score_bop_detection(dataset, ALL)
    assert found.instances == {CAN: 1} and found.mssd == found.mssd_mm == 1
    # Single views need no such file, and know no groups.
    assert open_bop(root).groups == () and len(open_bop(root).images) == 2
    plain = multi_view(write_bop(tmp_path / "ycbv"), [{"scene_id": 2, "im_id": [3, 4]}])
    assert open_bop(plain, multi_view=True).images == ((2, 3), (2, 4))


@pytest.mark.parametrize(
    ("entries", "told"),
    [
        ([{"scene_id": 2, "im_id": [["cam1", 3]]}], "no view is of the sensor"),
        ([{"scene_id": 2, "im_id": [9]}], "no such image .*scene 2, image 9"),
        ([{"scene_id": 7, "im_id": [3]}], "no such scene"),
        ([{"scene_id": 2, "im_id": []}], "length >= 1"),
        ([{"scene_id": 2, "im_id": [-1]}], "no such image .*scene 2, image -1"),
        ([{"scene_id": 2, "im_id": [["cam1"]]}], "im_id"),
        ([{"scene_id": 2}], "im_id"),
        (None, "no multi-view targets here"),
    ],
)
def test_wrong_multi_view_targets(
    tmp_path: Path, entries: list[dict[str, object]] | None, told: str
) -> None:
    root = write_bop(tmp_path / "set")
    if entries is not None:
        multi_view(root, entries)
    with pytest.raises(ToolkitError, match=told) as caught:
        open_bop(root, multi_view=True)
    assert "test_targets_multiview_bop25.json" in str(caught.value)


def test_numbers_from_zero(tmp_path: Path) -> None:
    """IPD has an object 0; scenes and images may be 0, too."""
    root = write_bop(tmp_path / "ipd")
    scene = root / "test" / "000000"
    (root / "test" / "000002").rename(scene)
    shift = {"3": "0", "4": "1"}
    for name in NAMES:
        path = scene / f"{name}.json"
        rows = {shift[k]: v for k, v in json.loads(path.read_text()).items()}
        path.write_text(json.dumps(rows).replace(f'"obj_id": {CAN}', '"obj_id": 0'))
    for old, new in shift.items():
        (scene / "depth" / f"00000{old}.png").rename(scene / "depth" / f"00000{new}.png")
    (root / "models" / f"obj_00000{CAN}.ply").rename(root / "models" / "obj_000000.ply")
    info = root / "models" / "models_info.json"
    info.write_text(info.read_text().replace(f'"{CAN}": ', '"0": ', 1))
    (root / "test_targets_bop19.json").unlink()
    estimates = [
        BopEstimate(0, int(shift[str(i)]), 0 if n == CAN else n, 0.5, T)
        for i, rows in TRUTHS.items()
        for n, T in rows
    ]
    write_bop_results(tmp_path / "mine_ipd-test.csv", estimates)
    read = read_bop_results(tmp_path / "mine_ipd-test.csv")
    assert {(e.scene_id, e.im_id, e.obj_id) for e in read} == {(0, 0, 0), (0, 0, 5), (0, 1, 0)}
    scores = score_bop(open_bop(root), read)
    assert scores.ar == 1 and scores.targets == 3
    found = score_bop_detection(open_bop(root), read)
    assert found.instances == {0: 2, BRICK: 1} and found.map == 1
