"""`std-report site`: boards of what may be ranked together, in a browser without a network."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
import pytest
from hostile_pages import PAYLOADS, harm

from benchmark.cli.report import main
from benchmark.evaluation.engine import run_all
from benchmark.evaluation.query_options import VerifyOptions
from benchmark.evaluation.tasks.depth_speed import Speed
from benchmark.evaluation.verify import verify
from benchmark.published.load import GRADES
from benchmark.report.page import make_parts, render_page
from benchmark.report.site import readers
from benchmark.report.site.build import build_site
from benchmark.report.site.pages import file_of
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import write_document
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import SPLIT, a_run, published_as, write_split

if TYPE_CHECKING:
    from playwright.sync_api import Page

JOBS = JobOptions(engine="serial", progress=False)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data and the results of two people: whole runs, and a part of the frames."""
    top = tmp_path_factory.mktemp("site")
    root = write_split(top / "data", scenes=3, frames=3)
    one = [a_run(root, top / "one", m, save_depth=True) for m in ("raw", "nearest", "telea")]
    two = [
        a_run(root, top / "two", "nearest", limit=4, gallery=False),
        a_run(root, top / "two", "planes", gallery=False),
    ]
    assert not run_all([*one, *two], JOBS).failed
    return top


@pytest.fixture
def copies(made: Path, tmp_path: Path) -> Path:
    for name in ("one", "two"):
        shutil.copytree(made / name, tmp_path / name)
    return tmp_path


def site_of(top: Path, **options: object) -> pd.DataFrame:
    build_site([top / "one", top / "two"], top / "site", **options)  # type: ignore[arg-type]
    return pd.read_parquet(top / "site" / "results.parquet")


def boards_of(table: pd.DataFrame) -> dict[tuple[str, ...], list[str]]:
    """Ranked methods of each board and class, best first."""
    rows = table[(table["subset"] == "all") & table["rank"].notna()]
    keys = ["data", "protocol", "scored", "selection", "series", "class"]
    return {
        tuple(map(str, key)): mine.sort_values("rank")["method"].tolist()
        for key, mine in rows.groupby(keys)
    }


def edit(path: Path, change: Callable[[dict[str, object]], None]) -> None:
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def test_a_part_of_the_frames_is_another_board(copies: Path) -> None:
    table = site_of(copies)
    boards = boards_of(table)
    assert sorted(len(m) for m in boards.values()) == [1, 4]
    scored = {key[2]: methods for key, methods in boards.items()}
    assert scored["4 of 9 frames"] == ["nearest (two)"]
    rmse = table[(table["subset"] == "all") & (table["scored"] == "9 frames")].set_index("method")
    assert scored["9 frames"] == rmse["rmse"].sort_values().index.tolist()
    assert (rmse["rmse_low"] <= rmse["rmse"]).all() and (rmse["rmse"] <= rmse["rmse_high"]).all()
    csv = pd.read_csv(copies / "site" / "results.csv")
    assert csv["rmse"].tolist() == pytest.approx(table["rmse"].tolist(), rel=1e-12)


def test_changed_data_another_version_and_another_class_are_other_boards(copies: Path) -> None:
    planes = copies / "two" / SPLIT / "planes" / "strict"
    edit(planes / "run.json", lambda d: d.update(version_of_tool="0.1.0"))
    assert len(boards_of(site_of(copies))) == 3
    content = pd.read_parquet(planes / "data.parquet")
    content.loc[content["content"] == "ground-truth depth", "digest"] = "0" * 32
    content.to_parquet(planes / "data.parquet")
    edit(planes / "run.json", lambda d: d.update(version_of_tool="0.2.0"))
    assert len({key[0] for key in boards_of(site_of(copies))}) == 2
    speed = Speed(
        frames_per_s=5, batch_size=1, width=640, height=480, repeats=3, parameters=None,
        gmacs=None, peak_memory_mib=1, hardware="a processor", processor_s=0.4, standard_s=0.2,
        load=0.0,
    )  # fmt: skip
    write_document(copies / "one" / SPLIT / "telea" / "strict" / "speed.json", speed)
    boards = boards_of(site_of(copies))
    assert ["telea"] in [m for key, m in boards.items() if key[-1] == "cpu"]


def test_unanswered_frames_leave_the_ranking(copies: Path) -> None:
    path = copies / "one" / SPLIT / "nearest" / "strict" / "images.parquet"
    table = pd.read_parquet(path)
    table[table["frame"] != "0001"].to_parquet(path)
    found = site_of(copies)
    row = found[(found["method"] == "nearest (one)") & (found["subset"] == "all")].iloc[0]
    assert pd.isna(row["rank"]) and row["unanswered"] == 3
    text = (copies / "site" / "boards").glob("*9-frames*")
    assert "9 (3 unanswered)" in next(text).read_text()


def test_grades_come_from_records_that_are_named(made: Path, copies: Path) -> None:
    """One that comes with results is their author's word."""
    options = VerifyOptions(results=(copies / "one",), data=(str(made / "data"),), jobs=JOBS)
    write_document(copies / "one" / "verification.json", verify(options))
    assert set(site_of(copies)["grade"]) == {"reported"}
    table = site_of(copies, verified=[copies / "one" / "verification.json"])
    grades = table.drop_duplicates("run").set_index("method")["grade"].to_dict()
    assert grades["nearest (one)"] == "recomputed" and grades["nearest (two)"] == "reported"
    page = (copies / "site" / file_of("methods", "nearest (one)")).read_text()
    assert "equal to the last bit" in page
    edit(copies / "one" / SPLIT / "nearest" / "strict" / "run.json", lambda d: d.update(root="x"))
    table = site_of(copies, verified=[copies / "one" / "verification.json"])
    assert "recomputed" not in set(table[table["method"] == "nearest (one)"]["grade"])


def test_the_same_results_give_the_same_bytes(copies: Path) -> None:
    words = ["site", str(copies / "one"), "--out", str(copies / "site")]
    assert main(words) == 0

    def files() -> dict[str, bytes]:
        found = (p for p in (copies / "site").rglob("*") if p.is_file() and ".std" not in p.parts)
        return {p.name: p.read_bytes() for p in found}

    first = files()
    assert main(words) == 0 and files() == first
    shutil.rmtree(copies / "one" / SPLIT / "telea")
    assert main(words) == 0
    assert file_of("methods", "telea").partition("/")[2] not in files()  # pages of no run go


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs on frames that count as published: all of them by two protocols, and a part."""
    top = tmp_path_factory.mktemp("printed")
    with published_as(4, 2):
        root = write_split(top / "data", scenes=2, frames=2)
        runs = [a_run(root, top / "one", "raw", protocol=p) for p in ("paper", "strict")]
        runs.append(a_run(root, top / "part", "raw", protocol="paper", limit=2))
        assert not run_all(runs, JOBS).failed
    return top


def test_published_rows_stand_beside_whole_published_sets(
    printed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(readers, "published_size", lambda _: 4)
    folders = [printed / "one", printed / "part"]
    build_site(folders, tmp_path / "site")
    pages = [p.read_text() for p in sorted((tmp_path / "site" / "boards").glob("*.html"))]
    of = {(p, f): t for t in pages for p in ("paper", "strict") for f in ("4 frames", "2 of 4")
          if f"protocol {p}: {f}" in t}  # fmt: skip
    assert len(of) == len(pages) == 3
    own, others = 'id="s-published"', 'id="s-published-others"'
    paper, strict, part = (of[k] for k in (
        ("paper", "4 frames"), ("strict", "4 frames"), ("paper", "2 of 4")
    ))  # fmt: skip
    assert own in paper and own not in strict and own not in part
    assert others in paper and others in strict and others not in part
    row = paper[paper.index(own) : paper.index(others)]
    assert "SwinDRNet" in row and "paper text" in row and "arxiv.org/abs/" in row
    assert "Manipulation as in Simulation" not in paper  # another data set
    table = pd.read_csv(tmp_path / "site" / "published.csv")
    assert (table["address"].notna() & table["trust"].isin(GRADES)).all()
    build_site(folders, tmp_path / "site", published=False)
    left = "".join(p.read_text() for p in (tmp_path / "site").rglob("*.html"))
    assert "SwinDRNet" not in left and not (tmp_path / "site" / "published.csv").exists()


def test_what_authors_say_is_on_the_page_of_the_method(copies: Path) -> None:
    said = {"training_data": "own pictures", "hardware": "a board", "device": "gpu",
            "seconds_per_frame": 0.25, "width": 640, "height": 480,
            "citation": "@misc{me,\n  title = {Mine}\n}"}  # fmt: skip
    for name in ("one", "two"):
        folder = copies / name / SPLIT / "nearest" / "strict"
        (folder / "submission.json").write_text(json.dumps(said))
        site_of(copies)
        page = (copies / "site" / file_of("methods", f"nearest ({name})")).read_text()
        for text in ("own pictures", "a board, gpu", "0.25 s at 640x480", "title = {Mine}"):
            assert text in page
    assert (copies / "site" / "citations.bib").read_text().count("title = {Mine}") == 1


@pytest.mark.parametrize("payload", PAYLOADS)
def test_texts_of_others_are_no_markup(copies: Path, payload: str) -> None:
    for path in sorted(copies.rglob("run.json")):

        def spoil(document: dict[str, object]) -> None:
            document["hardware"] = {"processor": payload}
            setup = document["setup"]
            assert isinstance(setup, dict)
            setup["settings"] = {payload: payload}
            setup["preset"] = setup["method"] = setup["weights_sha256"] = payload

        edit(path, spoil)
    edit(
        copies / "one" / SPLIT / "telea" / "strict" / "speed.json",
        lambda d: d.update(hardware=payload),
    ) if (copies / "one" / SPLIT / "telea" / "strict" / "speed.json").exists() else None
    site_of(copies, title=payload)
    for page in (copies / "site").rglob("*.html"):
        assert harm(page.read_text()) == []
        assert payload not in page.read_text()


def test_a_name_with_markup_is_refused_in_a_line(
    copies: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edit(
        copies / "one" / SPLIT / "telea" / "strict" / "run.json",
        lambda d: d.update(label="<script>alert(1)</script>"),
    )
    assert main(["site", str(copies / "one"), "--out", str(copies / "site")]) == 1
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1 and "run.json: label" in error[0]


def test_pictures_of_other_folders_are_not_shown(copies: Path) -> None:
    gallery = copies / "one" / SPLIT / "telea" / "strict" / "gallery"
    outside = copies / "secret.jpg"
    shutil.copy(next(gallery.glob("*.jpg")), outside)

    def lead_out(document: dict[str, object]) -> None:
        for picture in document["pictures"]:  # type: ignore[attr-defined]
            picture["picture"] = str(outside)

    edit(gallery / "gallery.json", lead_out)
    with pytest.raises(ToolkitError, match="is no file of this folder"):
        site_of(copies)
    with pytest.raises(ToolkitError, match="is no file of this folder"):
        render_page(make_parts([copies / "one"], published=False))


def test_names_of_pages() -> None:
    names = ["A/B", "a b", "A B", "x" * 400, "..", "con", "名前"]
    found = [file_of("methods", name) for name in names]
    assert len({f.lower() for f in found}) == len(names)
    assert all(len(f) < 100 and f.count("/") == 1 and ".." not in f for f in found)


def test_a_folder_follows_the_program_as_before(copies: Path) -> None:
    assert main([str(copies / "one")]) == 0
    assert (copies / "one" / "report.html").exists()
    (copies / "user").mkdir()
    (copies / "user" / "notes.txt").write_text("mine")
    words = ["site", str(copies / "one"), "--out", str(copies / "user")]
    assert main(words) == 1 and (copies / "user" / "notes.txt").read_text() == "mine"


@pytest.mark.slow
def test_in_a_browser(copies: Path, page: Page) -> None:
    site_of(copies)
    errors: list[str] = []
    asked: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
    page.on("request", lambda request: asked.append(request.url))
    page.goto((copies / "site" / "index.html").as_uri())
    boards = page.locator("#s-boards tbody tr")
    assert boards.count() == 2
    page.locator("#s-boards input").fill("4 of 9")
    assert boards.locator("visible=true").count() == 1
    assert page.locator("#s-boards .filters span").inner_text() == "1 of 2 rows"
    page.locator("#s-boards input").fill("")
    # To the board of all frames, and on to a method.
    boards.filter(has_text="9 frames").filter(has_not_text="4 of").locator("a").first.click()
    assert "/boards/" in page.url and page.url.endswith("#s-not-stated")
    rows = page.locator("table").first.locator("tbody tr")
    assert rows.first.locator("td").first.inner_text() == "1"
    head = page.locator("table").first.locator("th", has_text="RMSE")
    head.click()
    head.click()
    assert rows.first.locator("td").first.inner_text() == "4"  # the worst first
    rows.filter(has_text="telea").locator("a").click()
    assert page.locator("h1").inner_text() == "telea"
    assert page.locator("img").count() == 3
    page.locator(".links a", has_text="All boards").click()
    assert page.url.endswith("/index.html")
    for width in (1280, 420):
        page.set_viewport_size({"width": width, "height": 800})
        for path in sorted((copies / "site").rglob("*.html")):
            page.goto(path.as_uri())
            assert page.evaluate("document.documentElement.scrollWidth") <= width, path
    assert errors == []
    assert all(url.startswith(("file:", "data:")) for url in asked)
