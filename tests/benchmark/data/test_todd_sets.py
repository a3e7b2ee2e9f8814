"""Syn-TODD and TODD: mirrored projections, ids without names, records that are no programs."""

from __future__ import annotations

import json
import os
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmark.data.check import check_split
from benchmark.data.field.label_sets import open_labels
from benchmark.data.frame import BACKGROUND, DepthFrame, Material
from benchmark.data.splits import get_split
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.metrics.protocols.score import score_frame, score_sensor
from std_toolkit.errors import ToolkitError
from std_toolkit.io import plain_pickle
from tests.benchmark.data import todd_sets as sets
from tests.benchmark.data.field_sets import BOXES, put
from tests.benchmark.data.test_field_sets import check_geometry, check_raw, names, opened
from tests.benchmark.data.test_labelled_sets import falls_on_its_depth

SHORT = [name[:38] for name in sets.NAMES]


def check_boxes(frame: DepthFrame, camera: int, ids: list[int]) -> None:
    """The corners of each box, projected as the authors do, just enclose its pixels."""
    for box, mask_id in zip(sets.boxes_of(camera), ids, strict=True):
        rows, columns = np.nonzero(frame.mask == mask_id)
        uv = sets.as_authors_project(sets.corners(box))
        low, high = uv.min(axis=0), uv.max(axis=0)
        seen = np.array([columns.min(), rows.min(), columns.max(), rows.max()])
        assert np.abs(np.concatenate([low, high]) - seen).max() < 1.3


def test_syn_todd_as_rendered(tmp_path: Path) -> None:
    drawn = sets.write_rendered(tmp_path / "data")
    source = opened("syn-todd-rendered", tmp_path)
    assert names(source) == ["163/0", "163/1"]
    worlds = []
    for c in range(2):
        frame = source.load(c)
        assert (frame.depth_raw == 0).all() and frame.depth_raw.shape == frame.color.shape[:2]
        assert (frame.depth_true[0, :3] == 0).all()
        assert np.abs(frame.depth_true - drawn[c].depth)[1:].max() < 1e-6
        # By name: Beaker is the second box.
        assert [(i.mask_id, i.model) for i in frame.instances] == [(1, SHORT[1]), (2, SHORT[0])]
        assert {i.material for i in frame.instances} == {Material.TRANSPARENT}
        assert (np.array([BACKGROUND, 2, 1])[drawn[c].index + 1] == frame.mask).all()
        check_boxes(frame, c, [2, 1])
        poses = {i: source.poses(c)[i] for i in (2, 1)}
        check_geometry(frame, poses, [[2], [1]])
        camera = source.camera_pose(c)
        assert camera is not None
        worlds.append({i: (camera @ pose).matrix() for i, pose in poses.items()})
    for i in (1, 2):
        assert np.allclose(worlds[0][i], worlds[1][i], atol=1e-6)


@pytest.mark.parametrize(("mirrored", "compressed"), [(False, True), (True, False)])
def test_syn_todd_as_published(tmp_path: Path, mirrored: bool, compressed: bool) -> None:
    drawn = sets.write_syn_todd(tmp_path / "data", mirrored=mirrored, compressed=compressed)
    source = opened("syn-todd-test", tmp_path)
    assert names(source) == ["163/16300", "163/16301", "164/16446"]
    assert "dataloaders.template" not in sys.modules
    for index, c in ((0, 0), (1, 1)):
        frame = source.load(index)
        assert (frame.depth_raw == 0).all() and frame.color.std() > 1
        assert np.abs(frame.depth_true - drawn[index].depth).max() < 6e-4  # half precision
        assert (np.array([BACKGROUND, 3, 2])[drawn[index].index + 1] == frame.mask).all()
        assert {i.mask_id: i.model for i in frame.instances} == {3: SHORT[0], 2: SHORT[1]}
        poses = source.poses(index)
        check_geometry(frame, {i: poses[i] for i in (3, 2)}, [[3], [2]])
        check_boxes(frame, c, [3, 2])
    first, second = source.camera_pose(0), source.camera_pose(1)
    assert first is not None and second is not None
    assert np.allclose((first @ source.poses(0)[3]).matrix(),
                       (second @ source.poses(1)[3]).matrix(), atol=1e-6)  # fmt: skip


def test_colours_of_a_pickle_are_those_of_its_left_image(tmp_path: Path) -> None:
    sets.write_syn_todd(tmp_path, compressed=False)
    plain = opened("syn-todd-test", tmp_path).load(0).color
    other = tmp_path / "other"
    sets.write_syn_todd(other)
    packed = opened("syn-todd-test", other).load(0).color
    # Records hold RGB; the JPEG of the test was encoded as BGR.
    assert np.abs(packed[..., ::-1].astype(int) - plain).mean() < 3


def test_a_pose_without_clear_pixels_is_left_out(tmp_path: Path) -> None:
    sets.write_syn_todd(tmp_path)
    path = tmp_path / "synthetic_test_pkl/16300.pickle.zstd"
    with sets.authors_module() as module:
        record = pickle.loads(sets.zstd.decompress(path.read_bytes()))
        assert isinstance(record, module.Panoptic)
        record.detections[1].bbox = np.array([[0, 0], [20, 20]])
        path.write_bytes(sets.packed(record))
    source = opened("syn-todd-test", tmp_path)
    assert list(source.poses(0)) == [2]
    assert {i.mask_id: i.model for i in source.load(0).instances} == {3: "", 2: SHORT[1]}


def test_frames_that_others_call_bad_are_named(tmp_path: Path) -> None:
    sets.write_syn_todd(tmp_path, "train")
    top = tmp_path / "synthetic_train_pkl"
    (top / "16446.pickle.zstd").rename(top / "16346.pickle.zstd")
    report = check_split(tmp_path, "syn-todd-train")
    assert report.is_complete and report.frames == 3
    assert "other users call bad: 16346" in report.text()
    assert "10.5683/SP3/LQKTXE" in " ".join(get_split("syn-todd-train").download)
    sets.write_rendered(tmp_path)
    assert "scenes without all 56 cameras: 1" in check_split(tmp_path, "syn-todd-rendered").text()


def test_raw_depth_of_syn_todd_answers_nothing(tmp_path: Path) -> None:
    drawn = sets.write_rendered(tmp_path)[0]
    frame = opened("syn-todd-rendered", tmp_path).load(0)
    protocol = get_protocol("full-frame")
    rows = {row.subset: row.errors for row in score_frame(frame.depth_true, frame, protocol)}
    assert rows["scene"].n_pixels == drawn.depth.size - 3 and rows["scene"].rmse == 0
    assert all(row.errors.coverage in (0, None) or np.isnan(row.errors.coverage)
               for row in score_sensor(frame, protocol))  # fmt: skip


class Runs:
    """Runs a program where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, (f"touch {self.mark}",)


def test_a_record_that_would_run_a_command_is_not_run(tmp_path: Path) -> None:
    sets.write_syn_todd(tmp_path)
    mark, path = tmp_path / "ran", tmp_path / "synthetic_test_pkl/16300.pickle.zstd"
    with sets.authors_module() as module:
        record = module.Stereo(Runs(mark), None, False)
        path.write_bytes(sets.packed(record))
    source = opened("syn-todd-test", tmp_path)
    with pytest.raises(ToolkitError, match="could run anything") as error:
        source.load(0)
    assert "16300.pickle.zstd" in str(error.value) and "\n" not in str(error.value)
    assert not mark.exists()
    report = check_split(tmp_path, "syn-todd-test")
    assert len(report.unreadable) == 1 and not mark.exists()


@pytest.mark.parametrize("name", ["some.other", "dataloaders.dataset_blender"])
def test_records_of_other_programs_are_refused(tmp_path: Path, name: str) -> None:
    sets.write_syn_todd(tmp_path)
    path = tmp_path / "synthetic_test_pkl/16300.pickle.zstd"
    with sets.authors_module(name) as module:
        path.write_bytes(sets.packed(module.Stereo(1, 2, False)))
    with pytest.raises(ToolkitError, match=f"names {name}.Stereo"):
        opened("syn-todd-test", tmp_path).load(0)


def test_zstd_that_is_missing_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sets.write_syn_todd(tmp_path)

    def absent(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(plain_pickle, "importlib", SimpleNamespace(import_module=absent))
    with pytest.raises(ToolkitError, match="packed with zstd") as error:
        opened("syn-todd-test", tmp_path).load(0)
    assert error.value.hint == "pip install backports.zstd"
    assert "16300.pickle.zstd" in str(error.value)


PICKLES: list[tuple[str, Callable[[bytes], bytes]]] = [
    ("no pickle of plain values", lambda _: b"no zstd"),
    ("cut off", lambda data: data[:-40]),
    ("more than 64 MB", lambda _: sets.zstd.compress(bytes(65 * 2**20))),
    ("field is missing", lambda _: sets.packed({"stereo": 1})),
    ("no pickle of plain values", lambda data: sets.zstd.decompress(data)),
]


@pytest.mark.parametrize(("said", "spoil"), PICKLES)
def test_damaged_pickles_are_one_line(
    tmp_path: Path, said: str, spoil: Callable[[bytes], bytes]
) -> None:
    sets.write_syn_todd(tmp_path)
    path = tmp_path / "synthetic_test_pkl/16300.pickle.zstd"
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(ToolkitError, match=said) as error:
        opened("syn-todd-test", tmp_path).load(0)
    assert error.value.path == str(path) or error.value.path == path
    assert "\n" not in str(error.value)


WRONG: list[tuple[str, object, str]] = [
    ("6dpose_c_obj", np.eye(4).tolist(), "behind the camera in Blender's axes"),
    ("6dpose_c_obj", [1, 2, 3], "must be 4x4"),
    ("camera_intrinsic", [[1, 2], [3, 4]], "no camera"),
    ("resolution_x", 170, "other proportions"),
    ("quaternion_WXYZ", [2, 0, 0, 0], "no pose of the camera"),
]


@pytest.mark.parametrize(("field", "value", "said"), WRONG)
def test_wrong_fields_as_rendered(tmp_path: Path, field: str, value: object, said: str) -> None:
    sets.write_rendered(tmp_path)
    path = tmp_path / "163/BoundingBox.json"
    document = json.loads(path.read_text())
    fields = document["Camera_0"]
    (fields["transparent_Beaker"] if field == "6dpose_c_obj" else fields)[field] = value
    path.write_text(json.dumps(document))
    source = opened("syn-todd-rendered", tmp_path)
    with pytest.raises(ToolkitError, match=said):
        source.load(0)
        source.poses(0)
        source.camera_pose(0)


def test_a_mask_as_rendered_that_is_missing(tmp_path: Path) -> None:
    sets.write_rendered(tmp_path)
    (tmp_path / "163/segmentation_Camera_1_Beaker_visible_L.png").unlink()
    report = check_split(tmp_path, "syn-todd-rendered")
    missing = "163/segmentation_Camera_1_Beaker_visible_L.png"
    assert report.missing == {"mask of Beaker": [missing]}


@pytest.mark.parametrize("unit", [1.0, 0.001])
def test_todd(tmp_path: Path, unit: float) -> None:
    drawn = sets.write_todd(tmp_path / "todd", unit=unit)
    source = opened("todd-test", tmp_path)
    assert names(source) == ["test/1622410107.5037992", "test/1622410109.25"]
    frame = source.load(0)
    assert frame.depth_raw[0, 0] == 0
    frame.depth_raw[0, 0] = drawn.depth[0, 0]
    check_raw(frame, drawn, tolerance=1e-6)
    check_geometry(frame, source.poses(0), [[10], [20]])
    assert [i.mask_id for i in frame.instances] == [10, 20]
    assert {i.material for i in frame.instances} == {Material.TRANSPARENT}
    report = check_split(tmp_path, "todd-test")
    assert report.is_complete and "10.5683/SP3/ZJJAJ3" not in report.text()
    with pytest.raises(ToolkitError, match="nothing of this split is here"):
        opened("todd-val", tmp_path)


def test_todd_unpacked_twice_and_what_it_lacks(tmp_path: Path) -> None:
    sets.write_todd(tmp_path / "train", "train")
    sets.write_todd(tmp_path, "val")
    source = opened("todd-train", tmp_path)
    assert len(source) == 2
    (tmp_path / "val/1622410109.25/depth.exr").unlink()
    report = check_split(tmp_path, "todd-val")
    assert report.missing == {"raw depth": ["val/1622410109.25/depth.exr"]}
    put(tmp_path / "val/1622410107.5037992/instance_segment.png", np.zeros((9, 9, 3), np.uint8))
    with pytest.raises(ToolkitError, match="another size"):
        opened("todd-val", tmp_path).load(0)


def test_labels_of_both_sets_can_be_audited(tmp_path: Path) -> None:
    sets.write_todd(tmp_path)
    meshes = tmp_path / "meshes"
    for number, box in zip((10, 20), BOXES, strict=True):
        box.save(meshes / f"{number}.obj")
    falls_on_its_depth(open_labels(tmp_path, "todd-test", models=meshes))
    sets.write_rendered(tmp_path / "syn")
    for name, box in zip(SHORT, BOXES, strict=True):
        box.save(meshes / f"{name}.obj")
    frame = open_labels(tmp_path / "syn", "syn-todd-rendered", models=meshes).labels(0)
    assert [o.model for o in frame.objects] == [SHORT[1], SHORT[0]]
    assert all(o.mesh is not None for o in frame.objects)
