"""REAL275 and CAMERA25: unit, axes, order of labels and size, proved by meshes at their poses."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmark import evaluate
from benchmark.data.check import check_split
from benchmark.data.field.label_sets import open_labels
from benchmark.data.field.nocs_sets import NocsFrames
from benchmark.data.frame import BACKGROUND
from benchmark.data.splits import open_split
from benchmark.data.true_poses import known_boxes, true_poses
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from tests.benchmark.data import field_sets as sets
from tests.benchmark.data.field_sets import NocsDrawn

LABELS = "gts/real_test/results_real_test_scene_1_0000.pkl"
TOP = "Real/test/scene_1"


def opened(name: str, root: Path) -> NocsFrames:
    source = open_split(name, root)
    assert isinstance(source, NocsFrames)
    return source


def write(root: Path, name: str, pickled: bool, channels: int = 1) -> NocsDrawn:
    data, _, part = name.partition("-")
    folder = {"real275": "Real", "camera25": "CAMERA"}[data]
    return sets.write_nocs(root, folder, part, pickled=pickled, channels=channels)


@pytest.mark.parametrize(
    ("name", "pickled", "channels"),
    [
        ("real275-test", True, 1), ("real275-test", False, 1), ("real275-train", False, 1),
        ("camera25-val", True, 3), ("camera25-val", False, 3), ("camera25-train", False, 3),
    ],
)  # fmt: skip
def test_meshes_fall_on_masks_and_depth(
    tmp_path: Path, name: str, pickled: bool, channels: int
) -> None:
    drawn = write(tmp_path / "nocs", name, pickled, channels)
    source = opened(name, tmp_path)
    frame = source.load(0, nocs=True)
    seen = frame.depth_raw > 0
    assert np.abs(frame.depth_raw - drawn.depth)[seen].max() < 6e-4
    assert (drawn.index[~seen] == 0).all() and 0 < (~seen).sum() < (drawn.index == 0).sum()
    expected = np.array([BACKGROUND, *sets.NOCS_IDS])[drawn.index + 1]
    assert (frame.mask == expected)[20:].all() and (frame.mask[:20, :20] == BACKGROUND).all()
    # Where labels are filed they are exact; else as good as millimetres and 8 bits allow.
    far, angle, depth = (1e-5, 1e-4, 1e-4) if pickled else (2e-3, 0.5, 2e-3)
    objects = drawn.index >= 0
    assert (frame.depth_true[~objects] == 0).all()
    assert (frame.depth_true > 0).sum() > 0.97 * objects.sum() > 10_000
    error = np.abs(frame.depth_true - drawn.depth)[frame.depth_true > 0]
    assert np.quantile(error, 0.98) < depth
    poses, meshes = source.poses(0), source.meshes(0)
    assert list(poses) == list(sets.NOCS_IDS)
    for (i, pose), RT in zip(poses.items(), drawn.RTs, strict=True):
        scale = float(np.cbrt(np.linalg.det(RT[:3, :3])))
        turned = np.trace(pose.R.T @ RT[:3, :3] / scale)
        assert np.degrees(np.arccos(np.clip((turned - 1) / 2, -1, 1))) < angle
        assert np.abs(pose.t - RT[:3, 3]).max() < far
        assert np.linalg.norm(meshes[i].load().extents) == pytest.approx(scale, abs=far)
    assert frame.nocs is not None
    assert np.abs(frame.nocs - drawn.coordinates)[objects].max() < 0.6 / 255
    assert (frame.nocs[~objects] == 0).all()


@pytest.mark.parametrize("name", ["real275-test", "camera25-val"])
def test_boxes_and_classes_of_poses(tmp_path: Path, name: str) -> None:
    drawn = write(tmp_path, name, pickled=True)
    source = opened(name, tmp_path)
    boxes = known_boxes(source, 0)
    for i, sides, RT in zip(sets.NOCS_IDS, drawn.sides, drawn.RTs, strict=True):
        assert boxes[i].sides == pytest.approx(sides, abs=1e-5)
        found = boxes[i].RT
        assert found is not None and np.abs(found - RT).max() < 1e-6
    frame = source.load(0, nocs=True)
    named = {i.mask_id: (i.category, i.class_id) for i in frame.instances}
    assert named == {2: ("mug", 6), 5: ("laptop", 0), 9: ("can", 4)}
    (mug,) = true_poses(frame, boxes)
    assert mug.instance.mask_id == 2 and mug.box_known
    assert not mug.handle_visible  # as filed
    labels = open_labels(tmp_path, name).labels(0)
    assert [o.T_cam_obj.t == pytest.approx(drawn.RTs[k, :3, 3]) for k, o in
            enumerate(labels.objects)] == [True, True]  # fmt: skip
    mesh = labels.objects[0].mesh
    assert mesh is not None and mesh.load().extents == pytest.approx(
        drawn.sides[0] * mesh.diagonal_m, abs=1e-6
    )


def test_true_poses_score_full_marks(tmp_path: Path) -> None:
    write(tmp_path, "real275-test", pickled=True)
    (row,) = evaluate(
        "gt-nocs",
        "real275-test",
        data=tmp_path,
        task="pose",
        jobs=JobOptions(engine="serial", progress=False),
    ).to_dict("records")
    # The mug alone: the benchmark has no laptop.
    assert row["true"] == 1 and row["iou75"] == row["5deg2cm"] == 1


@pytest.mark.parametrize("inner", ["", "nocs", "nocs/Real"])
def test_where_the_root_may_be(tmp_path: Path, inner: str) -> None:
    write(tmp_path / "nocs", "real275-test", pickled=True)
    (tmp_path / "nocs/CAMERA/val").mkdir(parents=True)
    source = opened("real275-test", tmp_path / inner)
    assert [str(key) for key in source.keys()] == ["scene_1/0000"]  # noqa: SIM118
    assert set(source.poses(0)) == set(sets.NOCS_IDS)


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    write(tmp_path, "real275-test", pickled=True)
    report = check_split(tmp_path, "real275-test")
    assert not report.missing and not report.unreadable
    text = report.text()
    assert (
        "objects only" in text and "no source here states them" in text and "non-commercial" in text
    )
    (tmp_path / TOP / "0000_coord.png").unlink()
    assert "no coordinates: 1 of the frames" in check_split(tmp_path, "real275-test").text()
    with pytest.raises(ToolkitError, match="no coordinates"):
        opened("real275-test", tmp_path).load(0)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ToolkitError, match="nothing of this split is here"):
        open_split("real275-test", tmp_path / "empty")


def _labels(top: Path, **fields: object) -> None:
    (top / LABELS).write_bytes(pickle.dumps(fields))


def _depth(top: Path) -> None:
    (top / LABELS).unlink()
    sets.put_depth(top / TOP / "0000_depth.png", np.full((240, 320), 1.0), 0.001)


class Bomb:
    """A label that would make a file."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.mark,)


WRONG: list[tuple[Callable[[Path], object], str]] = [
    (lambda top: _labels(top, gt_RTs=np.stack([np.eye(4)] * 3)), "the mask has 2 objects"),
    (lambda top: _labels(top, gt_RTs=np.stack([np.eye(4)] * 2), handle_visibility=[1]),
     "the mask has 2 objects"),
    (lambda top: _labels(top, gt_RTs=np.stack([np.diag([1.0, 2, 1, 1])] * 2)),
     "not a rotation with a scale"),
    (lambda top: _labels(top, gt_RTs=np.stack([np.diag([1.0, 1, -1, 1])] * 2)),
     "not a rotation with a scale"),
    (lambda top: _labels(top, gt_RTs=np.full((2, 4, 4), np.nan)), "not a rotation with a scale"),
    (lambda top: _labels(top, other=1), "expected gt_RTs"),
    (lambda top: _labels(top, gt_RTs=Bomb(top / "ran")), "could run anything"),
    (lambda top: (top / TOP / "0000_meta.txt").write_text("2 6\n"), "line 1"),
    (lambda top: (top / TOP / "0000_meta.txt").write_text("2 7 mug\n"), "line 1"),
    (lambda top: (top / TOP / "0000_meta.txt").write_text("2 6 ../../x\n"), "line 1"),
    (lambda top: (top / TOP / "0000_meta.txt").write_text("2 6 a\n2 6 b\n"), "line 2"),
    (lambda top: sets.put(top / TOP / "0000_mask.png", np.full((48, 64, 3), 255, np.uint8)),
     "known at 640x480"),
    (_depth, "is not of the mask's size"),
    (lambda top: (top / "obj_models/real_test/mug_a_norm.obj").unlink(), "mesh file not found"),
]  # fmt: skip


@pytest.mark.parametrize(("spoil", "said"), WRONG)
def test_damaged_files_are_one_line(
    tmp_path: Path, spoil: Callable[[Path], object], said: str
) -> None:
    write(tmp_path, "real275-test", pickled=True)
    spoil(tmp_path)
    with pytest.raises(ToolkitError, match=said) as error:
        opened("real275-test", tmp_path).load(0)
    assert "\n" not in str(error.value) and error.value.path is not None
    assert not (tmp_path / "ran").exists()
