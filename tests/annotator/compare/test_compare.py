"""Two annotators beside each other: known differences give exactly these numbers."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from two_annotators import (
    CAMERA,
    MESHES,
    SYMMETRIES,
    TRUE_POSES,
    camera_pose,
    turned_about_centre,
    write_annotator,
)

from annotator.compare import CompareOptions, Comparison, ObjectAgreement, compare_labels
from annotator.session import ChangeObject, Session
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, mssd
from std_toolkit.io.images import read_color, write_color
from std_toolkit.scene import CameraModel, Scene, SymmetryModel
from std_toolkit.scene.model import Annotation, ObjectAnnotation


@pytest.fixture
def truth(tmp_path: Path) -> Scene:
    return write_annotator(tmp_path / "A")


def other(tmp_path: Path, **changes: SE3) -> Scene:
    return write_annotator(tmp_path / "B", {**TRUE_POSES, **changes})


def row(comparison: Comparison, name: str) -> ObjectAgreement:
    return next(x for x in comparison.objects if x.name == name)


def in_camera_0(pose: SE3, shift_mm: list[float]) -> SE3:
    """Moved in the camera of frame 0, which is the world here."""
    return SE3(pose.R, pose.t + np.array(shift_mm) / 1000)


# --- the numbers ---------------------------------------------------------------------------------


def test_equal_labels_differ_by_nothing(truth: Scene, tmp_path: Path) -> None:
    comparison = compare_labels(truth, other(tmp_path))
    assert [x.verdict for x in comparison.objects] == ["agree"] * 3
    assert comparison.max_mm == pytest.approx(0, abs=1e-6)
    assert not comparison.disagreements
    assert comparison.notes == ()
    assert comparison.only_a == comparison.only_b == ()


def test_a_shift_is_split_along_the_viewing_ray_and_across_it(truth: Scene, tmp_path: Path) -> None:
    ray = TRUE_POSES["wedge"].t / np.linalg.norm(TRUE_POSES["wedge"].t)
    across = np.cross(ray, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    shift = 12.0 * ray + 3.0 * across
    comparison = compare_labels(
        truth, other(tmp_path, wedge=in_camera_0(TRUE_POSES["wedge"], shift))
    )
    x = row(comparison, "wedge")
    assert x.verdict == "disagree"
    d = x.difference
    assert d is not None
    length = float(np.hypot(12, 3))
    assert 1000 * d.mssd_m == pytest.approx(length, abs=1e-6)
    assert 1000 * d.translation_m == pytest.approx(length, abs=1e-6)
    assert d.rotation_rad == pytest.approx(0, abs=1e-9)
    # The ray goes to the middle of the two poses, which lies a hair beside the first one.
    assert 1000 * d.along_ray_m == pytest.approx(12, abs=0.01)
    assert 1000 * d.sideways_m == pytest.approx(3, abs=0.03)
    assert x.mostly == "12.0 mm along the viewing ray (B is farther)"
    # The labels stand in one world: they are apart the same in every frame.
    assert len(x.mssd_by_frame) == 5
    assert 1000 * x.median_m == pytest.approx(length, abs=1e-6)
    assert 1000 * x.max_m == pytest.approx(length, abs=1e-6)
    assert comparison.objects[0].name == "wedge"


def test_the_shift_in_the_image_is_that_of_the_farthest_moved_point(
    truth: Scene, tmp_path: Path
) -> None:
    moved = in_camera_0(TRUE_POSES["wedge"], [4.0, 0.0, 0.0])
    x = row(compare_labels(truth, other(tmp_path, wedge=moved)), "wedge")
    nearest = (TRUE_POSES["wedge"] @ MESHES["wedge"].vertices)[:, 2].min()
    assert x.difference is not None
    assert x.difference.shift_px == pytest.approx(CAMERA.fx * 0.004 / nearest, rel=1e-6)


def test_a_turn_is_told_with_its_axis_and_what_it_moves(truth: Scene, tmp_path: Path) -> None:
    angle = np.deg2rad(12.0)
    turned = turned_about_centre(TRUE_POSES["wedge"], [0.0, angle, 0.0])
    x = row(compare_labels(truth, other(tmp_path, wedge=turned)), "wedge")
    d = x.difference
    assert d is not None
    assert d.rotation_rad == pytest.approx(angle, abs=1e-9)
    assert d.translation_m == pytest.approx(0, abs=1e-12)
    radius = float(np.hypot(0.04, 0.05))
    assert d.mssd_m == pytest.approx(2 * radius * np.sin(angle / 2), abs=1e-9)
    assert x.mostly == f"12.0 deg about y (moves the surface {1000 * d.mssd_m:.1f} mm)"


@pytest.mark.parametrize(
    ("turn", "text"),
    [
        ([0.0, 0.0, np.pi], "180 deg about z: flip?"),
        ([np.pi - 0.1, 0.0, 0.0], "174 deg about x: flip?"),
        ([0.0, -np.pi / 2, 0.0], "90 deg about y: a quarter turn?"),
    ],
)
def test_wrong_choices_are_called_so(
    truth: Scene, tmp_path: Path, turn: list[float], text: str
) -> None:
    turned = turned_about_centre(TRUE_POSES["wedge"], turn)
    assert row(compare_labels(truth, other(tmp_path, wedge=turned)), "wedge").mostly == text


def test_symmetric_variants_are_the_same_pose(truth: Scene, tmp_path: Path) -> None:
    b = other(
        tmp_path,
        can=turned_about_centre(TRUE_POSES["can"], [0.0, 0.0, 5 * 2 * np.pi / 72]),
        tile=turned_about_centre(TRUE_POSES["tile"], [0.0, 0.0, np.pi]),
    )
    comparison = compare_labels(truth, b)
    for name in ("can", "tile"):
        x = row(comparison, name)
        assert x.difference is not None
        assert x.difference.mssd_m == pytest.approx(0, abs=1e-9)
        assert x.difference.rotation_rad == pytest.approx(0, abs=1e-9)
        assert x.difference.translation_m == pytest.approx(0, abs=1e-12)
        assert x.difference.shift_px == pytest.approx(0, abs=1e-6)


def test_a_turn_about_an_axis_counts_if_only_one_declares_the_symmetry(
    truth: Scene, tmp_path: Path
) -> None:
    turned = turned_about_centre(TRUE_POSES["can"], [0.0, 0.0, 0.6])
    b = write_annotator(
        tmp_path / "B",
        {**TRUE_POSES, "can": turned},
        symmetries={**SYMMETRIES, "can": SymmetryModel()},
    )
    comparison = compare_labels(truth, b)
    assert row(comparison, "can").verdict == "disagree"
    assert row(comparison, "can").mostly.startswith("34.4 deg about z")
    assert any("can: the two declare different symmetries" in note for note in comparison.notes)


@pytest.mark.slow
@given(
    st.lists(st.floats(-1, 1), min_size=6, max_size=6),
    st.sampled_from(sorted(MESHES)),
)
@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_exchanging_the_two_changes_signs_only(
    tmp_path_factory: pytest.TempPathFactory, xi: list[float], name: str
) -> None:
    folder = tmp_path_factory.mktemp("exchanged")
    pose = TRUE_POSES[name] @ SE3.exp(np.array(xi) * [0.02, 0.02, 0.02, 1, 1, 1])
    a = write_annotator(folder / "a")
    b = write_annotator(folder / "b", {**TRUE_POSES, name: pose})
    forth, back = row(compare_labels(a, b), name), row(compare_labels(b, a), name)
    assert forth.verdict == back.verdict
    assert forth.difference is not None and back.difference is not None
    for field in ("mssd_m", "rotation_rad", "translation_m", "sideways_m", "shift_px"):
        there, here = getattr(forth.difference, field), getattr(back.difference, field)
        assert here == pytest.approx(there, rel=1e-6, abs=1e-9), field
    assert back.difference.along_ray_m == pytest.approx(-forth.difference.along_ray_m, abs=1e-9)


# --- worlds, frames and names ---------------------------------------------------------------------


def test_the_world_frames_of_the_two_need_not_be_the_same(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A")
    b = write_annotator(tmp_path / "B", T_new_old=SE3.exp([1.0, -2.0, 0.5, 0.4, 2.0, -0.3]))
    comparison = compare_labels(a, b)
    assert comparison.max_mm == pytest.approx(0, abs=1e-6)
    assert any("own camera poses (5 common frames)" in n for n in comparison.notes)


def test_labels_annotated_in_different_frames_meet_in_both(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A", frame=0)
    moved = in_camera_0(TRUE_POSES["wedge"], [0.0, 8.0, 0.0])
    b = write_annotator(tmp_path / "B", {**TRUE_POSES, "wedge": moved}, frame=3, propagated=False)
    x = row(compare_labels(a, b), "wedge")
    assert x.difference is not None
    assert 1000 * x.difference.mssd_m == pytest.approx(8, abs=1e-6)
    assert x.frame == 0


def test_camera_poses_that_differ_show_away_from_the_annotated_frame(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A")
    b = write_annotator(tmp_path / "B")
    assert b.poses is not None
    # 10 % in scale, far more than a sensor that reads long.
    scaled = []
    for pose in b.poses.frames:
        assert pose.T_world_cam is not None
        T = SE3.from_matrix(pose.T_world_cam)
        grown = SE3(T.R, 1.1 * T.t)
        scaled.append(msgspec.structs.replace(pose, T_world_cam=grown.flat()))
    b.save_poses(msgspec.structs.replace(b.poses, frames=scaled))
    x = row(compare_labels(a, b), "wedge")
    assert x.difference is not None
    assert x.difference.mssd_m == pytest.approx(0, abs=1e-9)
    expected = [np.linalg.norm(0.1 * camera_pose(i).t) for i in range(5)]
    assert list(x.mssd_by_frame.values()) == pytest.approx(expected, abs=1e-9)
    assert x.verdict == "disagree"
    assert "do the camera poses differ?" in x.mostly
    assert any("B times 0.9091 is the scale of A" in n for n in compare_labels(a, b).notes)


def test_without_camera_poses_the_annotated_frames_are_compared(tmp_path: Path) -> None:
    moved = in_camera_0(TRUE_POSES["can"], [7.0, 0.0, 0.0])
    a = write_annotator(tmp_path / "A", posed=False)
    b = write_annotator(tmp_path / "B", {**TRUE_POSES, "can": moved}, posed=False)
    comparison = compare_labels(a, b)
    assert row(comparison, "wedge").verdict == "agree"
    x = row(comparison, "can")
    assert list(x.mssd_by_frame) == [0]
    assert x.difference is not None
    assert 1000 * x.difference.mssd_m == pytest.approx(7, abs=1e-6)


def test_camera_poses_of_one_of_the_two_carry_its_labels_to_the_others_frame(
    tmp_path: Path,
) -> None:
    a = write_annotator(tmp_path / "A", frame=2)
    b = write_annotator(tmp_path / "B", frame=4, posed=False)
    comparison = compare_labels(a, b)
    x = row(comparison, "wedge")
    assert x.frame == 4
    assert comparison.max_mm == pytest.approx(0, abs=1e-6)
    assert "camera poses in common frames: A only" in comparison.notes


def test_without_camera_poses_other_frames_cannot_be_compared(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A", frame=0, posed=False)
    b = write_annotator(tmp_path / "B", frame=1, posed=False)
    comparison = compare_labels(a, b)
    assert {x.verdict for x in comparison.objects} == {"not comparable"}
    assert "no frame in which both have a pose" in comparison.objects[0].mostly
    assert len(comparison.disagreements) == 3
    assert np.isnan(comparison.median_mm)


def test_poses_of_unknown_unit_carry_nothing(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A", frame=0)
    b = write_annotator(tmp_path / "B", frame=1, unit="unknown", propagated=False)
    x = row(compare_labels(a, b), "wedge")
    assert list(x.mssd_by_frame) == [1]


def test_objects_of_other_names_are_matched_by_mesh_and_place(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A")
    moved = in_camera_0(TRUE_POSES["can"], [3.0, 0.0, 0.0])
    b = write_annotator(tmp_path / "B", {**TRUE_POSES, "can": moved}, names={"can": "tin"})
    comparison = compare_labels(a, b)
    x = row(comparison, "can")
    assert (x.b.name, x.by) == ("tin", "place")
    assert x.difference is not None
    assert 1000 * x.difference.mssd_m == pytest.approx(3, abs=1e-6)
    assert any("can of A is matched with tin of B" in note for note in comparison.notes)


def test_objects_of_other_names_far_apart_are_two_objects(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A")
    moved = in_camera_0(TRUE_POSES["can"], [150.0, 0.0, 0.0])
    b = write_annotator(tmp_path / "B", {**TRUE_POSES, "can": moved}, names={"can": "tin"})
    comparison = compare_labels(a, b)
    assert (comparison.only_a, comparison.only_b) == (("can",), ("tin",))


def test_what_only_one_labelled_is_listed(truth: Scene, tmp_path: Path) -> None:
    poses = {k: v for k, v in TRUE_POSES.items() if k != "tile"}
    b = write_annotator(tmp_path / "B", poses)
    comparison = compare_labels(truth, b)
    assert (comparison.only_a, comparison.only_b) == (("tile",), ())
    assert not comparison.disagreements


def test_the_hands_poses_can_be_compared_instead_of_the_refined(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A")
    b = write_annotator(tmp_path / "B")
    wedge = b.labels.labels[0]
    refined = in_camera_0(TRUE_POSES["wedge"], [0.0, 9.0, 0.0]).flat()
    b.save_labels(
        b.labels.with_label(msgspec.structs.replace(wedge, T_world_obj=refined, refined=True))
    )
    final = row(compare_labels(a, b), "wedge")
    assert final.difference is not None
    assert 1000 * final.difference.mssd_m == pytest.approx(9, abs=1e-6)
    by_hand = row(compare_labels(a, b, CompareOptions(as_annotated=True)), "wedge")
    assert by_hand.worst_m == pytest.approx(0, abs=1e-9)


def test_the_threshold_is_what_still_agrees(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A")
    b = other(tmp_path, wedge=in_camera_0(TRUE_POSES["wedge"], [5.0, 0.0, 0.0]))
    assert row(compare_labels(a, b), "wedge").verdict == "agree"
    below = compare_labels(a, b, CompareOptions(threshold_mm=4.99))
    assert row(below, "wedge").verdict == "disagree"


def test_unfinished_work_is_told(truth: Scene, tmp_path: Path) -> None:
    b = other(tmp_path)
    rows = [ObjectAnnotation(object=i, status="done") for i in (1, 2)]
    b.save_annotation(Annotation(objects=rows))
    with Session.open(truth.root, annotator="anna") as session:
        session.apply(ChangeObject(object="can", note="lid is off"))
        notes = compare_labels(Scene.open(truth.root), Scene.open(b.root)).notes
    assert notes[0].startswith("A: 1 edit by anna, ")
    assert notes[0].endswith("was not saved; only what was saved counts here")
    assert notes[1] == "B has not marked as done: tile"


# --- what cannot be compared ----------------------------------------------------------------------


def refused(a: Scene, b: Scene) -> str:
    with pytest.raises(ToolkitError) as caught:
        compare_labels(a, b)
    return str(caught.value)


def test_another_recording_is_refused(truth: Scene, tmp_path: Path) -> None:
    b = write_annotator(tmp_path / "B", seed=1)
    message = refused(truth, b)
    assert "not the same recording" in message
    assert "the images of frame 000000 differ" in message


def test_images_compressed_anew_are_the_same_recording(truth: Scene, tmp_path: Path) -> None:
    b = other(tmp_path)
    path = b.color_path(b.frames[0])
    write_color(path, read_color(path))
    before = path.read_bytes()
    path.write_bytes(before + b"\0")  # a trailing byte leaves the pixels as they are
    assert not compare_labels(truth, b).disagreements


def test_without_images_names_and_sizes_decide_and_it_is_said(truth: Scene, tmp_path: Path) -> None:
    b = other(tmp_path)
    for frame in b.frames:
        b.color_path(frame).unlink()
    assert any("no image is available in both scenes" in n for n in compare_labels(truth, b).notes)


def test_the_same_folder_twice_is_refused(truth: Scene) -> None:
    assert "the same folder" in refused(truth, Scene.open(truth.root))


def test_another_image_size_is_another_recording(truth: Scene, tmp_path: Path) -> None:
    b = other(tmp_path)
    half = CAMERA.resized(80, 60)
    b.save_info(msgspec.structs.replace(b.info, cameras={"color": CameraModel.of(half)}))
    assert "160x120 in one and 80x60 in the other" in refused(truth, b)


def test_a_scene_without_labels_is_refused(truth: Scene, tmp_path: Path) -> None:
    b = write_annotator(tmp_path / "B", {})
    assert "B: this scene has no labels to compare" in refused(truth, b)


def test_another_mesh_of_the_same_name_is_not_compared(truth: Scene, tmp_path: Path) -> None:
    b = other(tmp_path)
    moved = MESHES["wedge"].copy()
    moved.apply_translation([0.0, 0.0, 0.05])  # the same shape with the origin at its foot
    moved.export(b.mesh_path(b.objects.model("wedge")))
    x = row(compare_labels(truth, b), "wedge")
    assert x.verdict == "not comparable"
    assert "the meshes differ" in x.mostly


def test_the_same_mesh_in_another_format_is_compared(truth: Scene, tmp_path: Path) -> None:
    b = other(tmp_path)
    model = b.objects.model("wedge")
    MESHES["wedge"].export(b.root / "models/wedge/wedge.obj")
    new = msgspec.structs.replace(model, mesh="models/wedge/wedge.obj")
    others = [m for m in b.objects.models if m.id != "wedge"]
    b.save_objects(msgspec.structs.replace(b.objects, models=[new, *others]))
    assert row(compare_labels(truth, b), "wedge").verdict == "agree"


def test_a_missing_mesh_spoils_its_own_object_only(truth: Scene, tmp_path: Path) -> None:
    b = other(tmp_path)
    b.mesh_path(b.objects.model("wedge")).unlink()
    comparison = compare_labels(truth, b)
    x = row(comparison, "wedge")
    assert x.verdict == "not comparable"
    assert "wedge.ply" in x.mostly
    assert row(comparison, "can").verdict == "agree"


def test_names_given_the_other_way_round_are_recognised(tmp_path: Path) -> None:
    # Two of a kind: the tile becomes a second wedge.
    def two_wedges(root: Path, names: dict[str, str]) -> Scene:
        scene = write_annotator(root, names=names)
        table = [
            msgspec.structs.replace(o, model="wedge") if o.id == 3 else o
            for o in scene.objects.objects
        ]
        scene.save_objects(msgspec.structs.replace(scene.objects, objects=table))
        return Scene.open(root)

    a = two_wedges(tmp_path / "A", {"wedge": "left", "tile": "right"})
    b = two_wedges(tmp_path / "B", {"wedge": "right", "tile": "left"})
    comparison = compare_labels(a, b)
    assert row(comparison, "left").mostly == "B calls this one right: swapped?"
    assert row(comparison, "right").mostly == "B calls this one left: swapped?"


def test_the_mssd_is_that_of_the_library(truth: Scene, tmp_path: Path) -> None:
    pose = TRUE_POSES["tile"] @ SE3.exp([0.002, -0.001, 0.003, 0.02, 0.05, 2.9])
    x = row(compare_labels(truth, other(tmp_path, tile=pose)), "tile")
    symmetry = SYMMETRIES["tile"].symmetry()
    vertices = np.asarray(MESHES["tile"].vertices)
    expected = mssd(pose, TRUE_POSES["tile"], vertices, symmetry)
    assert x.difference is not None
    assert x.difference.mssd_m == pytest.approx(expected, abs=1e-9)
