"""Readers of the field's sets: unit, axes and ids, proved by a mesh at its pose."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmark.cli.bench import main
from benchmark.data.check import check_split
from benchmark.data.field.label_sets import open_labels
from benchmark.data.field.source import FieldFrames
from benchmark.data.field.transcg import cut_as_released
from benchmark.data.frame import BACKGROUND, DepthFrame, Material
from benchmark.data.splits import FrameKey, get_split, open_split
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.metrics.protocols.score import score_frame, score_sensor
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.rendering.maps import compose
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import PlacedMesh
from tests.benchmark.data import field_sets as sets
from tests.benchmark.data.field_sets import BOXES, Drawn


def opened(name: str, root: Path) -> FieldFrames:
    source = open_split(name, root)
    assert isinstance(source, FieldFrames)
    return source


def names(source: FieldFrames) -> list[str]:
    found: list[FrameKey] = FieldFrames.keys(source)
    return [str(key) for key in found]


def rendered(camera: Camera, poses: list[SE3]) -> tuple[np.ndarray, np.ndarray]:
    """The boxes at poses that a reader gave."""
    placed = [
        PlacedMesh(i + 1, trimesh.creation.box(box.sides), pose)
        for i, (box, pose) in enumerate(zip(BOXES, poses, strict=True))
    ]
    found = compose(RaycastRenderer(), camera, placed)
    return found.depth, found.index


def check_geometry(frame: DepthFrame, poses: dict[int, SE3], ids: list[list[int]]) -> None:
    """Each mesh falls on its mask, and on its depth to a millimetre."""
    depth, index = rendered(frame.camera, list(poses.values()))
    for i, mask_ids in enumerate(ids):
        drawn, masked = index == i, np.isin(frame.mask, mask_ids)
        both = drawn & masked
        assert both.sum() > 0.97 * drawn.sum() > 200
        error = np.abs(depth[both] - frame.depth_true[both])
        assert np.median(error) < 6e-4 and np.quantile(error, 0.98) < 2e-3


def check_raw(frame: DepthFrame, drawn: Drawn, tolerance: float = 6e-4) -> None:
    assert np.abs(frame.depth_raw - sets.with_holes(drawn)).max() < tolerance
    assert frame.color.shape[:2] == frame.depth_raw.shape


@pytest.mark.parametrize("inner", ["polarization", ""])
def test_hammer(tmp_path: Path, inner: str) -> None:
    drawn = sets.write_hammer(tmp_path / "data", inner=inner)
    source = opened("hammer-d435-test", tmp_path)
    assert len({n.partition("/")[0] for n in names(source)}) == 9 and len(source) == 18
    frame = source.load(3)
    check_raw(frame, drawn)
    assert np.abs(frame.depth_true - drawn.depth).max() < 6e-4
    # The camera, by the corners of the boxes: they are drawn where the wall is not.
    depth, index = rendered(frame.camera, [SE3.from_matrix(b.T) for b in BOXES])
    assert ((index >= 0) == (frame.depth_true < sets.WALL_M - 0.01)).mean() > 0.995
    assert np.median(np.abs(depth - frame.depth_true)[index >= 0]) < 6e-4
    assert (frame.mask == BACKGROUND).all() and source.camera_pose(0) is not None
    tof = opened("hammer-tof-test", tmp_path).load(0)
    assert np.median(tof.depth_raw - tof.depth_true) == pytest.approx(0.03, abs=1e-6)
    train = opened("hammer-l515-train", tmp_path)
    assert names(train) == ["scene3_traj1_1/000000", "scene3_traj1_1/000001"]


def test_hammer_is_scored_on_every_pixel(tmp_path: Path) -> None:
    sets.write_hammer(tmp_path, frames=1)
    frame = opened("hammer-l515-test", tmp_path).load(0)
    rows = {row.subset: row.errors for row in score_sensor(frame, get_protocol("full-frame"))}
    assert rows["scene"].n_pixels == frame.depth_true.size
    assert rows["scene"].mae == pytest.approx(0.01, abs=1e-4)
    assert rows["all"].n_pixels == 0
    words = ["--method", "raw", "--split", "hammer-d435-test", "--data", str(tmp_path)]
    words += ["--protocol", "full-frame", "--out", str(tmp_path / "r"), "--engine", "serial"]
    assert main([*words, "--no-gallery", "--no-speed"]) == 0


def test_a_sequence_of_hammer_that_is_not_there(tmp_path: Path) -> None:
    sets.write_hammer(tmp_path, frames=1)
    (tmp_path / "scene13_traj1_1").rename(tmp_path / "other")
    (tmp_path / "scene14_traj1_1/polarization/_gt/000000.png").unlink()
    report = check_split(tmp_path, "hammer-d435-test")
    assert not report.is_complete
    assert report.missing == {"ground-truth depth": ["scene14_traj1_1/_gt/000000.png"]}
    text = report.text()
    assert "not here: scene13_traj1_1" in text and "experimental" in text
    assert "--protocol full-frame" in text


@pytest.mark.parametrize("field", ["intrinsic_matrix", "camera_intrinsics"])
def test_clearpose(tmp_path: Path, field: str) -> None:
    drawn = sets.write_clearpose(tmp_path / "clearpose", field=field)
    source = opened("clearpose-heavy-occlusion", tmp_path)
    assert names(source) == ["set2_scene3/000000", "set2_scene3/000005"]
    frame = source.load(1)
    check_raw(frame, drawn)
    assert list(source.poses(1)) == list(sets.CLEARPOSE_LABELS)
    check_geometry(frame, source.poses(1), [[17], [64]])
    materials = {i.mask_id: i.material for i in frame.instances}
    assert materials == {17: Material.TRANSPARENT, 64: Material.RAW}


def test_parts_of_clearpose(tmp_path: Path) -> None:
    scenes = [
        "set1/scene4", "set1/scene5", "set3/scene11", "set4/scene5", "set4/scene6", "set8/scene3",
        "set8/scene4", "set8/scene6", "set9/scene8", "set9/scene12",
    ]  # fmt: skip
    sets.write_clearpose(tmp_path, scenes)
    expected = {
        "train": ["set1_scene4", "set4_scene5"],
        "heavy-occlusion": ["set3_scene11"],
        "new-background": ["set1_scene5", "set4_scene6"],
        "opaque-distractor": ["set8_scene3"],
        "translucent-cover": ["set8_scene4", "set9_scene8"],
        "non-planar": ["set9_scene12"],
        "filled-liquid": ["set8_scene6"],
    }
    for part, listed in expected.items():
        source = opened(f"clearpose-{part}", tmp_path)
        assert [s.name for s in source.index.scenes] == listed
    assert len(opened("clearpose-test", tmp_path)) == 2 * 8


def test_masks_of_clearpose(tmp_path: Path) -> None:
    """Objects, transparent ones alone, and every pixel; off the objects truth is the sensor."""
    drawn = sets.write_clearpose(tmp_path)
    frame = opened("clearpose-train", tmp_path).load(0)
    rows = {row.subset: row.errors for row in score_sensor(frame, get_protocol("clearpose"))}
    assert rows["all"].n_pixels == drawn.objects.sum()
    assert rows["transparent"].n_pixels == (drawn.index == 0).sum()
    assert rows["scene"].n_pixels == drawn.index.size
    of_background = rows["scene"].mae * drawn.index.size - rows["all"].mae * drawn.objects.sum()
    assert of_background == pytest.approx(0, abs=1e-6)


def test_a_scene_of_clearpose_with_one_object(tmp_path: Path) -> None:
    """MATLAB drops the last dimension of 1."""
    sets.write_clearpose(tmp_path, boxes=BOXES[:1])
    source = opened("clearpose-train", tmp_path)
    assert np.allclose(source.poses(0)[17].matrix(), BOXES[0].T, atol=1e-9)


@pytest.mark.parametrize(("sensor", "camera"), [("d435", 1), ("l515", 2)])
def test_transcg(tmp_path: Path, sensor: str, camera: int) -> None:
    drawn = sets.write_transcg(tmp_path / "transcg")[camera]
    source = opened(f"transcg-{sensor}-test", tmp_path)
    perspectives = {1: ["0", "7", "215"], 2: ["7", "30"]}[camera]
    assert names(source) == [f"scene2/{p}" for p in perspectives]
    frame = source.load(1)
    check_raw(frame, drawn, tolerance=6e-4 if camera == 1 else 1.5e-4)
    assert list(source.poses(1)) == [0, 1]
    check_geometry(frame, source.poses(1), [[1], [1]])
    assert [i.material for i in frame.instances] == [Material.TRANSPARENT]
    train = opened(f"transcg-{sensor}-train", tmp_path)
    assert {n.partition("/")[0] for n in names(train)} == {"scene1", "scene3"}


def test_counts_of_transcg(tmp_path: Path) -> None:
    sets.write_transcg(tmp_path)
    report = check_split(tmp_path, "transcg-d435-test")
    assert report.is_complete and report.frames == 3
    assert "both cameras: 5 samples, as metadata.json of the set says" in report.text()
    assert "CC BY-NC-SA" in report.text()
    (tmp_path / "scene3").rename(tmp_path / "elsewhere")
    report = check_split(tmp_path, "transcg-d435-train")
    assert report.missing == {"scene": ["scene3/metadata.json"]}
    assert "5 samples in the lists of the scenes, 10 in metadata.json" in report.text()


def test_the_two_protocols_of_transcg(tmp_path: Path) -> None:
    drawn = sets.write_transcg(tmp_path)[1]
    paper = opened("transcg-d435-test", tmp_path).load(2)
    release = opened("transcg-d435-test-2022-10", tmp_path).load(2)
    assert release.camera.size == (320, 240) and (release.depth_raw > 0).all()
    # By the description: mean and deviation of the whole raw image, k = 1 + (215 // 20) / 12.
    raw = sets.with_holes(drawn)
    low, high = (raw.mean() + sign * (1 + 10 / 12) * raw.std() for sign in (-1, 1))
    kept = drawn.depth[drawn.objects]
    share = ((kept > low) & (kept < high)).mean()
    rows = {
        name: score_frame(frame.depth_true, frame, get_protocol(name))[0].errors
        for name, frame in (("transcg", paper), ("transcg-2022-10", release))
    }
    assert rows["transcg"].rmse == rows["transcg-2022-10"].rmse == 0
    ratio = rows["transcg-2022-10"].n_pixels / rows["transcg"].n_pixels
    assert ratio == pytest.approx(share, abs=0.03) and ratio < 1


def test_depth_is_cut_as_described() -> None:
    raw = np.full((4, 5), 1.0, np.float32)
    raw[0, 0], raw[3, 4] = 0, 3.0
    true = raw + np.float32(0.01)
    filled, cut = cut_as_released(raw, true, 1.0)
    assert (filled == 1).all()  # the hole and what is too far are filled by a neighbour
    assert (cut == 0).sum() == 2 and cut[3, 4] == 0 == cut[0, 0]


@pytest.mark.parametrize(
    ("name", "data", "sensor", "gray", "first", "material"),
    [
        ("xyzibd-val-realsense", "xyzibd", "realsense", False, 4, Material.SPECULAR),
        ("xyzibd-val-xyz", "xyzibd", "xyz", True, 4, Material.SPECULAR),
        ("ipd-val-photoneo", "ipd", "photoneo", False, 0, Material.RAW),
    ],
)
def test_bop_of_several_sensors(
    tmp_path: Path, name: str, data: str, sensor: str, gray: bool, first: int, material: Material
) -> None:
    drawn = sets.write_bop_sensors(tmp_path / data, sensor, gray=gray, first=first)
    source = opened(name, tmp_path)
    frame = source.load(0)
    check_raw(frame, drawn, tolerance=6e-5)
    check_geometry(frame, source.poses(0), [[0], [1]])
    assert (frame.depth_true[~drawn.objects] == 0).all()
    assert np.abs(frame.depth_true - drawn.depth)[frame.depth_true > 0].max() < 1e-4
    assert (frame.depth_true > 0).sum() > 0.98 * drawn.objects.sum()
    assert {i.material for i in frame.instances} == {material}
    assert frame.instances[0].model == f"obj_{first:06d}"
    assert check_split(tmp_path, name).is_complete
    (tmp_path / data / f"val/000000/mask_visib_{sensor}/000000_000001.png").unlink()
    assert "no mask 1: 1 of the frames" in check_split(tmp_path, name).text()


@pytest.mark.parametrize(
    ("part", "unit", "channels"),
    [
        ("test", 0.001, 3), ("val_inst", 0.001, 1), ("val_pbr_cat", 0.0001, 3),
        ("train_pbr_cat", 0.0001, 1), ("train_pbr_inst", 0.0001, 1),
    ],
)  # fmt: skip
def test_pace(tmp_path: Path, part: str, unit: float, channels: int) -> None:
    drawn = sets.write_pace(tmp_path / "pace", part, unit, channels)
    name = f"pace-{part.replace('_', '-')}"
    source = opened(name, tmp_path)
    frame = source.load(0)
    check_raw(frame, drawn, tolerance=0.6 * unit)
    check_geometry(frame, source.poses(0), [[0], [1]])
    assert np.abs(frame.depth_true - drawn.depth)[frame.depth_true > 0].max() < 1e-4
    assert (frame.depth_true > 0).sum() > 0.98 * drawn.objects.sum()
    assert [i.model for i in frame.instances] == ["obj_000007", "obj_000545"]
    audited = open_labels(tmp_path, name).images(0).depth
    assert audited is not None and np.array_equal(audited, frame.depth_raw)
    report = check_split(tmp_path, name)
    assert report.is_complete and "objects only" in report.text()
    (tmp_path / "empty").mkdir()
    with pytest.raises(ToolkitError, match="nothing of this split is here") as error:
        opened(name, tmp_path / "empty")
    assert "https://github.com/qq456cvb/PACE" in str(error.value)
    (tmp_path / f"pace/{part}/000000/depth/000000.png").unlink()
    assert "no raw depth: 1 of the frames" in check_split(tmp_path, name).text()


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_housecat6d(tmp_path: Path, protocol: int) -> None:
    drawn = sets.write_housecat(tmp_path, protocol=protocol)
    source = opened("housecat6d-test", tmp_path)
    frame = source.load(0)
    check_raw(frame, drawn)
    check_geometry(frame, source.poses(0), [[1], [2]])
    assert np.abs(frame.depth_true - drawn.depth)[frame.depth_true > 0].max() < 1e-4
    named = {i.mask_id: (i.category, i.model, i.material) for i in frame.instances}
    assert named[1] == ("glass", "glass-new_3", Material.TRANSPARENT)
    assert named[2] == ("cutlery", "cutlery-fork_1", Material.SPECULAR)
    assert all(mesh.path.is_file() for mesh in source.meshes(0).values())


@pytest.mark.parametrize("truth", ["GT_Depth", "GT_Depth_Raw"])
def test_robi(tmp_path: Path, truth: str) -> None:
    drawn = sets.write_robi(tmp_path / "robi", truth)
    source = opened("robi-ensenso", tmp_path)
    assert names(source) == ["Zigzag_Scene_1/view_71", "Zigzag_Scene_1/view_72"]
    frame = source.load(1)
    check_raw(frame, drawn, tolerance=2e-5)
    assert np.abs(frame.depth_true - drawn.depth).max() < 2e-5 and (frame.color == 72).all()
    depth, index = rendered(frame.camera, [SE3.from_matrix(b.T) for b in BOXES])
    assert ((index >= 0) == (frame.depth_true < sets.WALL_M - 0.01)).mean() > 0.995
    assert np.median(np.abs(depth - frame.depth_true)[index >= 0]) < 5e-5
    pair = source.infrared_images(1)
    assert pair is not None and [p.name for p in pair] == ["LEFT_view_72.bmp", "RIGHT_view_72.bmp"]
    path = tmp_path / "robi/Zigzag/Scene_1/Ensenso/Stereo/LEFT_view_72.bmp"
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ToolkitError, match="damaged"):
        source.load(1)
    path.write_bytes(b"no bitmap")
    with pytest.raises(ToolkitError, match="is no bitmap"):
        source.load(1)


def test_a_label_that_would_run_a_command_is_not_run(tmp_path: Path) -> None:
    sets.write_housecat(tmp_path)
    mark = tmp_path / "ran"

    class Bomb:
        def __reduce__(self) -> tuple[object, ...]:
            import os

            return os.system, (f"touch {mark}",)

    path = tmp_path / "test_scene1/labels/000000_label.pkl"
    path.write_bytes(pickle.dumps({"instance_ids": Bomb()}))
    source = opened("housecat6d-test", tmp_path)
    with pytest.raises(ToolkitError, match="could run anything") as error:
        source.load(0)
    assert "000000_label.pkl" in str(error.value) and not mark.exists()
    report = check_split(tmp_path, "housecat6d-test")
    assert len(report.unreadable) == 1 and not mark.exists()


WRONG: list[tuple[str, Callable[[Path], object], str]] = [
    ("clearpose-train", lambda top: (top / "set1/scene1/metadata.mat").write_bytes(b"x" * 200),
     "no file of MATLAB 5"),
    ("clearpose-train", lambda top: (top / "set1/scene1/metadata.mat").unlink(),
     "cannot read the metadata"),
    ("transcg-d435-test", lambda top: (top / "metadata.json").write_text('{"test": [2]}'),
     "metadata.json"),
    ("transcg-d435-test",
     lambda top: np.save(top / "camera_intrinsics/1-camIntrinsics-D435.npy", np.eye(4)),
     "not a 3x3 matrix"),
    ("housecat6d-test", lambda top: (top / "test_scene1/meta.txt").write_text("1 8\n"),
     "line 1"),
    ("housecat6d-test", lambda top: (top / "test_scene1/meta.txt").write_text("1 8 ../../x\n"),
     "line 1"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "spoil", "said"), WRONG)
def test_damaged_documents_are_one_line(
    tmp_path: Path, name: str, spoil: Callable[[Path], object], said: str
) -> None:
    {"c": sets.write_clearpose, "t": sets.write_transcg, "h": sets.write_housecat}[name[0]](
        tmp_path
    )
    spoil(tmp_path)
    with pytest.raises(ToolkitError, match=said) as error:
        opened(name, tmp_path).load(0)
    assert "\n" not in str(error.value) and error.value.path is not None


def test_depth_in_another_unit_is_refused(tmp_path: Path) -> None:
    drawn = sets.write_hammer(tmp_path, frames=1)
    path = tmp_path / "scene12_traj1_1/polarization/depth_d435/000000.png"
    sets.put_depth(path, drawn.depth, 0.0001)
    with pytest.raises(ToolkitError, match=r"0\.001 m per number"):
        opened("hammer-d435-test", tmp_path).load(0)


def test_every_split_says_what_is_known(tmp_path: Path) -> None:
    from benchmark.data.field.field_splits import EVERY

    for name in EVERY:
        split = get_split(name)
        card = " ".join(split.card)
        assert split is EVERY[name] and split.page and "licence:" in card and "truth:" in card
        assert "score" in card
        report = check_split(tmp_path, name)
        assert "nothing found" in report.text() and split.page in report.text()
