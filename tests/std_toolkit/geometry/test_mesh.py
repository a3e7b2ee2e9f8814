"""Meshes come as they are stored, in metres, or not at all."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import (
    decimate_mesh,
    hull_vertices,
    load_mesh,
    mesh_diameter,
    mesh_extents,
    nocs_frame,
)
from std_toolkit.geometry.turned_surface import round_axis
from std_toolkit.io.images import write_color

BOX = trimesh.creation.box((0.1, 0.06, 0.03))


def saved(mesh: trimesh.Trimesh, path: Path) -> Path:
    mesh.export(path)
    return path


@pytest.mark.parametrize("suffix", ["ply", "obj", "glb", "off"])
def test_vertices_and_faces_keep_their_order(tmp_path: Path, suffix: str) -> None:
    """Keypoints and NOCS tables refer to vertices by number."""
    mesh = load_mesh(saved(BOX, tmp_path / f"box.{suffix}"))
    np.testing.assert_allclose(mesh.vertices, BOX.vertices, atol=1e-7)
    np.testing.assert_array_equal(mesh.faces, BOX.faces)
    np.testing.assert_allclose(mesh_extents(mesh), [0.1, 0.06, 0.03], atol=1e-7)


def test_vertices_that_no_face_uses_are_kept_but_have_no_size(tmp_path: Path) -> None:
    mesh = trimesh.Trimesh(
        np.vstack([BOX.vertices, [[9.0, 9, 9]]]), BOX.faces, process=False, validate=False
    )
    loaded = load_mesh(saved(mesh, tmp_path / "box.ply"))
    assert len(loaded.vertices) == 9
    np.testing.assert_allclose(mesh_extents(loaded), [0.1, 0.06, 0.03], atol=1e-7)


def test_an_obj_with_a_texture(tmp_path: Path) -> None:
    Image.new("RGB", (8, 8), (200, 10, 10)).save(tmp_path / "paint.png")
    (tmp_path / "box.mtl").write_text("newmtl m\nmap_Kd paint.png\n")
    (tmp_path / "box.obj").write_text(
        "mtllib box.mtl\nusemtl m\n"
        "v 0 0 0\nv 0.1 0 0\nv 0.1 0.1 0\nv 0 0.1 0.02\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n"
    )
    mesh = load_mesh(tmp_path / "box.obj")
    assert len(mesh.faces) == 2  # the quad became two triangles
    np.testing.assert_allclose(mesh.vertices[1], [0.1, 0, 0])
    assert mesh.visual.material.image.size == (8, 8)


def test_an_obj_whose_texture_is_missing_is_still_a_mesh(tmp_path: Path) -> None:
    (tmp_path / "box.obj").write_text(
        "mtllib ../../nowhere.mtl\nv 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n"
    )
    assert len(load_mesh(tmp_path / "box.obj").faces) == 1


def test_the_parts_of_a_glb_scene_become_one_mesh_in_place(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(BOX)
    scene.add_geometry(BOX, transform=trimesh.transformations.translation_matrix([0.2, 0, 0]))
    scene.export(tmp_path / "two.glb")
    mesh = load_mesh(tmp_path / "two.glb")
    assert len(mesh.faces) == 24
    np.testing.assert_allclose(mesh_extents(mesh), [0.3, 0.06, 0.03], atol=1e-7)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1000), ("cm", 100), ("m", 1)])
def test_units_are_converted(tmp_path: Path, unit: str, factor: float) -> None:
    mesh = BOX.copy()
    mesh.apply_scale(factor)
    loaded = load_mesh(saved(mesh, tmp_path / "box.ply"), unit=unit)
    np.testing.assert_allclose(mesh_extents(loaded), [0.1, 0.06, 0.03], atol=1e-7)


def test_millimetres_taken_for_metres_are_refused(tmp_path: Path) -> None:
    mesh = BOX.copy()
    mesh.apply_scale(1000)
    with pytest.raises(ToolkitError, match=r"box\.ply: .*implausibly large.*--mesh-unit mm"):
        load_mesh(saved(mesh, tmp_path / "box.ply"))


def test_metres_taken_for_millimetres_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="implausibly small"):
        load_mesh(saved(BOX, tmp_path / "box.ply"), unit="mm")


TRIANGLE = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\n"
DAMAGED = {
    "empty.obj": b"",
    "empty.ply": b"",
    "empty.glb": b"",
    "points.obj": b"v 0 0 0\nv 1 0 0\n",
    "no_such_vertex.obj": (TRIANGLE + "f 1 2 9\n").encode(),
    "not_a_number.obj": b"v nan 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n",
    "words.obj": b"v a b c\nf 1 2 3\n",
    "mislabelled.glb": (TRIANGLE + "f 1 2 3\n").encode(),
    "truncated.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 8\n"
    b"property float x\nproperty float y\nproperty float z\nelement face 12\n"
    b"property list uchar int vertex_indices\nend_header\n\0\0\0\0",
    "bomb.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 900000000000\n"
    b"property float x\nproperty float y\nproperty float z\nelement face 900000000000\n"
    b"property list uchar int vertex_indices\nend_header\n",
    "wrong_index.ply": b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n"
    b"property float y\nproperty float z\nelement face 1\n"
    b"property list uchar int vertex_indices\nend_header\n0 0 0\n0.1 0 0\n0 0.1 0\n3 0 1 77\n",
    "negative_index.ply": b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n"
    b"property float y\nproperty float z\nelement face 1\n"
    b"property list uchar int vertex_indices\nend_header\n0 0 0\n0.1 0 0\n0 0.1 0\n3 0 1 -7\n",
    "notes.txt": b"a mesh",
    "nothing": b"",
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_meshes_are_refused_by_name(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(DAMAGED[name])
    with pytest.raises(ToolkitError, match=name) as caught:
        load_mesh(path)
    assert "\n" not in str(caught.value)


def test_a_missing_mesh_and_an_unknown_unit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="not found"):
        load_mesh(tmp_path / "box.obj")
    with pytest.raises(ToolkitError, match="unknown unit"):
        load_mesh(saved(BOX, tmp_path / "box.ply"), unit="inch")


def test_the_diameter_is_the_largest_distance_of_two_vertices() -> None:
    assert mesh_diameter(BOX) == pytest.approx(np.linalg.norm([0.1, 0.06, 0.03]), rel=1e-12)
    rng = np.random.default_rng(0)
    points = rng.normal(size=(300, 3)) * 0.03
    mesh = trimesh.Trimesh(points, rng.integers(0, 300, (400, 3)), process=False)
    used = points[np.unique(mesh.faces)]
    exact = np.linalg.norm(used[:, None] - used[None], axis=-1).max()
    assert mesh_diameter(mesh) == pytest.approx(exact, rel=1e-12)


def test_the_diameter_of_a_finely_meshed_ball_needs_little_memory() -> None:
    """All 10,242 vertices lie on the hull: their 10^8 distances at once are 0.8 GB."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    assert mesh_diameter(ball) == pytest.approx(0.1, abs=1e-4)


def _shape(kind: str) -> np.ndarray:
    """Points of which few or all are at the ends of a longest segment, or nearly."""
    rng = np.random.default_rng(1)
    unit = rng.normal(size=(3000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    shapes = {
        "sphere": unit,
        "nearly a sphere": unit * [1, 1, 0.9999],
        "repeated": np.repeat(unit[:6], 700, axis=0),
        "cube": rng.choice([-1.0, 1.0], size=(2000, 3)),
        "far away": 1e-3 * unit + [1000, -400, 70],
        "rims": np.stack([unit[:, 0], unit[:, 1], 0.5 * np.sign(unit[:, 2])], axis=1),
        "disc": unit * [1, 1, 0],
    }
    return 0.1 * shapes[kind]


@pytest.mark.parametrize(
    "kind", ["sphere", "nearly a sphere", "repeated", "cube", "far away", "rims", "disc"]
)
def test_the_diameter_is_exact_whatever_the_shape(kind: str) -> None:
    points = _shape(kind)
    faces = np.arange(len(points) // 3 * 3).reshape(-1, 3)
    used = points[np.unique(faces)]
    exact = max(np.linalg.norm(used - p, axis=1).max() for p in used)
    mesh = trimesh.Trimesh(points, faces, process=False)
    assert mesh_diameter(mesh) == pytest.approx(exact, rel=1e-14)


@pytest.mark.slow
def test_the_diameter_of_a_large_mesh_takes_seconds() -> None:
    """All 163,842 vertices are on the hull and nearly every one ends a longest segment: their
    10^10 distances would take minutes."""
    ball = trimesh.creation.icosphere(subdivisions=7, radius=0.05)
    start = time.process_time()
    assert mesh_diameter(ball) == pytest.approx(0.1, rel=1e-12)
    assert time.process_time() - start < 10


def test_flat_and_straight_meshes_have_an_outline() -> None:
    u, v = np.meshgrid(np.linspace(0, 0.3, 40), np.linspace(0, 0.4, 40))
    grid = np.stack([u.ravel(), v.ravel(), (u + v).ravel()], axis=1)
    faces = np.random.default_rng(0).permutation(1600)[:1599].reshape(-1, 3)
    board = trimesh.Trimesh(grid, np.vstack([faces, [[0, 39, 1599]]]), process=False)
    assert len(hull_vertices(board)) <= 8
    assert mesh_diameter(board) == pytest.approx(np.linalg.norm([0.3, 0.4, 0.7]))
    line = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0.3, 0, 0]], [[0, 1, 2]], process=False)
    assert mesh_diameter(line) == pytest.approx(0.3)


def test_nocs_is_centred_on_the_box_and_divided_by_its_diagonal() -> None:
    mesh = BOX.copy()
    mesh.apply_translation([1, 2, 3])
    centre, diagonal = nocs_frame(mesh)
    nocs = (mesh.vertices - centre) / diagonal + 0.5
    np.testing.assert_allclose((nocs.min(0) + nocs.max(0)) / 2, [0.5] * 3)
    assert np.linalg.norm(np.ptp(nocs, axis=0)) == pytest.approx(1)


def turned_profile(axis: int, centre: tuple[float, float, float]) -> trimesh.Trimesh:
    """A bottle about a coordinate axis, anywhere."""
    profile = np.array([[0, 0], [0.03, 0], [0.04, 0.08], [0.015, 0.13], [0.015, 0.18], [0, 0.18]])
    mesh = trimesh.creation.revolve(profile, sections=48)
    order = {0: [2, 0, 1], 1: [1, 2, 0], 2: [0, 1, 2]}[axis]
    return trimesh.Trimesh(np.asarray(mesh.vertices)[:, order] + centre, mesh.faces, process=False)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_axis_of_a_turned_shape_wherever_it_is(axis: int) -> None:
    mesh = turned_profile(axis, (0.3, -0.2, 0.5))
    assert round_axis(np.asarray(mesh.vertices), np.asarray(mesh.faces)) == axis


def test_a_handle_does_not_hide_the_axis_and_a_box_has_none() -> None:
    bottle = turned_profile(2, (0.1, 0.2, 0.0))
    handle = trimesh.creation.box((0.02, 0.01, 0.06))
    handle.apply_translation((0.16, 0.2, 0.06))
    mug = trimesh.util.concatenate([bottle, handle])
    assert round_axis(np.asarray(mug.vertices), np.asarray(mug.faces)) == 2
    assert round_axis(np.asarray(BOX.vertices), np.asarray(BOX.faces)) is None
    ball = trimesh.creation.icosphere(radius=0.05)
    assert round_axis(np.asarray(ball.vertices), np.asarray(ball.faces)) is None


@pytest.mark.parametrize("share", [0.5, 0.8, 0.97])
@pytest.mark.parametrize("suffix", [".ply", ".off", ".obj"])
def test_text_meshes_that_are_cut_off_are_refused(
    suffix: str, share: float, tmp_path: Path
) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    options = {"encoding": "ascii"} if suffix == ".ply" else {}
    whole = mesh.export(file_type=suffix[1:], **options)
    data = whole.encode() if isinstance(whole, str) else whole
    path = tmp_path / f"ball{suffix}"
    path.write_bytes(data)
    assert len(load_mesh(path).faces) == len(mesh.faces)
    cut = data[: int(len(data) * share)]
    if suffix == ".obj":
        # The format has no counts: only a line that is cut is noticed.
        cut = cut[: cut.rindex(b" ")]
    path.write_bytes(cut)
    with pytest.raises(ToolkitError, match="ball"):
        load_mesh(path)


def test_a_mesh_of_very_many_faces_is_decimated_in_two_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("std_toolkit.geometry.mesh._MOST_FOR_OPEN3D", 5000)
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.05)  # 20,480 faces
    ball.apply_translation((2.0, 0.0, 0.0))
    ball.visual.vertex_colors = np.where(ball.vertices[:, 2:] > 0, [[255, 0, 0, 255]], 0)
    coarse = decimate_mesh(ball, 2000)
    assert len(coarse.faces) == 2000
    from_center = np.linalg.norm(coarse.vertices - [2, 0, 0], axis=1)
    assert np.abs(from_center - 0.05).max() < 0.0005
    inside = np.abs(coarse.vertices[:, 2]) > 0.005
    upper = coarse.vertices[inside, 2] > 0
    assert np.array_equal(coarse.visual.vertex_colors[inside, 0] > 127, upper)


def test_piled_faces_are_refused_and_fans_are_read(tmp_path: Path) -> None:
    """A search for the nearest surface would visit each of them."""
    corners = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\n"
    piled = tmp_path / "piled.obj"
    piled.write_text(corners + "f 1 2 3\n" * 2000)
    book = tmp_path / "book.obj"
    pages = [f"v {0.1 * np.cos(a)} {0.1 * np.sin(a)} 0\n" for a in np.linspace(0, 6, 1500)]
    leaves = [f"f {i + 3} 2 1\n" for i in range(1500)]
    book.write_text("v 0 0 0\nv 0 0 0.1\n" + "".join(pages + leaves))
    apart = tmp_path / "apart.stl"
    trimesh.Trimesh(
        np.tile([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], (2000, 1)),
        np.arange(6000).reshape(-1, 3),
        process=False,
    ).export(apart)
    for path in (piled, book, apart):
        with pytest.raises(ToolkitError, match="more than 1000 faces of the mesh lie on each"):
            load_mesh(path)
    cone = trimesh.creation.cone(0.05, 0.1, sections=3000)
    assert len(load_mesh(saved(cone, tmp_path / "cone.ply")).faces) == len(cone.faces)


BOX_OBJ = "mtllib a.mtl\nv 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"


@pytest.mark.parametrize(
    "name", ["C:\\Users\\me\\tex.png", "TEX.PNG", "maps/tex.png", "/no/such/tex.png"]
)
def test_a_texture_of_another_machine_is_found_by_its_name(
    tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    write_color(tmp_path / "tex.png", np.full((8, 8, 3), (255, 0, 0), np.uint8))
    (tmp_path / "a.mtl").write_text(f"newmtl m\nmap_Kd {name}\n")
    (tmp_path / "a.obj").write_text(BOX_OBJ + "usemtl m\nf 1/1 2/2 3/3\n")
    mesh = load_mesh(tmp_path / "a.obj")
    assert mesh.visual.to_color().vertex_colors[0].tolist() == [255, 0, 0, 255]
    assert "is missing; tex.png is used" in caplog.text


def test_colours_that_are_not_shown_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 0 0\nnewmtl b\nKd 1 0 0\n")
    (tmp_path / "a.obj").write_text(
        BOX_OBJ + "v 0 0 0.1\nusemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 1/1 2/2 4/3\n"
    )
    load_mesh(tmp_path / "a.obj")
    assert "one colour, Kd 1 0 0" in caplog.text
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=[255, 0, 0, 255])
    box.visual = trimesh.visual.TextureVisuals(material=material)
    box.export(tmp_path / "a.glb")
    load_mesh(tmp_path / "a.glb")
    assert "one colour, baseColorFactor 255 0 0" in caplog.text
    (tmp_path / "a.off").write_text(
        "COFF\n3 1 0\n0 0 0 255 0 0 255\n0.1 0 0 255 0 0 255\n0 0.1 0 255 0 0 255\n3 0 1 2\n"
    )
    load_mesh(tmp_path / "a.off")
    assert "colours of OFF files are not read" in caplog.text


@pytest.mark.parametrize(
    "faces",
    [
        "face 1\nproperty list uchar int vertex_indices",
        "tristrips 1\nproperty list int int vertex_indices",
    ],
)
@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        ("uchar", "diffuse_", "255 0 0"),
        ("uchar", "short", "255 0 0"),
        ("float", "", "1.0 0 0"),
        ("ushort", "", "65535 0 0"),
        ("uchar", "", "255 0 0"),
    ],
)
def test_colours_of_ply_files(tmp_path: Path, faces: str, kind: str, name: str, value: str) -> None:
    colors = "".join(f"property {kind} {name}{c}\n" for c in ("red", "green", "blue"))
    if name == "short":
        colors = "".join(f"property {kind} {c}\n" for c in "rgb")
    rows = "".join(f"{xyz} {value}\n" for xyz in ("0 0 0", "0.1 0 0", "0 0.1 0"))
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        f"property float z\n{colors}element {faces}\nend_header\n{rows}3 0 1 2\n"
    )
    mesh = load_mesh(tmp_path / "a.ply")
    assert mesh.visual.vertex_colors[0].tolist() == [255, 0, 0, 255]


def test_decimal_commas_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0,1 0 0\nv 0 0,1 0\nv 0 0 0,1\nf 1 2 3\n")
    with pytest.raises(ToolkitError, match="decimal commas"):
        load_mesh(tmp_path / "a.obj")


@pytest.mark.parametrize(
    "spell",
    [
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace(" ", "\t"),
        lambda text: "".join(f"  {line}\n" for line in text.splitlines()),
        lambda text: "".join(f"{line} # by hand\n" for line in text.splitlines()),
        lambda text: "".join(f"{line} # by hand\n" for line in text.splitlines())[:-1],
    ],
    ids=["line ends", "tabs", "indents", "comments", "comment at the end"],
)
def test_an_obj_as_other_programs_spell_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, spell: Callable[[str], str]
) -> None:
    text = "v 0 0 0\nv 0.1 0 0\nv 0.1 0.1 0\nv 0 0.1 0\nf 1 2 3\nf 1 3 4\n"
    (tmp_path / "a.obj").write_bytes(spell(text).encode())
    mesh = load_mesh(tmp_path / "a.obj")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    np.testing.assert_allclose(mesh.vertices[2], [0.1, 0.1, 0])
    assert not caplog.records


@pytest.mark.parametrize("face", ["0 1 2", "1 2 0", "0/1 1/1 2/1", "1 0//1 2"])
def test_an_obj_whose_faces_count_from_0_is_refused(tmp_path: Path, face: str) -> None:
    """Else the last vertex would stand for the first one."""
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nvt 0 0\nf {face}\n")
    with pytest.raises(ToolkitError, match="counts its corners from 0"):
        load_mesh(tmp_path / "a.obj")


def test_colours_of_a_ply_with_both_names_are_the_usual_ones(tmp_path: Path) -> None:
    colors = "".join(f"property uchar {c}\n" for c in ("red", "green", "blue", "r", "g", "b"))
    rows = "".join(f"{xyz} 10 20 30 1 0 0\n" for xyz in ("0 0 0", "0.1 0 0", "0 0.1 0"))
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        f"property float z\n{colors}element face 1\nproperty list uchar int vertex_indices\n"
        f"end_header\n{rows}3 0 1 2\n"
    )
    mesh = load_mesh(tmp_path / "a.ply")
    assert mesh.visual.vertex_colors[0].tolist() == [10, 20, 30, 255]
