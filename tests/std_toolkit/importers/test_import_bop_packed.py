"""BOP-imagewise and BOP-webdataset: the same scenes as in folders, and what breaks the forms."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.bop_packed import unpack_data_set
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.importer import detect_format
from std_toolkit.importers.options import ImportRequest
from std_toolkit.scene import Scene

K = [70.0, 0, 31.5, 0, 71.0, 23.5, 0, 0, 1]
# Scene and image numbers from 0, out of order.
IMAGES = [(3, 7), (0, 0), (0, 12), (3, 1)]


def image_wise(folder: Path, images: list[tuple[int, int]] = IMAGES) -> Path:
    """As the format's description has it; depth is 0.7 m and the image's number in millimetres."""
    folder.mkdir(parents=True)
    for scene, image in images:
        key = f"{scene:06d}_{image:06d}"
        color = np.full((48, 64, 3), (10 * scene, image, 90), np.uint8)
        cv2.imwrite(str(folder / f"{key}.rgb.png"), color)
        cv2.imwrite(
            str(folder / f"{key}.depth.png"), np.full((48, 64), 7000 + 10 * image, np.uint16)
        )
        pose = {"obj_id": 0, "cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [10, 0, 650]}
        documents = {
            "camera": {
                "cam_K": K,
                "depth_scale": 0.1,
                "cam_R_w2c": np.eye(3).ravel().tolist(),
                "cam_t_w2c": [0, 0, 0],
            },
            "gt": [pose],
            "gt_info": [{"visib_fract": 1.0}],
            "mask": {"0": {"counts": [0, 64 * 48], "size": [48, 64]}},
        }
        for part, content in documents.items():
            (folder / f"{key}.{part}.json").write_text(json.dumps(content))
    models = folder.parent / "models"
    models.mkdir()
    trimesh.creation.box((30, 40, 120)).export(models / "obj_000000.ply")
    return folder


def shards(folder: Path, out: Path, per_shard: int = 3) -> Path:
    """A WebDataset of image-wise files, key by key."""
    out.mkdir()
    keys = sorted({p.name.split(".")[0] for p in folder.iterdir()})
    for k in range(0, len(keys), per_shard):
        with tarfile.open(out / f"shard-{k // per_shard:06d}.tar", "w") as archive:
            for key in keys[k : k + per_shard]:
                for path in sorted(folder.glob(f"{key}.*")):
                    archive.add(path, path.name)
    (out / "key_to_shard.json").write_text("{}")
    return out


@pytest.fixture(params=["image-wise", "shards"])
def packed(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    folder = image_wise(tmp_path / "set" / "train_imwise")
    if request.param == "image-wise":
        return folder
    made = shards(folder, tmp_path / "set" / "train_web")
    for path in folder.iterdir():
        path.unlink()
    return made


def imported(source: Path, out: Path) -> Scene:
    return import_recording(ImportRequest(source=source, name="s"), out)


def test_a_scene_is_imported(packed: Path, tmp_path: Path) -> None:
    source = packed / "000003"
    assert detect_format(source) == "bop"
    scene = imported(source, tmp_path / "scene")
    assert [f.name for f in scene.frames] == ["000001", "000007"]
    first = scene.frames[0]
    depth = scene.read_depth(first)
    assert depth is not None and depth[5, 5] == pytest.approx(0.701)
    assert scene.read_color(first)[0, 0].tolist() == [90, 1, 30]
    T = scene.T_cam_obj(first.id, scene.objects.objects[0].id)
    assert T is not None and T.t.round(6).tolist() == [0.01, 0, 0.65]
    paths = [scene.root / f.color for f in scene.frames]
    assert not any(p.is_symlink() for p in paths) and packed.is_dir()
    # What was there is as it was.
    assert not (packed.parent / "bop").exists()


def test_several_scenes_are_named(packed: Path, tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="several BOP scenes") as caught:
        imported(packed, tmp_path / "scene")
    assert "000000, 000003" in str(caught.value) and str(packed / "000000") in str(caught.value)
    with pytest.raises(ToolkitError, match="no such scene") as caught:
        imported(packed / "000009", tmp_path / "scene")
    assert "9" in str(caught.value) and not (tmp_path / "scene").exists()


def test_it_is_laid_out_as_scene_folders(packed: Path, tmp_path: Path) -> None:
    found = unpack_data_set(packed, tmp_path / "out")
    assert sorted(p.name for p in found.iterdir()) == ["000000", "000003"]
    gt = json.loads((found / "000000/scene_gt.json").read_text())
    assert list(gt) == ["0", "12"] and gt["12"][0]["cam_t_m2c"] == [10, 0, 650]
    assert (found / "000000/depth/000012.png").read_bytes()[:4] == b"\x89PNG"
    assert not (found / "000000/mask").exists()
    assert (tmp_path / "out/models/obj_000000.ply").is_file()


def test_scene_folders_go_before(tmp_path: Path) -> None:
    """A data set with scenes in folders and a packed split is that with the folders."""
    top = tmp_path / "set"
    image_wise(top / "train_imwise")
    split = unpack_data_set(top / "train_imwise", tmp_path / "other", scene=0)
    split.rename(top / "test")
    assert [f.name for f in imported(top, tmp_path / "scene").frames] == ["000000", "000012"]


def _add(path: Path, name: str, data: bytes = b"{}", kind: bytes = tarfile.REGTYPE) -> None:
    with tarfile.open(path, "a") as archive:
        member = tarfile.TarInfo(name)
        member.size, member.type = (len(data), kind) if kind == tarfile.REGTYPE else (0, kind)
        member.linkname = "/etc/passwd"
        archive.addfile(member, io.BytesIO(data) if kind == tarfile.REGTYPE else None)


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (lambda p: p.write_bytes(p.read_bytes()[:5000]), "cannot read the archive"),
        (lambda p: p.write_bytes(b"no archive" * 100), "cannot read the archive"),
        (lambda p: _add(p, "../../evil.rgb.png"), "no file of an image of BOP"),
        (lambda p: _add(p, "000003_000099.rgb.png", kind=tarfile.SYMTYPE), "no file of an image"),
        (lambda p: _add(p, "000003_000007.camera.json"), "an image comes twice"),
        (lambda p: _add(p, "000003_000099.gt.json", b"[]"), "an image lacks its camera"),
        (lambda p: _add(p, "000003_000099.camera.json", b"{,"), "not valid JSON"),
        (lambda p: _add(p, "000003_000099.camera.json", b"{}"), "needs cam_K or cam_model"),
    ],
)
def test_a_wrong_shard_is_refused_in_one_line(tmp_path: Path, harm, told: str) -> None:
    folder = image_wise(tmp_path / "set" / "imwise", [(3, 7)])
    web = shards(folder, tmp_path / "set" / "web")
    harm(web / "shard-000000.tar")
    with pytest.raises(ToolkitError, match=told) as caught:
        imported(web / "000003", tmp_path / "scene")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "scene").exists()


def test_two_packed_folders_are_named(tmp_path: Path) -> None:
    folder = image_wise(tmp_path / "set" / "a", [(3, 7)])
    shards(folder, tmp_path / "set" / "b")
    with pytest.raises(ToolkitError, match="several folders of BOP images") as caught:
        detect_format(tmp_path / "set")
    assert "give a, b" in str(caught.value)
