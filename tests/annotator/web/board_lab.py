"""A project with people at the server of its board: real HTTP, real web sockets."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aiohttp import ClientSession, ClientWebSocketResponse, CookieJar, WSMsgType

from std_toolkit.project.people import make_token
from std_toolkit.project.record import Project, Rules, create_project
from std_toolkit.scene.judgement import Grade
from tests.std_toolkit.project.lab import copied

PEOPLE = ("Ann", "Ben", 'Zoë "<b>')
Labelled = Mapping[str, tuple[str, Grade | None]]


def make_lab(
    template: Path, root: Path, scenes: Labelled, *, twice_every: int = 0
) -> tuple[Project, dict[str, str]]:
    """A project of copies of a scene, by name who labelled it and the verdict; a token each."""
    for name, (by, grade) in scenes.items():
        copied(template, root / name, by=by, grade=grade)
    folders = [root / name for name in scenes]
    project, problems = create_project(
        root / "lab", scenes=folders, people=PEOPLE, rules=Rules(twice_every=twice_every)
    )
    assert problems == []
    return project, {name: make_token(project, name) for name in PEOPLE}


class Visitor:
    """A browser of one person; use as an asynchronous context manager."""

    def __init__(self, url: str, token: str | None) -> None:
        self.url = url.rstrip("/")
        self._token = token

    async def __aenter__(self) -> Visitor:
        self.http = ClientSession(cookie_jar=CookieJar(unsafe=True))
        if self._token is not None:
            async with self.http.get(f"{self.url}/?token={self._token}") as answer:
                assert answer.status == 200, await answer.text()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.http.close()

    async def get(self, path: str, **headers: str) -> tuple[int, str]:
        async with self.http.get(self.url + path, headers=headers) as answer:
            return answer.status, await answer.text(errors="replace")

    async def post(self, path: str, *, origin: str | None = "", **form: str) -> tuple[int, str]:
        """Send a form as the page of this server does, or with another origin; None sends none."""
        headers = {} if origin is None else {"Origin": origin or self.url}
        async with self.http.post(self.url + path, data=form, headers=headers) as answer:
            return answer.status, str(answer.url.path) + "\n" + await answer.text(errors="replace")

    async def due(self) -> list[str]:
        """The scenes of "next for me"."""
        _, page = await self.get("/")
        part = page.split('id="next"')[1].split('id="all"')[0]
        return re.findall(r'<a id="(?:first|due-\d+)" href="/scenes/([^"]+)"', part)

    async def open(self, name: str, mode: str = "edit") -> str:
        """Open a scene; returns the path of its session."""
        status, page = await self.post(f"/scenes/{name}/open", mode=mode)
        assert status == 200, page
        return page.split("\n")[0]


class Hand:
    """Mouse and keys in an open scene, as its page sends them."""

    def __init__(self, socket: ClientWebSocketResponse) -> None:
        self.socket = socket
        self.moved = 0
        self._reading = asyncio.create_task(self._read())

    @staticmethod
    async def at(visitor: Visitor, path: str) -> Hand:
        socket = await visitor.http.ws_connect(f"{visitor.url}{path}views", origin=visitor.url)
        hand = Hand(socket)
        await hand.send(type="sizes", sizes=[[400, 300]], ratio=1)
        return hand

    async def _read(self) -> None:
        """Take what comes, as a browser does, which also answers pings."""
        async for message in self.socket:
            if message.type is WSMsgType.TEXT:
                self.moved = json.loads(message.data).get("moved", self.moved)
            elif message.type is WSMsgType.BINARY:
                image = int.from_bytes(message.data[4:8], "little")
                await self.send(type="shown", view=message.data[0], number=image)

    async def send(self, **message: Any) -> None:
        await self.socket.send_str(json.dumps(message))

    async def key(self, name: str) -> None:
        await self.send(type="key", name=name)

    async def place(self, name: str) -> None:
        """Drop an object of the list onto the middle of the main view."""
        await self.send(type="drop", view=0, x=0.5, y=0.5, what="object", name=name)

    async def begin_drag(self) -> None:
        """Press on the middle of the main view and move, without letting go."""
        await self.send(type="pointer", view=0, kind="down", x=0.5, y=0.5)
        for i in range(1, 6):
            await self.send(type="pointer", view=0, kind="move", x=0.5 + i / 50, y=0.5, number=i)
        await until(lambda: self.moved == 5)


def journal(scene: Path) -> list[str]:
    """The kinds of the lines of a scene's journal; empty without one."""
    path = scene / ".std/annotate/journal.jsonl"
    if not path.is_file():
        return []
    return [json.loads(line)["entry"]["line"] for line in path.read_text().splitlines()]


async def until(wanted: Any, seconds: float = 60.0) -> None:
    """Wait until `wanted()` is true."""
    for _ in range(round(seconds / 0.05)):
        if wanted():
            return
        await asyncio.sleep(0.05)
    raise AssertionError("did not happen")


def sessions_of(server: int) -> dict[str, int]:
    """The processes that a server started: id by name of the scene."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((path / "stat").read_text().rsplit(")", 1)[1].split()[1])
            words = (path / "cmdline").read_bytes().split(b"\0")
        except (OSError, ValueError, IndexError):
            continue
        if parent == server and b"annotator.cli" in words:
            scene = words[words.index(b"annotator.cli") + 1].decode()
            found[Path(scene).name] = int(path.name)
    return found
