"""Refinement as a request of the session: one edit, with its sentence in the label's provenance.

How well it refines is tested in tests/std_toolkit/labels; here on a small recording with truth.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from textured_scene import write_textured_scene

from annotator.cli import main
from annotator.session import AddObject, Move, Session
from annotator.session.requests import Refine, RequestCancelled
from sensors.synthetic import RecordingOptions, make_recording
from sensors.synthetic.truth import scene_from_truth
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.symmetry import mssd
from std_toolkit.scene import LabelProvenance, Scene


class TestWhatIsAskedOf:
    def test_without_camera_poses_one_frame_must_be_named(self, loose_root: Path) -> None:
        with Session.open(loose_root) as session:
            for request in (
                Refine(objects=["box_1"]),
                Refine(objects=["box_1"], frames=[0, 1]),
                Refine(objects=["box_1"], frames=[0], frame=1),
            ):
                with pytest.raises(ToolkitError, match="uses one frame"):
                    session.perform(request)

    def test_unknown_frames_and_objects_are_named(self, root: Path) -> None:
        with Session.open(root) as session:
            with pytest.raises(ToolkitError, match="no such frame"):
                session.perform(Refine(objects=["box_1"], frame=9))
            with pytest.raises(ToolkitError, match="no such object"):
                session.perform(Refine(objects=["mug"]))
            session.apply(AddObject(object="box_2", model="box"))
            with pytest.raises(ToolkitError, match="no initial pose"):
                session.perform(Refine(objects=["box_2"], frame=0))
        with pytest.raises(ToolkitError, match="no object is named"):
            Refine(objects=[])

    def test_a_frame_without_camera_pose_is_refused_before_the_work(self, root: Path) -> None:
        document = json.loads((root / "poses.json").read_text())
        document["frames"] = document["frames"][:2]
        (root / "poses.json").write_text(json.dumps(document))
        with Session.open(root) as session:
            for request in (
                Refine(objects=["box_1"], frame=2),
                # Its pose in the world would be taken for one in that camera.
                Refine(objects=["box_1"], frames=[2]),
            ):
                with pytest.raises(ToolkitError, match="this frame has no camera pose"):
                    session.perform(request)

    def test_cancelling_ends_it_and_changes_nothing(self, root: Path) -> None:
        with Session.open(root) as session:
            request = Refine(objects=["box_1"], frame=0)
            with pytest.raises(RequestCancelled):
                request.resolve(session.snapshot(), cancelled=lambda: True)
            assert not session.unsaved


@pytest.mark.slow
class TestADamagedImage:
    @pytest.mark.parametrize("damaged", ["color/000003.jpg", "color/000003.png"])
    def test_its_frame_is_left_out_and_named(self, tmp_path: Path, damaged: str) -> None:
        root = write_textured_scene(tmp_path / "scene", suffix=Path(damaged).suffix)
        image = root / damaged
        image.write_bytes(image.read_bytes()[:3000])
        with Session.open(root) as session:
            before = session.T_world_obj("box_1")
            session.apply(Move(object="box_1", frame=0, shift_mm=[3, -2, 3]))
            outcome = session.perform(Refine(objects=["box_1"], frame=0))
            after = session.T_world_obj("box_1")
        (line,) = [w for w in outcome.warnings if "left out" in w]
        assert line.startswith(f"Frame 3 = {damaged} is left out: ")
        assert before is not None and after is not None
        assert np.linalg.norm(after.t - before.t) < 0.002

    def test_without_any_other_frame_it_is_told(self, tmp_path: Path) -> None:
        root = write_textured_scene(tmp_path / "scene", suffix=".jpg")
        image = root / "color/000003.jpg"
        image.write_bytes(image.read_bytes()[:3000])
        with Session.open(root) as session, pytest.raises(ToolkitError, match="JPEG"):
            session.perform(Refine(objects=["box_1"], frame=3, frames=[3]))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five frames around a table with six objects, labelled with the truth."""
    folder = tmp_path_factory.mktemp("recorded")
    options = RecordingOptions(frames=5, arc_degrees=110, width=320, height=240, samples=1)
    make_recording(folder / "recording", options)
    return scene_from_truth(folder / "recording", folder / "scene").root


@pytest.mark.slow
class TestOnARecording:
    @pytest.fixture
    def root(self, recorded: Path, tmp_path: Path) -> Path:
        return Path(shutil.copytree(recorded, tmp_path / "scene"))

    def errors_mm(self, session: Session, truth: dict[str, SE3]) -> dict[str, float]:
        """Largest distance of the surfaces, symmetry aware."""
        found = {}
        for name, T in truth.items():
            model = session.state.model_of(name)
            there = session.T_world_obj(name)
            assert there is not None
            vertices = np.asarray(session.mesh(model.id).vertices)
            found[name] = 1000 * mssd(there, T, vertices, model.symmetry.symmetry())
        return found

    def disturbed(self, session: Session, names: list[str]) -> dict[str, SE3]:
        """Move objects away; returns where they were."""
        truth = {}
        rng = np.random.default_rng(1)
        for name in names:
            there = session.T_world_obj(name)
            assert there is not None
            truth[name] = there
            session.apply(
                Move(
                    object=name,
                    frame=0,
                    shift_mm=rng.normal(0, 7, 3).tolist(),
                    turn_deg=rng.normal(0, 3, 3).tolist(),
                )
            )
        return truth

    def test_opaque_and_transparent_objects_come_back_in_one_edit(self, root: Path) -> None:
        names = ["soup_can", "glass"]
        with Session.open(root, annotator="mk") as session:
            truth = self.disturbed(session, names)
            before = session.state
            assert min(self.errors_mm(session, truth).values()) > 6
            told: list[float] = []
            request = Refine(objects=names, frame=2)
            outcome = request.resolve(session.snapshot(), progress=told.append)
            session.apply(outcome.edit)
            assert max(self.errors_mm(session, truth).values()) < 5
            assert told == sorted(told)
            assert told[-1] == 1.0
            assert [line.split(":")[0] for line in outcome.report] == names
            assert "moved by" in outcome.report[0]
            # Both told in the frame that was asked for; the others were not touched.
            assert all(list(session.object(n).placements) == [2] for n in names)
            assert session.object("mug") == before.object("mug")
            session.undo()
            assert session.state == before
            session.redo()
            session.save()
        label = Scene.open(root).labels.of(before.object("glass").id)
        assert label is not None
        assert label.method == "refine"
        assert isinstance(label.provenance, LabelProvenance)
        assert "edges" in label.provenance.refinement
        assert "5 views" in label.provenance.refinement

    def test_without_camera_poses_one_frame_is_refined_on_its_own(self, root: Path) -> None:
        with Session.open(root) as session:
            truth = session.pose("soup_can", 1)
            assert truth is not None
        (root / "poses.json").unlink()
        labels = json.loads((root / "labels.json").read_text())
        for row in labels["labels"]:
            row.update(T_world_obj=None, views={})
        (root / "labels.json").write_text(json.dumps(labels))
        start = SE3(truth.R, truth.t + np.array([0.006, -0.004, 0.008]))
        script = root.parent / "edits.json"
        place = {"object": "soup_can", "frame": 1, "T_cam_obj": start.flat()}
        steps = [
            {"edit": "set_poses", "changes": [place]},
            {"edit": "refine", "objects": ["soup_can"], "frame": 1},
            {"edit": "save"},
        ]
        script.write_text(json.dumps(steps))
        assert main([str(root), "--script", str(script)]) == 0
        with Session.open(root) as session:
            assert not session.posed
            assert set(session.object("soup_can").placements) == {0, 1}
            found = session.pose("soup_can", 1)
            assert found is not None
            model = session.state.model_of("soup_can")
            vertices = np.asarray(session.mesh(model.id).vertices)
            assert 1000 * mssd(found, truth, vertices, model.symmetry.symmetry()) < 12
            assert session.object("soup_can").placements[1].method == "refine"
