"""Requests: meshes from files, poses from clicked points."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from annotator.session import AddClick, AddObject, Click, Session, SetPoses
from annotator.session.requests import ImportMesh, SnapToTable, SolvePnP
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.se3 import rotation_angle
from std_toolkit.io.locks import scene_lock
from std_toolkit.labels.entry.label import add_model
from std_toolkit.scene import Scene, SceneInfo
from std_toolkit.scene.model import CameraModel


@pytest.fixture
def session(root: Path):  # type: ignore[no-untyped-def]
    with Session.open(root, annotator="mk") as opened:
        yield opened


@pytest.fixture
def can(tmp_path: Path) -> Path:
    """A can in millimetres."""
    path = tmp_path / "can.ply"
    trimesh.creation.cylinder(radius=33.0, height=122.0).export(path)
    return path


class TestImportMesh:
    def test_a_mesh_in_millimetres_is_refused_with_the_way_out(
        self, session: Session, can: Path
    ) -> None:
        with pytest.raises(ToolkitError, match=r"implausibly large.*unit as mm") as caught:
            session.perform(ImportMesh(mesh=str(can)))
        assert "--mesh-unit" not in str(caught.value)
        assert not (session.scene.root / "models/can").exists()
        assert not session.unsaved

    def test_the_file_is_copied_at_once_and_entered_when_saving(
        self, session: Session, can: Path
    ) -> None:
        root = session.scene.root
        before = (root / "objects.json").read_bytes()
        outcome = session.perform(
            ImportMesh(mesh=str(can), unit="mm", category="can", symmetry=["axis:z"])
        )
        assert outcome.report == ["model can: 66.0 x 66.0 x 122.0 mm, diameter 138.7 mm"]
        assert (root / "models/can/can.glb").is_file()
        assert (root / "objects.json").read_bytes() == before
        assert np.ptp(session.mesh("can").vertices, axis=0).max() == pytest.approx(0.122)
        session.apply(AddObject(object="can_1", model="can"))
        session.save()
        model = Scene.open(root).objects.model("can")
        assert (model.category, model.class_id) == ("can", 4)
        assert len(model.symmetry.continuous) == 1

    def test_a_scan_brings_its_symmetry(self, session: Session, tmp_path: Path) -> None:
        folder = tmp_path / "cup"
        folder.mkdir()
        trimesh.creation.cylinder(radius=0.03, height=0.1).export(folder / "cup.ply")
        axis = {"axis": [0.0, 0.0, 1.0], "offset": [0.0, 0.0, 0.0]}
        (folder / "symmetry.json").write_text(json.dumps({"discrete": [], "continuous": [axis]}))
        # Beside a mesh from elsewhere, the file may belong to anything.
        outcome = session.perform(ImportMesh(mesh=str(folder / "cup.ply"), model="other"))
        assert session.state.model("other").symmetry.continuous == []
        (folder / "scan.json").write_text("{}")
        outcome = session.perform(ImportMesh(mesh=str(folder / "cup.ply")))
        assert outcome.report[1] == "symmetry of the scan (symmetry.json): any turn about z"
        assert len(session.state.model("cup").symmetry.continuous) == 1
        session.perform(ImportMesh(mesh=str(folder / "cup.ply"), model="plain", symmetry=["none"]))
        assert session.state.model("plain").symmetry.continuous == []

    def test_undo_takes_the_model_away_and_redo_finds_its_file(
        self, session: Session, can: Path
    ) -> None:
        session.perform(ImportMesh(mesh=str(can), unit="mm"))
        session.undo()
        assert [m.id for m in session.state.models] == ["box"]
        session.redo()
        assert session.mesh("can").vertices.shape[1] == 3

    def test_an_import_survives_the_end_of_the_session(self, root: Path, can: Path) -> None:
        with Session.open(root) as session:
            session.perform(ImportMesh(mesh=str(can), unit="mm"))
            session.apply(AddObject(object="can_1", model="can"))
            state = session.state
        with Session.open(root, recover="yes") as session:
            assert session.state == state
            assert session.mesh("can").vertices.shape[1] == 3

    def test_another_mesh_of_a_known_id_is_refused(self, session: Session, can: Path) -> None:
        with pytest.raises(ToolkitError, match=r"has another mesh.*another id"):
            session.perform(ImportMesh(mesh=str(can), unit="mm", model="box"))
        again = session.scene.root / "models/box/box.ply"
        session.perform(ImportMesh(mesh=str(again)))  # the same mesh is the same model
        assert [m.id for m in session.state.models] == ["box"]

    def test_a_mesh_that_others_entered_meanwhile_is_not_overwritten(
        self, session: Session, can: Path, tmp_path: Path
    ) -> None:
        scene = Scene.open(session.scene.root)
        other = tmp_path / "other" / "can.ply"
        other.parent.mkdir()
        trimesh.creation.box((0.1, 0.1, 0.1)).export(other)
        with scene.lock():
            theirs = scene.mesh_path(add_model(scene, other))
        before = theirs.read_bytes()
        with pytest.raises(ToolkitError, match="has another mesh"):
            session.perform(ImportMesh(mesh=str(can), unit="mm", model="can"))
        session.perform(ImportMesh(mesh=str(can), unit="mm"))
        assert theirs.read_bytes() == before
        session.save()
        assert {m.id for m in Scene.open(session.scene.root).objects.models} == {
            "box", "can", "can_2",
        }  # fmt: skip

    def test_another_mesh_of_a_known_name_gets_a_number(
        self, session: Session, can: Path, tmp_path: Path
    ) -> None:
        other = tmp_path / "other" / "can.ply"
        other.parent.mkdir()
        trimesh.creation.box((0.1, 0.1, 0.1)).export(other)
        for _ in range(2):  # the second time each is known
            session.perform(ImportMesh(mesh=str(can), unit="mm"))
            session.perform(ImportMesh(mesh=str(other)))
            assert [m.id for m in session.state.models] == ["box", "can", "can_2"]
        assert np.ptp(session.mesh("can_2").vertices, axis=0) == pytest.approx([0.1] * 3)
        assert np.ptp(session.mesh("can").vertices, axis=0) != pytest.approx([0.1] * 3)

    def test_a_name_that_tells_nothing_gives_way_to_the_folder_s(
        self, session: Session, tmp_path: Path
    ) -> None:
        for i, folder in enumerate(("006_mustard_bottle", "025_mug", "more/025_mug")):
            path = tmp_path / folder / "textured.obj"
            path.parent.mkdir(parents=True)
            trimesh.creation.box((0.1, 0.1, 0.1 + 0.01 * i)).export(path)
            session.perform(ImportMesh(mesh=str(path)))
        ids = [m.id for m in session.state.models]
        assert ids == ["006_mustard_bottle", "025_mug", "025_mug_2", "box"]

    def test_files_that_are_no_mesh_are_named(self, session: Session, tmp_path: Path) -> None:
        bad = tmp_path / "bad.obj"
        bad.write_text("not a mesh")
        for path, problem in (
            (bad, "bad.obj"),
            (tmp_path / "none.obj", "mesh file not found"),
            (tmp_path, "mesh file not found"),
        ):
            with pytest.raises(ToolkitError, match=problem):
                session.perform(ImportMesh(mesh=str(path)))

    def test_nothing_is_copied_while_another_process_writes(
        self, session: Session, can: Path
    ) -> None:
        with (
            scene_lock(session.scene.root),
            pytest.raises(ToolkitError, match="another process is writing"),
        ):
            session.perform(ImportMesh(mesh=str(can), unit="mm"))

    def test_a_session_for_looking_copies_nothing(self, root: Path, can: Path) -> None:
        with Session.open(root, read_only=True) as session:
            with pytest.raises(ToolkitError, match="read-only"):
                ImportMesh(mesh=str(can), unit="mm").resolve(session.snapshot())
            assert not (root / "models/can").exists()


POSE = SE3.exp([0.03, -0.02, 0.5, 0.4, -0.3, 0.2])
CORNERS = [
    [x, y, z] for x in (-0.03, 0.03) for y in (-0.02, 0.02) for z in (-0.05, 0.05)
]  # fmt: skip


def click_corners(session: Session, pixels: np.ndarray, frame: int = 1) -> None:
    for point, (u, v) in zip(CORNERS, pixels, strict=False):
        click = Click(u=float(u), v=float(v), point=point)
        session.apply(AddClick(object="box_1", frame=frame, click=click))


def project(session: Session, frame: int = 1) -> np.ndarray:
    camera = session.scene.camera(session.scene.frame(frame))
    return camera.project(POSE @ np.array(CORNERS))


class TestSolvePnP:
    def test_clicks_keep_their_fractions_of_a_pixel(self, session: Session) -> None:
        """A peer casts clicked pixels to integers before it solves."""
        exact = project(session)
        click_corners(session, exact)
        session.perform(SolvePnP(object="box_1", frame=1))
        found = session.pose("box_1", 1)
        assert found is not None
        assert np.linalg.norm(found.t - POSE.t) < 1e-7
        assert rotation_angle(found.R.T @ POSE.R) < 1e-6
        # Whole pixels would be off by far more than that, so the test would tell.
        assert np.abs(exact - np.trunc(exact)).max() > 0.5

    def test_residuals_are_told_for_every_click(self, session: Session) -> None:
        pixels = project(session)
        pixels[3] += [25.0, -10.0]
        click_corners(session, pixels)
        outcome = session.perform(SolvePnP(object="box_1", frame=1))
        assert outcome.report[0].startswith("7 of 8 points fit, rms 0.00 px")
        assert len(outcome.report) == 9
        assert outcome.report[4] == f"point 4: {np.hypot(25, 10):.2f} px (left out)"
        (warning,) = outcome.warnings
        assert "point 4 does not fit" in warning
        found = session.pose("box_1", 1)
        assert found is not None
        assert np.linalg.norm(found.t - POSE.t) < 1e-6
        assert session.object("box_1").placements[1].method == "pnp"

    def test_clicks_are_pixels_of_the_recorded_image_with_its_distortion(self, root: Path) -> None:
        scene = Scene.open(root)
        camera = CameraModel(
            width=96, height=72, fx=90, fy=90, cx=47.5, cy=35.5, distortion=[0.2, -0.1, 0, 0]
        )
        scene.save_info(SceneInfo(name="tiny", cameras={"color": camera}, depth_scale=0.001))
        with Session.open(root) as session:
            click_corners(session, project(session))
            session.perform(SolvePnP(object="box_1", frame=1))
            found = session.pose("box_1", 1)
            assert found is not None
            assert np.linalg.norm(found.t - POSE.t) < 1e-5

    def test_one_pixel_of_noise_is_told_as_uncertainty(self, session: Session) -> None:
        noise = np.random.default_rng(3).normal(0, 1, (8, 2))
        click_corners(session, project(session) + noise)
        outcome = session.perform(SolvePnP(object="box_1", frame=1))
        assert "standard deviation" in outcome.report[0]
        residuals = [float(line.split(": ")[1].split(" ")[0]) for line in outcome.report[1:]]
        assert 0.2 < np.sqrt(np.mean(np.square(residuals))) < 2.0

    def test_too_few_points_and_unknown_frames_are_told(self, session: Session) -> None:
        click_corners(session, project(session)[:3])
        with pytest.raises(ToolkitError, match=r"3 points are clicked in frame 1.*at least 4"):
            session.perform(SolvePnP(object="box_1", frame=1))
        with pytest.raises(ToolkitError, match="0 points are clicked in frame 2"):
            session.perform(SolvePnP(object="box_1", frame=2))
        with pytest.raises(ToolkitError, match="no such frame"):
            session.perform(SolvePnP(object="box_1", frame=9))
        with pytest.raises(ToolkitError, match="no such object"):
            session.perform(SolvePnP(object="mug", frame=1))


class TestSnapToTable:
    """The wall of the tiny scene, 0.8 m before the camera, is a table seen from right above."""

    def lowest_mm(self, session: Session) -> float:
        """How far the box's lowest point is above the table, along the first camera's axis."""
        pose = session.pose("box_1", 0)
        assert pose is not None
        return 1000 * (0.8 - float((pose @ session.mesh("box").vertices)[:, 2].max()))

    def test_drop_moves_along_the_normal_until_it_touches(self, session: Session) -> None:
        given = [0.0, 0.0, -1.0, 0.8]
        before = session.pose("box_1", 0)
        request = SnapToTable(object="box_1", frame=1, mode="drop", table=given)
        outcome = session.perform(request)
        after = session.pose("box_1", 0)
        assert before is not None
        assert after is not None
        assert abs(self.lowest_mm(session)) < 1e-6
        assert np.allclose(after.R, before.R, atol=1e-12)
        assert np.allclose(after.t[:2], before.t[:2], atol=1e-12)
        assert f"moved by {1000 * np.linalg.norm(after.t - before.t):.1f} mm" in outcome.report[0]
        placement = session.object("box_1").placements[1]
        assert (placement.method, placement.refinement) == (
            "snap", "put onto the table (table as given)",
        )  # fmt: skip

    def test_rest_lays_the_nearest_facet_flat(self, session: Session) -> None:
        pose = SE3.exp([0, 0, 0.7, 0.1, -0.15, 0.4])
        session.apply(SetPoses.one("box_1", 0, pose, method="typed"))
        session.perform(SnapToTable(object="box_1", mode="rest", table=[0.0, 0.0, -1.0, 0.8]))
        after = session.pose("box_1", 0)
        assert after is not None
        assert abs(self.lowest_mm(session)) < 1e-6
        # One axis of the box stands on the table.
        assert np.abs(after.R[2]).max() == pytest.approx(1.0, abs=1e-9)
        assert rotation_angle(after.R @ pose.R.T) < 0.2

    def test_the_table_is_found_in_the_sensor_depth(self, session: Session) -> None:
        outcome = session.perform(SnapToTable(object="box_1", frame=0))
        assert "table from depth" in outcome.report[0]
        # The three depth images of this scene are flat: they fit one wall to some millimetres.
        assert abs(self.lowest_mm(session)) < 15

    def test_without_camera_poses_the_table_is_that_of_the_frame(self, loose_root: Path) -> None:
        with Session.open(loose_root) as session:
            session.apply(SetPoses.one("box_1", 2, SE3.exp([0, 0, 0.6, 0, 0, 0]), method="typed"))
            session.perform(SnapToTable(object="box_1", frame=2))
            pose = session.pose("box_1", 2)
            assert pose is not None
            assert abs(pose.t[2] + 0.05 - 0.8) < 0.002

    def test_an_object_alone_says_nothing_about_its_table(self, root: Path) -> None:
        for path in (root / "depth").iterdir():
            path.unlink()
        frames = (root / "frames.json").read_text()
        (root / "frames.json").write_text(re.sub(r'"depth": "[^"]*"', '"depth": null', frames))
        with (
            Session.open(root) as session,
            pytest.raises(ToolkitError, match=r"no table found.*no object is placed"),
        ):
            session.perform(SnapToTable(object="box_1", frame=0))

    def test_an_object_that_is_not_placed_has_nothing_to_start_from(self, session: Session) -> None:
        session.apply(AddObject(object="box_2", model="box"))
        with pytest.raises(ToolkitError, match="this object has no"):
            session.perform(SnapToTable(object="box_2"))
