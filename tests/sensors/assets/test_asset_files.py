"""Assets from ShapeNet folders and any folder of meshes, written by the tests."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from sensors.assets import TURN_Y, Asset, AssetSource, SourceOptions, open_source
from sensors.assets.asset_source import in_split
from std_toolkit.errors import ToolkitError

MUG, BOTTLE = "03797390", "02876657"
QUAD = """mtllib model.mtl
v 0 0 0
v 2 0 0
v 2 1 0
v 0 1 0
v 0 0 1
vt 0.1 0.1
vt 0.9 0.1
vt 0.9 0.9
vt 0.1 0.9
usemtl skin
f 1/1 3/3 2/2
f 1/1 4/4 3/3
f 1/1 2/2 5/4
f 2/2 3/3 5/4
f 3/3 4/4 5/4
f 4/4 1/1 5/4
"""


def write_obj(path: Path, mesh: trimesh.Trimesh) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)


def textured(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "model.obj").write_text(QUAD)
    (folder / "model.mtl").write_text("newmtl skin\nKd 1 1 1\nmap_Kd skin.png\n")
    picture = np.zeros((8, 8, 3), np.uint8)
    picture[:4] = (255, 0, 0)  # the upper half, v > 0.5
    picture[4:] = (0, 0, 255)
    Image.fromarray(picture).save(folder / "skin.png")


@pytest.mark.slow
def test_shapenet_of_both_versions(tmp_path: Path) -> None:
    for k in range(12):
        cylinder = trimesh.creation.cylinder(0.2 + 0.01 * k, 1.0, sections=64)
        cylinder.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
        write_obj(tmp_path / BOTTLE / f"b{k}" / "models" / "model_normalized.obj", cylinder)
    textured(tmp_path / MUG / "m1")
    (tmp_path / MUG / "empty_folder").mkdir()
    (tmp_path / "04379243" / "table").mkdir(parents=True)
    source = open_source("shapenet", SourceOptions(root=tmp_path))
    assert list(source.categories()) == ["bottle", "mug"]
    asset = source.sample(np.random.default_rng(1), "bottle")
    assert asset.class_id == 1 and asset.symmetry == TURN_Y and asset.diagonal_m is None
    assert np.linalg.norm(asset.mesh.extents) == pytest.approx(1, abs=1e-6)
    assert source.load(asset.id).content_hash == asset.content_hash
    mug = source.load(f"{MUG}-m1")
    assert mug.symmetry.is_trivial and mug.mesh.is_watertight
    assert mug.texture is not None and mug.texture.shape == (8, 8, 3)
    assert mug.corner_uv is not None and mug.corner_uv.max() == pytest.approx(0.9)

    def ids(split: str) -> set[str]:
        part = open_source("shapenet", SourceOptions(root=tmp_path, split=split))  # type: ignore[arg-type]
        rng = np.random.default_rng(0)
        return {part.sample(rng, "bottle").id for _ in range(60)}

    assert ids("train") and ids("test")
    assert ids("train") | ids("test") == {f"{BOTTLE}-b{k}" for k in range(12)}
    assert not ids("train") & ids("test")


def test_texture_colours_the_faces(tmp_path: Path) -> None:
    textured(tmp_path / MUG / "m1")
    mug = open_source("shapenet", SourceOptions(root=tmp_path)).load(f"{MUG}-m1")
    assert mug.corner_uv is not None and mug.face_colors is not None
    v = mug.corner_uv[..., 1].mean(axis=1)
    expected = np.where((v > 0.5)[:, None], (255, 0, 0), (0, 0, 255))
    np.testing.assert_array_equal(mug.face_colors, expected)


@pytest.mark.parametrize("wrong", [f"{MUG}-x", "03797390", "9-m1", f"{MUG}-..", f"{MUG}-../a"])
def test_unknown_shapenet_ids(tmp_path: Path, wrong: str) -> None:
    textured(tmp_path / MUG / "m1")
    source = open_source("shapenet", SourceOptions(root=tmp_path))
    with pytest.raises(ToolkitError, match="no such model"):
        source.load(wrong)
    with pytest.raises(ToolkitError, match="no model of this category"):
        source.sample(np.random.default_rng(0), "car")


def test_folders_without_models(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="no ShapeNetCore model"):
        open_source("shapenet", SourceOptions(root=tmp_path))
    with pytest.raises(ToolkitError, match="not there"):
        open_source("shapenet", SourceOptions(root=tmp_path / "none"))
    with pytest.raises(ToolkitError, match="needs the folder"):
        open_source("folder")
    with pytest.raises(ToolkitError, match="no mesh here"):
        open_source("folder", SourceOptions(root=tmp_path))


def test_what_a_folder_without_meshes_of_the_split_has_is_told(tmp_path: Path) -> None:
    (tmp_path / "mug").mkdir()
    (tmp_path / "mug/a.dae").write_text("<COLLADA/>")
    with pytest.raises(ToolkitError, match=r"mug/a\.dae: not a mesh format; .*as OBJ or GLB"):
        open_source("folder", SourceOptions(root=tmp_path))
    write_obj(tmp_path / "mug/a.obj", trimesh.creation.box((1, 2, 3)))
    found = {}
    for split in ("train", "test"):
        try:
            open_source("folder", SourceOptions(root=tmp_path, split=split))  # type: ignore[arg-type]
        except ToolkitError as error:
            found[split] = str(error)
    assert len(found) == 1
    assert ": 1 of the other split" in next(iter(found.values()))


def test_a_mesh_at_the_end_of_the_numbers_is_named(tmp_path: Path) -> None:
    path = tmp_path / "mug/far.obj"
    write_obj(path, trimesh.creation.box((1, 2, 3)).apply_translation([1e200, 0, 0]))
    source = open_source("folder", SourceOptions(root=tmp_path, split="all"))
    with pytest.raises(ToolkitError, match=r"far\.obj: .*implausibly far away"):
        source.load("mug_far")


def test_folder_by_subfolders(tmp_path: Path) -> None:
    write_obj(tmp_path / "mug" / "red.obj", trimesh.creation.box((1, 2, 3)))
    write_obj(tmp_path / "mug" / "blue" / "model.ply", trimesh.creation.icosphere(3))
    write_obj(tmp_path / "teapot" / "a.stl", trimesh.creation.box((1, 1, 1)))
    (tmp_path / "mug" / "notes.txt").write_text("not a mesh")
    source = open_source("folder", SourceOptions(root=tmp_path))
    assert list(source.categories()) == ["mug", "teapot"]
    assert {source.sample(np.random.default_rng(k), "mug").id for k in range(9)} == {
        "mug_red",
        "mug_blue_model",
    }
    teapot = source.load("teapot_a")
    assert (teapot.class_id, teapot.category) == (0, "teapot")
    # STL repeats every corner; welded it is closed.
    assert teapot.mesh.is_watertight and len(teapot.vertices) == 8


def test_folder_by_document(tmp_path: Path) -> None:
    # A cone standing along z, in millimetres.
    write_obj(tmp_path / "scans" / "cone.ply", trimesh.creation.cone(30, 90, sections=128))
    write_obj(tmp_path / "scans" / "box.ply", trimesh.creation.box((0.05, 0.1, 0.2)))
    rows = [
        {"mesh": "scans/cone.ply", "category": "other", "up": "z", "unit": "mm", "id": "cone"},
        {"mesh": "scans/box.ply", "category": "mug", "symmetry": "axis:y", "material": "specular"},
    ]
    (tmp_path / "assets.json").write_text(json.dumps({"assets": rows}))
    source = open_source("folder", SourceOptions(root=tmp_path, unit="m"))
    cone = source.load("cone")
    assert cone.symmetry == TURN_Y
    assert cone.diagonal_m == pytest.approx(np.linalg.norm((0.06, 0.06, 0.09)), rel=1e-3)
    # The point is up.
    np.testing.assert_allclose(cone.vertices[cone.vertices[:, 1].argmax(), ::2], 0, atol=1e-6)
    assert cone.mesh.volume > 0
    box = source.load("mug_scans_box")
    assert (box.material, cone.material) == ("specular", None)
    assert box.symmetry == TURN_Y
    assert box.diagonal_m == pytest.approx(np.linalg.norm((0.05, 0.1, 0.2)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not a list of assets"),
        ('{"assets": [{"mesh": "a.ply"}]}', "category"),
        ('{"assets": [{"mesh": "../a.ply", "category": "mug"}]}', "relative path"),
        ('{"assets": [{"mesh": "a.ply", "category": "m/u"}]}', "safe name"),
        ('{"assets": [{"mesh": "a.ply", "category": "mug", "colour": 1}]}', "colour"),
        ('{"assets": [{"mesh": "a.ply", "category": "mug", "material": "glass"}]}', "material"),
        (
            '{"assets": [{"mesh": "a.ply", "category": "mug"}, '
            '{"mesh": "a.obj", "category": "mug"}]}',
            "same id",
        ),
    ],
)
def test_bad_documents(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "assets.json").write_text(text)
    with pytest.raises(ToolkitError, match=message):
        open_source("folder", SourceOptions(root=tmp_path))


def test_millimetres_are_refused_only_where_metres_are_meant(tmp_path: Path) -> None:
    write_obj(tmp_path / "mug" / "big.ply", trimesh.creation.box((80, 90, 100)))
    free = open_source("folder", SourceOptions(root=tmp_path)).load("mug_big")
    assert free.diagonal_m is None
    with pytest.raises(ToolkitError, match="implausibly large"):
        open_source("folder", SourceOptions(root=tmp_path, unit="m")).load("mug_big")
    metric = open_source("folder", SourceOptions(root=tmp_path, unit="mm")).load("mug_big")
    assert metric.diagonal_m == pytest.approx(0.1565, abs=1e-4)
    with pytest.raises(ToolkitError, match="unknown unit"):
        open_source("folder", SourceOptions(root=tmp_path, unit="inch"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "cannot read|no faces"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "cannot read|no faces"),
        ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "one place"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "cannot read|do not exist"),
    ],
)
def test_broken_meshes_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "mug").mkdir()
    (tmp_path / "mug" / "a.obj").write_text(text)
    with pytest.raises(ToolkitError, match=message) as caught:
        open_source("folder", SourceOptions(root=tmp_path)).load("mug_a")
    assert "a.obj" in str(caught.value)


def test_open_surface_is_used_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    half = trimesh.creation.icosphere(3)
    half.update_faces(half.triangles_center[:, 1] < 0)
    write_obj(tmp_path / "bowl" / "sheet.ply", half)
    with caplog.at_level("WARNING", logger="std_toolkit"):
        bowl = open_source("folder", SourceOptions(root=tmp_path)).load("bowl_sheet")
    assert "not closed" in caplog.text
    assert not bowl.mesh.is_watertight and bowl.symmetry == TURN_Y


def test_an_asset_outside_the_canonical_frame_is_refused() -> None:
    box = trimesh.creation.box((1, 1, 1))
    with pytest.raises(ToolkitError, match="bounding-box diagonal"):
        Asset(id="a", category="mug", mesh=box)


def test_split_of_a_name_is_its_own() -> None:
    names = [f"model{k}" for k in range(2000)]
    test = [n for n in names if in_split(n, "test")]
    assert all(in_split(n, "train") != in_split(n, "test") for n in names)
    assert 0.16 < len(test) / len(names) < 0.24


class BoxSource:
    """A source of one asset, as another package would bring it."""

    def __init__(self, options: SourceOptions) -> None:
        self.options = options

    def categories(self) -> list[str]:
        return ["carton"]

    def sample(self, rng: np.random.Generator, category: str) -> Asset:
        return self.load(f"{category}-{rng.integers(9)}")

    def load(self, asset_id: str) -> Asset:
        box = trimesh.creation.box(np.full(3, 3**-0.5))
        return Asset(id=asset_id, category="carton", mesh=box)


def test_sources_of_other_packages() -> None:
    source: AssetSource = open_source(f"{__name__}:BoxSource", SourceOptions(split="test"))
    assert source.sample(np.random.default_rng(0), "carton").class_id == 0
    with pytest.raises(ToolkitError, match=r"asset_sources.*procedural, shapenet, folder"):
        open_source("blender")
