"""Pictures go to each browser at its own pace, and one hand at a time holds a button."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from aiohttp import ClientSession, ClientWebSocketResponse, WSMsgType, web
from aiohttp.test_utils import TestServer

from annotator.web.channel import UNDER_WAY, Drop, Key, Pointer, ViewChannel

WAIT_S = 30.0


class Desk:
    """Notes what it is told."""

    def __init__(self) -> None:
        self.told: list[Any] = []
        self.wanted_views: list[int] = []

    def pointer(self, event: Pointer) -> None:
        self.told.append((event.view, event.kind))

    def give_up(self, view: int) -> None:
        self.told.append((view, "given up"))

    def key(self, event: Key) -> None:
        self.told.append(event.name)

    def drop(self, event: Drop) -> None:
        self.told.append((event.view, event.name))

    def resize(self, sizes: Sequence[tuple[int, int]], ratio: float) -> None:  # noqa: ARG002
        self.told.append([tuple(s) for s in sizes])

    def wanted(self, view: int) -> None:
        self.wanted_views.append(view)

    def failed(self, error: Exception) -> None:
        raise error


class Tab:
    """A browser, played by the test."""

    def __init__(self, socket: ClientWebSocketResponse) -> None:
        self.socket = socket

    async def say(self, type: str, **values: Any) -> None:
        await self.socket.send_str(json.dumps({"type": type, **values}))

    async def appear(self, width: int = 100) -> None:
        await self.say("sizes", sizes=[[width, 50], [40, 20]], ratio=1)

    async def picture(self) -> tuple[int, int, bytes]:
        """View, number and content of the next picture."""
        while True:
            message = await self.socket.receive(timeout=WAIT_S)
            assert message.type in (WSMsgType.BINARY, WSMsgType.TEXT), message
            if message.type is WSMsgType.BINARY:
                return (
                    message.data[0],
                    int.from_bytes(message.data[4:8], "little"),
                    message.data[8:],
                )


Play = Callable[[ViewChannel, Desk, Callable[[], Awaitable[Tab]]], Awaitable[None]]


def play(scene: Play) -> None:
    async def run() -> None:
        desk = Desk()
        channel = ViewChannel(desk, views=2, keys=["R"])
        app = web.Application()
        app.add_routes([web.get("/views", channel.serve)])
        async with TestServer(app, host="127.0.0.1") as server, ClientSession() as client:

            async def open_tab() -> Tab:
                return Tab(await client.ws_connect(server.make_url("/views")))

            await scene(channel, desk, open_tab)
            await channel.close()

    asyncio.run(run())


async def until(condition: Callable[[], Any]) -> None:
    async with asyncio.timeout(WAIT_S):
        while not condition():
            await asyncio.sleep(0.005)


def test_a_page_that_is_behind_gets_the_latest_picture_next() -> None:
    async def scene(channel: ViewChannel, desk: Desk, open_tab: Any) -> None:
        tab = await open_tab()
        await tab.appear()
        await until(lambda: channel.can_take(0))
        for content in (b"a", b"b", b"c", b"d"):
            channel.send(0, content)
        assert UNDER_WAY == 2 and not channel.can_take(0)
        first, second = await tab.picture(), await tab.picture()
        assert (first[2], second[2]) == (b"a", b"b")
        await tab.say("shown", view=0, number=first[1])
        assert (await tab.picture())[2] == b"d"

    play(scene)


def test_a_page_that_takes_no_pictures_holds_up_no_other() -> None:
    async def scene(channel: ViewChannel, desk: Desk, open_tab: Any) -> None:
        stuck, quick = await open_tab(), await open_tab()
        await stuck.appear()
        await quick.appear()
        await until(lambda: len(desk.told) >= 1 and channel.can_take(0))
        await quick.say("key", name="R")
        await until(lambda: "R" in desk.told)
        for i in range(20):
            await until(lambda: channel.can_take(0))
            channel.send(0, b"%d" % i)
            _, number, content = await quick.picture()
            assert content == b"%d" % i
            await quick.say("shown", view=0, number=number)

    play(scene)


def test_a_hidden_page_and_one_without_the_view_get_nothing() -> None:
    async def scene(channel: ViewChannel, desk: Desk, open_tab: Any) -> None:
        tab = await open_tab()
        await tab.say("sizes", sizes=[[100, 50]], ratio=2)
        await until(lambda: channel.can_take(0))
        assert not channel.can_take(1)
        await tab.say("sight", visible=False)
        await until(lambda: not channel.can_take(0))
        channel.send(0, b"unseen")
        await tab.say("sight", visible=True)
        assert (await tab.picture())[2] == b"unseen"

    play(scene)


def test_while_a_button_is_held_other_pointers_rest() -> None:
    async def scene(channel: ViewChannel, desk: Desk, open_tab: Any) -> None:
        one, other = await open_tab(), await open_tab()
        await one.say("pointer", view=0, kind="down")
        await until(lambda: (0, "down") in desk.told)
        for kind in ("down", "move", "up", "wheel"):
            await other.say("pointer", view=1, kind=kind)
        await other.say("key", name="R")  # keys do not rest: Esc ends a drag
        await until(lambda: "R" in desk.told)
        await one.say("pointer", view=0, kind="up")
        await until(lambda: (0, "up") in desk.told)
        await other.say("pointer", view=1, kind="down")
        await until(lambda: (1, "down") in desk.told)
        assert desk.told == [(0, "down"), "R", (0, "up"), (1, "down")]

    play(scene)


def test_a_page_that_goes_away_lets_go_of_the_button() -> None:
    async def scene(channel: ViewChannel, desk: Desk, open_tab: Any) -> None:
        tab = await open_tab()
        await tab.say("pointer", view=1, kind="down")
        await until(lambda: desk.told)
        await tab.socket.close()
        await until(lambda: (1, "given up") in desk.told)

    play(scene)


def test_the_views_have_the_size_of_the_page_in_which_something_was_done_last() -> None:
    async def scene(channel: ViewChannel, desk: Desk, open_tab: Any) -> None:
        one, other = await open_tab(), await open_tab()
        await one.appear(300)
        await until(lambda: [(300, 50), (40, 20)] in desk.told)
        await other.appear(200)
        await until(lambda: [(200, 50), (40, 20)] in desk.told)
        await one.say("key", name="R")
        await until(lambda: desk.told[-2:] == [[(300, 50), (40, 20)], "R"])
        await one.socket.close()
        await until(lambda: desk.told[-1] == [(200, 50), (40, 20)])

    play(scene)


def test_what_no_page_of_ours_sends_ends_the_connection() -> None:
    async def scene(channel: ViewChannel, desk: Desk, open_tab: Any) -> None:
        for nonsense in ("{}", "[", '{"type": "pointer", "view": 9, "kind": "down"}',
                         '{"type": "pointer", "view": 0, "kind": "down", "x": 1e9}',
                         '{"type": "key", "name": "R", "run": "rm"}'):  # fmt: skip
            tab = await open_tab()
            await tab.socket.send_str(nonsense)
            while (await tab.socket.receive(timeout=WAIT_S)).type is WSMsgType.TEXT:
                pass
            assert tab.socket.close_code == 1008
        assert desk.told == []

    play(scene)
