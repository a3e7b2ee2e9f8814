"""What is wrong in one of the field's sets is one line, and two scenes of one name stay two."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from benchmark.data.field.clearpose import read_metadata
from benchmark.data.field.places import object_pose, pose_of, whole_number
from benchmark.data.field.syn_todd import BAD_FRAMES
from std_toolkit.errors import ToolkitError
from tests.benchmark.data import todd_sets
from tests.benchmark.data.field_sets import write_housecat, write_nocs
from tests.benchmark.data.test_field_sets import names, opened
from tests.benchmark.data.test_phocal_set import edit, write_phocal
from tests.benchmark.data.test_transpose_set import HAND, MOUNTED, write_transpose

LONG = "9" * 5000  # Python refuses to read so many digits


def test_only_short_numbers_are_numbers() -> None:
    assert [whole_number(t) for t in ("0", "007", "123456789")] == [0, 7, 123456789]
    assert {whole_number(t) for t in ("", "-1", "1.0", "²", "٣", LONG, " 1")} == {-1}


@pytest.mark.parametrize("t", [[0, np.nan, 1], [0, 0, np.inf], [1, 2], [{}, 0, 1]])
def test_a_translation_that_is_none(tmp_path: Path, t: list[object]) -> None:
    with pytest.raises(ToolkitError, match="no pose"):
        pose_of(np.eye(3), t, tmp_path)  # type: ignore[arg-type]


@pytest.mark.parametrize("R", [np.diag([1, 1, -1]), 2 * np.eye(3), np.eye(3) + np.eye(3)[::-1]])
def test_a_rotation_that_is_none(tmp_path: Path, R: np.ndarray) -> None:
    with pytest.raises(ToolkitError, match="not a rotation"):
        object_pose(R, [0, 0, 1], tmp_path)


def test_phocal_in_millimetres_is_refused(tmp_path: Path) -> None:
    """Else its objects would be rendered beyond sight: no truth, and nothing said."""
    write_phocal(tmp_path)
    path = tmp_path / "sequence_2/rgb_scene_gt.json"
    document = json.loads(path.read_text())
    for row in document["4"]:
        row["cam_t_m2c"] = [1000 * x for x in row["cam_t_m2c"]]
    path.write_text(json.dumps(document))
    with pytest.raises(ToolkitError, match="known to be in metres") as error:
        opened("phocal-test", tmp_path).load(0)
    assert str(error.value.path) == str(path) and "1000" in str(error.value.hint)


def test_a_frame_of_phocal_whose_key_is_no_number(tmp_path: Path) -> None:
    write_phocal(tmp_path)
    edit(tmp_path / "sequence_2/rgb_scene_gt.json", '"3"', f'"{LONG}"')
    assert opened("phocal-test", tmp_path).load(0).depth_true.any()


HOUSECAT: list[tuple[str, object]] = [
    ("instance_ids", [1, np.nan]), ("instance_ids", [1, 300]), ("instance_ids", [1, 1]),
    ("translations", np.full((2, 3), 900.0)), ("translations", np.full((2, 3), np.nan)),
]  # fmt: skip


@pytest.mark.parametrize(("field", "value"), HOUSECAT)
def test_labels_of_housecat6d(tmp_path: Path, field: str, value: object) -> None:
    write_housecat(tmp_path)
    path = tmp_path / "test_scene1/labels/000000_label.pkl"
    path.write_bytes(pickle.dumps(pickle.loads(path.read_bytes()) | {field: value}))
    with pytest.raises(ToolkitError) as error:
        opened("housecat6d-test", tmp_path).load(0)
    assert str(error.value.path) == str(path)


@pytest.mark.parametrize("line", [f"{LONG} 8 glass-new_3", "² 8 glass-new_3", "300 8 glass-new_3"])
def test_the_list_of_housecat6d(tmp_path: Path, line: str) -> None:
    write_housecat(tmp_path)
    (tmp_path / "test_scene1/meta.txt").write_text(line)
    with pytest.raises(ToolkitError, match="expected instance_id"):
        opened("housecat6d-test", tmp_path).load(0)


@pytest.mark.parametrize("line", ["² 6 mug_a_norm", f"2 {LONG} mug_a_norm", "2 ² mug_a_norm", "2"])
def test_the_list_of_nocs(tmp_path: Path, line: str) -> None:
    write_nocs(tmp_path, "Real", "test", pickled=True)
    (tmp_path / "Real/test/scene_1/0000_meta.txt").write_text(line)
    with pytest.raises(ToolkitError, match="expected instance class name"):
        opened("real275-test", tmp_path).load(0)


@pytest.mark.parametrize("value", [np.float64(3), np.eye(4), [1], "text", {"gt_RTs": "text"}])
def test_labels_of_nocs(tmp_path: Path, value: object) -> None:
    write_nocs(tmp_path, "Real", "test", pickled=True)
    path = tmp_path / "gts/real_test/results_real_test_scene_1_0000.pkl"
    path.write_bytes(pickle.dumps(value))
    with pytest.raises(ToolkitError, match="gt_RTs") as error:
        opened("real275-test", tmp_path).load(0)
    assert str(error.value.path) == str(path)


METADATA: list[dict[str, object]] = [
    {"cls_indexes": [np.nan]}, {"cls_indexes": [1.5]}, {"cls_indexes": "text"},
    {"poses": "text"}, {"poses": np.zeros((3, 5, 1))}, {"rotation_translation_matrix": [1.0]},
]  # fmt: skip


@pytest.mark.parametrize("change", METADATA)
def test_metadata_of_clearpose(tmp_path: Path, change: dict[str, object]) -> None:
    path = tmp_path / "metadata.mat"
    row = {
        "cls_indexes": [1], "poses": np.eye(3, 4)[..., None], "intrinsic_matrix": np.eye(3),
        "rotation_translation_matrix": np.eye(3, 4),
    }  # fmt: skip
    savemat(path, {"f000000": row})
    assert list(read_metadata(path)["f000000"].poses) == [1]
    savemat(path, {"f000000": row | change})
    with pytest.raises(ToolkitError, match="f000000"):
        read_metadata(path)


def spoilt(root: Path, spoil: Callable[[dict[str, object]], None]) -> None:
    """Syn-TODD whose record of the first frame is changed."""
    todd_sets.write_syn_todd(root, compressed=False)
    path = root / "synthetic_test_pkl/16300.pickle.zstd"
    with todd_sets.authors_module():
        record = pickle.loads(todd_sets.zstd.decompress(path.read_bytes()))
        spoil(vars(record))
        path.write_bytes(todd_sets.packed(record))


@pytest.mark.parametrize(
    ("said", "spoil"),
    [
        ("expected a list", lambda fields: fields.update(detections=5)),
        ("expected a list", lambda fields: fields.update(detections=fields["detections"] * 300)),
        ("from 0 to 255", lambda fields: setattr(
            fields["stereo"], "left_color", fields["stereo"].left_color / 255)),
        ("no pose of the camera", lambda fields: fields["camera_params"].update(
            camera_location=[0, np.nan, 1])),
    ],
)  # fmt: skip
def test_fields_of_syn_todd(
    tmp_path: Path, said: str, spoil: Callable[[dict[str, object]], None]
) -> None:
    spoilt(tmp_path, spoil)
    source = opened("syn-todd-test", tmp_path)
    with pytest.raises(ToolkitError, match=said):
        source.load(0)
        source.camera_pose(0)


def test_names_of_syn_todd_stay_as_they_are(tmp_path: Path) -> None:
    todd_sets.write_syn_todd(tmp_path)
    top = tmp_path / "synthetic_test_pkl"
    (top / "16300.pickle.zstd").rename(top / "016300.pickle.zstd")
    source = opened("syn-todd-test", tmp_path)
    assert names(source)[0] == "163/016300" and source.load(0).depth_true.any()
    assert "16346" in BAD_FRAMES


def test_two_scenes_of_one_name_stay_two(tmp_path: Path) -> None:
    """Results and lists are kept by the name of the scene."""
    for part in ("one", "two"):
        todd_sets.write_rendered(tmp_path / "rendered" / part)
        write_transpose(tmp_path / "arm", f"sequences/{part}/seq_H_01")
    for found in (
        opened("syn-todd-rendered", tmp_path / "rendered"),
        opened("transpose-right-train", tmp_path / "arm"),
    ):
        assert len(set(names(found))) == len(found) == 4
        assert len({s.path for s in found.index.scenes}) == 2


@pytest.mark.parametrize("unit", [1.0, 0.001])
def test_the_arm_of_transpose_in_either_unit(tmp_path: Path, unit: float) -> None:
    write_transpose(tmp_path)
    top = tmp_path / "sequences/seq_H_01"
    hands = json.loads((top / "World2EEs.json").read_text())
    for row in hands.values():
        row["tra"] = [x / unit for x in row["tra"]]
    (top / "World2EEs.json").write_text(json.dumps(hands))
    T = MOUNTED.copy()
    T[:3, 3] /= unit
    (top / "extrinsic.json").write_text(json.dumps({"T_EE2cam_R": T.ravel().tolist()}))
    pose = opened("transpose-right-train", tmp_path).camera_pose(0)
    assert pose is not None
    np.testing.assert_allclose(pose.matrix(), HAND[1] @ MOUNTED, atol=1e-9)
