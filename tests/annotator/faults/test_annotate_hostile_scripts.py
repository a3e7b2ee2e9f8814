"""Scripts that cannot be carried out are refused in one line, and the scene stays as it was."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hostile_annotation import Annotate, Refuse, pose_in_frame, set_pose

from annotator.cli import main
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.scene import Scene

SAVE = {"edit": "save"}
GOOD = pose_in_frame(0)


def changed(entry: int, value: float) -> list[float]:
    numbers = GOOD.flat()
    numbers[entry] = value
    return numbers


# --- what is no script ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("", "not valid JSON"),
        ("[{", "not valid JSON"),
        ("null", "Expected `array`"),
        ('{"edit": "save"}', "Expected `array`"),
        ('["save"]', "[0]"),
        ('[{"edit": "save"}, 3]', "[1]"),
        ("[" * 100_000, "script.json"),
        ('[{"edit": "save", "edit": "undo"}]', "twice"),
        ("\x00\x01\x02", "not valid JSON"),
        ('[{"edit": "change_object", "object": "box_1", "note": "\\ud800"}]', "not valid JSON"),
    ],
    ids=[
        "empty", "cut", "null", "no list", "word", "number", "deep", "twice", "binary", "surrogate",
    ],
)  # fmt: skip
def test_what_is_no_script(refuse: Refuse, text: str, names: str) -> None:
    assert "script.json" in refuse(text, names=names)


def test_a_script_that_is_not_there(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (tmp_path / "nowhere.json", tmp_path, Path("/dev/zero")):
        assert main([str(root), "--script", str(path)]) == 1
        assert capsys.readouterr().err.startswith(f"error: {path}: ")


@pytest.mark.parametrize(
    ("step", "names"),
    [
        ({"edit": "teleport"}, "[0].edit"),
        ({"edit": None}, "[0].edit"),
        ({}, "[0]"),
        ({"edit": "save", "path": "/etc"}, "path"),
        ({"edit": "remove_object"}, "object"),
        ({"edit": "remove_object", "object": 3}, "[0].object"),
        ({"edit": "remove_object", "object": "spoon"}, "no such object"),
        ({"edit": "add_object", "object": "b", "model": "spoon"}, "no such model"),
        ({"edit": "add_object", "object": "../b", "model": "box"}, "not a safe name"),
        ({"edit": "add_object", "object": "", "model": "box"}, "not a safe name"),
        ({"edit": "add_object", "object": "box_1", "model": "box"}, "object of this name"),
        ({"edit": "add_object", "object": "b", "model": "box", "id": 0}, "[0].id"),
        ({"edit": "add_object", "object": "b", "model": "box", "id": 255}, "[0].id"),
        ({"edit": "add_object", "object": "b", "model": "box", "id": 1}, "taken"),
        ({"edit": "add_object", "object": "b", "model": "box", "material": "gold"}, "material"),
        ({"edit": "change_object", "object": "box_1"}, "nothing to change"),
        ({"edit": "change_object", "object": "box_1", "status": "finished"}, "status"),
        ({"edit": "undo"}, "[0]"),
        ({"edit": "redo"}, "[0]"),
        ({"edit": "propagate", "keyframes": 1}, "keyframes"),
        ({"edit": "propagate", "refine_scale": True}, "refine"),
        ({"edit": "propagate", "objects": ["spoon"]}, "spoon"),
        ({"edit": "solve_pnp", "object": "box_1", "frame": 0}, "at least 4"),
        ({"edit": "set_symmetry", "model": "box", "symmetry": {"discrete": [[1] * 16]}}, "0 0 0 1"),
        ({"edit": "change_click", "object": "box_1", "frame": 0, "index": 0}, "no such"),
        ({"edit": "clear_pose", "object": "spoon", "frame": 0}, "no such object"),
        ({"edit": "snap_to_table", "object": "spoon"}, "no such object"),
        ({"edit": "snap_to_table", "object": "box_1", "mode": "glue"}, "mode"),
        ({"edit": "snap_to_table", "object": "box_1", "table": [0, 0, 1]}, "table"),
        ({"edit": "snap_to_table", "object": "box_1", "table": [0, 0, 0, 0]}, "[0]"),
        ({"edit": "snap_to_table", "object": "box_1", "table": [0, 0, 1, 1e9]}, "[0]"),
        ({"edit": "snap_to_table", "object": "box_1", "frame": 9}, "[0]"),
    ],
)  # fmt: skip
def test_steps_that_cannot_be_carried_out(refuse: Refuse, step: dict[str, Any], names: str) -> None:
    refuse([step, SAVE], names=names)


def test_an_unknown_step_tells_the_known_ones(refuse: Refuse) -> None:
    line = refuse([{"edit": "teleport"}], names="teleport")
    assert "set_poses" in line and "import_mesh" in line


# --- poses ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("numbers", "names"),
    [
        (GOOD.inverse().flat(), "behind the camera"),
        ((np.diag([1, -1, -1, 1]) @ GOOD.matrix()).ravel().tolist(), "behind the camera"),
        (changed(11, 600.0), "implausible"),
        (changed(11, 0.0), "behind the camera"),
        (GOOD.matrix().T.ravel().tolist(), "transposed"),
        ((GOOD.matrix() * [[2], [2], [2], [1]]).ravel().tolist(), "not a rotation matrix"),
        ((np.diag([-1, 1, 1, 1]) @ GOOD.matrix()).ravel().tolist(), "not a rotation matrix"),
        ([0.0] * 16, "0 0 0 1"),
        (GOOD.flat()[:15], "T_cam_obj"),
        ([*GOOD.flat(), 0.0], "T_cam_obj"),
        ([None, *GOOD.flat()[1:]], "T_cam_obj[0]"),
        (["1", *GOOD.flat()[1:]], "T_cam_obj[0]"),
        ([], "T_cam_obj"),
    ],
    ids=[
        "inverse", "opengl", "millimetres", "zero depth", "transposed", "scaled", "mirrored",
        "zeros", "15", "17", "null", "text", "empty",
    ],
)  # fmt: skip
def test_numbers_that_are_no_pose(refuse: Refuse, numbers: list[Any], names: str) -> None:
    refuse([set_pose(numbers), SAVE], names=names)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"])
def test_numbers_that_are_not_finite(refuse: Refuse, number: str) -> None:
    text = json.dumps([set_pose(GOOD), SAVE])
    first = repr(GOOD.flat()[3])
    assert first in text
    refuse(text.replace(first, number, 1), names="script.json")


@pytest.mark.parametrize(
    ("frame", "names"),
    [(7, "no such frame"), (-1, "frame"), (0.5, "frame"), ("0.png", "frame"), (2**60, "frame")],
)
def test_frames_that_are_not_there(refuse: Refuse, frame: Any, names: str) -> None:
    refuse([set_pose(GOOD, frame=frame), SAVE], names=names)


@pytest.mark.parametrize("shift", [[1e9, 0, 0], [0, 0, -10_000], [0, 0, 1e308]])
def test_steps_that_lead_out_of_sight(refuse: Refuse, shift: list[float]) -> None:
    move = {"edit": "move", "object": "box_1", "frame": 0, "shift_mm": shift}
    refuse([move, SAVE], names="[0]")


@pytest.mark.parametrize("number", ["NaN", "1e999"])
@pytest.mark.parametrize("field", ["shift_mm", "turn_deg"])
def test_steps_of_no_number(refuse: Refuse, field: str, number: str) -> None:
    refuse(
        f'[{{"edit": "move", "object": "box_1", "frame": 0, "{field}": [{number}, 0, 0]}}]',
        names="script.json",
    )


@pytest.mark.parametrize("click", ['"u": 1e999, "v": 0', '"u": 0', '"u": 0, "v": "0"'])
def test_clicks_of_no_number(refuse: Refuse, click: str) -> None:
    refuse(
        '[{"edit": "add_click", "object": "box_1", "frame": 0, "click": '
        f'{{{click}, "point": [0, 0, 0]}}}}]',
        names="script.json",
    )


def test_points_on_a_line_give_no_pose(refuse: Refuse) -> None:
    clicks = [
        {
            "edit": "add_click",
            "object": "box_1",
            "frame": 0,
            "click": {"u": 10.0 * i, "v": 20.0, "point": [0.01 * i, 0.0, 0.0]},
        }
        for i in range(6)
    ]
    refuse([*clicks, {"edit": "solve_pnp", "object": "box_1", "frame": 0}, SAVE], names="[6]")


def test_what_stands_before_the_mistake_is_not_saved(refuse: Refuse) -> None:
    moved = SE3(GOOD.R @ so3_exp([0, 0, 0.1]), GOOD.t)
    line = refuse(
        [set_pose(moved), {"edit": "remove_object", "object": "spoon"}, SAVE], names="[1]"
    )
    assert "known: box_1" in line


def test_what_was_saved_before_the_mistake_stays(root: Path, annotate: Annotate) -> None:
    moved = SE3(GOOD.R @ so3_exp([0, 0, 0.1]), GOOD.t)
    outcome = annotate([set_pose(moved), SAVE, {"edit": "remove_object", "object": "spoon"}])
    assert outcome.status == 1
    label = Scene.open(root).labels.of(1)
    assert label is not None
    np.testing.assert_allclose(label.T_cam_obj, moved.flat(), atol=1e-12)
    # And the corrected script can be run without a word about recovery.
    assert annotate([set_pose(GOOD), SAVE]).status == 0


# --- meshes ---------------------------------------------------------------------------------------


def import_mesh(path: Path | str, **more: Any) -> dict[str, Any]:
    return {"edit": "import_mesh", "mesh": str(path), **more}


def write_mesh(path: Path, scale: float = 1.0) -> Path:
    trimesh.creation.box((0.05 * scale, 0.06 * scale, 0.07 * scale)).export(path)
    return path


def test_a_mesh_in_millimetres_is_told_as_that(refuse: Refuse, tmp_path: Path) -> None:
    mesh = write_mesh(tmp_path / "mug.ply", 1000)
    line = refuse([import_mesh(mesh), SAVE], names="implausibly large in metres")
    assert "millimetres" in line and "50 x 60 x 70" in line


def test_the_same_mesh_with_its_unit_is_taken(
    root: Path, annotate: Annotate, tmp_path: Path
) -> None:
    mesh = write_mesh(tmp_path / "mug.ply", 1000)
    outcome = annotate([import_mesh(mesh, unit="mm"), SAVE])
    assert outcome.status == 0, outcome.err
    assert Scene.open(root).objects.model("mug").size_m == pytest.approx([0.05, 0.06, 0.07])


def test_a_mesh_in_metres_called_millimetres(refuse: Refuse, tmp_path: Path) -> None:
    mesh = write_mesh(tmp_path / "mug.ply")
    refuse([import_mesh(mesh, unit="mm"), SAVE], names="implausibly small")


@pytest.mark.parametrize(
    ("name", "content", "names"),
    [
        ("mug.ply", None, "not found"),
        ("mug.ply", b"", "cannot read the mesh"),
        ("mug.ply", b"ply\nformat ascii 1.0\nend_header\n", "mug.ply"),
        ("mug.obj", b"hello\n", "mug.obj"),
        ("mug.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "mug.obj"),
        ("mug.obj", b"v 0 0 0\nv .1 0 0\nv 0 .1 0\nf 1 2 9\n", "mug.obj"),
        ("mug.obj", b"mtllib ../../secret.mtl\nv 0 0 0\nv .1 0 0\nv 0 .1 0\nf 1 2 3\n", "outside"),
        ("mug.step", b"ISO-10303-21;", "not a mesh format"),
        ("mug.stl", b"\xff" * 200, "mug.stl"),
    ],
)
def test_files_that_are_no_mesh(
    refuse: Refuse, tmp_path: Path, name: str, content: bytes | None, names: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    refuse([import_mesh(name), SAVE], names=names)


@pytest.mark.parametrize("path", ["/dev/zero", ".", "", "/etc/passwd", "\x00"])
def test_paths_that_lead_to_no_mesh(refuse: Refuse, path: str) -> None:
    refuse([import_mesh(path), SAVE], names="[0]")


@pytest.mark.parametrize(
    ("more", "names"),
    [
        ({"unit": "inch"}, "unit"),
        ({"model": "../../mug"}, "not a safe name"),
        ({"model": "box"}, "another mesh"),
        ({"category": "a/b"}, "not a safe name"),
        ({"symmetry": ["axis:w"]}, "axis:w"),
        ({"symmetry": ["nowhere.json"]}, "nowhere.json"),
        ({"symmetry": "axis:z"}, "symmetry"),
    ],
)
def test_meshes_with_words_that_mean_nothing(
    refuse: Refuse, tmp_path: Path, more: dict[str, Any], names: str
) -> None:
    refuse([import_mesh(write_mesh(tmp_path / "mug.ply"), **more), SAVE], names=names)
