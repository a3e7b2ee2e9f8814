"""Opening a scene: what is shown at first, and what must not prevent it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from scene_on_disk import OBJECT_IN_WORLD, camera_pose, write_scene

from annotator.session import ChangeObject, Move, Session, SetPoses
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.mesh import hull_vertices
from std_toolkit.geometry.symmetry import mssd
from std_toolkit.scene import CameraPoses, FramePose, Frames, Label, Labels, Scene
from std_toolkit.scene.model import Frame, ScaleReport

POSE = SE3.exp([0.0, 0.0, 0.5, 0.0, 0.0, 0.0])


def edit_label(root: Path, **changes: object) -> None:
    document = json.loads((root / "labels.json").read_text())
    document["labels"][0].update(changes)
    (root / "labels.json").write_text(json.dumps(document))


class TestLabels:
    def test_an_annotated_pose_is_shown_exactly_as_written(self, root: Path) -> None:
        """The way to the world and back would change its last digits."""
        written = json.loads((root / "labels.json").read_text())["labels"][0]["T_cam_obj"]
        with Session.open(root) as session:
            assert session.object("box_1").placements[0].T_cam_obj == written

    def test_views_that_were_not_propagated_are_brought_together(self, root: Path) -> None:
        def seen(frame: int, down: float) -> list[float]:
            T_cam_obj = camera_pose(frame).inverse() @ OBJECT_IN_WORLD
            return (SE3.exp([0, down, 0, 0, 0, 0]) @ T_cam_obj).flat()

        # Off by 4 mm up and down: what agrees best with both is the truth between them.
        edit_label(root, T_cam_obj=seen(0, 0.004), T_world_obj=None, views={"2": seen(2, -0.004)})
        with Session.open(root) as session:
            there = session.T_world_obj("box_1")
            assert there is not None
            points = hull_vertices(session.mesh("box"))
            assert mssd(there, OBJECT_IN_WORLD, points) < 0.001

    def test_views_whose_mesh_is_missing_are_shown_as_annotated_with_a_warning(
        self, root: Path
    ) -> None:
        pose = (camera_pose(2).inverse() @ OBJECT_IN_WORLD).flat()
        edit_label(root, T_world_obj=None, views={"2": pose})
        (root / "models/box/box.ply").unlink()
        with Session.open(root) as session:
            assert list(session.object("box_1").placements) == [0]
            assert any("box_1" in w and "mesh file not found" in w for w in session.warnings)

    def test_a_label_of_a_frame_without_camera_pose_holds_in_that_frame(self, root: Path) -> None:
        scene = Scene.open(root)
        assert scene.poses is not None
        edit_label(root, T_world_obj=None)
        scene.save_poses(CameraPoses(frames=scene.poses.frames[1:], source="import:test"))
        with Session.open(root) as session:
            assert session.frames == (1, 2)
            assert session.pose("box_1", 0) is not None
            assert session.pose("box_1", 1) is None
            session.apply(SetPoses.one("box_1", 1, POSE, method="typed"))
            assert session.pose("box_1", 2) is not None


class TestScenesWithoutMetricPoses:
    def test_every_frame_is_labelled_on_its_own(self, loose_root: Path) -> None:
        with Session.open(loose_root) as session:
            assert not session.posed
            assert session.frames == (0, 1, 2)
            assert session.pose_problem == (
                "The scene has no camera poses, so each frame is labelled on its own."
            )

    def test_poses_without_a_unit_are_none(self, root: Path) -> None:
        scene = Scene.open(root)
        assert scene.poses is not None
        scale = ScaleReport(unit="unknown", chosen="")
        scene.save_poses(CameraPoses(frames=scene.poses.frames, scale=scale))
        with Session.open(root) as session:
            assert not session.posed
            assert "no metric scale" in str(session.pose_problem)
            assert session.T_world_cam(0) is None
            assert session.pose("box_1", 0) is not None
            assert session.pose("box_1", 1) is None


class TestDamage:
    def test_missing_and_damaged_images_prevent_nothing(self, root: Path) -> None:
        shutil.rmtree(root / "depth")
        (root / "color/000000.png").unlink()
        (root / "color/000001.png").write_bytes(b"no image")
        with Session.open(root) as session:
            session.apply(Move(object="box_1", frame=1, shift_mm=[1, 0, 0]))
            session.save()

    def test_a_missing_mesh_prevents_only_what_needs_it(self, root: Path) -> None:
        (root / "models/box/box.ply").unlink()
        with Session.open(root) as session:
            session.apply(SetPoses.one("box_1", 0, POSE, method="typed"))
            with pytest.raises(ToolkitError, match=r"box\.ply: mesh file not found"):
                session.apply(Move(object="box_1", frame=0, turn_deg=[0, 0, 1]))
            session.save()

    @pytest.mark.parametrize(
        "name", ["scene.json", "frames.json", "objects.json", "poses.json", "labels.json",
                 "annotation.json"],
    )  # fmt: skip
    def test_a_damaged_document_is_named_and_the_scene_is_free_again(
        self, root: Path, name: str
    ) -> None:
        whole = (root / name).read_bytes() if (root / name).exists() else None
        (root / name).write_text('{"frames": 1')
        with pytest.raises(ToolkitError, match=name):
            Session.open(root)
        (root / name).write_bytes(whole or b'{"objects": []}')
        Session.open(root).close()

    def test_annotations_of_unknown_objects_and_frames_are_named(self, root: Path) -> None:
        click = {"frame": 9, "u": 1, "v": 1, "point": [0, 0, 0]}
        for rows, field in (
            ([{"object": 7}], r"objects\[0\]\.object"),
            ([{"object": 1, "clicks": [click]}], r"objects\[0\]\.clicks\[0\]\.frame"),
        ):
            (root / "annotation.json").write_text(json.dumps({"objects": rows}))
            with pytest.raises(ToolkitError, match=rf"annotation\.json: {field}"):
                Session.open(root)

    def test_no_scene_is_told(self, tmp_path: Path) -> None:
        with pytest.raises(ToolkitError, match=r"no scene here.*std-curate import"):
            Session.open(tmp_path / "nothing")


@contextmanager
def not_root() -> Iterator[None]:
    """Root may write anywhere: for a while be somebody else."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


class TestReadOnly:
    def test_what_was_annotated_can_be_seen_and_not_edited(self, root: Path) -> None:
        with Session.open(root, read_only=True) as session:
            assert not session.writable
            assert session.pose("box_1", 2) is not None
            for attempt in (
                lambda: session.apply(ChangeObject(object="box_1", note="x")),
                session.undo,
                session.redo,
                session.save,
                session.propagate,
                session.reload,
            ):
                with pytest.raises(ToolkitError, match="read-only"):
                    attempt()

    def test_looking_needs_no_lock(self, root: Path) -> None:
        with Session.open(root), Session.open(root, read_only=True) as second:
            assert second.state.objects

    def test_a_folder_that_cannot_be_written_says_how_to_look_at_it(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            Path(folder).chmod(0o755)
            root = write_scene(Path(folder) / "scene").root
            Session.open(root).close()  # everything is imported now
            shutil.rmtree(root / ".std")
            root.chmod(0o555)
            with not_root():
                with pytest.raises(
                    ToolkitError, match=r"cannot write to the scene: Permission denied.*--read-only"
                ):
                    Session.open(root)
                with Session.open(root, read_only=True) as session:
                    assert session.pose("box_1", 0) is not None

    def test_a_folder_that_becomes_unwritable_keeps_every_edit(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            Path(folder).chmod(0o755)
            root = write_scene(Path(folder) / "scene").root
            with Session.open(root) as session:
                session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
                session.save()
                session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
                root.chmod(0o555)
                (root / ".std").chmod(0o555)
                with not_root():
                    with pytest.raises(ToolkitError, match="cannot write"):
                        session.save()
                    # The journal was open already: editing goes on.
                    session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
                assert session.unsaved
                state = session.state
                root.chmod(0o755)
                (root / ".std").chmod(0o755)
            with Session.open(root, recover="yes") as session:
                assert session.state == state


class TestLock:
    def test_a_second_session_is_refused_and_told_who_has_the_first(self, root: Path) -> None:
        with Session.open(root, annotator="mk") as session:
            with pytest.raises(
                ToolkitError,
                match=rf"another process is annotating.*pid {os.getpid()}, annotator mk.*read-only",
            ):
                Session.open(root, annotator="other")
            session.apply(ChangeObject(object="box_1", note="still mine"))
        Session.open(root, recover="no").close()

    def test_a_killed_session_frees_the_scene(self, root: Path) -> None:
        script = (
            "import sys, time; from annotator.session import Session; "
            "session = Session.open(sys.argv[1], annotator='dead'); "
            "print('open', flush=True); time.sleep(60)"
        )
        child = subprocess.Popen(
            [sys.executable, "-c", script, str(root)], stdout=subprocess.PIPE, text=True
        )
        assert child.stdout is not None
        assert child.stdout.readline() == "open\n"
        with pytest.raises(ToolkitError, match=f"pid {child.pid}, annotator dead"):
            Session.open(root)
        child.kill()
        child.wait()
        child.stdout.close()
        Session.open(root).close()

    def test_an_open_session_hinders_no_curation(self, root: Path) -> None:
        with Session.open(root) as session:
            session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
            with Scene.open(root).lock():
                pass

    def test_the_name_in_the_lock_is_one_line(self, root: Path) -> None:
        with Session.open(root, annotator="m\nk\x1b[31m"):
            with pytest.raises(ToolkitError) as caught:
                Session.open(root)
            assert str(caught.value).isprintable()


def test_a_scene_of_900_frames_opens_well_within_a_second(tmp_path: Path) -> None:
    """Its images are not there at all, so nothing can have read them."""
    root = write_scene(tmp_path / "long").root
    frames = [Frame(id=i, name=f"{i:06d}", color=f"color/{i:06d}.png") for i in range(900)]
    shutil.rmtree(root / "color")
    (root / "frames.json").write_bytes(_json(Frames(frames=frames)))
    covariance = np.eye(6).ravel().tolist()
    poses = [
        FramePose(
            frame=i,
            status="registered",
            T_world_cam=camera_pose(i).flat(),
            covariance=covariance,
            points=500,
        )
        for i in range(900)
    ]
    (root / "poses.json").write_bytes(_json(CameraPoses(frames=poses, source="sfm")))
    label = Label(object=1, frame=450, T_cam_obj=POSE.flat())
    (root / "labels.json").write_bytes(_json(Labels(labels=[label])))
    best = float("inf")
    for _ in range(3):
        start = time.perf_counter()
        with Session.open(root) as session:
            assert len(session.frames) == 900
        best = min(best, time.perf_counter() - start)
    assert best < 1.0


def _json(document: object) -> bytes:
    import msgspec

    return msgspec.json.encode(document)
