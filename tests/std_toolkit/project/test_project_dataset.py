"""One data set of all accepted scenes, and the agreement of the people who labelled them."""

from __future__ import annotations

import json
import signal
import tarfile
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from PIL import Image

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.importers.bop_packed import unpack_data_set
from std_toolkit.project.agreement import agreement
from std_toolkit.project.dataset import assign_splits
from std_toolkit.project.dataset_card import Dataset
from std_toolkit.project.queue import review_scene
from std_toolkit.project.record import Project, Rules, create_project
from std_toolkit.project.shared import make_second
from std_toolkit.project.status import project_board
from std_toolkit.scene import Scene
from std_toolkit.scene.model import pose_from_list
from std_toolkit.scene.sidecar import find_sidecar
from tests.std_toolkit.project.lab import copied, judge

PEOPLE = ("Annabelle", "Benedict", "Zacharias")
SPLIT = ("--split", "train=0.6", "test=0.4", "--split-by", "order", "--engine", "serial")


@pytest.fixture(scope="module")
def lab(rendered: Path, tmp_path_factory: pytest.TempPathFactory) -> Project:
    """Three accepted scenes, the third labelled twice, and one that waits for a review."""
    top = tmp_path_factory.mktemp("dataset")
    folders = [copied(rendered, top / f"table{i}", by=PEOPLE[0]) for i in range(4)]
    project, _ = create_project(
        top / "mugs", scenes=folders, people=PEOPLE, rules=Rules(twice_every=3)
    )
    for name in ("table0", "table1", "table2"):
        review_scene(project, name, by=PEOPLE[1], accept=True, reasons={"box_1": "seen well"})
    second = make_second(project, project.find("table2"))
    (label,) = Scene.open(folders[2]).labels.labels
    # 2 mm and 3 degrees beside the first label.
    step = SE3.exp([0.002, 0.0, 0.0, 0.0, 0.0, np.deg2rad(3)])
    moved = {
        key: (pose_from_list(getattr(label, key)) @ step).flat()
        for key in ("T_world_obj", "T_cam_obj")
    }
    second.save_labels(
        msgspec.structs.replace(second.labels, labels=[msgspec.structs.replace(label, **moved)])
    )
    judge(second, by=PEOPLE[2], grades={1: "fits"})
    return project


def export(lab: Project, out: Path, format_name: str) -> list[str]:
    words = ["project", "export", str(lab.root), "--out", str(out), "--format", format_name]
    return [*words, "--licence", "CC-BY-4.0", *SPLIT]


@pytest.mark.parametrize(
    ("format_name", "folders"),
    [
        ("bop", ["train/000001", "train/000002", "test/000003"]),
        ("std", ["train/table0", "train/table1", "test/table2"]),
        ("nocs", ["real/train/scene_1", "real/train/scene_2", "real/test/scene_3"]),
    ],
)
def test_all_accepted_scenes_are_one_data_set(
    lab: Project,
    tmp_path: Path,
    format_name: str,
    folders: list[str],
    killed_at: Callable[[str, list[str]], int],
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    words = export(lab, out, format_name)
    if format_name == "bop":
        # In the second of the scenes: the first one is kept.
        assert killed_at(".table1.partial/train/000002/rgb/000001", words) == -signal.SIGKILL
        assert not out.exists()
        kept = tmp_path / ".out.partial/.progress/scenes/table0/std_toolkit.json"
        made = kept.stat().st_mtime_ns
        assert main(["--quiet", *words]) == 0
        image = out / folders[0] / "rgb/000000.png"
        assert image.stat().st_mtime_ns < made
    else:
        assert main(["--quiet", *words]) == 0
    told = capsys.readouterr().out
    assert "train: table0, table1\ntest: table2\n" in told and "left out: table3" in told
    dataset = msgspec.json.decode((out / "dataset.json").read_bytes(), type=Dataset)
    assert [s.folder for s in dataset.scenes] == folders
    (model,) = dataset.models
    assert (model.model, model.scenes, model.objects, model.poses) == ("box", 3, 3, 6)
    assert model.materials == ["diffuse"] and model.viewpoints == 1
    assert 0.5 < model.nearest_m < model.farthest_m < 0.7
    assert dataset.labels.grades["fits"] == 3 and dataset.labels.deviation_mm == [0.4, 0.4]
    there = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()}
    assert there == {*dataset.files, "dataset.json"}
    card = (out / "README.md").read_text()
    assert "CC-BY-4.0" in card and "| train | 2 | 4 | 2 |" in card
    # Nobody is named, and no folder of this machine.
    for path in out.rglob("*"):
        content = path.read_bytes() if path.is_file() else b""
        for word in (*PEOPLE, str(lab.root.parent), "seen well"):
            assert word.encode() not in content, path
    # Each scene is read as one that was exported alone.
    sidecar, top = find_sidecar(out / folders[1], format_name) or pytest.fail("no sidecar")
    assert top / sidecar.folder == out / folders[1]
    assert main(["--quiet", "import", str(out / folders[1]), "--out", str(tmp_path / "in")]) == 0
    (label,), source = Scene.open(tmp_path / "in").labels.labels, lab.folder(lab.find("table1"))
    (given,) = Scene.open(source).labels.labels
    assert np.allclose(label.T_world_obj or (), given.T_world_obj or (0,), atol=1e-6)
    # The same data set again is kept.
    before = (out / "dataset.json").stat().st_mtime_ns
    assert main(["--quiet", *words]) == 0
    assert (out / "dataset.json").stat().st_mtime_ns == before


def test_targets_of_bop_are_those_of_the_split(lab: Project, tmp_path: Path) -> None:
    assert main(["--quiet", *export(lab, tmp_path / "out", "bop")]) == 0
    targets = json.loads((tmp_path / "out/test_targets_bop19.json").read_bytes())
    assert {row["scene_id"] for row in targets} == {3}
    assert not (tmp_path / "out/train_targets_bop19.json").exists()


def test_shards_hold_the_images_of_a_split(lab: Project, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = [*export(lab, out, "bop"), "--shards", "3"]
    assert main(["--quiet", *words]) == 0
    shards = out / "train_web"
    index = json.loads((shards / "key_to_shard.json").read_bytes())
    assert sorted(index) == ["000001_000000", "000001_000001", "000002_000000", "000002_000001"]
    assert sorted(index.values()) == [0, 0, 0, 1]
    # They are read as the scene folders are.
    back = unpack_data_set(shards, tmp_path / "back")
    for scene in ("000001", "000002"):
        for name in ("scene_camera", "scene_gt", "scene_gt_info"):
            there = json.loads((back / scene / f"{name}.json").read_bytes())
            assert there == json.loads((out / "train" / scene / f"{name}.json").read_bytes())
        for kind in ("rgb", "depth"):
            pictures = sorted((out / "train" / scene / kind).iterdir())
            assert pictures and all(
                (back / scene / kind / p.name).read_bytes() == p.read_bytes() for p in pictures
            )
    mask = np.asarray(Image.open(out / "train/000002/mask_visib/000001_000000.png")) > 0
    with tarfile.open(shards / f"shard-{index['000002_000001']:06d}.tar") as archive:
        member = archive.extractfile("000002_000001.mask_visib.json")
        assert member is not None
        filed = json.load(member)["0"]
    values = np.repeat(np.arange(len(filed["counts"])) % 2, filed["counts"])
    assert mask.any() and (values.reshape(filed["size"], order="F") == mask).all()
    # Every byte is known, and the same export is kept.
    dataset = msgspec.json.decode((out / "dataset.json").read_bytes(), type=Dataset)
    assert "train_web/shard-000001.tar" in dataset.files
    assert main(["--quiet", *words]) == 0
    # Other shards are another data set.
    other = [*export(lab, out, "bop"), "--shards", "1000", "--overwrite"]
    assert main(["--quiet", *other]) == 0
    assert not (shards / "shard-000001.tar").exists()


def test_wrong_exports_are_a_line(
    lab: Project, rendered: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("mine")
    given = export(lab, tmp_path / "out", "bop")
    for changed, told in (
        (["--split", "train=0.5", "test=0.4"], "must add up to 1"),
        (["--split", "dev=1"], "no such split"),
        (["--split", "train=x"], "expected NAME=FLOAT"),
        (["--split", "train=0.999", "test=0.001"], "test gets none of 3 scenes"),
        (["--format", "coco"], "coco"),
        (["--format", "std", "--shards", "9"], "only bop has shards"),
        (["--licence", " "], "--licence: needed"),
        (["--out", str(tmp_path / "mine")], "not empty"),
        (["--out", str(lab.folder(lab.find("table0")) / "x")], "inside"),
    ):
        words, place = list(given), given.index(changed[0])
        count = 2 if changed[0] == "--split" else 1  # that are replaced
        words[place : place + 1 + count] = changed
        assert main(["--quiet", *words]) in (1, 2)
        lines = [x for x in capsys.readouterr().err.splitlines() if x.startswith("error:")]
        assert len(lines) == 1 and told in lines[0], lines
    bare = copied(rendered, tmp_path / "bare", grade=None)
    none, _ = create_project(tmp_path / "none", scenes=[bare], rules=None)
    assert main(["--quiet", *export(none, tmp_path / "out", "bop")]) == 1
    assert "no scene is accepted" in capsys.readouterr().err
    assert main(["project", "agreement", str(none.root)]) == 1
    assert "no scene was labelled twice" in capsys.readouterr().err


def test_scenes_stay_in_their_split_when_others_are_added() -> None:
    names = [f"scene{i}" for i in range(200)]
    shares = {"train": 0.8, "test": 0.2}
    few, many = (assign_splits(names[:n], shares, "name") for n in (100, 200))
    assert set(few["test"]) <= set(many["test"]) and set(few["train"]) <= set(many["train"])
    assert 20 <= len(many["test"]) <= 60
    # The rule is the same in every version.
    assert assign_splits(["a", "b", "c", "d"], {"train": 0.5, "test": 0.5}, "name") == SAME


SAME = {"train": ["a", "c"], "test": ["b", "d"]}


def test_agreement_is_that_of_the_two_labels(lab: Project) -> None:
    found = agreement(lab, project_board(lab))
    (pair,) = found.pairs
    assert (pair.scene, pair.object, pair.people) == ("table2", "box_1", ("A", "C"))
    assert pair.translation_mm == pytest.approx(2.0, abs=1e-3)
    assert pair.turn_deg == pytest.approx(3.0, abs=1e-3)
    assert found.all is not None and found.all.turn_deg == (3.0, 3.0)
    assert [s.of for s in found.people] == ["A and C"] and [s.of for s in found.models] == ["box"]
    named = agreement(lab, project_board(lab), names=True)
    assert named.pairs[0].people == (PEOPLE[0], PEOPLE[2])


def test_models_of_one_name_are_the_same(lab: Project, tmp_path: Path) -> None:
    scene = Scene.open(lab.folder(lab.find("table1")))
    model = msgspec.structs.replace(scene.objects.models[0], category="mug")
    before = scene.objects
    scene.save_objects(msgspec.structs.replace(before, models=[model]))
    judge(scene, by=PEOPLE[0], grades={1: "fits"})
    review_scene(lab, "table1", by=PEOPLE[1], accept=True)
    assert main(["--quiet", *export(lab, tmp_path / "out", "std")]) == 1
    scene.save_objects(before)
    judge(scene, by=PEOPLE[0], grades={1: "fits"})
    with pytest.raises(ToolkitError, match="none of 0"):
        assign_splits([], {"test": 1.0}, "name")
