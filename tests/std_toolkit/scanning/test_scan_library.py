"""All objects of a recording: told apart, picked, scanned one by one, and what a failure leaves."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("manifold3d")

from std_toolkit.cli.scanning import main
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document
from std_toolkit.io.images import read_color
from std_toolkit.jobs import JobOptions
from std_toolkit.poses.board_sheet import write_board_pdf
from std_toolkit.scanning import library, scan_step
from std_toolkit.scanning.board.tags_through import tags_at_place
from std_toolkit.scanning.clock import Clock
from std_toolkit.scanning.library import Library, scan_all
from std_toolkit.scanning.masks import standing
from std_toolkit.scanning.masks.candidates import Candidate
from std_toolkit.scanning.masks.object_masks import Things
from std_toolkit.scanning.masks.outlines import best_photos
from std_toolkit.scanning.masks.standing import choose_candidate, find_standing
from std_toolkit.scanning.options import ScanOptions
from std_toolkit.scanning.photos.photos import Photos
from std_toolkit.scanning.photos.posed_photos import PosedPhotos
from tests.std_toolkit.scanning.boxes import BOXES, CORNERS, photos_of_boxes


def posed_boxes(folder: Path) -> PosedPhotos:
    views = photos_of_boxes()
    paths = tuple(folder / v.name for v in views)
    return PosedPhotos(
        views=views, corners=CORNERS, points=np.zeros((0, 3)), on_table=True, facts={},
        warnings=[], digest="boxes", photos=Photos(paths, paths, (240, 180), 1.0),
    )  # fmt: skip


@pytest.mark.slow
def test_two_boxes_are_told_apart_and_each_pick_chooses_its_own() -> None:
    views = photos_of_boxes()
    found = find_standing(views, CORNERS, np.zeros((0, 3)), threads=1).candidates
    assert len(found) == 2
    for candidate, (low, high) in zip(found, BOXES, strict=True):
        assert np.allclose(
            (candidate.low + candidate.high)[:2] / 2, (low + high)[:2] / 2, atol=0.01
        )
    for n, shown in enumerate(best_photos(found, views)):
        assert choose_candidate(found, views, pick=shown.pick)[1] == n
        # The outline is that of the box, not of a part of the photo.
        middle, _ = views[shown.photo].project(np.array([sum(BOXES[n]) / 2]))
        assert shown.mask[tuple(np.rint(middle[0, ::-1]).astype(int))]
        assert shown.mask.mean() < 0.15
    with pytest.raises(ToolkitError, match="2 objects stand on the board"):
        choose_candidate(found, views)


@pytest.mark.slow
def test_what_stands_out_and_is_left_out_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Photos show the table through the smaller box, as through a cap of the colour of tags."""
    small = float(np.prod(BOXES[1][1] - BOXES[1][0]))
    monkeypatch.setattr(standing, "_hides", lambda c, *_: c.volume > 2 * small)
    things = Things(posed_boxes(tmp_path), 1)
    (left_out,) = things.standing.left_out
    assert np.allclose((left_out.low + left_out.high)[:2] / 2, [0.07, 0.0], atol=0.01)
    with caplog.at_level(logging.WARNING, "std_toolkit"):
        things.draw(tmp_path / "candidates.jpg")
    assert "stand out and are not scanned: 1. Photos show the table" in caplog.text
    # One picture of each.
    assert read_color(tmp_path / "candidates.jpg").shape[1] == 2 * 480


@pytest.mark.slow
def test_features_are_the_object_where_a_box_limits_them() -> None:
    views = photos_of_boxes()
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(low, high, (400, 3)) for low, high in BOXES])
    found = find_standing(views, CORNERS, points, threads=1).candidates
    assert [len(c.points) > 300 for c in found if c.points is not None] == [True, True]
    uv, _ = views[0].project(np.array(BOXES[1]))
    around = *(uv.min(axis=0) - 25), *(uv.max(axis=0) + 25)
    limited, chosen = choose_candidate(found, views, box=(0, *around))
    assert np.allclose(limited[chosen].high, BOXES[1][1], atol=0.01)


def test_features_above_one_place_are_one_object() -> None:
    """A lone bottle has a label below and one above: objects do not stand in one another."""
    rng = np.random.default_rng(0)
    low, high = np.array([-0.03, -0.03, 0.0]), np.array([0.03, 0.03, 0.03])
    bottle = [rng.uniform(low, high, (300, 3)) + np.array([0, 0, z]) for z in (0.01, 0.12)]
    beside = rng.uniform(low, high, (300, 3)) + np.array([0.1, 0, 0.01])
    found = standing._clusters(np.concatenate([*bottle, beside]))
    assert sorted(len(c.points) > 400 for c in found if c.points is not None) == [False, True]
    assert max(c.high[2] for c in found) > 0.14


def test_tags_that_photos_show_are_no_object() -> None:
    views = photos_of_boxes(4)
    half = 0.015
    tag = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    bare, beside = tag + np.array([0, 0.1, 0]), tag - np.array([0, 0.1, 0])
    found = {v.name: np.concatenate([v.project(bare)[0], v.project(beside)[0] + np.array([0, 4])])
             for v in views}  # fmt: skip
    quads = tags_at_place(views, found, {0: bare, 1: beside})
    # The second lies four pixels from its place: something refracts it, or it is misread.
    assert [len(q) for q in quads.values()] == [1, 1, 1, 1]
    middles = standing._on_table(views, quads)
    # The middle of four pixels is not quite that of the tag.
    assert np.allclose(middles, [0.0, 0.1], atol=0.002)

    def candidate(x: float, y: float) -> Candidate:
        low, high = np.array([x - 0.03, y - 0.03, 0]), np.array([x + 0.03, y + 0.03, 0.05])
        return Candidate(low, high, 1e-4, np.zeros((0, 3)), np.zeros((0, 3), np.int64))

    assert standing._bare(candidate(0.005, 0.1), middles)
    # Objects beside a tag may reach over it.
    assert not standing._bare(candidate(0.025, 0.1), middles)
    assert not standing._bare(candidate(0.0, 0.1), middles[:2])


@pytest.mark.slow
def test_an_object_that_fails_does_not_stop_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The photos are drawn with their poses; everything after that is the scan itself."""
    posed = posed_boxes(tmp_path)
    monkeypatch.setattr(library, "pose_step", lambda *_: posed)
    seen = []
    measure = scan_step.measure_side

    def broken(options: ScanOptions, *args: object) -> object:
        seen.append(options.out.name)
        if options.out.name == "second" and len(seen) < 3:
            raise ToolkitError("the photos leave no space that the object could fill")
        return measure(options, *args)  # type: ignore[arg-type]

    monkeypatch.setattr(scan_step, "measure_side", broken)
    out = tmp_path / "things"
    words = f"{tmp_path} --all --names first second --out {out} --voxels 40 --faces 600"
    _, board = write_board_pdf(tmp_path / "board.pdf")
    more = f"--texture 64 --engine serial --board {board}"
    assert main([*words.split(), *more.split()]) == 1
    told = capsys.readouterr()
    assert "error: second: the photos leave no space" in told.err
    assert (out / "first/first.obj").is_file()
    made = read_document(out / "library.json", Library).objects
    assert [(o.name, o.status) for o in made] == [("first", "done"), ("second", "failed")]
    assert made[0].mesh == "first/first.obj"
    assert 'href="first/report.html"' in (out / "report.html").read_text()
    assert cv2.imread(str(out / "candidates.jpg")) is not None

    # What is finished is kept; only the other is scanned again.
    again = scan_all(
        ScanOptions(
            photos=tmp_path, out=out, all_objects=True, names=("first", "second"), voxels=40,
            board=board,
            faces=600, texture=64, jobs=JobOptions(engine="serial", workers=1),
        )
    )  # fmt: skip
    assert seen == ["first", "second", "second"]
    assert [o.status for o in again.objects] == ["done", "done"]
    with pytest.raises(ToolkitError, match="models of several objects"):
        scan_step.scan(ScanOptions(photos=tmp_path, out=out))


def test_names_are_as_many_as_objects(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "pose_step", lambda *_: posed_boxes(tmp_path))
    options = ScanOptions(photos=tmp_path, out=tmp_path / "x", all_objects=True, names=("one",))
    with pytest.raises(ToolkitError, match="1 names for 2 objects"):
        scan_all(options)


def test_picks_are_pixels_of_the_files(tmp_path: Path) -> None:
    """Photos are reduced to half: a pick is twice as far from the corner."""
    posed = posed_boxes(tmp_path)
    half = replace(posed, photos=replace(posed.photos, factor=0.5))
    whole, reduced = Things(posed, 1), Things(half, 1)
    reduced.standing = whole.standing
    name, _, place = whole.picks()[0].partition(":")
    x, y = (int(v) for v in place.split(","))
    assert reduced.picks()[0] == f"{name}:{2 * x},{2 * y}"


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"pick": "a.jpg:1,2", "board": Path("b.json")}, "contradicts --pick"),
        ({"box": "a.jpg:1,2,3,4", "board": Path("b.json")}, "contradicts --box"),
        ({"revolve": True}, "contradicts --revolve"),
        ({"wall_mm": 3.0}, "contradicts --wall-mm"),
        ({"flipped": Path("other")}, "contradicts a second folder"),
        ({"names": ("a", "A")}, "one name is given twice"),
        ({"names": ("../a",)}, "not a safe name"),
    ],
)
def test_options_of_one_object_contradict_all(changes: dict[str, object], told: str) -> None:
    values = {"photos": Path("p"), "out": Path("o"), "all_objects": True, **changes}
    with pytest.raises(ToolkitError, match=told):
        ScanOptions(**values)  # type: ignore[arg-type]


def test_names_need_all() -> None:
    with pytest.raises(ToolkitError, match="--names: names the objects of --all"):
        ScanOptions(photos=Path("p"), out=Path("o"), names=("a",))


def test_time_left_is_by_what_the_stages_took(tmp_path: Path) -> None:
    clock = Clock(tmp_path, {"a": 10.0, "b": 30.0}, more=20.0)
    clock.lap("a")
    assert clock.left(["a"]) == pytest.approx(5 * clock.seconds["a"])
    assert clock.left([]) is None
    # A run that resumes keeps stage a at once, and still knows what it took.
    again = Clock(tmp_path, {"a": 10.0, "b": 30.0})
    again._took["a"] = 100.0
    again.lap("a")
    assert again.left(["a"]) == pytest.approx(300.0)
