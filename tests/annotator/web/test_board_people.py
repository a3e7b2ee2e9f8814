"""Three people at one server: sessions of their own, second labels, reviews, and a killed one."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from board_lab import PEOPLE, Hand, Visitor, journal, make_lab, sessions_of, until
from serving import Served

from annotator.session import Session
from std_toolkit.cli.main import main
from std_toolkit.project.shared import make_second
from std_toolkit.project.status import needs_second, project_board
from std_toolkit.scene import Scene
from std_toolkit.scene.review import read_reviews
from tests.std_toolkit.project.lab import template


@pytest.mark.long
def test_three_people_label_and_review_and_a_killed_session_loses_nothing(
    serve: Callable[..., Served], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ann, ben, zoe = PEOPLE
    scenes = {f"s{i}": (PEOPLE[i % 3], "doubtful" if i == 4 else "fits") for i in range(12)}
    project, tokens = make_lab(
        template(tmp_path / "template"),
        tmp_path,
        scenes,
        twice_every=4,  # type: ignore[arg-type]
    )
    # As `project run` does it.
    for item, row in zip(project.record.scenes, project_board(project), strict=True):
        if needs_second(row):
            make_second(project, item)
    again = {"s3": ben, "s7": zoe, "s11": ann}
    server = serve(project.root)

    async def work() -> None:
        async with (
            Visitor(server.url, tokens[ann]) as a,
            Visitor(server.url, tokens[ben]) as b,
            Visitor(server.url, tokens[zoe]) as z,
        ):
            visitors = {ann: a, ben: b, zoe: z}
            # The doubtful scene comes first, and nobody reviews their own.
            assert (await a.due())[0] == "s4"
            assert not {*await b.due()} & {name for name, (who, _) in scenes.items() if who == ben}
            opened = zip((a, b, z), ("s0", "s1", "s2"), strict=True)
            paths = await asyncio.gather(*(v.open(name) for v, name in opened))
            assert paths == ["/at/edit/s0/", "/at/edit/s1/", "/at/edit/s2/"]
            hands = [await Hand.at(v, p) for v, p in zip((a, b, z), paths, strict=True)]
            for hand, times in zip(hands, (1, 2, 3), strict=True):
                for _ in range(times):
                    await hand.key("Left")
            for name, times in (("s0", 1), ("s1", 2), ("s2", 3)):
                wanted = ["begun", *["edit"] * times]
                await until(lambda n=name, w=wanted: journal(tmp_path / n) == w)
            # The page of another person is not there for them.
            assert (await b.get("/at/edit/s0/annotator/page.css"))[1].startswith("<!doctype")
            status, page = await b.post("/scenes/s0/open", mode="edit")
            assert status == 409 and "Ann has s0 open since" in page
            assert await b.open("s0", "look") == "/at/look/s0/"
            # Killed in the middle of a drag.
            await hands[2].begin_drag()
            os.kill(sessions_of(server.process.pid)["s2"], signal.SIGKILL)
            await until(lambda: "s2" not in sessions_of(server.process.pid))
            assert journal(tmp_path / "s2") == ["begun", "edit", "edit", "edit"]
            # Its page tries again and finds a new session of the scene; the others go on.
            while (found := await z.get("/at/edit/s2/index.html"))[0] == 502:
                await asyncio.sleep(0.1)  # the server did not notice yet
            status, page = found
            assert status == 200 and "annotator/start.js" in page
            await hands[0].key("Left")
            await until(lambda: journal(tmp_path / "s0").count("edit") == 2)
            for hand in hands[:2]:
                for _ in range(2):
                    await hand.key("Ctrl+Z")
            await until(lambda: journal(tmp_path / "s1").count("undo") == 2)
            for visitor, name in ((a, "s0"), (b, "s1"), (b, "s0"), (z, "s2")):
                status, page = await visitor.post(f"/scenes/{name}/close")
                assert status == 200
            await until(lambda: not sessions_of(server.process.pid))
            # The second labels: nobody sees the first ones, and nobody else may make them.
            for name, person in again.items():
                path = await visitors[person].open(name, "again")
                assert path == f"/at/again/{name}/"
                hand, copy = await Hand.at(visitors[person], path), project.root / "second" / name
                assert Scene.open(copy).labels.labels == []
                await hand.place("box_1")
                await until(lambda c=copy: journal(c) == ["begun", "edit"])
                for key in ("Left", "Up"):
                    await hand.key(key)
                await until(lambda c=copy: journal(c).count("edit") == 3)
                await hand.key("Ctrl+S")
                await until(lambda c=copy: len(Scene.open(c).labels.labels) == 1)
                assert (await visitors[person].post(f"/scenes/{name}/close"))[0] == 200
            # Everybody reviews until nothing is due.
            for person, visitor in visitors.items():
                while due := await visitor.due():
                    form = {"press": "accept"}
                    status, page = await visitor.post(f"/scenes/{due[0]}/review", **form)
                    if status != 200:
                        assert due[0] == "s4" and f"has no reason of {person}" in page
                        form["about: box_1"] = "the rim fits"
                        status, page = await visitor.post(f"/scenes/{due[0]}/review", **form)
                    assert status == 200, page
            assert [await v.due() for v in visitors.values()] == [[], [], []]

    asyncio.run(work())
    assert server.stop() == 130
    assert {row.stage for row in project_board(project)} == {"accepted"}
    by = {name: read_reviews(tmp_path / name).reviews[-1].by for name in scenes}
    assert all(by[name] in PEOPLE and by[name] != who for name, (who, _) in scenes.items())
    assert all(by[name] != second for name, second in again.items())
    # The poses of the second copies, and what two people agree on.
    assert main(["project", "run", str(project.root), "--workers", "1"]) == 0
    capsys.readouterr()
    main(["project", "agreement", str(project.root), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert {(p["scene"], *p["people"]) for p in found["pairs"]} == {
        ("s3", "A", "B"), ("s7", "B", "C"), ("s11", "C", "A")
    }  # fmt: skip
    assert found["all"]["labels"] == 3 and found["problems"] == {}
    main(["project", "agreement", str(project.root)])
    assert "all" in capsys.readouterr().out
    with Session.open(tmp_path / "s2", annotator=zoe, recover="yes") as session:
        assert session.unsaved and len(session.steps) == 3


@pytest.mark.slow
def test_a_revoked_token_ends_the_session_and_the_server_takes_all_with_it(
    serve: Callable[..., Served], tmp_path: Path
) -> None:
    from std_toolkit.project.people import make_token, revoke_token

    scenes = {"one": ("", None), "two": ("", None)}
    project, tokens = make_lab(template(tmp_path / "template"), tmp_path, scenes)  # type: ignore[arg-type]
    server = serve(project.root)

    async def work() -> None:
        async with (
            Visitor(server.url, tokens["Ann"]) as a,
            Visitor(server.url, tokens["Ben"]) as b,
        ):
            await asyncio.gather(a.open("one"), b.open("two"))
            hand = await Hand.at(a, "/at/edit/one/")
            revoke_token(project, "Ann")
            await until(lambda: hand.socket.closed)
            await until(lambda: [*sessions_of(server.process.pid)] == ["two"])
            assert (await a.get("/"))[0] == (await a.get("/at/edit/two/"))[0] == 401
            new = make_token(project, "Ann")
            assert (await a.get("/"))[0] == 401
            async with Visitor(server.url, new) as again:
                assert "You are <b>Ann</b>" in (await again.get("/"))[1]

    asyncio.run(work())
    sessions = sessions_of(server.process.pid)
    server.process.send_signal(signal.SIGKILL)
    server.process.wait()

    def alive(pid: int) -> bool:
        status = Path(f"/proc/{pid}/status")
        return status.is_file() and "State:\tZ" not in status.read_text()

    assert [*sessions] == ["two"]
    asyncio.run(until(lambda: not any(alive(pid) for pid in sessions.values())))
