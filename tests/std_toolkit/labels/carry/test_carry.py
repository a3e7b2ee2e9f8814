"""Poses carried over between two recordings of one table, by each way, and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

from std_toolkit.checks.check_step import run_check
from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.jobs import JobOptions
from std_toolkit.labels.carry.carry_step import CarryPlan, carry_labels
from std_toolkit.labels.carry.options import CarryOptions
from std_toolkit.labels.carry.shared_features import shared_features
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.scene import Labels, ObjectAnnotation, ObjectTable, Scene
from std_toolkit.scene.label_verdicts import label_verdicts
from tests import carried_scenes as made
from tests.scene_on_disk import contents

# Corners and edges of prints on the table, metres, table frame; visible in both recordings.
MARKS = np.array([[-0.2, -0.1, 0], [0.22, -0.12, 0], [0.02, 0.2, 0], [0.0, -0.2, 0]])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scenes `a`, labelled, and `b` in another world, both with a board."""
    root = tmp_path_factory.mktemp("table")
    texture = made.with_board(made.table())
    made.write_table_scene(root / "a", texture=texture, labelled=True)
    made.write_table_scene(root / "b", made.SECOND, T_world_table=made.ELSEWHERE, texture=texture)
    made.write_board(root / "b/board.json")
    return root


@pytest.fixture
def root(recorded: Path, tmp_path: Path) -> Path:
    shutil.copytree(recorded, tmp_path / "scenes")
    return tmp_path / "scenes"


def carry(root: Path, **options: object) -> CarryPlan:
    return carry_labels(
        Scene.open(root / "b"), Scene.open(root / "a"), CarryOptions(**options), annotator="ben"
    )


def write_points(path: Path, root: Path, marks: np.ndarray, noise_px: float = 0.0) -> Path:
    """The pixels of marks in frame 2 of A and 3 of B."""
    rng = np.random.default_rng(1)
    pixels = [
        made.CAMERA.project(T.inverse() @ marks) + rng.normal(0, noise_px, (len(marks), 2))
        for T in (made.FIRST[2], made.SECOND[3])
    ]
    rows = ["from_frame,from_u,from_v,to_frame,to_u,to_v"]
    rows += [
        f"000002.png,{a[0]:.2f},{a[1]:.2f},000003,{b[0]:.2f},{b[1]:.2f}"
        for a, b in zip(*pixels, strict=True)
    ]
    path.write_text("\n".join(rows) + "\n")
    return path


def test_by_the_board(root: Path) -> None:
    plan = carry(root)
    assert plan.relation.by == "board"
    assert plan.relation.count == 48
    assert plan.relation.residual_mm < 0.5
    scene = Scene.open(root / "b")
    errors = made.errors_of(scene, made.SECOND)
    assert len(errors) == 2
    assert errors[:, 0].max() < 0.5
    assert errors[:, 1].max() < 0.1


def test_labels_say_where_they_are_from_and_have_no_verdict(root: Path) -> None:
    carry(root)
    scene = Scene.open(root / "b")
    assert [(o.id, o.name, o.material) for o in scene.objects.objects] == [
        (1, "box_a", "raw"),
        (2, "box_b", "raw"),
    ]
    for label in scene.labels.labels:
        assert label.method == "carry:board"
        assert label.annotator == "ben"
        assert label.T_world_obj is None
        assert label.judgement is msgspec.UNSET
        assert label.provenance.refinement.startswith("carried over from a by the board: 48 cor")
    propagate_labels(scene)
    assert [v.grade for v in label_verdicts(Scene.open(root / "b"))] == ["unknown", "unknown"]


def test_by_points_of_a_person(root: Path) -> None:
    points = write_points(root / "points.csv", root, MARKS, noise_px=1.0)
    plan = carry(root, points=points)
    assert plan.relation.sentence().startswith("by given points: 4 points, residual")
    errors = made.errors_of(Scene.open(root / "b"), made.SECOND)
    assert errors[:, 0].max() < 6
    assert errors[:, 1].max() < 1.5


def test_points_as_places(root: Path) -> None:
    rows = [
        {f"{side}_{axis}": float(x) for side, p in pair for axis, x in zip("xyz", p, strict=True)}
        for pair in ((("from", p), ("to", made.ELSEWHERE @ p)) for p in MARKS[:3])
    ]
    (root / "points.json").write_bytes(msgspec.json.encode(rows))
    carry(root, points=root / "points.json")
    assert made.errors_of(Scene.open(root / "b"), made.SECOND).max() < 1e-3


@pytest.mark.slow
def test_by_features(root: Path) -> None:
    plan = carry(root, by="features")
    assert plan.relation.count > 300
    assert plan.relation.residual_mm < 4
    errors = made.errors_of(Scene.open(root / "b"), made.SECOND)
    assert len(errors) == 2
    assert errors[:, 0].max() < 1
    assert errors[:, 1].max() < 0.2


@pytest.mark.slow
def test_one_frame_has_its_places_from_the_depth(tmp_path: Path) -> None:
    made.write_table_scene(tmp_path / "a", labelled=True)
    world = made.ELSEWHERE
    made.write_table_scene(tmp_path / "b", made.SECOND, T_world_table=world, registered=[3])
    carry(tmp_path)
    scene = Scene.open(tmp_path / "b")
    assert {x.frame for x in scene.labels.labels} == {3}
    assert made.errors_of(scene, made.SECOND)[:, 0].max() < 2
    made.write_table_scene(tmp_path / "c", made.SECOND, registered=[3], depth=False)
    with pytest.raises(ToolkitError, match="too few can be triangulated, and there is no depth"):
        carry_labels(Scene.open(tmp_path / "c"), Scene.open(tmp_path / "a"))


@pytest.mark.slow
def test_other_table_and_repeated_pattern_are_refused(root: Path) -> None:
    textures = {"other": made.table(9), "plain": made.plain()}
    for name, texture in textures.items():
        made.write_table_scene(root / name, made.SECOND, texture=texture, boxes={})
        with pytest.raises(ToolkitError, match=r"cannot be related|are not known"):
            carry_labels(Scene.open(root / name), Scene.open(root / "a"))
    tiles = made.table(2, period=120)
    made.write_table_scene(root / "t1", texture=tiles, labelled=True)
    made.write_table_scene(root / "t2", made.SECOND, texture=tiles, boxes={})
    with pytest.raises(ToolkitError, match="cannot be related"):
        carry_labels(Scene.open(root / "t2"), Scene.open(root / "t1"))


@pytest.mark.slow
def test_tags_are_matched_by_their_ids(root: Path) -> None:
    """The corners of one tag look like those of another: only the ids tell them apart."""
    for name, cameras in (("p1", made.FIRST), ("p2", made.SECOND)):
        made.write_table_scene(
            root / name,
            cameras,
            texture=made.with_board(made.plain()),
            boxes=made.BOXES if name == "p1" else {},
            labelled=name == "p1",
        )
    board = made.write_board(root / "board.json")
    source = Scene.open(root / "p1")
    carry_labels(Scene.open(root / "p2"), source, CarryOptions(board=board))
    assert made.errors_of(Scene.open(root / "p2"), made.SECOND)[:, 0].max() < 0.5
    by_features = shared_features(source, Scene.open(root / "p2"), check=lambda: None)
    wrong = np.linalg.norm(by_features.a - by_features.b, axis=1) > 0.01
    assert wrong.any()
    try:
        options = CarryOptions(by="features", overwrite=True)
        carry_labels(Scene.open(root / "p2"), source, options)
    except ToolkitError as error:
        assert "cannot be related" in str(error)
    else:
        assert made.errors_of(Scene.open(root / "p2"), made.SECOND)[:, 0].max() < 2


@pytest.mark.long
def test_object_that_was_moved_meanwhile_is_not_right(tmp_path: Path) -> None:
    """The table relates the scenes; the judge finds which object stands elsewhere."""
    moved = {**made.BOXES, "box_b": made.standing(0.14, 0.0, -0.3)}
    texture = made.with_board(made.table())
    board = made.write_board(tmp_path / "board.json")
    made.write_table_scene(tmp_path / "a", texture=texture, labelled=True)
    scene = made.write_table_scene(tmp_path / "b", made.SECOND, texture=texture, boxes=moved)
    carry_labels(scene, Scene.open(tmp_path / "a"), CarryOptions(board=board))
    propagate_labels(scene)
    run_check(scene, jobs=JobOptions(engine="serial", progress=False))
    grades = {v.name: v.grade for v in label_verdicts(Scene.open(tmp_path / "b"))}
    assert grades["box_a"] == "fits"
    assert grades["box_b"] in ("wrong", "doubtful")


# --- what is carried ------------------------------------------------------------------------------


def test_what_is_here_is_kept_unless_asked(root: Path) -> None:
    carry(root, objects=("box_a",))
    scene = Scene.open(root / "b")
    mine = scene.labels.labels[0]
    other = msgspec.structs.replace(
        mine, method="gui", T_cam_obj=SE3.exp([0, 0, 1, 0, 0, 0]).flat()
    )
    scene.save_labels(Labels(labels=[other]))
    scene.save_annotation(
        msgspec.structs.replace(
            scene.annotation, objects=[ObjectAnnotation(object=1, status="done", note="mine")]
        )
    )
    plan = carry(root)
    assert plan.left_out == (("box_a", "it has a pose here already"),)
    scene = Scene.open(root / "b")
    assert scene.labels.of(1) == other
    assert scene.annotation.of(1).status == "done"
    carry(root, overwrite=True)
    scene = Scene.open(root / "b")
    assert scene.labels.of(1).T_cam_obj == mine.T_cam_obj
    assert (scene.annotation.of(1).status, scene.annotation.of(1).note) == ("open", "mine")
    with pytest.raises(ToolkitError, match="nothing to carry over: box_a: it has a pose here"):
        carry(root)


def test_objects_of_one_mesh_are_interchangeable(root: Path) -> None:
    carry(root)
    scene = Scene.open(root / "b")
    rows = [msgspec.structs.replace(o, name=f"product_{o.id}") for o in scene.objects.objects]
    scene.save_objects(ObjectTable(models=scene.objects.models, objects=rows))
    scene.save_labels(Labels())
    plan = carry(root)
    assert [(i.source.name, i.name) for i in plan.objects] == [
        ("box_a", "product_1"),
        ("box_b", "product_2"),
    ]
    assert len(Scene.open(root / "b").objects.objects) == 2


def test_namesake_with_another_mesh_is_left_out(root: Path) -> None:
    carry(root)
    scene = Scene.open(root / "b")
    rows = [
        msgspec.structs.replace(o, model="box_b") if o.name == "box_a" else o
        for o in scene.objects.objects
    ]
    scene.save_objects(ObjectTable(models=scene.objects.models, objects=rows))
    scene.save_labels(Labels())
    plan = carry(root)
    assert plan.left_out == (("box_a", "it has another mesh here (box_b)"),)
    assert [i.name for i in plan.objects] == ["box_b"]


# --- errors ---------------------------------------------------------------------------------------


def test_one_line_of_what_is_missing(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made.write_table_scene(root / "c", made.SECOND[:2], boxes={})
    shutil.copytree(root / "c", root / "d")
    (root / "d/poses.json").unlink()
    before = contents(root)
    cases = {
        "b --from b": "a scene cannot be carried over to itself",
        "d --from c": "the two scenes are one recording",
        "b --from c": "no object is labelled there",
        "d --from a": "the scene has no camera poses",
        "b --from nowhere": "no scene here",
        "b --from a --objects cup": "no such object",
        "b --from a --by points": "--by points needs --points FILE",
        "b --from a --points b/board.json": "must be a list of objects",
        "b --from a --board a/scene.json": "the board has no tags",
    }
    for words, problem in cases.items():
        arguments = [str(root / w) if (root / w).exists() else w for w in words.split()]
        status = main(["carry", *arguments])
        told = capsys.readouterr().err.strip().splitlines()
        assert status in (1, 2), words
        assert len([line for line in told if line.startswith("error")]) == 1, (words, told)
        assert problem in told[-1] or problem in told[0], (words, told)
    assert contents(root) == before


def test_meshes_in_common(root: Path) -> None:
    made.write_table_scene(
        root / "c", made.SECOND, texture=made.with_board(made.table()), labelled=True,
        boxes={"cup": made.standing(0, 0, 0)},
    )  # fmt: skip
    shutil.copyfile(root / "b/board.json", root / "c/board.json")
    target = Scene.open(root / "c")
    with pytest.raises(ToolkitError, match="no mesh in common") as told:
        carry_labels(target, Scene.open(root / "a"))
    assert "--objects (box_a, box_b)" in str(told.value.hint)
    plan = carry_labels(target, Scene.open(root / "a"), CarryOptions(objects=("box_a",)))
    assert [i.name for i in plan.objects] == ["box_a"]
    assert [o.id for o in Scene.open(root / "c").objects.objects] == [1, 2]


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ("000002,60,300,000003,60,300\n" * 2, "2 points, three or more"),
        ("000002,60,300,000003,900,10\n" * 3, r"row 2\.to_u: .*outside the 480x360 image"),
        ("000002,x,10,000003,10,10\n" * 3, r"row 2\.from_u: .*not a number"),
        ("000042,10,10,000003,10,10\n" * 3, "no such frame"),
        ("000002,240,4,000003,10,10\n" * 3, "no smooth surface here"),
        (",10,10,000003,10,10\n" * 3, r"row 2\.from_frame: a key is missing"),
    ],
)
def test_wrong_files_of_points(root: Path, rows: str, problem: str) -> None:
    path = root / "points.csv"
    path.write_text("from_frame,from_u,from_v,to_frame,to_u,to_v\n" + rows)
    with pytest.raises(ToolkitError, match=problem) as told:
        carry(root, points=path)
    assert str(told.value.path) == str(path)


def test_points_near_to_each_other_are_too_few(root: Path) -> None:
    near = 0.06 * (MARKS - [0, -0.2, 0]) + [0, -0.2, 0]
    path = write_points(root / "points.csv", root, near)
    with pytest.raises(ToolkitError, match=r"the place of box_a follows to ± \d+ mm only"):
        carry(root, points=path)
