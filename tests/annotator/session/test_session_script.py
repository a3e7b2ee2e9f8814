"""Scripts: everything that the window does, from a file."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scene_on_disk import contents
from textured_scene import HALF_TURN, T_WORLD_BOX, write_textured_scene

from annotator.cli import main
from annotator.session import (
    AddObject,
    ChangeObject,
    CompoundEdit,
    EnterModel,
    Move,
    Session,
    SetPoses,
    SetSymmetry,
)
from annotator.session.merge import content
from annotator.session.requests import ImportMesh
from annotator.session.script import export_edits, known_steps, read_script, script_schema
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.scene import Scene
from std_toolkit.scene.model import ContinuousSymmetry, SymmetryModel

POSE = SE3.exp([0.01, 0.02, 0.6, 0.3, 0.2, 0.1])
CORNERS = [[x, y, z] for x in (-0.03, 0.03) for y in (-0.02, 0.02) for z in (-0.05, 0.05)]


@pytest.fixture
def script(tmp_path: Path) -> Callable[[Any], Path]:
    """Write steps to a file."""

    def write(steps: Any) -> Path:
        path = tmp_path / "edits.json"
        path.write_text(steps if isinstance(steps, str) else json.dumps(steps))
        return path

    return write


def test_a_script_goes_from_a_mesh_to_labels_in_all_frames(
    root: Path, script: Callable[[Any], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    camera = Scene.open(root).camera(Scene.open(root).frame(1))
    trimesh.creation.box((60.0, 40.0, 100.0)).export(root.parent / "carton.ply")
    clicks = [
        {
            "edit": "add_click",
            "object": "carton_1",
            "frame": 1,
            "click": {"u": u, "v": v, "point": point},
        }
        for point, (u, v) in zip(CORNERS, camera.project(POSE @ np.array(CORNERS)), strict=True)
    ]
    path = script(
        [
            {"edit": "import_mesh", "mesh": "carton.ply", "unit": "mm", "symmetry": ["fold:z:2"]},
            {
                "edit": "add_object",
                "object": "carton_1",
                "model": "carton",
                "material": "transparent",
            },
            *clicks,
            {"edit": "solve_pnp", "object": "carton_1", "frame": 1},
            {
                "edit": "move",
                "object": "carton_1",
                "frame": 1,
                "axes": "object",
                "shift_mm": [0, 0, 5],
            },
            {"edit": "undo"},
            {"edit": "redo"},
            {"edit": "undo"},
            {"edit": "change_object", "object": "carton_1", "status": "done", "anyway": True},
            {"edit": "propagate"},
        ]
    )
    assert main([str(root), "--script", str(path), "--annotator", "bot"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "[0] Add mesh carton.ply"
    assert "[10] Pose of carton_1 from points" in lines
    assert any("8 of 8 points fit" in line for line in lines)
    assert "[12] Undo: Move carton_1" in lines
    assert "[13] Redo: Move carton_1" in lines
    assert any("carton_1: propagated from 1 annotated frame to 3 of 3" in line for line in lines)
    scene = Scene.open(root)
    thing = scene.objects.object_named("carton_1")
    there = scene.T_cam_obj(1, thing.id)
    assert there is not None
    assert np.abs(there.matrix() - POSE.matrix()).max() < 1e-6
    label = scene.labels.of(thing.id)
    assert label is not None
    assert (label.annotator, label.method) == ("bot", "pnp")
    assert scene.annotation.of(thing.id).status == "done"
    assert len(scene.annotation.of(thing.id).clicks) == 8


def test_a_script_names_frames_by_file(
    root: Path, script: Callable[[Any], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    scene = Scene.open(root)
    change = {"object": "box_1", "frame": 2, "T_cam_obj": POSE.flat()}
    steps = [
        {"edit": "set_poses", "changes": [change]},
        {"edit": "move", "object": "box_1", "frame": "000001.png"},
        {"edit": "save"},
    ]
    assert main([str(root), "--script", str(script(steps))]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"[0] frame 2 = {scene.frame(2).color}"
    assert f"[1] frame 1 = {scene.frame(1).color}" in lines
    label = Scene.open(root).labels.of(1)
    assert label is not None
    assert label.frame == 1
    change["frame"] = "000077.png"
    assert main([str(root), "--script", str(script(steps))]) == 1
    error = capsys.readouterr().err
    assert "[0].changes[0].frame: no such frame; the scene has 3 frames" in error


class TestValidation:
    @pytest.mark.parametrize(
        ("steps", "place"),
        [
            ([{"edit": "undo"}, {"edit": "fly"}], r"\[1\]\.edit.*known: add_click, add_object"),
            ([{"edit": "undo"}, {"object": "x"}], r"\[1\]"),
            ([{"edit": "move", "object": "box_1"}], r"\[0\]: .*frame"),
            ([{"edit": "move", "object": "box_1", "frame": "one"}], r"\[0\]\.frame"),
            ([{"edit": "move", "object": "box_1", "frame": 0, "by": 1}], r"\[0\].*by"),
            ([{"edit": "move", "object": "b", "frame": 0, "shift_mm": [1]}], r"\[0\]\.shift_mm"),
            (
                [{"edit": "set_poses", "changes": [{"object": "b", "frame": 0,
                  "T_cam_obj": [2.0] * 16}]}],
                r"\[0\]\.changes\[0\]\.T_cam_obj",
            ),
            ({"edit": "undo"}, "array"),
            ("[", "not valid JSON"),
        ],
    )  # fmt: skip
    def test_a_bad_step_is_named_before_the_first_is_carried_out(
        self,
        root: Path,
        script: Callable[[Any], Path],
        steps: Any,
        place: str,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        if isinstance(steps, list):
            steps = [{"edit": "change_object", "object": "box_1", "note": "x"}, *steps]
            place = place.replace(r"\[1\]", r"\[2\]").replace(r"\[0\]", r"\[1\]")
            place = place.replace(r"changes\[1\]", r"changes\[0\]")
        before = contents(root)
        path = script(steps)
        with pytest.raises(ToolkitError, match=rf"edits\.json.*{place}"):
            read_script(path)
        assert main([str(root), "--script", str(path)]) == 1
        error = capsys.readouterr().err
        assert error.startswith(f"error: {path}: ")
        assert len(error.splitlines()) == 1
        assert contents(root) == before

    def test_a_missing_script_is_named(self, root: Path) -> None:
        assert main([str(root), "--script", str(root / "none.json")]) == 1


class TestFailure:
    def test_what_fails_is_named_by_its_place_and_nothing_after_the_last_save_is_saved(
        self, root: Path, script: Callable[[Any], Path], capsys: pytest.CaptureFixture[str]
    ) -> None:
        path = script(
            [
                {"edit": "change_object", "object": "box_1", "note": "saved"},
                {"edit": "save"},
                {"edit": "change_object", "object": "box_1", "note": "lost"},
                {"edit": "move", "object": "mug", "frame": 0},
                {"edit": "save"},
            ]
        )
        assert main([str(root), "--script", str(path)]) == 1
        error = capsys.readouterr().err
        assert f"{path}: [3]: no such object (got 'mug'); known: box_1" in error
        assert Scene.open(root).annotation.of(1).note == "saved"
        with Session.open(root) as session:
            assert session.recovery is None  # the script can simply be run again

    def test_another_file_at_fault_is_named_too(
        self, root: Path, script: Callable[[Any], Path], capsys: pytest.CaptureFixture[str]
    ) -> None:
        path = script([{"edit": "import_mesh", "mesh": "none.obj"}])
        assert main([str(root), "--script", str(path)]) == 1
        error = capsys.readouterr().err
        assert f"{path}: [0]: {path.parent / 'none.obj'}: mesh file not found" in error

    def test_edits_that_nobody_saved_are_told_and_kept(
        self, root: Path, script: Callable[[Any], Path], capsys: pytest.CaptureFixture[str]
    ) -> None:
        path = script([{"edit": "change_object", "object": "box_1", "note": "x"}])
        assert main([str(root), "--script", str(path)]) == 0
        assert "not saved" in capsys.readouterr().err
        with Session.open(root) as session:
            assert session.recovery is not None

    def test_edits_of_an_earlier_session_must_be_decided_first(
        self, root: Path, script: Callable[[Any], Path], capsys: pytest.CaptureFixture[str]
    ) -> None:
        with Session.open(root, annotator="mk") as session:
            session.apply(ChangeObject(object="box_1", note="by hand"))
        path = script([{"edit": "save"}])
        assert main([str(root), "--script", str(path)]) == 1
        assert "1 edit by mk" in (error := capsys.readouterr().err)
        assert "--recover yes" in error
        assert main([str(root), "--script", str(path), "--recover", "yes"]) == 0
        assert Scene.open(root).annotation.of(1).note == "by hand"


class TestExport:
    def test_an_exported_session_makes_the_same_labels_on_a_copy_of_the_scene(
        self, root: Path, tmp_path: Path
    ) -> None:
        copy = Path(shutil.copytree(root, tmp_path / "copy"))
        mesh = tmp_path / "tin.ply"
        trimesh.creation.cylinder(radius=0.03, height=0.1).export(mesh)
        exported = tmp_path / "exported.json"
        with Session.open(root, annotator="mk") as session:
            session.perform(ImportMesh(mesh=str(mesh), category="can"))
            around_z = SymmetryModel(continuous=[ContinuousSymmetry(axis=[0, 0, 1])])
            session.apply(SetSymmetry(model="tin", symmetry=around_z))
            session.apply(
                CompoundEdit(
                    edits=[
                        AddObject(object="tin_1", model="tin"),
                        SetPoses.one("tin_1", 2, POSE, method="drop"),
                    ]
                )
            )
            for i in range(5):
                session.apply(Move(object="tin_1", frame=i % 3, turn_deg=[0, 1.0, 0.3]))
            session.apply(ChangeObject(object="box_1", note="undone"))
            session.undo()
            session.save()
            session.apply(Move(object="box_1", frame=1, shift_mm=[0.3, 0, 0]))
            export_edits(session, exported)
            expected = session.state
        assert read_script(exported)
        steps = [*json.loads(exported.read_text()), {"edit": "save"}]
        exported.write_text(json.dumps(steps))
        assert main([str(copy), "--script", str(exported)]) == 0
        with Session.open(copy) as session:
            assert [content(o) for o in session.state.objects] == [
                content(o) for o in expected.objects
            ]
            assert session.state.models == expected.models

    def test_a_mesh_within_several_edits_is_exported_as_a_file(
        self, root: Path, tmp_path: Path
    ) -> None:
        with Session.open(root) as session:
            model = session.state.model("box")
            session.apply(
                CompoundEdit(edits=[EnterModel(model=model), AddObject(object="x", model="box")])
            )
            export_edits(session, tmp_path / "e.json")
        kinds = [step["edit"] for step in json.loads((tmp_path / "e.json").read_text())]
        assert kinds == ["import_mesh", "add_object"]


def test_the_schema_accepts_what_the_reader_accepts(
    root: Path, script: Callable[[Any], Path]
) -> None:
    import jsonschema

    schema = json.loads(script_schema())
    good = [{"edit": "move", "object": "a", "frame": 0}, {"edit": "save"}]
    jsonschema.validate(good, schema)
    refined = {"edit": "refine", "objects": ["a"], "frame": "0.png", "frames": [1, "000002"]}
    jsonschema.validate([refined], schema)
    assert len(read_script(script(good))) == 2
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate([{"edit": "fly"}], schema)


def test_the_specification_tells_every_step() -> None:
    specification = (Path(__file__).parents[3] / "data_spec.md").read_text()
    section = specification.split("### 10.1")[1]
    assert [step for step in known_steps() if f"`{step}`" not in section] == []


def test_the_scripts_of_the_specification_are_scripts(script: Callable[[Any], Path]) -> None:
    text = (Path(__file__).parents[3] / "data_spec.md").read_text()
    parts = text.split("<!-- script -->")[1:]
    assert parts
    for part in parts:
        body = part.split("```json\n", 1)[1].split("```", 1)[0]
        assert read_script(script(body))


@pytest.mark.slow
def test_what_is_not_known_to_fit_is_done_only_if_the_script_says_anyway(
    root: Path, script: Callable[[Any], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """The images of this scene show nothing, so that no pose can be confirmed."""
    done = {"edit": "change_object", "object": "box_1", "status": "done"}
    assert main([str(root), "--script", str(script([done, {"edit": "save"}]))]) == 1
    told = capsys.readouterr().err
    assert "[0].status" in told
    assert "box_1 is not known to fit: " in told
    assert '"anyway": true' in told
    assert Scene.open(root).annotation.of(1).status == "open"
    steps = [{**done, "anyway": True}, {"edit": "save"}]
    assert main([str(root), "--script", str(script(steps))]) == 0
    assert Scene.open(root).annotation.of(1).status == "done"


@pytest.mark.slow
def test_what_fits_needs_no_such_word(
    tmp_path: Path, script: Callable[[Any], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    done = {"edit": "change_object", "object": "box_1", "status": "done"}
    path = script([done, {"edit": "save"}])
    right = write_textured_scene(tmp_path / "right")
    assert main([str(right), "--script", str(path)]) == 0
    assert Scene.open(right).annotation.of(1).status == "done"
    wrong = write_textured_scene(tmp_path / "wrong", T_world_obj=T_WORLD_BOX @ HALF_TURN)
    assert main([str(wrong), "--script", str(path)]) != 0
    assert "turned by 180 deg about z fits the texture better" in capsys.readouterr().err
