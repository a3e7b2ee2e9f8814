"""Folders of predictions as other programs write them, scored as they lie."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.data.predictions import DepthFolder, read_prediction
from benchmark.data.splits import FrameKey, open_split
from benchmark.evaluation.results import TABLE
from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_png
from tests.benchmark.evaluation.bench_set import SPLIT, write_split

Depth = np.ndarray


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_split(tmp_path_factory.mktemp("data"), scenes=2, frames=2)


@pytest.fixture(scope="module")
def answers(root: Path) -> dict[FrameKey, Depth]:
    """Truth plus 10 mm, everywhere."""
    source = open_split(SPLIT, root)
    frames = [source.load(i) for i in range(len(source))]
    return {
        FrameKey(f.scene, f.name): np.where(f.depth_true > 0, f.depth_true + 0.01, 0.8).astype("f4")
        for f in frames
    }


def bench(root: Path, out: Path, *words: str) -> int:
    start = ["depth", "--data", str(root), "--split", SPLIT, "--out", str(out)]
    return main([*start, "--no-gallery", "--engine", "serial", *words])


def rmse(out: Path, label: str) -> pd.Series:
    table = pd.read_parquet(out / SPLIT / label / "strict" / TABLE)
    chosen = (table["grid"] == "h126w224") & (table["subset"] == "all")
    return table.loc[chosen].set_index("frame")["rmse"]


def write_pfm(path: Path, depth: Depth, order: str = "<") -> None:
    scale = "-1.0" if order == "<" else "1.0"
    head = f"Pf\n{depth.shape[1]} {depth.shape[0]}\n{scale}\n".encode()
    path.write_bytes(head + depth[::-1].astype(f"{order}f4").tobytes())


def millimetres(depth: Depth) -> Depth:
    return np.round(depth * 1000).astype(np.uint16)


FORMS: dict[str, tuple[str, Callable[[Path, Depth], object]]] = {
    "png": ("{scene}/{name}.png", lambda p, d: write_png(p, millimetres(d))),
    "png beside a confidence": (
        "{scene}/{name}_depth.png",
        lambda p, d: (
            write_png(p, millimetres(d)),
            np.save(p.with_name(p.name.replace("_depth.png", "_conf.npy")), d),
        ),
    ),
    "exr": ("{scene}/{name}.exr", lambda p, d: write_exr(p, {"Z": d})),
    "npy": ("{scene}/{name}.npy", lambda p, d: np.save(p, d[None])),
    "npy of whole numbers": ("{scene}/{name}.npy", lambda p, d: np.save(p, millimetres(d))),
    "npz": ("{scene}/{name}.npz", lambda p, d: np.savez(p, depth=d, confidence=0 * d)),
    "tiff": ("{scene}/{name}.tiff", lambda p, d: cv2.imwrite(str(p), d)),
    "pfm": ("{scene}/{name}.pfm", write_pfm),
    "pfm, big end first": ("{scene}/{name}.pfm", lambda p, d: write_pfm(p, d, ">")),
    "below the scene": ("{scene}/depth_restored/{name}.npy", lambda p, d: np.save(p, d)),
    "std-restore": ("{scene}/depth/{name}.exr", lambda p, d: write_exr(p, {"Y": d})),
    "set and method": (
        "STD/mine/{scene}/{name}_depth.png",
        lambda p, d: write_png(p, millimetres(d)),
    ),
    "without folders": ("{scene}_{name}.npy", lambda p, d: np.save(p, d)),
    "another size": (
        "{scene}/{name}.npy",
        lambda p, d: np.save(p, d.repeat(3, axis=0).repeat(3, axis=1)),
    ),
}


def write_answers(
    folder: Path, answers: dict[FrameKey, Depth], place: str, write: Callable[[Path, Depth], object]
) -> Path:
    for key, depth in answers.items():
        path = folder / place.format(scene=key.scene, name=key.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path, depth)
    return folder


@pytest.mark.parametrize("form", FORMS)
def test_every_form_is_scored_as_it_lies(
    root: Path, tmp_path: Path, answers: dict[FrameKey, Depth], form: str
) -> None:
    folder = write_answers(tmp_path / "mine", answers, *FORMS[form])
    assert bench(root, tmp_path / "out", "--method", f"mine={folder}") == 0
    found = rmse(tmp_path / "out", "mine")
    assert len(found) == 4
    np.testing.assert_allclose(found, 0.01, atol=5.1e-4)


def test_two_folders_and_a_method_in_one_command(
    root: Path, tmp_path: Path, answers: dict[FrameKey, Depth], capsys: pytest.CaptureFixture[str]
) -> None:
    one = write_answers(tmp_path / "one", answers, *FORMS["npy"])
    two = write_answers(tmp_path / "two", answers, *FORMS["png"])
    next(two.rglob("*.png")).unlink()
    words = ["--method", "raw", f"a={one}", f"b={two}", "--no-speed"]
    assert bench(root, tmp_path / "out", *words) == 1  # one frame is missing
    told = capsys.readouterr()
    assert "a on std-catknown, strict: .npy in m, median depth 0." in told.err
    assert "b on std-catknown, strict: .png in mm, median depth 0." in told.err
    assert set(re.findall(r"^(raw|a|b) +all +4 ", told.out, re.M)) == {"raw", "a", "b"}
    assert sorted(rmse(tmp_path / "out", "b") > 0.1) == [False, False, False, True]
    setup = json.loads((tmp_path / f"out/{SPLIT}/a/strict/run.json").read_text())["setup"]
    assert setup["depth_from"] == str(one) and setup["depth_unit"] == 0
    assert not (tmp_path / f"out/{SPLIT}/a/strict/speed.json").exists()


@pytest.mark.parametrize(
    ("factor", "words", "told"),
    [
        (1000.0, [], "read in m, and is likely in mm"),
        (4000.0, [], "is likely in 0.00025 m"),
        (10_000.0, [], "is likely in 0.1mm"),
        (100.0, [], "is likely in cm"),
        (1.0, ["--depth-unit", "mm"], "read in mm, and is likely in m"),
        (1000.0, ["--depth-unit", "0.1mm"], "read in 0.1mm, and is likely in mm"),
        (4.0, [], "is likely in 0.25 m"),
    ],
)
def test_another_unit_is_refused_with_the_likely_one(
    root: Path, tmp_path: Path, answers: dict[FrameKey, Depth], factor: float, words: list[str],
    told: str, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    scaled = {key: depth * np.float32(factor) for key, depth in answers.items()}
    folder = write_answers(tmp_path / "mine", scaled, *FORMS["exr"])
    assert bench(root, tmp_path / "out", "--method", f"mine={folder}", *words) == 1
    error = capsys.readouterr().err
    assert told in error and "--depth-unit" in error
    assert not (tmp_path / f"out/{SPLIT}/mine/strict/images.parquet").exists()


def test_a_stated_unit_is_used_and_recorded(
    root: Path, tmp_path: Path, answers: dict[FrameKey, Depth], capsys: pytest.CaptureFixture[str]
) -> None:
    scaled = {key: depth * np.float32(4000) for key, depth in answers.items()}
    folder = write_answers(tmp_path / "mine", scaled, *FORMS["exr"])
    words = ["--method", f"mine={folder}", "--depth-unit"]
    assert bench(root, tmp_path / "out", *words, "mine=0.00025") == 0
    np.testing.assert_allclose(rmse(tmp_path / "out", "mine"), 0.01, atol=1e-5)
    assert bench(root, tmp_path / "out", *words, "other=mm") == 1
    assert "names no predictions" in capsys.readouterr().err
    assert bench(root, tmp_path / "out", *words, "inch") == 1
    assert "expected m, cm, mm, 0.1mm, or metres per number" in capsys.readouterr().err


def test_depth_from_is_held_to_the_unit_as_well(
    root: Path, tmp_path: Path, answers: dict[FrameKey, Depth], capsys: pytest.CaptureFixture[str]
) -> None:
    scaled = {key: depth * np.float32(1000) for key, depth in answers.items()}
    place = "{scene}/{name}_depth_415.exr"
    folder = write_answers(tmp_path / "mine", scaled, place, lambda p, d: write_exr(p, {"Z": d}))
    words = ["--method", "raw", "--label", "mine", "--depth-from", str(folder), "--no-speed"]
    assert bench(root, tmp_path / "out", *words) == 1
    assert "is likely in mm" in capsys.readouterr().err
    assert bench(root, tmp_path / "out", *words, "--depth-unit", "mm") == 0
    np.testing.assert_allclose(rmse(tmp_path / "out", "mine"), 0.01, atol=1e-5)


def harm_two_files(folder: Path) -> None:
    path = next(folder.rglob("*.npy"))
    np.savez(path.with_suffix(".npz"), depth=np.load(path))


def harm_flat(folder: Path) -> None:
    for path in list(folder.rglob("*.npy")):
        path.rename(folder / path.name)


def harm_twice(folder: Path) -> None:
    for name in ("one", "two"):
        for path in list(folder.glob("test_*/*.npy")):
            copy = folder / name / path.parent.name / path.name
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(path.read_bytes())
    for path in list(folder.glob("test_*/*.npy")):
        path.unlink()
    for place in folder.glob("test_*"):
        place.rmdir()


def harm_aspect(folder: Path) -> None:
    for path in folder.rglob("*.npy"):
        np.save(path, np.load(path)[0][:, ::2])


def harm_all(folder: Path, write: Callable[[Path], object]) -> None:
    for path in list(folder.rglob("*.npy")):
        path.unlink()
        write(path)


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (harm_two_files, "two files could be the depth of the frame"),
        (harm_flat, "2 frames have this name"),
        (harm_twice, "two folders of this scene"),
        (harm_aspect, "has other proportions than the ground truth's"),
        (lambda f: harm_all(f, lambda _: None), "no file of any of the 4 frames"),
        (lambda f: harm_all(f, lambda p: p.with_suffix(".png").write_bytes(b"GIF89a")), "PNG"),
        (
            lambda f: harm_all(
                f, lambda p: write_png(p.with_suffix(".png"), np.ones((36, 64), "u1"))
            ),
            "8-bit images hold no metric depth",
        ),
        (
            lambda f: harm_all(f, lambda p: np.save(p, np.array([{"a": 1}]), allow_pickle=True)),
            ".npy",
        ),
        (
            lambda f: harm_all(
                f, lambda p: p.with_suffix(".pfm").write_bytes(b"Pf\n64 36\n-1\nxx")
            ),
            "cut off",
        ),
        (
            lambda f: harm_all(f, lambda p: np.savez(p.with_suffix(".npz"), a=1, b=2)),
            "several arrays, none called depth",
        ),
    ],
)
def test_what_cannot_be_scored_is_one_line(
    root: Path, tmp_path: Path, answers: dict[FrameKey, Depth], harm: Callable[[Path], object],
    told: str, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    folder = write_answers(tmp_path / "mine", answers, *FORMS["npy"])
    harm(folder)
    assert bench(root, tmp_path / "out", "--method", f"mine={folder}") == 1
    lines = [x for x in capsys.readouterr().err.splitlines() if "scored anew" not in x and x]
    assert len(lines) == 1 and told in lines[0], lines


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--method", "swindrnet={}"], "need a name of their own"),
        (["--method", "a={}", "a={}/."], "two methods have this name"),
        (["--method", "a={}/nowhere"], "no such folder of saved depth"),
        (["--method", "a b={}"], "usable as a folder's name"),
        (["--method", "a={}", "--probe", "holes"], "predictions in a folder"),
        (["--method", "raw", "a={}", "--depth-from", "{}"], "predictions in a folder"),
    ],
)
def test_wrong_names_are_one_line(
    root: Path, tmp_path: Path, words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bench(root, tmp_path / "out", *(w.format(tmp_path) for w in words)) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert told in line


def test_a_folder_of_many_names_takes_no_longer(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    for i in range(20_000):
        (tmp_path / "a" / f"x{i}.png").touch()
    keys = [FrameKey("a", f"{i:04d}") for i in range(2000)]
    answers = DepthFolder(tmp_path, "std-catknown", keys=keys)
    start = time.monotonic()
    assert not any(answers.path(key).is_file() for key in keys)
    assert time.monotonic() - start < 10


def test_a_pfm_is_read_from_the_bottom(tmp_path: Path) -> None:
    depth = np.arange(1, 7, dtype=np.float32).reshape(2, 3)
    for order in "<>":
        write_pfm(tmp_path / "a.pfm", depth, order)
        np.testing.assert_array_equal(read_prediction(tmp_path / "a.pfm"), depth)
    (tmp_path / "a.pfm").write_bytes(b"PF\n3 2\n-1\n" + bytes(72))
    with pytest.raises(ToolkitError, match="one channel"):
        read_prediction(tmp_path / "a.pfm")


def test_a_spread_beside_the_depth_is_judged(
    root: Path, tmp_path: Path, answers: dict[FrameKey, Depth], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_answers(tmp_path / "mine", answers, *FORMS["png beside a confidence"])
    words = ["--method", f"mine={folder}", "--protocol", "strict"]
    assert bench(root, tmp_path / "out", *words) == 0
    path = tmp_path / "out" / SPLIT / "mine" / "strict" / TABLE
    assert pd.read_parquet(path)["spread1_glass"].isna().all()
    for key, depth in answers.items():  # 12 mm expected, 10 are right; none in the upper rows
        spread = np.full(depth.shape, 0.012, np.float32)
        spread[:3] = np.nan
        np.save(folder / key.scene / f"{key.name}_spread.npy", spread * 1000)
    capsys.readouterr()
    assert bench(root, tmp_path / "out", *words, "--depth-unit", "mm") == 1  # another unit
    out = tmp_path / "again"
    assert bench(root, out, *words, "--depth-unit", "mm") == 0
    table = pd.read_parquet(out / SPLIT / "mine" / "strict" / TABLE).dropna(subset="selective_50")
    assert len(table) == 4
    np.testing.assert_allclose(table[["selective_50", "selective_area"]], 0.01, atol=6e-4)
    assert (table[["spread1_opaque", "spread2_opaque"]].stack() == 1).all()
    np.save(folder / key.scene / f"{key.name}_spread.npy", spread[::2])
    assert bench(root, out, *words, "--depth-unit", "mm") == 1
    error = capsys.readouterr().err
    assert "saved spread of" in error and "another size than the depth" in error


def test_a_million_names_are_one_line(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from benchmark.data import prediction_files

    monkeypatch.setattr(prediction_files, "_MOST_NAMES", 50)
    for i in range(60):
        (tmp_path / f"<script>alert({i})").touch()
    assert bench(root, tmp_path / "out", "--method", f"mine={tmp_path}") == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "too many for predictions of a data set" in line and "script" not in line
