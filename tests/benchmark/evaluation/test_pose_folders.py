"""Folders of poses as other programs write them, scored as they lie."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmark.cli.bench import main
from benchmark.cli.report import PROGRAM
from benchmark.data.splits import FrameKey, open_split
from benchmark.evaluation.tasks.pose import load_pose_frame
from tests.benchmark.evaluation.pose_set import SPLIT, write_pose_split

Poses = dict[FrameKey, dict[str, np.ndarray]]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pose_split(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def poses(root: Path) -> Poses:
    """The true poses, in NOCS's words."""
    source = open_split(SPLIT, root)
    found = {}
    for index, key in enumerate(source.keys()):
        truths = load_pose_frame(source, index).truths
        found[key] = {
            "pred_class_ids": np.array([t.instance.class_id for t in truths]),
            "pred_RTs": np.array([t.RT for t in truths]),
            "pred_scales": np.array([t.size for t in truths]),
            "pred_scores": np.full(len(truths), 0.9),
        }
    return found


def as_json(fields: dict[str, np.ndarray]) -> bytes:
    """As JSON, and classes by their names."""
    known = ("other", "bottle", "bowl", "camera", "can", "car", "mug", "aeroplane")
    named = [known[i] for i in fields["pred_class_ids"]]
    rest = {"RT": fields["pred_RTs"].tolist(), "sizes": fields["pred_scales"].tolist()}
    return json.dumps({"classes": named, **rest}).encode()


FORMS: dict[str, tuple[str, Callable[[dict[str, np.ndarray]], bytes]]] = {
    "pickles": ("{scene}/{name}.pkl", pickle.dumps),
    "NOCS": ("results_real_test_{scene}_{name}.pkl", lambda f: pickle.dumps(f, 2)),
    "json": ("{scene}/{name}.json", as_json),
    "flat": ("{scene}_{name}.json", as_json),
    "deep": ("SET/mine/{scene}/poses/{name}.json", as_json),
}


def write(folder: Path, poses: Poses, form: str) -> Path:
    place, make = FORMS[form]
    for key, fields in poses.items():
        path = folder / place.format(scene=key.scene, name=key.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(make(fields))
    return folder


def bench(root: Path, out: Path, *words: str) -> int:
    start = ["pose", "--data", str(root), "--split", SPLIT, "--out", str(out)]
    return main([*start, "--engine", "serial", *words])


@pytest.mark.parametrize("form", FORMS)
def test_true_poses_are_right_in_every_form(
    root: Path, tmp_path: Path, poses: Poses, form: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write(tmp_path / "mine", poses, form)
    words = ["--method", f"mine={folder}", "--no-gallery", "--json"]
    assert bench(root, tmp_path / "out", *words) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {(r["method"], r["depth"], r["fit"]) for r in rows} == {("mine", "as-filed", "as-filed")}
    assert {r["5deg5cm"] for r in rows if r["objects"] == "all"} == {1.0}


def test_beside_a_method_and_on_the_page(
    root: Path, tmp_path: Path, poses: Poses, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write(tmp_path / "mine", poses, "pickles")
    first, *_, last = poses
    (folder / last.scene / f"{last.name}.pkl").unlink()
    out = tmp_path / "out"
    assert bench(root, out, "--method", "gt-nocs", f"mine={folder}") == 1  # a frame is missing
    assert "1 frames failed" in capsys.readouterr().err
    assert PROGRAM.main([str(out)]) == 0
    page = (out / "report.html").read_text()
    assert "as-filed" in page and "unanswered" in page
    # Changed poses are scored again, and nothing else.
    for key in (first, last):
        fields = {**poses[key], "pred_scores": poses[key]["pred_scores"] / 2}
        (folder / key.scene / f"{key.name}.pkl").write_bytes(pickle.dumps(fields))
    assert bench(root, out, "--method", f"mine={folder}") == 0
    assert f"saved poses of {first}, {last}" in capsys.readouterr().err


class Runs:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("echo ran >&2",)


def harmed(fields: dict[str, np.ndarray], **changes: object) -> bytes:
    return pickle.dumps({**fields, **changes})


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda _: pickle.dumps(Runs()), "which could run anything"),
        (lambda f: harmed(f, pred_RTs=[Runs()]), "which could run anything"),
        (lambda f: harmed(f, pred_RTs=f["pred_RTs"] * 2), "must be a rotation times"),
        (lambda f: harmed(f, pred_scales=-f["pred_scales"]), "must be finite and not negative"),
        (lambda f: harmed(f, pred_class_ids=["mug"]), "must be an array of numbers"),
        (lambda f: harmed(f, pred_class_ids=[1.5] * 3), "must be whole numbers"),
        (lambda f: harmed(f, scores=[1]), "one field under two names"),
        (lambda _: pickle.dumps({"pred_RTs": []}), "lacks a field"),
        (lambda _: pickle.dumps([1, 2]), "must hold fields by name"),
    ],
)
def test_a_hostile_folder_is_one_line(
    root: Path, tmp_path: Path, poses: Poses, make: Callable[[dict[str, np.ndarray]], bytes],
    told: str, capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    folder = write(tmp_path / "mine", poses, "pickles")
    for path, fields in zip(sorted(folder.rglob("*.pkl")), poses.values(), strict=True):
        path.write_bytes(make(fields))
    assert bench(root, tmp_path / "out", "--method", f"mine={folder}") == 1
    (line,) = capfd.readouterr().err.strip().splitlines()
    assert told in line and ".pkl" in line


def test_what_names_no_folder_is_one_line(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, told in (
        (["--method", f"a={tmp_path}"], "no file of any of the 4 frames"),
        (["--method", f"a={tmp_path}/none"], "no such folder of saved poses"),
        (["--method", f"spd={tmp_path}"], "need a name of their own"),
        (["--method", f"a={tmp_path}", f"a={tmp_path}/."], "two methods have this name"),
        (["--method", "gt-nocs", "--depth", f"as-filed={tmp_path}"], "needs a name of its own"),
    ):
        assert bench(root, tmp_path / "out", *words) == 1
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert told in line


def test_what_an_author_says_of_poses_is_shown(
    root: Path, tmp_path: Path, poses: Poses, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = write(tmp_path / "mine", poses, "json"), tmp_path / "out"
    said = {"training_data": "CAMERA25", "citation": "@misc{mine, title = {My poses}}"}
    (folder / "submission.json").write_text(json.dumps(said))
    words = ["--method", f"mine={folder}", "--no-gallery"]
    assert bench(root, out, *words) == 0
    assert PROGRAM.main([str(out)]) == 0
    assert "trained on CAMERA25" in (out / "report.html").read_text()
    assert "My poses" in (out / "citations.bib").read_text()
    (folder / "submission.json").write_text(json.dumps({"training": "CAMERA25"}))
    capsys.readouterr()
    assert bench(root, tmp_path / "other", *words) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "submission.json" in line and "training" in line
