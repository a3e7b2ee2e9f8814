"""The DREDS layout, read back by the toolkit's importer and by a loader like the released one."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from simulated_views import LABELS, make_objects, make_scene, random_frames

from sensors.output.dreds import SUFFIXES, dreds_scene, mask_values, read_record, scene_folder
from sensors.output.simulated_frame import SimulatedFrame, SimulatedScene
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, rotation_angle, umeyama
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.options import ImportRequest
from std_toolkit.importers.std_objects import read_meta
from std_toolkit.io.exr import read_exr_depth
from std_toolkit.scene.model import pose_from_list

HERE = Path(__file__).parent


def write(out: Path, scene: SimulatedScene, frames: list[SimulatedFrame]) -> None:
    with dreds_scene(out, scene, split="train") as writer:
        for frame in frames:
            writer.add(frame)


@pytest.fixture(scope="module")
def scene() -> SimulatedScene:
    return make_scene(frames=3)


@pytest.fixture(scope="module")
def frames(scene: SimulatedScene) -> list[SimulatedFrame]:
    return list(random_frames(scene))


@pytest.fixture(scope="module")
def out(scene, frames, tmp_path_factory) -> Path:
    """Two scenes that share their shapes, the frames of the second one in another order."""
    top = tmp_path_factory.mktemp("dreds") / "set"
    write(top, scene, frames)
    write(top, replace(scene, name="00018"), frames[::-1])
    return top


class ReleasedLoader:
    """As the released code is documented to read: glob by suffix, pair by place, truncate masks."""

    def __init__(self, images: Path) -> None:
        self.lists = {s: sorted(map(str, images.glob(f"*/*{s}"))) for s in SUFFIXES}
        counts = {s: len(found) for s, found in self.lists.items()}
        assert len(set(counts.values())) == 1, counts

    def __len__(self) -> int:
        return len(self.lists["_color.png"])

    def __getitem__(self, i: int) -> dict:
        path = {s: found[i] for s, found in self.lists.items()}
        rgb = cv2.imread(path["_color.png"])[:, :, ::-1]
        raw, exact = (_bgr(path[s])[:, :, 0] for s in ("_simDepthImage.exr", "_depth_120.exr"))
        mask = (_channel(path["_mask.exr"], "R") * 255).astype(np.int32)
        nocs = cv2.imread(path["_coord.png"])[:, :, ::-1].astype(np.float32) / 255
        nocs[:, :, 2] = 1 - nocs[:, :, 2]
        meta = [line.split(" ") for line in Path(path["_meta.txt"]).read_text().splitlines()]
        v, u = np.mgrid[: mask.shape[0], : mask.shape[1]].astype(np.float32)
        return {
            "rgb": rgb,
            "raw": np.where(raw <= 0, 0, raw),
            "depth": np.where(exact <= 0, 0, exact),
            "mask": mask,
            "nocs": nocs - 0.5,
            "meta": meta,
            "u": u,
            "v": v,
            "stem": Path(path["_color.png"]).stem.split("_")[0],
        }

    def squashed(self, i: int) -> dict:
        """At 224x224, by nearest neighbours."""
        return {k: v if not isinstance(v, np.ndarray) else _nearest(v) for k, v in self[i].items()}


def _nearest(image: np.ndarray) -> np.ndarray:
    return cv2.resize(np.ascontiguousarray(image), (224, 224), interpolation=cv2.INTER_NEAREST)


def _channel(path: str, name: str) -> np.ndarray:
    with OpenEXR.File(path, separate_channels=True) as file:
        pixels = file.channels()[name].pixels
        assert pixels.dtype == np.float32
        return pixels.copy()


def _bgr(path: str) -> np.ndarray:
    return np.stack([_channel(path, c) for c in "BGR"], axis=-1)


def fitted(sample: dict, mask_id: int, K: np.ndarray):
    """The authors' advice: Umeyama from NOCS to ground-truth depth, back-projected."""
    chosen = (sample["mask"] == mask_id) & (sample["depth"] > 0)
    u, v, z = (sample[k][chosen].astype(float) for k in ("u", "v", "depth"))
    points = np.stack([(u - K[0, 2]) * z / K[0, 0], (v - K[1, 2]) * z / K[1, 1], z], axis=1)
    return umeyama(sample["nocs"][chosen].astype(float), points), int(chosen.sum())


def test_a_loader_finds_every_file_of_every_frame(out, scene, frames) -> None:
    loader = ReleasedLoader(out / "DREDS-CatKnown/train")
    assert len(loader) == 6
    assert [loader[i]["stem"] for i in range(6)] == ["0000", "0001", "0002"] * 2
    for i, frame in enumerate([*frames, *frames]):
        sample = loader[i]
        np.testing.assert_array_equal(sample["rgb"], frame.color)
        np.testing.assert_array_equal(sample["raw"], frame.depth_aligned)
        np.testing.assert_array_equal(sample["depth"], frame.depth_exact)
        np.testing.assert_array_equal(
            np.where(sample["mask"] == 255, 0, sample["mask"]), frame.mask
        )
        assert ((sample["mask"] == 255) == (frame.mask == 0)).all()
        seen = frame.mask > 0
        assert np.abs(sample["nocs"][seen] + 0.5 - frame.nocs[seen]).max() <= 0.5 / 255 + 1e-6


def test_missing_raw_depth_is_minus_a_millimetre(out, frames) -> None:
    raw = _bgr(str(scene_folder(out, "train", "00017") / "0000_simDepthImage.exr"))
    assert (raw[:, :9] == np.float32(-0.001)).all()
    assert (raw == raw[..., :1]).all()


@pytest.mark.parametrize("squash", [False, True], ids=["label size", "224x224"])
def test_nocs_and_depth_tell_every_pose(out, scene, frames, squash) -> None:
    loader = ReleasedLoader(out / "DREDS-CatKnown/train")
    fits = 0
    for i, frame in enumerate(frames):
        sample = loader.squashed(i) if squash else loader[i]
        for item in scene.objects:
            if (frame.mask == item.instance_id).sum() < 300:
                continue
            fit, pixels = fitted(sample, item.instance_id, frame.label_camera.K)
            truth = frame.T_world_cam.inverse() @ item.T_world_obj
            assert pixels > 100
            assert np.linalg.norm(fit.t - truth.t) < 1e-3
            assert rotation_angle(fit.R.T @ truth.R) < np.radians(0.7)
            assert fit.scale == pytest.approx(item.scale_m, rel=0.01)
            fits += 1
    assert fits >= 12


def test_meta_lines_tell_what_the_generator_tells(out, scene, frames) -> None:
    loader = ReleasedLoader(out / "DREDS-CatKnown/train")
    for i, frame in enumerate(frames):
        lines = loader[i]["meta"]
        assert [int(line[0]) for line in lines] == [o.instance_id for o in scene.objects]
        for line, item in zip(lines, scene.objects, strict=True):
            assert (len(line), line[-1]) == (14, "")
            truth = frame.T_world_cam.inverse() @ item.T_world_obj
            assert int(line[1]) == item.class_id
            cad = out / "cad_model/syn_train" / line[2] / line[3]
            assert (cad / "model.obj").is_file()
            assert float(line[4]) == pytest.approx(item.scale_m, abs=1e-8)
            assert (
                int(line[5])
                == {"raw": 0, "diffuse": 1, "transparent": 2, "specular": 3}[item.material_class]
            )
            w, x, y, z = (float(n) for n in line[6:10])
            # The conjugate is the rotation object to camera.
            conjugate = SE3.from_quat([w, -x, -y, -z], np.zeros(3))
            np.testing.assert_allclose(conjugate.R, truth.R, atol=1e-7)
            np.testing.assert_allclose([float(n) for n in line[10:13]], truth.t, atol=1e-8)
    synsets = {
        o.category: p.parent.name
        for o in scene.objects
        for p in (out / "cad_model/syn_train").glob(f"*/{o.asset_id}")
    }
    assert synsets == {
        "other": "00000000",
        "can": "02946921",
        "mug": "03797390",
        "bottle": "02876657",
        "bowl": "02880940",
    }


def test_models_have_a_unit_diagonal_and_their_box(out, scene) -> None:
    for item in scene.objects:
        (folder,) = (out / "cad_model/syn_train").glob(f"*/{item.asset_id}")
        high, low = np.loadtxt(folder / "bbox.txt")
        assert np.linalg.norm(high - low) == pytest.approx(1, abs=1e-6)
        rows = [s.split() for s in (folder / "model.obj").read_text().splitlines()]
        vertices = np.array([r[1:4] for r in rows if r and r[0] == "v"], float)
        np.testing.assert_allclose(vertices.max(0), high, atol=1e-6)
        np.testing.assert_allclose(vertices.min(0), low, atol=1e-6)


def test_pictures_have_their_sizes_and_types(out, frames) -> None:
    folder = scene_folder(out, "train", "00017")
    for name, shape in (("color", (360, 640, 3)), ("ir_l", (180, 320)), ("ir_r", (180, 320)),
                        ("coord", (180, 320, 3))):  # fmt: skip
        image = cv2.imread(str(folder / f"0001_{name}.png"), cv2.IMREAD_UNCHANGED)
        assert (image.dtype, image.shape) == (np.uint8, shape)
    left = cv2.imread(str(folder / "0001_ir_l.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(left, frames[1].infrared_left)
    normals = _bgr(str(folder / "0001_normal.exr"))[:, :, ::-1]
    np.testing.assert_array_equal(normals, frames[1].normals)
    assert normals.shape == (*LABELS[::-1], 3)


def test_every_mask_id_survives_truncation() -> None:
    ids = np.arange(256, dtype=np.uint8).reshape(16, 16)
    values = mask_values(ids)
    assert values.dtype == np.float32
    expected = np.where(ids == 0, 255, ids)
    np.testing.assert_array_equal((values * 255).astype(np.int32), expected)
    np.testing.assert_array_equal(
        (values.astype(np.float64) * 255 + 1e-5).astype(np.int32), expected
    )


def test_the_importer_gives_the_scene_back(out, scene, frames, tmp_path) -> None:
    request = ImportRequest(
        source=scene_folder(out, "train", "00017"),
        name="back",
        intrinsics=str(out / "parameters/train/00017.json"),
    )
    back = import_recording(request, tmp_path / "back")
    assert [f.name for f in back.frames] == ["0000", "0001", "0002"]
    assert back.camera(back.frames[0]) == frames[0].label_camera
    for frame, read in zip(frames, back.frames, strict=True):
        np.testing.assert_array_equal(back.read_depth(read), frame.depth_aligned)
        halved = cv2.resize(frame.color, LABELS, interpolation=cv2.INTER_AREA)
        assert np.abs(back.read_color(read).astype(int) - halved).max() <= 1
        reference = back.root / "reference"
        np.testing.assert_array_equal(
            read_exr_depth(reference / f"depth/{read.name}.exr"), frame.depth_exact
        )
        mask = cv2.imread(str(reference / f"mask/{read.name}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(mask, frame.mask)
    things = {o.id: o for o in back.objects.objects}
    assert set(things) == {o.instance_id for o in scene.objects}
    for item in scene.objects:
        model = back.objects.model_of(item.instance_id)
        assert things[item.instance_id].material == item.material_class
        assert (model.category, model.class_id) == (item.category, item.class_id)
        assert np.linalg.norm(model.size_m) == pytest.approx(item.scale_m, rel=1e-6)
        label = back.labels.of(item.instance_id)
        views = {str(label.frame): label.T_cam_obj, **label.views}
        assert views
        for key, flat in views.items():
            truth = frames[int(key)].T_world_cam.inverse() @ item.T_world_obj
            found = pose_from_list(flat)
            assert np.linalg.norm(found.t - truth.t) < 1e-3
            assert rotation_angle(found.R.T @ truth.R) < np.radians(0.7)


def test_the_toolkit_reads_the_meta_lines(out, scene, frames) -> None:
    folder = scene_folder(out, "train", "00017")
    for frame in frames:
        lines = read_meta(folder / f"{frame.index:04d}_meta.txt")
        assert [x.mask_id for x in lines] == [o.instance_id for o in scene.objects]
        assert [x.material for x in lines] == [o.material_class for o in scene.objects]


def test_the_record_holds_what_the_layout_cannot(out, scene, frames) -> None:
    record = read_record(out, "train", "00017")
    assert (record.seed, record.sensor, record.name) == (17, "d415", "00017")
    assert record.parameters == scene.parameters
    assert record.color_camera.camera() == frames[0].color_camera
    assert record.infrared_camera.camera() == frames[0].infrared_camera
    for frame, row in zip(frames, record.frames, strict=True):
        assert row.index == frame.index
        np.testing.assert_allclose(row.T_world_ir, frame.T_world_ir.flat(), atol=1e-15)
        np.testing.assert_allclose(row.T_world_cam, frame.T_world_cam.flat(), atol=1e-15)
    for item, entry in zip(scene.objects, record.objects, strict=True):
        assert entry.asset_id == item.asset_id
        np.testing.assert_allclose(entry.T_world_obj, item.T_world_obj.flat(), atol=1e-15)
    # No loader's pattern meets a record, a model or a folder.
    met = [p for s in SUFFIXES for p in out.rglob(f"*{s}")]
    assert {p.parent.parent for p in met} == {out / "DREDS-CatKnown/train"}


def test_the_same_scene_has_the_same_bytes_in_any_order(out) -> None:
    first, second = (scene_folder(out, "train", n) for n in ("00017", "00018"))
    names = sorted(p.name for p in first.iterdir())
    assert names == sorted(p.name for p in second.iterdir())
    assert len(names) == 3 * len(SUFFIXES)
    for name in names:
        assert (first / name).read_bytes() == (second / name).read_bytes(), name


def seen_by_loaders(out: Path) -> list[Path]:
    """What a pattern meets; pathlib's meets hidden folders, too."""
    data = out / "DREDS-CatKnown"
    return [p for s in SUFFIXES for top in (data, data / "train") for p in top.glob(f"*/*{s}")]


def test_nothing_is_seen_before_the_scene_is_whole(scene, frames, tmp_path) -> None:
    out = tmp_path / "set"
    with dreds_scene(out, scene, split="train") as writer:
        for frame in frames:
            writer.add(frame)
            assert not seen_by_loaders(out)
    assert len(seen_by_loaders(out)) == 3 * len(SUFFIXES)
    assert sorted(p.name for p in out.iterdir()) == ["DREDS-CatKnown", "cad_model", "parameters"]


def test_a_scene_that_fails_leaves_nothing(scene, frames, tmp_path) -> None:
    out = tmp_path / "set"
    with pytest.raises(ToolkitError, match="1 of 3 frames"):
        write(out, scene, frames[:2])
    with pytest.raises(KeyboardInterrupt), dreds_scene(out, scene, split="train") as writer:
        writer.add(frames[0])
        raise KeyboardInterrupt
    assert not any(p.is_file() for p in out.rglob("*"))
    with pytest.raises(ToolkitError, match="no such scene"):
        read_record(out, "train", "00017")


def test_a_full_disk_is_told_with_the_place_that_was_asked_for(
    scene, frames, tmp_path, monkeypatch
) -> None:
    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("std_toolkit.io.atomic.os.fsync", full)
    with pytest.raises(ToolkitError, match=r"train/00017/0000_color\.png.*No space left"):
        write(tmp_path / "set", scene, frames)
    assert not any(p.is_file() for p in (tmp_path / "set").rglob("*"))


KILLED = """
import os, signal, sys
from pathlib import Path
sys.path[:0] = [{here!r}]
from simulated_views import make_scene, random_frames
from sensors.output.dreds import dreds_scene
scene = make_scene(frames=3)
with dreds_scene(Path(sys.argv[1]), scene, split="train") as writer:
    for frame in random_frames(scene):
        writer.add(frame)
        if frame.index == 1:
            os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.slow
def test_a_killed_writer_leaves_no_half_scene(out, scene, frames, tmp_path) -> None:
    again = tmp_path / "set"
    code = KILLED.format(here=str(HERE))
    root = HERE.parents[2]
    done = subprocess.run([sys.executable, "-c", code, str(again)], cwd=root, timeout=100)
    assert done.returncode == -signal.SIGKILL
    assert any((again / ".partial").rglob("0001_color.png"))
    assert not seen_by_loaders(again)
    write(again, scene, frames)
    assert not (again / ".partial").exists()
    whole = scene_folder(out, "train", "00017")
    files = sorted(p.name for p in scene_folder(again, "train", "00017").iterdir())
    assert files == sorted(p.name for p in whole.iterdir())
    for name in files:
        written = scene_folder(again, "train", "00017") / name
        assert written.read_bytes() == (whole / name).read_bytes(), name


@pytest.mark.slow
def test_two_writers_of_one_scene_do_not_mix(scene, frames, tmp_path) -> None:
    out = tmp_path / "set"
    with (
        pytest.raises(ToolkitError, match="already"),
        dreds_scene(out, scene, split="train") as one,
    ):
        one.add(frames[0])
        write(out, scene, frames)
        one.add(frames[1])
        one.add(frames[2])
    assert len(seen_by_loaders(out)) == 3 * len(SUFFIXES)
    assert read_record(out, "train", "00017").seed == 17
    with pytest.raises(ToolkitError, match="already"):
        write(out, scene, frames)


@pytest.mark.slow
def test_a_name_stands_for_one_mesh(scene, frames, tmp_path) -> None:
    out = tmp_path / "set"
    write(out, scene, frames)
    box, can = make_objects()[:2]
    other = replace(can, mesh=box.mesh)
    changed = replace(scene, name="00099", objects=[box, other, *scene.objects[2:]])
    with pytest.raises(ToolkitError, match="another mesh of this name"):
        write(out, changed, frames)
    assert not scene_folder(out, "train", "00099").exists()
    assert not (out / "parameters/train/00099.json").exists()


def test_what_the_layout_cannot_hold_is_refused(scene, frames, tmp_path) -> None:
    with (
        pytest.raises(ToolkitError, match="split"),
        dreds_scene(tmp_path, scene, split="validation"),
    ):
        pass
    many = replace(scene, frames=10_001)
    with (
        pytest.raises(ToolkitError, match="10000 frames"),
        dreds_scene(tmp_path, many, split="val"),
    ):
        pass
    bent = replace(frames[0].color_camera, distortion=(0.1, 0.0, 0.0, 0.0))
    with pytest.raises(ToolkitError, match="pinhole"):
        write(tmp_path / "set", scene, [replace(frames[0], color_camera=bent)])


def test_novel_scenes_have_the_layout_of_catnovel(scene, frames, tmp_path: Path) -> None:
    """No split, no NOCS, no meshes, short meta lines."""
    with dreds_scene(tmp_path, scene, split="test", novel=True) as writer:
        for frame in frames:
            writer.add(frame)
    folder = tmp_path / "DREDS-CatNovel" / scene.name
    assert len(list(folder.glob("*_depth_0.exr"))) == scene.frames
    assert not list(folder.glob("*_coord.png")) and not (tmp_path / "cad_model").exists()
    rows = (folder / "0000_meta.txt").read_text().splitlines()
    assert {len(row.split()) for row in rows} == {3}
    assert [row.mask_id for row in read_meta(folder / "0000_meta.txt")] == [
        o.instance_id for o in scene.objects
    ]
    assert (tmp_path / "parameters/novel" / f"{scene.name}.json").is_file()
