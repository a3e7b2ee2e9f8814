"""The server of a project's board: who may do what, and what hostile requests find."""

from __future__ import annotations

import asyncio
import os
import socket
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from aiohttp import WSServerHandshakeError
from board_lab import PEOPLE, Visitor, make_lab

from annotator.cli import main
from annotator.session import Session
from annotator.web.board_app import BoardServer
from std_toolkit.errors import ToolkitError
from std_toolkit.io import locks
from std_toolkit.io.locks import DEAD_S
from std_toolkit.project.record import Project
from std_toolkit.project.status import project_board
from std_toolkit.scene.review import read_reviews
from tests.std_toolkit.project.lab import template

pytestmark = pytest.mark.slow

Lab = tuple[Project, dict[str, str]]


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return template(tmp_path_factory.mktemp("lab") / "template")


@pytest.fixture
def lab(rendered: Path, tmp_path: Path) -> Lab:
    """A scene that fits, a doubtful one, a wrong one, and one without a label."""
    scenes = {"fits": ("Ann", "fits"), "doubt": ("Ann", "doubtful"), "bare": ("", None),
              "wrong": ("Ann", "wrong")}  # fmt: skip
    return make_lab(rendered, tmp_path, scenes)  # type: ignore[arg-type]


def visit(lab: Lab, work: Callable[[str], Coroutine[Any, Any, Any]]) -> None:
    """Run `work(address)` while a server of the project runs in this process."""

    async def run() -> None:
        began: asyncio.Queue[int] = asyncio.Queue()
        serving = asyncio.create_task(
            BoardServer(lab[0]).serve(host="127.0.0.1", port=0, started=began.put_nowait)
        )
        try:
            await work(f"http://127.0.0.1:{await began.get()}")
        finally:
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)

    asyncio.run(run())


def test_the_token_decides_who_acts(lab: Lab) -> None:
    project, tokens = lab

    async def work(url: str) -> None:
        async with Visitor(url, None) as nobody:
            for path in ("/", "/scenes/fits", "/board/board.js", "/at/edit/fits/", "/?token=x"):
                assert (await nobody.get(path))[0] == 401
            assert (await nobody.post("/scenes/fits/review", press="accept"))[0] == 401
        async with Visitor(url, tokens[PEOPLE[2]]) as zoe:
            _, page = await zoe.get("/scenes/fits")
            assert "<b>Zoë &#34;&lt;b&gt;</b>" in page and 'Zoë "<b>' not in page
            # A name in the form is nobody's.
            status, _ = await zoe.post("/scenes/fits/review", press="accept", by="Ben")
            assert status == 200
            assert (await zoe.post("/scenes/fits/comment", comment="is it upright?"))[0] == 200
            assert "is it upright?" in (await zoe.get("/scenes/fits"))[1]
        async with Visitor(url, tokens["Ann"]) as ann:
            status, page = await ann.post("/scenes/doubt/review", press="accept")
            assert status == 409 and "who labelled a scene may not review it" in page
            assert 'id="review"' not in (await ann.get("/scenes/doubt"))[1]
            assert (await ann.post("/scenes/doubt/comment", comment=" "))[0] == 409

    visit(lab, work)
    (first, second) = read_reviews(project.folder(project.find("fits"))).reviews
    assert (first.by, first.verdict) == (PEOPLE[2], "accepted")
    assert (second.by, second.verdict, second.reason) == (PEOPLE[2], "noted", "is it upright?")
    assert {r.name: r.stage for r in project_board(project)}["fits"] == "accepted"


def test_reviews_on_the_page_keep_the_rules_and_what_was_typed(lab: Lab) -> None:
    project, tokens = lab

    async def work(url: str) -> None:
        async with Visitor(url, tokens["Ben"]) as ben:
            assert (await ben.due())[:2] == ["doubt", "fits"]
            assert "it doubtful" in (await ben.get("/"))[1]
            status, page = await ben.post("/scenes/doubt/review", press="accept")
            assert status == 409 and "box_1 is doubtful and has no reason of Ben" in page
            status, page = await ben.post("/scenes/wrong/review", press="accept")
            assert status == 409 and "the check calls box_1 wrong" in page
            status, page = await ben.post(
                "/scenes/doubt/review", press="send_back", **{"about: box_1": 'so "it" <is>'}
            )
            assert status == 409 and "say what is wrong" in page
            assert "so &#34;it&#34; &lt;is&gt;" in page
            for form in ({}, {"press": "delete"}):
                assert (await ben.post("/scenes/doubt/review", **form))[0] == 409
            long = await ben.post("/scenes/doubt/review", press="send_back", back="x" * 3000)
            assert long[0] == 409
            status, _ = await ben.post("/scenes/doubt/review", press="send_back", back="turned")
            assert status == 200
            assert "Sent back by Ben: turned" in (await ben.get("/scenes/doubt"))[1]

    visit(lab, work)
    (row,) = read_reviews(project.folder(project.find("doubt"))).reviews
    assert (row.by, row.verdict, row.reason, row.reasons) == ("Ben", "sent back", "turned", {})


def test_hostile_requests_find_nothing(lab: Lab, tmp_path: Path) -> None:
    project, tokens = lab
    (tmp_path / "secret.txt").write_text("secret")

    async def work(url: str) -> None:
        async with Visitor(url, tokens["Ben"]) as ben:
            for origin in ("https://elsewhere.example", "null", "http://127.0.0.1:1", None):
                form = {"origin": origin, "press": "accept"}
                assert (await ben.post("/scenes/fits/review", **form))[0] == 403  # type: ignore[arg-type]
                assert (await ben.post("/scenes/fits/open", origin=origin))[0] == 403
            assert (await ben.get("/", Host="elsewhere.example"))[0] == 403
            assert (await ben.get("/", Origin="https://elsewhere.example"))[0] == 403
            names = ("..", "%2e%2e", "..%2f..%2fsecret.txt", "none", "%00", "fits%2f..", "../fits")
            for name in names:
                for rest in ("", "/picture", "/report"):
                    path = f"/scenes/{name}{rest}"
                    status, text = await ben.get(path)
                    assert status in (400, 404) or text.startswith("<!doctype"), (path, status)
                    assert "secret" not in text
            for path in ("/board/..%2f..%2fboard_app.py", "/board/%2e%2e/board_app.py",
                         "/at/edit/fits/../../../secret.txt", "/at/root/fits/"):  # fmt: skip
                status, text = await ben.get(path)
                assert "import" not in text and "secret" not in text
            # A scene that is not open leads to the board, and its socket nowhere.
            assert "Next for me" in (await ben.get("/at/edit/fits/"))[1]
            with pytest.raises(WSServerHandshakeError):
                await ben.http.ws_connect(f"{url}/at/edit/fits/views", origin=url)
            assert (await ben.post("/scenes/fits/open", mode="root"))[0] == 400
            assert (await ben.post("/scenes/fits/open", mode="again"))[0] == 409
            assert (await ben.post("/scenes/fits/comment", comment="x" * 400_000))[0] == 413
            async with ben.http.get(url) as answer:
                policy = answer.headers["Content-Security-Policy"]
                assert "script-src 'self';" in policy and "unsafe" not in policy
                assert answer.headers["X-Frame-Options"] == "DENY"
            async with ben.http.get(f"{url}/scenes/fits/report") as answer:
                assert answer.headers["Content-Security-Policy"].startswith("sandbox ")
            (cookie,) = [c for c in ben.http.cookie_jar if c.key.startswith("std_annotate")]
            assert cookie["httponly"] and cookie["samesite"] == "Strict"

    visit(lab, work)
    assert all(not read_reviews(project.folder(s)).reviews for s in project.record.scenes)


def test_a_scene_that_cannot_be_opened_says_why(lab: Lab) -> None:
    project, tokens = lab
    (project.folder(project.find("fits")) / "labels.json").write_text("{")

    async def work(url: str) -> None:
        async with Visitor(url, tokens["Ben"]) as ben:
            _, page = await ben.get("/")
            assert "unreadable" in page and "labels.json" in page
            status, page = await ben.post("/scenes/fits/open", mode="edit")
            assert status == 409 and "not valid JSON" in page
            assert (await ben.get("/scenes/fits/picture"))[0] == 404
            # What is known is not sent, drawn or read again.
            async with ben.http.get(url) as answer:
                known = {"If-None-Match": answer.headers["ETag"]}
            async with ben.http.get(url, headers=known) as answer:
                assert answer.status == 304
            (project.root / "project.json").write_text("{")
            await asyncio.sleep(1.1)
            status, page = await ben.get("/")
            assert status == 500 and "project.json" in page

    visit(lab, work)


def test_a_scene_of_a_computer_that_is_gone_is_taken_over(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    project, tokens = lab
    root = project.folder(project.find("bare"))

    async def work(url: str) -> None:
        async with Visitor(url, tokens["Ben"]) as ben:
            assert "Ann (lab2) has it open" in (await ben.get("/"))[1]
            status, page = await ben.post("/scenes/bare/open", mode="edit")
            assert status == 409 and 'name="take_over"' in page, page
            assert "annotator Ann" in page
            status, page = await ben.post("/scenes/bare/open", mode="edit", take_over="1")
            assert status == 200 and page.startswith("/at/edit/bare/")

    with monkeypatch.context() as there:
        there.setattr(socket, "gethostname", lambda: "lab2")
        there.setattr(locks, "BEAT_S", 1e6)
        held = Session.open(root, annotator="Ann")
    old = time.time() - DEAD_S - 60
    os.utime(root / ".std/annotate.lock", (old, old))
    visit(lab, work)
    with pytest.raises(ToolkitError, match="took this scene over"):
        held.undo()
    held.close()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--web", "0", "--token", "0123456789abcdef"], "each person has a token"),
        (["--web", "0", "--annotator", "Max"], "no such person"),
        (["--web", "0"], "nobody of the project has a token"),
        (["--read-only"], "this is a project"),
        (["--script", "x.json"], "this is a project"),
    ],
)
def test_wrong_options_are_one_line(
    lab: Lab, words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (lab[0].root / ".std/tokens.json").unlink()
    assert main([str(lab[0].root), *words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line
