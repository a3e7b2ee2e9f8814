"""What a merge writes: a new scene, or labels into another one; the merged ones stay untouched."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from scene_on_disk import contents
from two_annotators import (
    MESHES,
    TRUE_POSES,
    annotators,
    merge,
    shifted,
    write_annotator,
)

from annotator.compare import write_into, write_scene
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.documents import read_document
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.scene import CameraPoses, Scene
from std_toolkit.scene.model import Annotation, ClickedPoint, ObjectAnnotation


def test_the_new_scene_is_a_whole_copy_and_the_others_are_untouched(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {"wedge": shifted("wedge", 12.0)})
    before = contents(a.root), contents(b.root)
    scene = write_scene(merge(a, b), tmp_path / "C")
    assert (contents(a.root), contents(b.root)) == before
    assert [scene.objects.object(x.object).name for x in scene.labels.labels] == ["can", "tile"]
    assert scene.annotation.of(1).status == "open"
    assert scene.poses == a.poses
    for frame in scene.frames:
        copied, source = scene.color_path(frame), a.color_path(frame)
        assert copied.read_bytes() == source.read_bytes()
        assert copied.stat().st_ino != source.stat().st_ino
        assert not copied.is_symlink()
    # It is a scene like any other: the next step works.
    propagate_labels(scene)


def test_linked_images_are_copied_as_files(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {})
    image = a.color_path(a.frames[0])
    elsewhere = image.rename(tmp_path / "elsewhere.png")
    image.symlink_to(elsewhere)
    scene = write_scene(merge(a, b), tmp_path / "C")
    copied = scene.color_path(scene.frames[0])
    assert not copied.is_symlink()
    assert copied.read_bytes() == elsewhere.read_bytes()


def test_what_follows_from_labels_is_not_copied(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {})
    for name in ("gt/info/000000.json", "check/report.html", ".std/records/propagate.json"):
        (a.root / name).parent.mkdir(parents=True, exist_ok=True)
        (a.root / name).write_text("{}")
    (a.root / "poses/sparse").mkdir(parents=True)
    (a.root / "poses/sparse/cameras.bin").write_bytes(b"model")
    (a.root / ".std/records/poses.json").write_text("{}")
    scene = write_scene(merge(a, b), tmp_path / "C")
    assert not (scene.root / "gt").exists() and not (scene.root / "check").exists()
    assert (scene.root / "poses/sparse/cameras.bin").read_bytes() == b"model"
    # With its record, the step that made the camera poses is not done again.
    assert [p.name for p in (scene.root / ".std/records").iterdir()] == ["poses.json"]


def test_done_is_what_all_had_marked_as_done(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {})
    for scene, done in ((a, (1, 2)), (b, (1,))):
        rows = [ObjectAnnotation(object=i, status="done") for i in done]
        scene.save_annotation(Annotation(objects=rows))
    b.save_annotation(
        Annotation(
            objects=[
                ObjectAnnotation(object=1, status="done"),
                ObjectAnnotation(object=3, note="handle hidden"),
            ]
        )
    )
    annotation = merge(Scene.open(a.root), Scene.open(b.root)).annotation()
    assert [annotation.of(i).status for i in (1, 2, 3)] == ["done", "open", "open"]
    assert annotation.of(3).note == "B: handle hidden"


def test_an_object_that_the_first_does_not_know_comes_with_its_mesh(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {})
    labels = [x for x in a.labels.labels if x.object != 3]
    a.save_labels(msgspec.structs.replace(a.labels, labels=labels))
    table = msgspec.structs.replace(
        a.objects,
        objects=[o for o in a.objects.objects if o.id != 3],
        models=[m for m in a.objects.models if m.id != "tile"],
    )
    a.save_objects(table)
    scene = write_scene(merge(Scene.open(a.root), b, single=True), tmp_path / "C")
    added = scene.objects.object_named("tile")
    assert (added.id, added.model) == (3, "tile")
    np.testing.assert_allclose(scene.mesh("tile").extents, MESHES["tile"].extents)
    assert scene.labels.of(3) is not None


def test_another_mesh_of_the_same_id_gets_an_id_of_its_own(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {})
    # In A the tile is gone, and another mesh has its id.
    a.save_labels(
        msgspec.structs.replace(a.labels, labels=[x for x in a.labels.labels if x.object != 3])
    )
    a.save_objects(
        msgspec.structs.replace(a.objects, objects=[o for o in a.objects.objects if o.id != 3])
    )
    MESHES["wedge"].export(a.root / "models/tile/tile.ply")
    scene = write_scene(merge(Scene.open(a.root), b, single=True), tmp_path / "C")
    assert scene.objects.object_named("tile").model == "tile_B"
    np.testing.assert_allclose(scene.mesh("tile_B").extents, MESHES["tile"].extents)
    np.testing.assert_allclose(scene.mesh("tile").extents, MESHES["wedge"].extents)


def test_labels_can_go_into_a_third_scene_of_the_recording(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {"wedge": shifted("wedge", 4.0)})
    move = SE3.exp([0.1, 0.0, 0.3, 0.0, 1.0, 0.0])
    target = write_annotator(tmp_path / "T", {}, T_new_old=move)
    images = {k: v for k, v in contents(target.root).items() if not k.endswith(".json")}
    written = write_into(merge(a, b, target=target))
    T = written.T_world_obj(1)
    assert T is not None
    np.testing.assert_allclose(T.matrix(), (move @ shifted("wedge", 2.0)).matrix(), atol=1e-10)
    after = contents(target.root)
    assert {k: after[k] for k in images} == images


def test_labels_that_are_there_are_replaced_only_when_asked(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {})
    target = write_annotator(tmp_path / "T")
    before = contents(target.root)
    with pytest.raises(ToolkitError, match="has labels already"):
        write_into(merge(a, b, target=target))
    assert contents(target.root) == before
    write_into(merge(a, b, target=target), overwrite=True)
    assert {x.method for x in Scene.open(target.root).labels.labels} == {"merge"}


def test_clicks_and_notes_of_the_target_stay(tmp_path: Path) -> None:
    """They are work of a person, and no part of what is replaced."""
    can = {"can": TRUE_POSES["can"]}
    a, b = (write_annotator(tmp_path / name, can) for name in "AB")
    target = write_annotator(tmp_path / "T", {})
    click = ClickedPoint(frame=1, u=12.5, v=7.25, point=[0.0, 0.01, 0.02])
    rows = [
        ObjectAnnotation(object=i, note=f"look at {i}", clicks=[click], status="done")
        for i in (1, 2)
    ]
    target.save_annotation(Annotation(objects=rows))
    for overwrite in (False, True):
        write_into(merge(a, b, target=Scene.open(target.root)), overwrite=overwrite)
        after = Scene.open(target.root).annotation
        assert [after.of(i).clicks for i in (1, 2)] == [[click], [click]]
        assert [after.of(i).note for i in (1, 2)] == ["look at 1", "look at 2"]
        # Nobody has looked at what was merged.
        assert [after.of(i).status for i in (1, 2)] == ["open", "open"]


def test_a_target_that_changed_meanwhile_is_left_alone(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {})
    target = write_annotator(tmp_path / "T", {})
    result = merge(a, b, target=target)
    other = Scene.open(target.root)
    assert other.poses is not None
    other.save_poses(msgspec.structs.replace(other.poses, notes=["adjusted again"]))
    with pytest.raises(ToolkitError, match="was changed meanwhile"):
        write_into(result)
    assert read_document(target.root / "poses.json", CameraPoses).notes == ["adjusted again"]
    assert Scene.open(target.root).labels.labels == []


def test_one_of_the_annotators_is_never_written_to(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {})
    before = contents(a.root)
    with pytest.raises(ToolkitError, match="cannot replace those of one of the annotators"):
        write_into(merge(a, b, target=a), overwrite=True)
    with pytest.raises(ToolkitError, match="cannot be inside another scene"):
        write_scene(merge(a, b), a.root / "merged")
    assert contents(a.root) == before


def test_a_failed_copy_leaves_nothing_behind(tmp_path: Path) -> None:
    a, b = annotators(tmp_path, {}, {})
    result = merge(a, b)
    a.color_path(a.frames[4]).unlink()
    with pytest.raises(ToolkitError, match=r"000004\.png"):
        write_scene(result, tmp_path / "C")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["A", "B"]
