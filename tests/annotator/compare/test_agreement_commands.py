"""`compare` and `merge` as a user types them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest
from scene_on_disk import contents
from two_annotators import TRUE_POSES, turned_about_centre, write_annotator

from annotator.cli import main
from std_toolkit.geometry import SE3
from std_toolkit.io.images import read_color
from std_toolkit.io.locks import scene_lock
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.scene import Scene
from std_toolkit.scene.judgement import Judgement
from std_toolkit.scene.label_verdicts import judgement_inputs

Run = Callable[..., tuple[int, str]]
Refuse = Callable[..., str]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Exit status and output of a command that works."""

    def run_command(*arguments: object) -> tuple[int, str]:
        capsys.readouterr()
        status = main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        assert "error" not in err, err
        return status, out

    return run_command


@pytest.fixture
def refuse(capsys: pytest.CaptureFixture[str]) -> Refuse:
    """The one line with which a command is refused."""

    def refused(*arguments: object, status: int = 1) -> str:
        capsys.readouterr()
        assert main([str(a) for a in arguments]) == status
        out, err = capsys.readouterr()
        lines = err.splitlines()
        assert len(lines) == 1 and lines[0].startswith("error: "), err
        assert out == ""
        return lines[0]

    return refused


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """Two annotators: the wedge is 12 mm apart, the tile is flipped, the can agrees."""
    T = TRUE_POSES["wedge"]
    moved = {
        **TRUE_POSES,
        "wedge": SE3(T.R, T.t + 0.012 * T.t / np.linalg.norm(T.t)),
        "tile": turned_about_centre(TRUE_POSES["tile"], [np.pi, 0.0, 0.0]),
    }
    write_annotator(tmp_path / "anna", annotator="anna")
    write_annotator(tmp_path / "ben", moved, annotator="ben")
    return tmp_path / "anna", tmp_path / "ben"


def test_compare_lists_what_to_review_first(run: Run, pair: tuple[Path, Path]) -> None:
    before = [contents(p) for p in pair]
    status, out = run("compare", *pair)
    lines = out.splitlines()
    assert status == 1
    assert lines[0] == "to review (above 5 mm, or not comparable):"
    # Half a turn about x moves a corner by the sides across it: 60 and 30 mm.
    assert lines[1] == "  tile: 67.1 mm apart; 180 deg about x: flip?"
    assert lines[2] == "  wedge: 12.0 mm apart; 12.0 mm along the viewing ray (B is farther)"
    assert lines[-1] == ("3 objects compared: MSSD median 12.0 mm, largest 67.1 mm; 2 above 5 mm")
    assert [contents(p) for p in pair] == before


def test_compare_of_equal_labels_succeeds(run: Run, tmp_path: Path) -> None:
    a, b = write_annotator(tmp_path / "a"), write_annotator(tmp_path / "b")
    status, out = run("compare", a.root, b.root)
    assert status == 0
    assert "to review" not in out
    assert out.splitlines()[-1].endswith("largest 0.0 mm; 0 above 5 mm")


def test_compare_tells_what_the_judge_says_of_labels_that_agree(run: Run, tmp_path: Path) -> None:
    """Two annotators may make the same mistake."""
    scenes = [write_annotator(tmp_path / name) for name in ("a", "b")]
    assert "judged" not in run("compare", *(x.root for x in scenes))[1]
    for scene in scenes:
        propagate_labels(scene)
        inputs = judgement_inputs(scene)
        label = next(
            x for x in scene.labels.labels if scene.objects.object(x.object).name == "tile"
        )
        assert label.T_world_obj is not None
        judgement = Judgement(
            grade="wrong",
            probability=0.0,
            reason="turned by 180 deg about x fits the texture better",
            T_obj=label.T_world_obj,
            inputs=inputs[label.object],
            time="2026-01-01T00:00:00Z",
        )
        judged = msgspec.structs.replace(label, judgement=judgement)
        scene.save_labels(scene.labels.with_label(judged))
    status, out = run("compare", *(x.root for x in scenes), "--csv", tmp_path / "table.csv")
    assert status == 0
    assert "A: tile: wrong (0 %): turned by 180 deg about x fits the texture better" in out
    table = pd.read_csv(tmp_path / "table.csv").set_index("object")
    assert list(table.loc["tile", ["judged_a", "judged_b"]]) == ["wrong", "wrong"]
    assert table.loc["can", "judged_a"] == "unknown"


def test_compare_with_another_threshold(run: Run, pair: tuple[Path, Path]) -> None:
    status, out = run("compare", *pair, "--threshold-mm", 15)
    assert status == 1 and "wedge: 12" not in out
    assert run("compare", *pair, "--threshold-mm", 68)[0] == 0


def test_compare_writes_tables_and_a_picture_of_every_disagreement(
    run: Run, pair: tuple[Path, Path], tmp_path: Path
) -> None:
    out = tmp_path / "report"
    run("compare", *pair, "--out", out, "--csv", tmp_path / "table.csv")
    table = pd.read_csv(out / "agreement.csv")
    assert list(table["object"]) == ["tile", "wedge", "can"]
    assert list(table["verdict"]) == ["disagree", "disagree", "agree"]
    assert table["along_ray_mm"][1] == pytest.approx(12.0)
    assert (tmp_path / "table.csv").read_bytes() == (out / "agreement.csv").read_bytes()
    frames = pd.read_csv(out / "frames.csv")
    assert len(frames) == 3 * 5
    document = json.loads((out / "agreement.json").read_text())
    assert document["max_mm"] == pytest.approx(np.hypot(60, 30))
    assert [x["object"] for x in document["objects"]] == ["tile", "wedge", "can"]
    assert sorted(p.name for p in (out / "pictures").iterdir()) == ["tile.png", "wedge.png"]


def test_the_picture_shows_both_outlines_where_the_object_is(
    run: Run, pair: tuple[Path, Path], tmp_path: Path
) -> None:
    from annotator.compare.comparison_report import CAPTION_PX, COLORS, PANEL

    run("compare", *pair, "--out", tmp_path / "report")
    picture = read_color(tmp_path / "report/pictures/wedge.png")
    panel = picture[CAPTION_PX:, : PANEL[0]].astype(int)
    # B is farther away, so its outline lies inside that of A.
    boxes = []
    for color in COLORS:
        rows, columns = np.nonzero(np.abs(panel - color).max(axis=2) < 12)
        boxes.append((columns.min(), rows.min(), columns.max(), rows.max()))
    (ax0, ay0, ax1, ay1), (bx0, by0, bx1, by1) = boxes
    assert ax0 < bx0 < bx1 < ax1
    assert ay0 < by0 < by1 < ay1
    # As much smaller as it is farther: 12 mm of 710 mm.
    distance = float(np.linalg.norm(TRUE_POSES["wedge"].t))
    assert (bx1 - bx0) / (ax1 - ax0) == pytest.approx(distance / (distance + 0.012), abs=0.008)


def test_not_comparable_objects_are_told_and_written_as_null(run: Run, tmp_path: Path) -> None:
    a = write_annotator(tmp_path / "a", posed=False, frame=0)
    b = write_annotator(tmp_path / "b", posed=False, frame=1)
    status, out = run("compare", a.root, b.root, "--out", tmp_path / "report")
    assert status == 1
    assert "wedge: no frame in which both have a pose" in out
    assert out.splitlines()[-2] == "no object could be compared"
    document = json.loads((tmp_path / "report/agreement.json").read_text())
    assert document["median_mm"] is None
    assert not (tmp_path / "report/pictures").exists()


def test_merge_makes_a_scene_and_leaves_disagreements_open(
    run: Run, pair: tuple[Path, Path], tmp_path: Path
) -> None:
    before = [contents(p) for p in pair]
    status, out = run("merge", *pair, "--out", tmp_path / "merged")
    assert status == 1
    assert "left open, without a label:" in out
    assert out.splitlines()[-1] == f"{tmp_path / 'merged'}: 1 of 3 objects labelled"
    merged = Scene.open(tmp_path / "merged")
    assert [merged.objects.object(x.object).name for x in merged.labels.labels] == ["can"]
    assert [contents(p) for p in pair] == before


def test_merge_with_all_decided_succeeds(run: Run, pair: tuple[Path, Path], tmp_path: Path) -> None:
    status, _ = run(
        "merge", *pair, "--out", tmp_path / "merged", "--take", "tile=A", "--prefer", "B"
    )
    assert status == 0
    labels = Scene.open(tmp_path / "merged").labels.labels
    assert [x.annotator for x in labels] == ["ben", "anna, ben", "anna"]


def test_merge_into_a_scene(
    run: Run, refuse: Refuse, pair: tuple[Path, Path], tmp_path: Path
) -> None:
    target = write_annotator(tmp_path / "target", {})
    run("merge", *pair, "--into", target.root, "--prefer", "A")
    assert len(Scene.open(target.root).labels.labels) == 3
    assert "has labels already" in refuse("merge", *pair, "--into", target.root)
    assert run("merge", *pair, "--into", target.root, "--overwrite", "--prefer", "A")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--take", "mug"], "--take: expected NAME=VALUE"),
        (["--take", "=A"], "--take: expected NAME=VALUE"),
        (["--take", "can=A", "--take", "can=B"], "given twice"),
        (["--overwrite"], "--overwrite needs --into"),
        (["--threshold-mm", "0"], "--threshold-mm: must be above 0"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(
    refuse: Refuse, pair: tuple[Path, Path], tmp_path: Path, arguments: list[str], message: str
) -> None:
    told = refuse("merge", *pair, "--out", tmp_path / "merged", *arguments, status=2)
    assert message in told
    assert not (tmp_path / "merged").exists()


def test_a_folder_in_use_is_refused_before_the_work(
    refuse: Refuse, pair: tuple[Path, Path], tmp_path: Path
) -> None:
    (tmp_path / "merged").mkdir()
    (tmp_path / "merged/notes.txt").write_text("mine")
    assert "the folder is not empty" in refuse("merge", *pair, "--out", tmp_path / "merged")
    assert (tmp_path / "merged/notes.txt").read_text() == "mine"


def test_what_is_no_scene_is_refused(
    refuse: Refuse, pair: tuple[Path, Path], tmp_path: Path
) -> None:
    assert "no scene here" in refuse("compare", pair[0], tmp_path / "nowhere")
    assert "no scene here" in refuse("merge", *pair, "--into", tmp_path / "nowhere")


def test_a_target_in_use_is_refused(
    refuse: Refuse, pair: tuple[Path, Path], tmp_path: Path
) -> None:
    target = write_annotator(tmp_path / "target", {})
    with scene_lock(target.root):
        line = refuse("merge", *pair, "--into", target.root)
    assert "another process is writing to this scene" in line and "pid" in line
