"""The order of points: counted by hand on photos written from the set's description."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.data.splits import splits
from benchmark.evaluation.config import BenchJobs
from benchmark.evaluation.query_options import OrderOptions, VerifyOptions
from benchmark.evaluation.tasks.order_run import ORDERS, ScoredOrder, score_order
from benchmark.evaluation.verify import verify
from benchmark.report.page import make_parts, render_page
from benchmark.report.site.build import build_site
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import write_document

SIZE = (40, 30)
# A pane before a wall: it covers columns 10 to 29. Layers 1 and 3 are its faces, 5 is the wall.
PANE = slice(10, 30)


def depth_of(layer: int) -> np.ndarray:
    """Metres of a layer; 0 where it does not exist."""
    wall = np.tile(np.linspace(2, 3, SIZE[0]), (SIZE[1], 1))
    found = wall.copy() if layer == 1 else np.zeros_like(wall)
    found[:, PANE] = {1: 1.0, 3: 1.01, 5: 2.5, 7: 0}[layer]
    return found


def one(*points: tuple[int, int, int], is_real: bool = True) -> dict[str, Any]:
    return {f"p{i}": list(p) for i, p in enumerate(points, 1)} | {"is_real": is_real}


FIRST = {
    "pairs": [one((15, 5, 1), (2, 5, 1)), one((2, 9, 1), (35, 9, 1))],
    "trips": [one((15, 5, 1), (2, 5, 1), (35, 5, 1))],
    "quads": [one((15, 5, 1), (2, 5, 1), (8, 5, 1), (35, 5, 1))],
}
EVERY = {
    "pairs": [
        *FIRST["pairs"],
        one((15, 5, 1), (15, 5, 3)),
        one((15, 5, 3), (2, 5, 1)),
        one((12, 5, 3), (40, 5, 1)),  # outside
        one((2, 5, 3), (4, 5, 3), is_real=False),
    ],
    "trips": [one((15, 5, 1), (15, 5, 3), (15, 5, 5))],
    "quads": [],
}


def items() -> dict[str, bytes]:
    image = cv2.imencode(".png", np.zeros((SIZE[1], SIZE[0], 3), np.uint8))[1].tobytes()
    tuples = json.dumps({"layer_first": FIRST, "layer_all": EVERY}).encode()
    return {f"{key}{end}": data for key in ("0", "1")
            for end, data in ((".image.png", image), (".tuples.json", tuples))}  # fmt: skip


def write_set(root: Path, *, packed: bool = False) -> None:
    root.mkdir(parents=True)
    if not packed:
        for name, data in items().items():
            (root / name).write_bytes(data)
        return
    with tarfile.open(root / "validation.tar", "w") as archive:
        for name, data in items().items():
            member = tarfile.TarInfo(f"./{name}")
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))


def write_png(folder: Path, numbers: dict[int, int], keys: tuple[str, ...] = ("0", "1")) -> None:
    """Layers by the number in the file's name."""
    folder.mkdir(exist_ok=True)
    for key in keys:
        for number, layer in numbers.items():
            units = np.rint(1000 * depth_of(layer)).astype(np.uint16)
            assert cv2.imwrite(str(folder / f"{key}_{number}.png"), units)


def scored(data: Path, predictions: Path, **options: Any) -> dict[tuple[str, str], tuple[int, int]]:
    given = OrderOptions(data=data, predictions=(f"mine={predictions}",), **options)
    return {(s.tuples, s.layer): (s.right, s.count) for s in score_order(given).record.scores}


ALL_RIGHT = {
    ("pairs", "1"): (4, 4), ("pairs", "3"): (2, 2), ("pairs", "mixed"): (4, 4),
    ("pairs", "all"): (10, 10), ("trips", "mixed"): (2, 2), ("trips", "all"): (2, 2),
}  # fmt: skip


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("numbers", [{1: 1, 3: 3, 5: 5, 7: 7}, {0: 1, 1: 3, 2: 5, 3: 7}])
def test_the_true_layers_are_right(tmp_path: Path, packed: bool, numbers: dict[int, int]) -> None:
    write_set(tmp_path / "data/set", packed=packed)
    write_png(tmp_path / "p", numbers)
    assert scored(tmp_path / "data", tmp_path / "p", subset="layer_all") == ALL_RIGHT


def test_first_layers_alone(tmp_path: Path) -> None:
    """Inverse depth of networks for colour: any scale, larger is nearer."""
    write_set(tmp_path / "data")
    folder = tmp_path / "p"
    folder.mkdir()
    for key in ("0", "1"):
        np.save(folder / f"{key}.npy", (7 / depth_of(1)).astype(np.float32))
    found = scored(tmp_path / "data", folder)
    assert found[("quads", "all")] == (2, 2) and found[("pairs", "1")] == (4, 4)
    # Taken for depth, everything is the other way round.
    assert all(right == 0 for right, _ in scored(tmp_path / "data", folder, npy="depth").values())
    # Without other layers, only tuples of the first one are right, and those that are not real.
    every = scored(tmp_path / "data", folder, subset="layer_all")
    assert every[("pairs", "mixed")] == (0, 4) and every[("pairs", "3")] == (2, 2)


def test_what_is_wrong_by_hand(tmp_path: Path) -> None:
    write_set(tmp_path / "data")
    write_png(tmp_path / "p", {1: 1, 3: 3, 5: 5, 7: 7})
    flat = np.full((SIZE[1], SIZE[0]), 1500, np.uint16)
    assert cv2.imwrite(str(tmp_path / "p/0_3.png"), flat)
    found = scored(tmp_path / "data", tmp_path / "p", subset="layer_all")
    # Of photo 0, the tuple that is not real is wrong; the back face is still before the wall.
    assert found[("pairs", "3")] == (1, 2) and found[("trips", "mixed")] == (2, 2)
    flat[:] = 2500
    assert cv2.imwrite(str(tmp_path / "p/0_3.png"), flat)
    found = scored(tmp_path / "data", tmp_path / "p", subset="layer_all")
    # Now it is not before the wall beside the pane, and not before the one behind it: equal.
    assert found[("pairs", "mixed")] == (3, 4) and found[("trips", "mixed")] == (1, 2)


def test_a_photo_that_is_not_answered_is_wrong(tmp_path: Path) -> None:
    write_set(tmp_path / "data")
    write_png(tmp_path / "p", {0: 1, 1: 3, 2: 5, 3: 7}, keys=("1",))
    options = OrderOptions(
        data=tmp_path / "data", predictions=(f"a={tmp_path / 'p'}",), subset="layer_all"
    )
    record = score_order(options).record
    assert record.unanswered == {"a": 1} and record.left_out == 2
    assert all(2 * s.right == s.count for s in record.scores)


def test_predictions_of_another_size(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_set(tmp_path / "data")
    folder = tmp_path / "p"
    folder.mkdir()
    for key in ("0", "1"):
        large = np.repeat(np.repeat(depth_of(1), 3, axis=0), 3, axis=1)
        np.save(folder / f"{key}_1.npy", 1 / large)
    assert scored(tmp_path / "data", folder)[("quads", "all")] == (2, 2)
    np.save(folder / "0_1.npy", np.ones((SIZE[0], SIZE[1])))
    # A photo whose prediction cannot be used is wrong, and is told.
    given = OrderOptions(data=tmp_path / "data", predictions=(f"mine={folder}",))
    found = score_order(given)
    assert found.record.unanswered == {"mine": 1} and found.campaign.failed_frames == 1
    assert "other proportions than the photo's 40x30" in caplog.text
    assert [s.right for s in found.record.scores if s.tuples == "quads"] == [1, 1]


def test_numbers_that_could_mean_two_layers(tmp_path: Path) -> None:
    write_set(tmp_path / "data")
    write_png(tmp_path / "p", {1: 1, 3: 3})
    with pytest.raises(ToolkitError, match="may count layers") as error:
        scored(tmp_path / "data", tmp_path / "p")
    assert error.value.hint is not None and "--layers" in error.value.hint
    found = scored(tmp_path / "data", tmp_path / "p", subset="layer_all", layers="odd")
    assert found[("pairs", "all")] == (10, 10)
    write_png(tmp_path / "q", {0: 1, 5: 5})
    with pytest.raises(ToolkitError, match="fit no way of counting"):
        scored(tmp_path / "data", tmp_path / "q")
    (tmp_path / "p/0.npy").write_bytes((tmp_path / "p/0_1.png").read_bytes())
    with pytest.raises(ToolkitError, match="two files of one photo and layer"):
        scored(tmp_path / "data", tmp_path / "p", layers="odd")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_set(tmp_path / "data", packed=True)
    write_png(tmp_path / "p", {1: 1})
    words = ["order", "--data", str(tmp_path / "data")]
    assert main(words) == 0
    counted = capsys.readouterr().out
    assert "2 photos" in counted and "huggingface.co" in counted and "CC0" in counted
    assert main([*words, "--predictions", f"mine={tmp_path / 'p'}"]) == 0
    assert "never beside errors of metric depth" in (text := capsys.readouterr().out)
    assert text.splitlines()[-1].split()[:2] == ["mine", "100.00"]
    assert main([*words, "--predictions", f"mine={tmp_path / 'p'}", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["photos"] == 2 and record["unanswered"] == {"mine": 0}


def kept(top: Path, name: str = "mine", **options: Any) -> ScoredOrder:
    """Score the predictions of `top/NAME` into `top/results`."""
    return score_order(
        OrderOptions(
            data=top / "data", predictions=(f"{name}={top / name}",), subset="layer_all",
            out=top / "results", **options,
        )
    )  # fmt: skip


def rights(done: ScoredOrder) -> dict[tuple[str, str], int]:
    return {(s.tuples, s.layer): s.right for s in done.record.scores}


def test_results_are_kept_and_what_changed_is_scored_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_set(tmp_path / "data")
    write_png(tmp_path / "mine", {1: 1, 3: 3, 5: 5, 7: 7})
    first = kept(tmp_path)
    table = tmp_path / "results" / "layered-depth" / "mine" / "layer_all" / ORDERS
    before = table.stat().st_mtime_ns
    assert rights(kept(tmp_path)) == rights(first) and table.stat().st_mtime_ns == before
    # Under the same name another prediction, then another truth: of one photo alone.
    flat = np.full((SIZE[1], SIZE[0]), 1500, np.uint16)
    assert cv2.imwrite(str(tmp_path / "mine" / "0_1.png"), flat)
    caplog.clear()
    assert rights(kept(tmp_path))[("pairs", "1")] == 2
    assert "saved depth of layer 1 of 0/image" in caplog.text and "1/image" not in caplog.text
    document = json.loads((tmp_path / "data" / "1.tuples.json").read_text())
    document["layer_all"]["pairs"] = [one((2, 5, 1), (15, 5, 1))]
    (tmp_path / "data" / "1.tuples.json").write_text(json.dumps(document))
    found = rights(kept(tmp_path))
    assert found[("pairs", "1")] == 0 and "tuples of 1/image" in caplog.text
    # Another way to read the same files is another run.
    done = kept(tmp_path, npy="depth")
    assert not done.campaign.finished and "npy" in next(iter(done.campaign.failed.values()))


def test_results_are_verified_and_stand_on_the_site(tmp_path: Path) -> None:
    write_set(tmp_path / "data")
    write_png(tmp_path / "good", {1: 1, 3: 3, 5: 5, 7: 7})
    write_png(tmp_path / "half", {1: 1, 3: 3, 5: 5, 7: 7}, keys=("0",))
    write_png(tmp_path / "poor", {1: 5, 3: 3, 5: 1, 7: 7})
    for name in ("good", "half", "poor"):
        kept(tmp_path, name)
    results = tmp_path / "results"
    jobs = BenchJobs(engine="serial", progress=False)
    options = VerifyOptions(results=(results,), data=(str(tmp_path / "data"),), jobs=jobs)
    done = verify(options)
    grades = {run.title.split()[0]: (run.holds, run.grade) for run in done.runs}
    assert grades == dict.fromkeys(("good", "half", "poor"), (True, "recomputed"))
    write_document(tmp_path / "v.json", done)
    build_site([results], tmp_path / "site", verified=[tmp_path / "v.json"])
    table = pd.read_csv(tmp_path / "site" / "results.csv")
    assert set(table["task"]) == {"order of points"} and set(table["grade"]) == {"recomputed"}
    rank = table[table["subset"] == "all"].set_index("method")["rank"]
    assert rank["good"] == 1 and rank["poor"] == 2 and np.isnan(rank["half"])
    row = table[(table["subset"] == "all") & (table["method"] == "good")].iloc[0]
    assert row["pairs"] == 1 and row["pairs_low"] == 1
    assert "Order of points" in render_page(make_parts([results]))
    # A table in which somebody added right tuples does not hold.
    path = results / "layered-depth" / "poor" / "layer_all" / ORDERS
    rows = pd.read_parquet(path)
    rows["right"] = rows["asked"]
    rows.to_parquet(path)
    wrong = {run.title.split()[0]: run for run in verify(options).runs}
    assert not wrong["poor"].holds and wrong["good"].holds
    assert any(not figure.holds for figure in wrong["poor"].figures)
    rows["right"] = rows["asked"] + 1
    rows.to_parquet(path)
    with pytest.raises(ToolkitError, match="more right tuples than tuples"):
        verify(options)


def test_it_is_no_split() -> None:
    """Its scores must not stand beside metric ones."""
    assert not [name for name in splits.names() if "layered" in name]


def _pack(path: Path, name: str, data: bytes) -> None:
    with tarfile.open(path, "w") as archive:
        member = tarfile.TarInfo(name)
        member.size = len(data)
        archive.addfile(member, io.BytesIO(data))


WRONG: list[tuple[Callable[[Path], object], str]] = [
    (lambda top: (top / "0.tuples.json").unlink(), "lacks a file"),
    (lambda top: (top / "1.image.png").write_bytes(b"no image"), "no readable PNG or JPEG"),
    (lambda top: (top / "0.tuples.json").write_text('{"layer_all": {}}'), "field is missing"),
    (lambda top: (top / "0.tuples.json").write_text('{"layer_first": {"pairs": [{}]}}'), "p1"),
    (lambda top: (top / "a.tar").write_bytes(b"x" * 2000), "not a readable archive"),
    (lambda top: _pack(top / "a.tar", "../7.tuples.json", b"{}"), "lacks a file"),
]


@pytest.mark.parametrize(("spoil", "said"), WRONG)
def test_a_damaged_set_is_one_line(
    tmp_path: Path, spoil: Callable[[Path], object], said: str
) -> None:
    write_set(tmp_path / "data")
    spoil(tmp_path / "data")
    with pytest.raises(ToolkitError, match=said) as error:
        score_order(OrderOptions(data=tmp_path / "data"))
    assert "\n" not in str(error.value) and not (tmp_path / "7.tuples.json").exists()


def test_two_parts_whose_photos_have_the_same_numbers(tmp_path: Path) -> None:
    """Else the photos of the second one would stand for those of the first one."""
    write_set(tmp_path / "data/validation")
    write_set(tmp_path / "data/test")
    write_png(tmp_path / "p", {k: k for k in (1, 3, 5, 7)})
    with pytest.raises(ToolkitError, match="two files of one photo") as error:
        scored(tmp_path / "data", tmp_path / "p")
    assert "validation" in str(error.value)


def test_nothing_is_there(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(ToolkitError, match="no photo of LayeredDepth") as error:
        score_order(OrderOptions(data=tmp_path / "empty"))
    assert "huggingface.co" in (error.value.hint or "")
    with pytest.raises(ToolkitError, match="no such folder"):
        score_order(OrderOptions(data=tmp_path / "none"))
