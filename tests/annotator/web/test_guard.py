"""Who may talk to the browser front end."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from aiohttp import ClientSession, CookieJar, web
from aiohttp.test_utils import TestServer

from annotator.web.guard import check_address, guard, is_loopback, opens_to
from std_toolkit.errors import ToolkitError

TOKEN = "0123456789abcdef"


def serve(
    token: str | None, visit: Callable[[ClientSession, str], Coroutine[Any, Any, Any]]
) -> Any:
    """What `visit(client, base address)` finds on a guarded server that says "inside"."""

    async def page(_: web.Request) -> web.Response:
        return web.Response(text="inside")

    async def run() -> Any:
        app = web.Application(
            middlewares=[guard(opens_to(token) if token else None, loopback=True)]
        )
        app.add_routes([web.get("/", page), web.get("/ws", page)])
        async with (
            TestServer(app, host="127.0.0.1") as server,
            ClientSession(cookie_jar=CookieJar(unsafe=True)) as client,
        ):
            return await visit(client, f"http://127.0.0.1:{server.port}")

    return asyncio.run(run())


def status_of(path: str, token: str | None = None, **headers: str) -> int:
    async def visit(client: ClientSession, base: str) -> int:
        async with client.get(base + path, headers=headers, allow_redirects=False) as answer:
            return answer.status

    return int(serve(token, visit))


def test_this_machine_comes_in() -> None:
    assert status_of("/") == 200


def test_a_page_of_another_site_may_not_use_the_users_browser() -> None:
    assert status_of("/ws", Origin="https://elsewhere.example") == 403


def test_a_name_that_was_pointed_at_loopback_is_refused() -> None:
    """DNS rebinding: the browser believes that it talks to the other site."""
    assert status_of("/", Host="elsewhere.example:8080") == 403


@pytest.mark.parametrize("path", ["/", "/ws", "/?token=wrong", "/?token=", "/?token=%ff"])
def test_without_the_token_nothing_is_served(path: str) -> None:
    assert status_of(path, TOKEN) == 401


def test_the_token_becomes_a_cookie_and_leaves_the_address() -> None:
    async def visit(client: ClientSession, base: str) -> tuple[str, str]:
        async with client.get(f"{base}/?token={TOKEN}&view=1") as answer:
            first = (str(answer.url.query_string), await answer.text())
        async with client.get(f"{base}/ws") as answer:
            assert answer.status == 200
        return first

    assert serve(TOKEN, visit) == ("view=1", "inside")


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "127.3.2.1"])
def test_loopback_needs_no_token(host: str) -> None:
    assert is_loopback(host)
    check_address(host, None)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.4", "lab-server", "", "127.evil.org"])
def test_any_other_address_needs_one(host: str) -> None:
    with pytest.raises(ToolkitError, match="token"):
        check_address(host, None)
    check_address(host, TOKEN)


@pytest.mark.parametrize("token", ["", "short", "x" * 15, "x" * 20 + "\n"])
def test_a_token_that_can_be_guessed_is_refused(token: str) -> None:
    with pytest.raises(ToolkitError, match="16"):
        check_address("0.0.0.0", token)
