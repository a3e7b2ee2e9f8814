"""Copies of meshes: what OBJ, PLY and STL files of other programs hold arrives in the scene."""

from __future__ import annotations

import contextlib
import os
import struct
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import load_mesh, vertex_colors
from std_toolkit.geometry.mesh_proof import check_copy, check_same_mesh
from std_toolkit.geometry.obj_files import texture_options
from std_toolkit.labels.entry.mesh_copies import plan_mesh_copy, write_mesh_copy

RED, BLUE = (200, 30, 30), (30, 30, 200)
BOX = trimesh.creation.box((0.06, 0.08, 0.1))
VERTICES = [f"v {x} {y} {z}" for x, y, z in BOX.vertices]
UV = ["vt 0.05 0.05", "vt 0.95 0.05", "vt 0.95 0.95"]
FACES = [f"f {a + 1}/1 {b + 1}/2 {c + 1}/3" for a, b, c in BOX.faces]


def obj(path: Path, *lines: str, mark: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(mark + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def picture(path: Path, color: tuple[int, int, int]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (8, 8), color).save(path)


def copied(path: Path, **options: str) -> trimesh.Trimesh:
    target = path.parent / "copy"
    return load_mesh(write_mesh_copy(target, plan_mesh_copy(path, unit="m", **options)))


def colors_of(mesh: trimesh.Trimesh) -> set[tuple[int, ...]]:
    colors = vertex_colors(mesh)
    assert colors is not None
    return {tuple(int(x) for x in c[:3]) for c in colors}


def test_textures_of_one_name_in_two_folders(tmp_path: Path) -> None:
    picture(tmp_path / "t1/diffuse.png", RED)
    picture(tmp_path / "t2/diffuse.png", BLUE)
    text = "newmtl A\nmap_Kd t1/diffuse.png\nnewmtl B\nmap_Kd t2/diffuse.png\n"
    (tmp_path / "two.mtl").write_text(text)
    path = obj(
        tmp_path / "two.obj", "mtllib two.mtl", *VERTICES, *UV, "usemtl A", *FACES[:6],
        "usemtl B", *FACES[6:],
    )  # fmt: skip
    assert colors_of(copied(path)) == {RED, BLUE}
    pictures = sorted(p.name for p in (tmp_path / "copy").glob("*.png"))
    assert len(pictures) == 2 and all(p.startswith("diffuse-") for p in pictures)
    again = plan_mesh_copy(tmp_path / "copy/two.obj", unit="m")
    assert sorted(n for n in again if n.endswith(".png")) == pictures


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("map_Kd -s 1 1 1 -o 0 0 0 red.png", "red.png"),
        ("map_Kd -blendu on -clamp off red.png", "red.png"),
        ("map_Kd -bm 1.0 -imfchan l a red wall.png", "a red wall.png"),
        ("map_Kd red (1).png", "red (1).png"),
        ('map_Kd "red.png"', "red.png"),
        ("map_Kd .\\sub\\red.png", "sub/red.png"),
        ("map_kd red.bmp", "red.bmp"),
        ("map_Kd red.tga", "red.tga"),
    ],
)
def test_texture_lines(line: str, name: str, tmp_path: Path) -> None:
    picture(tmp_path / name, RED)
    (tmp_path / "a.mtl").write_text(f"newmtl R\n{line}\n")
    path = obj(tmp_path / "a.obj", "mtllib a.mtl", "usemtl R", *VERTICES, *UV, *FACES)
    assert colors_of(copied(path)) == {RED}


def test_a_texture_that_is_moved_or_scaled_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    picture(tmp_path / "red.png", RED)
    (tmp_path / "a.mtl").write_text("newmtl R\nmap_Kd -s 2 2 1 red.png\n")
    copied(obj(tmp_path / "a.obj", "mtllib a.mtl", "usemtl R", *VERTICES, *UV, *FACES))
    assert "map_kd -s 2 2 1 is not applied" in caplog.text
    assert texture_options("-s 2 red.png") == ({"-s": ["2"]}, "red.png")


def test_faces_without_usemtl(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    picture(tmp_path / "red.png", RED)
    (tmp_path / "a.mtl").write_text("newmtl R\nmap_Kd red.png\n")
    path = obj(tmp_path / "a.obj", "mtllib a.mtl", *VERTICES, *UV, *FACES)
    assert colors_of(copied(path)) == {RED}
    (tmp_path / "a.mtl").write_text("newmtl R\nmap_Kd red.png\nnewmtl S\nKd 1 1 1\n")
    copied(path)
    assert "no face names its material (usemtl)" in caplog.text


def test_a_material_that_is_missing_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "a.mtl").write_text("newmtl R\nKd 1 0 0\n")
    copied(obj(tmp_path / "a.obj", "mtllib a.mtl", "usemtl T", *VERTICES, *UV, *FACES))
    assert "materials are missing: T" in caplog.text


def test_colours_of_materials_without_texture(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mtl = "newmtl R r\nKd 0.8 0.1 0.1\nnewmtl B\nKd 0.1 0.1 0.8\n"
    (tmp_path / "a.mtl").write_text(mtl)
    path = obj(
        tmp_path / "a.obj", "mtllib a.mtl", *VERTICES, *UV, "usemtl R r", *FACES[:6], "usemtl B",
        *FACES[6:],
    )  # fmt: skip
    assert colors_of(copied(path)) == {(204, 26, 26), (26, 26, 204)}
    assert "Kd" not in caplog.text
    copied(obj(path, "mtllib a.mtl", "usemtl R r", *VERTICES, *UV, *FACES))
    assert "one colour, Kd 0.8 0.1 0.1, and no texture: it is not shown" in caplog.text
    copied(obj(path, "mtllib a.mtl", *VERTICES, *UV, *FACES))
    assert "(usemtl): colour Kd 0.8 0.1 0.1 is not shown" in caplog.text


@pytest.mark.parametrize("name", ["杯子.obj", "rec [1].obj", "ça va.OBJ", "🙂.obj"])
def test_names_of_any_script(name: str, tmp_path: Path) -> None:
    picture(tmp_path / "红.png", RED)
    (tmp_path / "材料.mtl").write_text("newmtl 甲\nmap_Kd 红.png\n", encoding="utf-8")
    path = obj(tmp_path / name, "mtllib 材料.mtl", "usemtl 甲", *VERTICES, *UV, *FACES)
    files = plan_mesh_copy(path, unit="m")
    assert all(n.isascii() for n in files) and next(iter(files)).endswith(".obj")
    assert colors_of(copied(path)) == {RED}


def test_byte_order_marks_in_mesh_and_material(tmp_path: Path) -> None:
    picture(tmp_path / "red.png", RED)
    obj(tmp_path / "a.mtl", "newmtl R", "map_Kd red.png", mark="\ufeff")
    path = obj(
        tmp_path / "a.obj", *VERTICES, "mtllib a.mtl", *UV, "usemtl R", *FACES, mark="\ufeff"
    )
    mesh = copied(path)
    assert len(mesh.vertices) >= 8 and colors_of(mesh) == {RED}


QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4)]
TRIANGLES = [(1, 5, 7), (1, 7, 3)]


def ply(path: Path, *, binary: bool, strips: bool = False) -> Path:
    corners = [[(i >> 2 & 1) * 0.06, (i >> 1 & 1) * 0.08, (i & 1) * 0.1] for i in range(8)]
    faces = [*QUADS, *TRIANGLES]
    strip = [0, 1, 2, 3, -1, 4, 5, 6, 7]
    head = [
        "ply", f"format {'binary_little_endian' if binary else 'ascii'} 1.0", "element vertex 8",
        *(f"property float {c}" for c in "xyz"), *(f"property uchar {c}" for c in
        ("red", "green", "blue")),
        *(["element tristrips 1", "property list int int vertex_indices"] if strips else
          [f"element face {len(faces)}", "property list uchar int vertex_indices"]),
        "end_header",
    ]  # fmt: skip
    rows = [strip] if strips else faces
    if binary:
        body = b"".join(struct.pack("<3f3B", *c, *RED) for c in corners)
        count = "<i" if strips else "<B"
        body += b"".join(struct.pack(count, len(f)) + struct.pack(f"<{len(f)}i", *f) for f in rows)
    else:
        lines = [f"{x} {y} {z} 200 30 30" for x, y, z in corners]
        lines += [" ".join(map(str, (len(f), *f))) for f in rows]
        body = ("\n".join(lines) + "\n").encode()
    path.write_bytes("\n".join(head).encode() + b"\n" + body)
    return path


@pytest.mark.parametrize("binary", [True, False])
def test_a_ply_with_faces_of_mixed_sizes(binary: bool, tmp_path: Path) -> None:
    mesh = copied(ply(tmp_path / "box.ply", binary=binary))
    assert len(mesh.faces) == 12 and mesh.is_watertight
    assert mesh.volume == pytest.approx(0.06 * 0.08 * 0.1, rel=1e-5)
    assert colors_of(mesh) == {RED}


@pytest.mark.parametrize("binary", [True, False])
def test_a_ply_of_triangle_strips(binary: bool, tmp_path: Path) -> None:
    mesh = copied(ply(tmp_path / "box.ply", binary=binary, strips=True))
    assert len(mesh.faces) == 4
    normals = mesh.face_normals
    assert np.allclose(normals[0], normals[1]) and np.allclose(normals[2], normals[3])


def test_a_ply_that_is_cut_off_stays_an_error(tmp_path: Path) -> None:
    path = ply(tmp_path / "box.ply", binary=True)
    path.write_bytes(path.read_bytes()[:-6])
    with pytest.raises(ToolkitError, match=r"box\.ply: cannot read the mesh"):
        load_mesh(path)


@pytest.mark.parametrize("padding", [b"\0", b"\0" * 77, b"COLOR=rgba" * 20])
def test_an_stl_with_bytes_behind_its_end(padding: bytes, tmp_path: Path) -> None:
    BOX.export(tmp_path / "box.stl")
    (tmp_path / "box.stl").write_bytes((tmp_path / "box.stl").read_bytes() + padding)
    mesh = copied(tmp_path / "box.stl")
    assert len(mesh.faces) == 12
    assert np.allclose(mesh.extents, BOX.extents)


def test_a_copy_that_differs_is_refused(tmp_path: Path) -> None:
    path = obj(
        tmp_path / "a.obj", *VERTICES, *[f"f {a + 1} {b + 1} {c + 1}" for a, b, c in BOX.faces]
    )
    data, mesh = path.read_bytes(), load_mesh(path)
    check_copy({"a.obj": data}, mesh, path)
    with pytest.raises(ToolkitError, match="another number of faces"):
        check_copy({"a.obj": data[: data.rindex(b"f ")]}, mesh, path)
    with pytest.raises(ToolkitError, match="another size"):
        check_copy({"a.obj": data.replace(b"0.05", b"0.06")}, mesh, path)
    painted, other = mesh.copy(), mesh.copy()
    painted.visual.vertex_colors, other.visual.vertex_colors = (*RED, 255), (*BLUE, 255)
    check_same_mesh(painted, painted, path=path)
    with pytest.raises(ToolkitError, match="other colours"):
        check_same_mesh(other, painted, path=path)
    with pytest.raises(ToolkitError, match="lost its colours"):
        check_same_mesh(mesh, painted, path=path)


def test_the_texture_of_a_ply_comes_along(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    picture(tmp_path / "red.png", RED)
    vertices = "\n".join(f"{x} {y} {z} 0.5 0.5" for x, y, z in BOX.vertices)
    faces = "\n".join(f"3 {a} {b} {c}" for a, b, c in BOX.faces)
    head = ["ply", "format ascii 1.0", "comment TextureFile red.png", "element vertex 8"]
    head += [f"property float {c}" for c in "xyzst"]
    head += ["element face 12", "property list uchar int vertex_indices", "end_header"]
    (tmp_path / "box.ply").write_text("\n".join([*head, vertices, faces, ""]))
    files = plan_mesh_copy(tmp_path / "box.ply", unit="m")
    assert list(files) == ["box.glb"]
    (tmp_path / "copy").mkdir()
    assert colors_of(load_mesh(write_mesh_copy(tmp_path / "copy", files))) == {RED}
    (tmp_path / "red.png").unlink()
    os.mkfifo(tmp_path / "red.png")  # nobody writes to it
    assert len(load_mesh(tmp_path / "box.ply").faces) == 12
    assert "red.png is missing; the mesh is read without it" in caplog.text


def test_buffers_of_gltf_are_files_beside_it(tmp_path: Path) -> None:
    for name, data in trimesh.Scene([BOX]).export(file_type="gltf").items():
        (tmp_path / name).write_bytes(data)
    buffer = sorted(tmp_path.glob("*.bin"))[0]
    named = buffer.rename(tmp_path / "a b.bin")
    path, text = tmp_path / "model.gltf", (tmp_path / "model.gltf").read_text()
    path.write_text(text.replace(buffer.name, "a%20b.bin"))
    assert len(load_mesh(path).faces) == 12
    named.unlink()
    os.mkfifo(named)
    for uri in ("a%20b.bin", "../../etc/passwd", "http://127.0.0.1/a.bin", "x" * 5000):
        path.write_text(text.replace(buffer.name, uri))
        with pytest.raises(ToolkitError, match="is not a file in the folder of the mesh"):
            load_mesh(path)


LONG = 300_000
LINES = {
    "mtllib": "mtllib a" + " " * LONG + "b",
    "usemtl": "usemtl a" + " " * LONG + "b",
    "number": "v 0 0 " + "1" * LONG + "x",
    "colour": "v 0 0 0 0 0 " + "1" * LONG + "x",
    "spaces": " " * LONG + "x",
    "name": "mtllib " + "a" * LONG,
}


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("unit", ["m", "mm"])
def test_a_long_line_takes_no_time(line: str, unit: str, tmp_path: Path) -> None:
    faces = [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in BOX.faces]
    path = obj(tmp_path / "a.obj", LINES[line], *VERTICES, *faces)
    began = time.process_time()
    with contextlib.suppress(ToolkitError):
        plan_mesh_copy(path, unit=unit)
    assert time.process_time() - began < 2


def test_a_long_line_of_a_material_takes_no_time(tmp_path: Path) -> None:
    began = time.process_time()
    texture_options("-s " * LONG)
    (tmp_path / "a.mtl").write_text("newmtl a" + " " * LONG + "b\nmap_Kd " + "-s " * LONG)
    with pytest.raises(ToolkitError, match=r"a\.mtl: names no file"):
        copied(obj(tmp_path / "a.obj", "mtllib a.mtl", *VERTICES, *UV, *FACES))
    assert time.process_time() - began < 2


@pytest.mark.parametrize("fault", ["zero byte", "link to itself"])
def test_a_texture_whose_name_names_no_file_is_an_error_of_the_file(
    fault: str, tmp_path: Path
) -> None:
    name = "a\0b.png" if fault == "zero byte" else "a.png"
    (tmp_path / "box.mtl").write_text(f"newmtl A\nmap_Kd {name}\n")
    if fault == "link to itself":
        (tmp_path / name).symlink_to(name)
    path = obj(tmp_path / "box.obj", "mtllib box.mtl", *VERTICES, *UV, "usemtl A", *FACES)
    with pytest.raises(ToolkitError, match="names no file") as refused:
        load_mesh(path)
    assert str(refused.value.path) == str(tmp_path / "box.mtl")


@pytest.mark.parametrize("scale", [1, 255])
def test_colours_of_vertices_in_an_obj(scale: int, tmp_path: Path) -> None:
    """Some programs write 0 to 255 where the format has 0 to 1."""
    color = " ".join(f"{c * scale / 255:.6g}" for c in RED)
    faces = [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in BOX.faces]
    path = obj(tmp_path / "box.obj", *(f"{v} {color}" for v in VERTICES), *faces)
    assert colors_of(copied(path)) == {RED}


def test_a_texture_of_ambient_light_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    picture(tmp_path / "t.png", RED)
    (tmp_path / "m.mtl").write_text("newmtl A\nmap_Ka t.png\n")
    copied(obj(tmp_path / "m.obj", "mtllib m.mtl", *VERTICES, *UV, "usemtl A", *FACES))
    assert "map_ka without map_Kd" in caplog.text
