"""Several annotators become one scene: agreed objects get the mean, the others stay open."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from two_annotators import (
    MESHES,
    SYMMETRIES,
    TIME,
    TRUE_POSES,
    annotators,
    camera_pose,
    merge,
    shifted,
    turned_about_centre,
    write_annotator,
)

from annotator.compare import Merge, write_scene
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, mssd
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.scene import Scene
from std_toolkit.scene.model import LabelProvenance


def pose_of(result: Merge, name: str) -> SE3:
    found = next(x for x in result.objects if x.object.name == name)
    assert found.label is not None and found.label.T_world_obj is not None
    return SE3.from_matrix(found.label.T_world_obj)


def outcomes(result: Merge) -> dict[str, str]:
    return {x.object.name: x.outcome for x in result.objects}


def note_of(result: Merge, name: str) -> str:
    return next(x.note for x in result.objects if x.object.name == name)


# --- whose label counts ---------------------------------------------------------------------------


def test_equal_labels_merge_into_themselves(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {})
    result = merge(a, b)
    assert set(outcomes(result).values()) == {"merged"}
    for name, T in TRUE_POSES.items():
        np.testing.assert_allclose(pose_of(result, name).matrix(), T.matrix(), atol=1e-12)
    for merged, before in zip(result.objects, a.labels.labels, strict=True):
        assert merged.label is not None
        assert (merged.label.object, merged.label.frame) == (before.object, before.frame)
        np.testing.assert_allclose(merged.label.T_cam_obj, before.T_cam_obj, atol=1e-12)


def test_agreed_labels_become_their_mean_with_both_named(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {"wedge": shifted("wedge", 4.0)})
    result = merge(a, b)
    np.testing.assert_allclose(
        pose_of(result, "wedge").matrix(), shifted("wedge", 2.0).matrix(), atol=1e-12
    )
    label = result.objects[0].label
    assert label is not None
    assert (label.method, label.annotator) == ("merge", "p0, p1")
    assert isinstance(label.provenance, LabelProvenance)
    assert label.provenance.time == TIME
    assert label.provenance.refinement == "mean of A (p0) and B (p1), 4.0 mm apart"


def test_symmetric_variants_agree_and_keep_the_first_ones(tmp_path: Path) -> None:
    turned = turned_about_centre(TRUE_POSES["tile"], [0.0, 0.0, np.pi])
    spun = turned_about_centre(TRUE_POSES["can"], [0.0, 0.0, 1.3])
    a, b = annotators(tmp_path, {}, {"tile": turned, "can": spun})
    result = merge(a, b)
    np.testing.assert_allclose(
        pose_of(result, "tile").matrix(), TRUE_POSES["tile"].matrix(), atol=1e-12
    )
    symmetry = SYMMETRIES["can"].symmetry()
    points = np.asarray(MESHES["can"].vertices)
    assert mssd(pose_of(result, "can"), TRUE_POSES["can"], points, symmetry) < 2e-5


def test_labels_that_do_not_agree_are_left_to_a_person(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {"wedge": shifted("wedge", 12.0)})
    result = merge(a, b)
    assert outcomes(result) == {"wedge": "open", "can": "merged", "tile": "merged"}
    assert note_of(result, "wedge").startswith("A and B are 12.0 mm apart, ")
    assert "sideways" in note_of(result, "wedge")
    row = result.annotation().of(1)
    assert row.status == "open"
    assert row.note == note_of(result, "wedge")


def test_one_may_be_preferred_where_they_disagree(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {"wedge": shifted("wedge", 12.0), "can": shifted("can", 2.0)})
    result = merge(a, b, prefer="B")
    assert outcomes(result) == {"wedge": "taken", "can": "merged", "tile": "merged"}
    np.testing.assert_allclose(pose_of(result, "wedge").t, shifted("wedge", 12.0).t, atol=1e-12)
    np.testing.assert_allclose(pose_of(result, "can").t, shifted("can", 1.0).t, atol=1e-12)
    label = result.objects[0].label
    assert label is not None
    assert (label.method, label.annotator) == ("file", "p1")


def test_one_may_be_taken_for_one_object_even_where_they_agree(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {"can": shifted("can", 2.0)})
    result = merge(a, b, take={"can": "B"})
    np.testing.assert_allclose(pose_of(result, "can").t, shifted("can", 2.0).t, atol=1e-12)
    assert note_of(result, "can") == "taken from B, as asked"


def test_what_only_one_labelled_is_open_unless_asked_for(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A", {k: TRUE_POSES[k] for k in ("wedge", "can")})
    b = write_annotator(tmp_path / "B", {k: TRUE_POSES[k] for k in ("wedge", "tile")})
    assert outcomes(merge(a, b)) == {"wedge": "merged", "can": "open", "tile": "open"}
    assert note_of(merge(a, b), "tile") == "labelled by B only"
    assert set(outcomes(merge(a, b, single=True)).values()) == {"merged", "taken"}
    preferred = outcomes(merge(a, b, prefer="A"))
    assert preferred == {"wedge": "merged", "can": "taken", "tile": "open"}


def test_three_must_all_agree_unless_the_majority_is_asked(tmp_path: Path) -> None:
    changes = [{}, {"wedge": shifted("wedge", 12.0)}, {"wedge": shifted("wedge", 2.0)}]
    scenes = annotators(tmp_path, *changes)
    assert outcomes(merge(*scenes))["wedge"] == "open"
    result = merge(*scenes, majority=True)
    assert outcomes(result)["wedge"] == "merged"
    np.testing.assert_allclose(pose_of(result, "wedge").t, shifted("wedge", 1.0).t, atol=1e-12)
    assert note_of(result, "wedge").startswith("outvoted: B (")
    label = result.objects[0].label
    assert label is not None and label.annotator == "p0, p2"


def test_a_chain_of_three_has_no_majority(tmp_path: Path) -> None:
    # A agrees with B and B with C, but A does not with C: two pairs, neither the better one.
    scenes = annotators(
        tmp_path,
        {},
        {"wedge": shifted("wedge", 4.0)},
        {"wedge": shifted("wedge", 8.0)},
    )
    assert outcomes(merge(*scenes, majority=True))["wedge"] == "open"


def test_the_mean_of_three_is_that_of_all(tmp_path: Path) -> None:
    scenes = annotators(
        tmp_path,
        {},
        {"wedge": shifted("wedge", 3.0)},
        {"wedge": shifted("wedge", 0.0, 3.0)},
    )
    result = merge(*scenes)
    np.testing.assert_allclose(pose_of(result, "wedge").t, shifted("wedge", 1.0, 1.0).t, atol=1e-12)


def test_covariances_of_refined_labels_are_the_weights(tmp_path: Path) -> None:
    scenes = annotators(tmp_path, {}, {"wedge": shifted("wedge", 4.0)})
    for scene, variance in zip(scenes, (1e-6, 3e-6), strict=True):
        label = scene.labels.labels[0]
        covariance = (np.eye(6) * variance).ravel().tolist()
        scene.save_labels(
            scene.labels.with_label(
                msgspec.structs.replace(label, covariance=covariance, refined=True)
            )
        )
    result = merge(*scenes)
    np.testing.assert_allclose(pose_of(result, "wedge").t, shifted("wedge", 1.0).t, atol=1e-9)
    label = result.objects[0].label
    assert label is not None and label.refined and label.covariance is not None


# --- worlds and frames ----------------------------------------------------------------------------


def test_the_labels_come_into_the_world_of_the_first(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A")
    move = SE3.exp([1.0, 0.2, -0.5, 0.4, 2.0, 0.3])
    poses = {**TRUE_POSES, "wedge": shifted("wedge", 4.0)}
    b = write_annotator(tmp_path / "B", poses, T_new_old=move, frame=3)
    result = merge(a, b)
    np.testing.assert_allclose(pose_of(result, "wedge").t, shifted("wedge", 2.0).t, atol=1e-10)
    turned_round = merge(b, a)
    expected = move @ shifted("wedge", 2.0)
    np.testing.assert_allclose(
        pose_of(turned_round, "wedge").matrix(), expected.matrix(), atol=1e-10
    )
    label = turned_round.objects[0].label
    assert label is not None and label.frame == 3


def test_unpropagated_labels_stay_unpropagated(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A", propagated=False)
    b = write_annotator(
        tmp_path / "B", {**TRUE_POSES, "can": shifted("can", 2.0)}, propagated=False
    )
    scene = write_scene(merge(a, b), tmp_path / "C")
    assert all(x.T_world_obj is None for x in scene.labels.labels)
    propagate_labels(scene)
    T = scene.T_world_obj(2)
    assert T is not None
    np.testing.assert_allclose(T.t, shifted("can", 1.0).t, atol=1e-12)


def test_without_camera_poses_every_common_annotated_frame_gets_its_mean(tmp_path: Path) -> None:
    def views(x_mm: float) -> dict[str, dict[int, SE3]]:
        moved = shifted("wedge", x_mm)
        return {"wedge": {f: camera_pose(f).inverse() @ moved for f in (1, 2)}}

    a = write_annotator(tmp_path / "A", posed=False, views=views(0.0))
    poses = {**TRUE_POSES, "wedge": shifted("wedge", 4.0)}
    b = write_annotator(tmp_path / "B", poses, posed=False, views=views(4.0))
    label = merge(a, b).objects[0].label
    assert label is not None and label.T_world_obj is None
    assert label.frame == 0 and set(label.views) == {"1", "2"}
    expected = camera_pose(1).inverse() @ shifted("wedge", 2.0)
    np.testing.assert_allclose(
        SE3.from_matrix(label.views["1"]).matrix(), expected.matrix(), atol=1e-12
    )


def test_labels_that_never_meet_stay_open(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A", posed=False, frame=0)
    b = write_annotator(tmp_path / "B", posed=False, frame=1)
    result = merge(a, b)
    assert set(outcomes(result).values()) == {"open"}
    assert "no frame in which both have a pose" in note_of(result, "can")
    # Either one can still be taken.
    assert outcomes(merge(a, b, take={"can": "B"}))["can"] == "taken"


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"prefer": "C"}, r"--prefer: no such annotator .*A to B"),
        ({"take": {"can": "Z"}}, r"--take can: no such annotator"),
        ({"take": {"spoon": "A"}}, r"no such labelled object .*known: can, tile, wedge"),
        ({"threshold_mm": -1.0}, r"threshold_mm: must be above 0"),
        ({"threshold_mm": float("nan")}, r"threshold_mm: must be above 0"),
    ],
)
def test_options_that_name_nothing_are_refused(
    tmp_path: Path, options: dict[str, object], message: str
) -> None:
    a, b = annotators(tmp_path, {}, {})
    with pytest.raises(ToolkitError, match=message):
        merge(a, b, **options)


def test_taking_what_somebody_did_not_label_is_refused(tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "A")
    b = write_annotator(tmp_path / "B", {"wedge": TRUE_POSES["wedge"]})
    with pytest.raises(ToolkitError, match=r"B did not label it.*labelled by A"):
        merge(a, b, take={"can": "B"})


def test_scenes_of_other_recordings_and_the_same_twice_are_refused(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {})
    other = write_annotator(tmp_path / "other", seed=5)
    with pytest.raises(ToolkitError, match="not the same recording"):
        merge(a, other)
    with pytest.raises(ToolkitError, match="the same folder"):
        merge(a, Scene.open(a.root))
    with pytest.raises(ToolkitError, match="given twice"):
        merge(a, b, Scene.open(b.root))
    with pytest.raises(ToolkitError, match="two to 26"):
        merge(a)


def test_scenes_without_any_label_are_refused(tmp_path: Path) -> None:
    a, b = write_annotator(tmp_path / "A", {}), write_annotator(tmp_path / "B", {})
    with pytest.raises(ToolkitError, match="none of the scenes has labels"):
        merge(a, b)
