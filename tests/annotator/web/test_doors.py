"""What a stranger gets from the real server: nothing, by whichever door."""

from __future__ import annotations

import asyncio
import re
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from aiohttp import ClientSession, CookieJar, WSMsgType, WSServerHandshakeError
from scene_on_disk import write_scene
from serving import Served, start
from wslink.chunking import generate_chunks

pytestmark = pytest.mark.slow

TOKEN = "correct-horse-battery-staple"


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A server that wants a token."""
    folder = tmp_path_factory.mktemp("guarded")
    write_scene(folder / "scene")
    server = start(folder / "scene", folder / "web.log", "--token", TOKEN)
    yield server
    server.process.kill()
    server.process.wait()


def raw(port: int, request: str) -> str:
    """The answer to a request exactly as it is written: clients tidy up what they send."""
    with socket.create_connection(("127.0.0.1", port), timeout=60) as line:
        line.sendall(request.replace("\n", "\r\n").encode())
        answer = b""
        while part := line.recv(65536):
            answer += part
    return answer.decode(errors="replace")


def get(port: int, path: str, *, token: str = TOKEN) -> str:
    cookie = f"Cookie: std_annotate_token_{port}={token}\n"
    return raw(port, f"GET {path} HTTP/1.1\nHost: 127.0.0.1:{port}\n{cookie}Connection: close\n\n")


def upgrade(port: int, path: str, origin: str, cookie: str = "") -> str:
    """First line of the answer to a web socket's request."""
    return raw_head(
        port,
        f"GET {path} HTTP/1.1\nHost: 127.0.0.1:{port}\nUpgrade: websocket\nConnection: Upgrade\n"
        f"Sec-WebSocket-Version: 13\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\n"
        f"Origin: {origin}\n{cookie}\n",
    )


def raw_head(port: int, request: str) -> str:
    with socket.create_connection(("127.0.0.1", port), timeout=60) as line:
        line.sendall(request.replace("\n", "\r\n").encode())
        return line.recv(4096).decode(errors="replace").split("\r\n")[0]


@pytest.mark.parametrize("path", ["/ws", "/views"])
def test_a_web_socket_needs_the_token_and_a_page_of_this_server(guarded: Served, path: str) -> None:
    port = guarded.port
    own = f"http://127.0.0.1:{port}"
    cookie = f"Cookie: std_annotate_token_{port}={TOKEN}\n"
    assert " 101 " in upgrade(port, path, own, cookie)
    assert " 401 " in upgrade(port, path, own)
    assert " 401 " in upgrade(port, path, own, cookie.replace("staple", "stable"))
    for origin in ("https://elsewhere.example", "null", f"http://localhost:{port}", own + "0"):
        assert " 403 " in upgrade(port, path, origin, cookie)


def test_a_web_socket_without_a_token_needs_a_page_of_this_server(served: Served) -> None:
    for path in ("/ws", "/views"):
        assert " 101 " in upgrade(served.port, path, f"http://127.0.0.1:{served.port}")
        assert " 403 " in upgrade(served.port, path, "https://elsewhere.example")


@pytest.mark.parametrize(
    "path",
    [
        "/../scene.json",
        "/annotator/../app.py",
        "/annotator/..%2fapp.py",
        "/annotator/%2e%2e/app.py",
        "/assets/..%5c..%5cvue3.py",
        "/annotator//etc/passwd",
        "//etc/passwd",
        "/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
        "/annotator/",
    ],
)
def test_no_path_leads_out_of_the_pages_own_files(guarded: Served, path: str) -> None:
    answer = get(guarded.port, path)
    assert re.match(r"HTTP/1.1 40[0-9] ", answer), answer[:200]
    assert "root:" not in answer and "import" not in answer and '"cameras"' not in answer


def test_the_page_talks_to_nobody_else_and_is_in_nobodys_frame(guarded: Served) -> None:
    for path in ("/", "/index.html", "/vue.global.js", "/missing"):
        head = get(guarded.port, path).split("\r\n\r\n")[0]
        policy = re.search(r"Content-Security-Policy: (.*)", head)
        assert policy is not None
        own = f"ws://127.0.0.1:{guarded.port} wss://127.0.0.1:{guarded.port}"
        assert f"connect-src 'self' {own};" in policy[1]
        assert "frame-ancestors 'none'" in policy[1] and "X-Frame-Options: DENY" in head
        assert "unsafe-inline" not in policy[1].split("style-src")[0]


def test_the_token_is_printed_once_and_logged_nowhere(guarded: Served) -> None:
    port = guarded.port
    for path in (f"/?token={TOKEN}", "/?token=wrong-wrong-wrong", f"/missing?token={TOKEN}"):
        get(port, path)
    assert guarded.log.read_text().count(TOKEN) == 1
    assert TOKEN not in get(port, "/")


def test_the_cookie_of_one_server_does_not_replace_that_of_another(guarded: Served) -> None:
    """Browsers send the cookies of 127.0.0.1 to each of its ports."""
    answer = get(guarded.port, f"/?token={TOKEN}", token="")
    cookie = re.search(r"Set-Cookie: (.*)", answer)
    assert cookie is not None and cookie[1].startswith(f"std_annotate_token_{guarded.port}=")
    assert "HttpOnly" in cookie[1] and "SameSite=Strict" in cookie[1]


def test_trames_own_password_opens_nothing(served: Served) -> None:
    """Everybody knows the one that it has unless it is given another."""

    async def greet(secret: str) -> Any:
        async with (
            ClientSession(cookie_jar=CookieJar(unsafe=True)) as client,
            client.ws_connect(f"{served.url}/ws") as line,
        ):
            hello = {
                "wslink": "1.0",
                "id": "system:c0:0",
                "method": "wslink.hello",
                "args": [{"secret": secret}],
                "kwargs": {},
            }
            body = msgspec.msgpack.encode(hello)
            for chunk in generate_chunks(body, 1 << 20):
                await line.send_bytes(chunk)
            message = await line.receive(timeout=60)
            assert message.type is WSMsgType.BINARY
            return message.data

    page = get(served.port, "/")
    secret = re.search(r'name="secret" content="([^"]+)"', page)
    assert secret is not None and len(secret[1]) >= 32
    assert b"clientID" in asyncio.run(greet(secret[1]))
    assert b"Authentication failed" in asyncio.run(greet("wslink-secret"))


def test_the_web_socket_refuses_before_it_is_opened(guarded: Served) -> None:
    async def knock() -> int:
        async with ClientSession() as client:
            try:
                await client.ws_connect(f"http://127.0.0.1:{guarded.port}/views")
            except WSServerHandshakeError as refusal:
                return refusal.status
        return 101

    assert asyncio.run(knock()) == 401


def test_trame_hears_neither_our_command_line_nor_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its own options could open the server to others without a token."""
    monkeypatch.setenv("TRAME_ARGS", "--host 0.0.0.0 --authKey known")
    write_scene(tmp_path / "scene")
    server = start(tmp_path / "scene", tmp_path / "web.log")
    try:
        local = f":{server.port:04X}"
        listening = [
            line.split()[1]
            for line in Path("/proc/net/tcp").read_text().splitlines()[1:]
            if line.split()[1].endswith(local) and line.split()[3] == "0A"
        ]
        assert listening == [f"0100007F{local}"]
        assert 'content="known"' not in get(server.port, "/")
    finally:
        server.process.kill()
        server.process.wait()
