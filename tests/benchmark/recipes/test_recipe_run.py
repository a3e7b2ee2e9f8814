"""Recipes from data to table, on frames that need no simulation; killed, resumed, refused."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
import torch
from recipe_data import write_set, write_std

from benchmark.cli.train import main
from benchmark.recipes.recipe_overview import MARKDOWN, all_tables
from benchmark.recipes.recipe_page import ALL_TABLES, CSV, PAGE, POSES_CSV
from benchmark.recipes.recipe_table import ABSENT, COLUMNS, MEASURED, PUBLISHED

pytestmark = pytest.mark.slow
HERE = ["--accelerator", "cpu", "--readers", "0", "--engine", "serial"]


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Options that name sets to train and to test on, and STD."""
    top = tmp_path_factory.mktemp("recipe_data")
    train = write_set(top / "train", "train", 3)
    test = write_set(top / "test", "test", 1, 60000)
    std = write_std(top / "std")
    return ["--train-data", str(train), "--test-data", str(test), "--data", str(std)]


def command(out: Path, own: list[str], *more: str) -> list[str]:
    return ["recipe", "sim-to-real", "--scale", "tiny", "--out", str(out), *own, *HERE, *more]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory, own: list[str]) -> Path:
    """The recipe, run once, on one thread: sums depend on the number of threads."""
    torch.set_num_threads(1)
    out = tmp_path_factory.mktemp("recipe_run") / "out"
    assert main(command(out, own)) == 0
    return out


def stamps(out: Path) -> dict[str, int]:
    """When each file was written, without the page, which is written by every run."""
    kept = [
        p for name in ("packs", "training", "results") for p in (out / "tiny" / name).rglob("*")
    ]
    passing = ("lock", ".digests.json")  # the latter is a cache
    return {str(p): p.stat().st_mtime_ns for p in kept if p.is_file() and p.name not in passing}


def test_the_table_holds_everything(done):
    rows = pd.read_csv(done / "tiny" / "sim-to-real" / CSV)
    assert tuple(rows.columns) == COLUMNS
    assert set(rows["scale"]) == {"tiny"}
    measured = rows[rows["kind"] == MEASURED]
    variants = {
        "raw",
        "SwinDRNet, cropped synthetic depth",
        "SwinDRNet, simulated depth",
    }
    for test in ("std-catknown", "dreds-catknown-test"):
        mine = measured[measured["test"] == test]
        assert set(mine["variant"]) == variants
        assert set(mine["protocol"]) == {"paper", "strict"}
        assert len(mine) == 3 * 2 * 2  # variants, protocols, objects
        assert mine["rmse"].notna().all()
    absent = rows[rows["kind"] == ABSENT]
    assert set(absent["test"]) == {"std-catnovel", "cleargrasp-real-known"}
    assert absent["note"].str.contains("not available: .* download: https://").all()
    printed = rows[(rows["kind"] == PUBLISHED) & (rows["test"] == "std-catknown")]
    hard = printed[printed["subset"] == "specular+transparent"].set_index("variant")
    assert hard.loc["SwinDRNet, simulated depth", "rmse"] == 0.018
    assert hard.loc["SwinDRNet, cropped synthetic depth", "d105"] == pytest.approx(0.3942)
    trained = measured[measured["steps"].notna()]
    assert set(trained["training_frames"]) == {4}
    assert set(trained["training_scenes"]) == {2}
    # Beside each other: what was measured of a variant, and what is printed of it.
    shown = rows[(rows["test"] == "std-catknown") & (rows["subset"] == "all")]
    order = list(shown[["variant", "kind"]].itertuples(index=False, name=None))
    cropped = "SwinDRNet, cropped synthetic depth"
    at = order.index((cropped, PUBLISHED))
    assert order[at - 1] == order[at - 2] == (cropped, MEASURED)


def test_the_scores_are_those_of_the_benchmark(done):
    from benchmark.evaluation.tasks.depth_results import read_results, summarise

    rows = pd.read_csv(done / "tiny" / "sim-to-real" / CSV)
    results = read_results([done / "tiny" / "results"])
    assert len(results) == 3 * 2 * 2  # methods, tests, protocols
    found = next(
        r
        for r in results
        if r.manifest.setup.split == "std-catknown"
        and r.manifest.setup.protocol == "strict"
        and ".cut" in r.manifest.label
    )
    means = summarise(found.table)
    mean = means[(means["subset"] == "all") & (means["grid"] == "h126w224")].iloc[0]
    chosen = (rows["test"] == "std-catknown") & (rows["protocol"] == "strict")
    chosen &= (rows["subset"] == "all") & rows["variant"].str.contains("cropped")
    row = rows[chosen & (rows["kind"] == MEASURED)].iloc[0]
    assert row["rmse"] == pytest.approx(mean["rmse"], rel=1e-12)
    weights = done / "tiny" / "training" / found.manifest.label / "best.safetensors"
    assert found.manifest.weights == str(weights)


def test_all_tables_stand_on_one_page(done, tmp_path):
    page = (done / "tiny" / ALL_TABLES).read_text()
    assert page.startswith("# All recipes at scale `tiny`\n")
    own = (done / "tiny" / "sim-to-real" / MARKDOWN).read_text()
    rows = [line for line in own.splitlines() if line.startswith("|")]
    assert len(rows) > 20
    assert [line for line in page.splitlines() if line in rows] == rows
    assert "\n## Sim-to-real\n" in page and "`std-train recipe sim-to-real --scale tiny`" in page
    headings = [line for line in page.splitlines() if line.startswith("#")]
    assert sum(line.startswith("# ") for line in headings) == 1
    # Figures are explained once, also below two recipes; what is not a recipe is left out.
    (tmp_path / "other").mkdir()
    (tmp_path / "data").mkdir()
    for name in ("one", "other"):
        (tmp_path / name).mkdir(exist_ok=True)
        (tmp_path / name / MARKDOWN).write_text(own)
    two = all_tables(tmp_path, "tiny")
    assert two.count("Figures are means over frames") == 1
    assert two.index("recipe one") < two.index("recipe other")
    assert "recipe data" not in two


def test_every_page_tells_the_scale(done):
    folder = done / "tiny" / "sim-to-real"
    page, text = (folder / PAGE).read_text(), (folder / MARKDOWN).read_text()
    for told in (page, text):
        assert "Scale: tiny" in told
        assert "its numbers mean nothing" in told
        assert "not available" in told
        assert "47" in told  # 46.7 mm is printed for cropped depth
    assert "<title>Sim-to-real, scale tiny</title>" in page
    sections = re.findall(r"<h2>.*?</h2>", page)
    assert len(sections) >= 6
    assert all("scale tiny" in heading for heading in sections)
    headings = [line for line in text.splitlines() if line.startswith("## ")]
    assert len(headings) == 5
    assert all("(scale tiny)" in line for line in headings)
    assert "http" not in re.sub(r"https://(pku-epic|sites\.google)\S*", "", page.split("<main>")[1])


def test_what_is_finished_is_left_alone(done, own, capsys, monkeypatch):
    import benchmark.training.fit as fit_module

    before = stamps(done)
    pages = [(done / "tiny" / "sim-to-real" / n).read_bytes() for n in (CSV, MARKDOWN, PAGE)]
    monkeypatch.setattr(fit_module, "fit", lambda *_: pytest.fail("trained again"))
    assert main(command(done, own)) == 0
    assert stamps(done) == before
    again = [(done / "tiny" / "sim-to-real" / n).read_bytes() for n in (CSV, MARKDOWN, PAGE)]
    assert pages == again
    assert "Scale: tiny" in capsys.readouterr().out


def test_another_recipe_takes_what_is_there(done, own, capsys):
    before = stamps(done)
    line = command(done, own)
    line[1] = "material-randomization"
    assert main([*line, "--only", "randomized"]) == 0
    assert stamps(done) == before
    rows = pd.read_csv(done / "tiny" / "material-randomization" / CSV)
    assert "SwinDRNet, randomized materials" in set(rows["variant"])
    printed = rows[rows["kind"] == PUBLISHED]
    left_out = printed[printed["training_data"] == "DREDS-CatKnown, fixed material"]
    assert (left_out["note"] == "not a variant that was run").all()
    assert len(left_out)


def test_killed_and_run_again_ends_with_the_same_table(done, own, tmp_path):
    """kill -9 in the middle of the first training, then of the scoring."""
    torch.set_num_threads(1)
    out = tmp_path / "out"
    line = [sys.executable, "-m", "benchmark.cli.train", *command(out, own)]
    training = out / "tiny" / "training"
    for pattern in ("*/last.ckpt", "*/last.safetensors"):
        process = subprocess.Popen(
            line,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        while process.poll() is None and not list(training.glob(pattern)):
            time.sleep(0.02)
        if process.poll() is None:
            os.kill(process.pid, signal.SIGKILL)
        process.wait()
    assert main(command(out, own)) == 0
    names = (CSV, MARKDOWN)
    one, other = (
        [(o / "tiny" / "sim-to-real" / n).read_text() for n in names] for o in (out, done)
    )
    assert one == other


def test_stale_steps_are_refused(own, tmp_path, capsys, monkeypatch):
    """A training by another configuration, and a set that has grown."""
    train = write_set(tmp_path / "train", "train", 3)
    line = command(tmp_path / "out", ["--train-data", str(train), *own[2:4]], "--only", "cropped")
    assert main(line) == 0
    from benchmark.recipes import recipe as scale_module

    text = scale_module._FILE.read_text()
    (tmp_path / "scales.toml").write_text(text.replace("steps = 4", "steps = 6"))
    with monkeypatch.context() as patch:
        patch.setattr(scale_module, "_FILE", tmp_path / "scales.toml")
        capsys.readouterr()
        assert main(line) == 1
        told = capsys.readouterr()
        assert "steps: this training was begun with 4 (got 6)" in told.err
        assert "SwinDRNet, cropped synthetic depth" in told.err
    write_set(train, "train", 1, first=3)
    assert main(line) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert "frames: this pack was begun with 6 (got 8)" in error
    assert "choose another --out" in error


def test_a_variant_that_fails_keeps_no_other_from_running(own, tmp_path, capsys):
    path = tmp_path / "mine.toml"
    path.write_text(
        'title = "Mine & own"\nprotocols = ["strict"]\n'
        '[variants.odd]\ntitle = "Odd"\nmethod = "nothing"\n'
        '[variants.bad]\ntitle = "Bad"\nmethod = "dfnet"\nsettings = { near = "5", far = "6" }\n'
        '[variants.good]\ntitle = "Good"\nmethod = "dfnet"\n'
        '[tests.dreds-catknown-test]\nset = "test"\n'
    )
    line = ["recipe", str(path), "--scale", "tiny", "--out", str(tmp_path / "out"), *own[:4]]
    status = main([*line, *HERE])
    told = capsys.readouterr()
    rows = pd.read_csv(tmp_path / "out" / "tiny" / "mine" / CSV)
    kinds = rows.groupby("variant")["kind"].agg(set)
    assert kinds["Good"] == {MEASURED}
    assert kinds["Odd"] == {ABSENT}
    assert status == 1
    assert "error: Odd: cannot be trained here: no plug-in with this name" in told.err
    page = (tmp_path / "out" / "tiny" / "mine" / PAGE).read_text()
    assert "Mine &amp; own" in page
    assert "What did not run" in page


def test_without_any_test_nothing_is_begun(own, tmp_path, capsys):
    line = ["recipe", "domain-transfer", "--scale", "tiny", "--out", str(tmp_path / "out")]
    assert main([*line, *HERE]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: no test of this recipe is available")
    assert "sites.google.com/view/cleargrasp" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_damaged_frames_are_told_and_left_out(own, tmp_path, capsys):
    train = write_set(tmp_path / "train", "train", 3)
    damaged = train / "DREDS-CatKnown" / "train" / "00001" / "0001_simDepthImage.exr"
    damaged.write_bytes(damaged.read_bytes()[:100])
    line = command(tmp_path / "out", ["--train-data", str(train), *own[2:4]], "--only", "simulated")
    assert main(line) == 1
    error = capsys.readouterr().err
    assert re.search(r"error: pack train-\w+\.32x32, 00001/0001: .*simDepthImage", error)
    rows = pd.read_csv(tmp_path / "out" / "tiny" / "sim-to-real" / CSV)
    assert rows["rmse"].notna().any()


POSES = """
title = "Poses"
[variants.filled]
title = "DFNet"
method = "dfnet"
[poses.raw]
title = "Head, raw depth"
method = "swindrnet-nocs"
[poses.filled]
title = "Head, DFNet's depth"
method = "swindrnet-nocs"
depth = "filled"
[tests.dreds-catknown-test]
set = "test"
"""


def test_poses_rest_on_the_depth_of_a_variant(tmp_path: Path, own: list[str]) -> None:
    recipe = tmp_path / "poses.toml"
    recipe.write_text(POSES)
    out = tmp_path / "out"
    words = ["recipe", str(recipe), "--scale", "tiny", "--out", str(out), *own[:4], *HERE]
    assert main(words) == 0
    rows = pd.read_csv(out / "tiny" / "poses" / POSES_CSV)
    assert set(rows["kind"]) == {MEASURED}
    assert set(rows["variant"]) == {"Head, raw depth", "Head, DFNet's depth"}
    # One training for both, and frames with coordinates.
    trained = sorted(p.name.partition(".")[0] for p in (out / "tiny" / "training").iterdir())
    assert trained == ["dfnet", "swindrnet-nocs"]
    assert any(".nocs." in p.name for p in (out / "tiny" / "packs").iterdir())
    assert "Poses, DREDS-CatKnown" in (out / "tiny" / "poses" / MARKDOWN).read_text()
    assert "Poses, DREDS-CatKnown" in (out / "tiny" / "poses" / PAGE).read_text()
    # The same command again trains nothing and writes the same.
    before = (out / "tiny" / "poses" / POSES_CSV).read_bytes()
    assert main(words) == 0
    assert (out / "tiny" / "poses" / POSES_CSV).read_bytes() == before
