"""Passes requests of a browser on to the server of one scene, under a path of its own."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from aiohttp import ClientError, ClientSession, ClientWebSocketResponse, WSMsgType, web

from annotator.web.channel import HEARTBEAT_S

# Of the browser and of the server; all others belong to one connection, or are the guard's matter.
_ASKED = ("Accept", "Accept-Encoding", "If-None-Match", "If-Modified-Since", "Range")
_ANSWERED = ("Content-Type", "Content-Encoding", "Cache-Control", "ETag", "Last-Modified",
             "Content-Range", "Accept-Ranges", "Vary")  # fmt: skip


async def pass_on(
    request: web.Request, client: ClientSession, url: str, headers: dict[str, str]
) -> web.StreamResponse:
    """Answer a request as another server does.

    Args:
        request: GET, HEAD, or the beginning of a web socket.
        client: does not decompress.
        url: of the other server, with the query.
        headers: for the other server, such as its cookie.

    Raises:
        ClientError: the other server is gone.
    """
    if request.headers.get("Upgrade", "").lower() == "websocket":
        return await _pass_socket(request, client, url, headers)
    asked = {name: request.headers[name] for name in _ASKED if name in request.headers}
    async with client.request(
        request.method, url, headers=asked | headers, allow_redirects=False
    ) as found:
        told = {name: found.headers[name] for name in _ANSWERED if name in found.headers}
        # Read as a whole, so that the guard adds its headers: the largest file has a few MB.
        return web.Response(status=found.status, headers=told, body=await found.read())


async def _pass_socket(
    request: web.Request, client: ClientSession, url: str, headers: dict[str, str]
) -> web.StreamResponse:
    wanted = request.headers.get("Sec-WebSocket-Protocol", "")
    protocols = [name.strip() for name in wanted.split(",") if name.strip()]
    async with client.ws_connect(
        url, headers=headers, protocols=protocols, max_msg_size=0, autoclose=False
    ) as far:
        near = web.WebSocketResponse(
            heartbeat=HEARTBEAT_S,
            compress=False,
            max_msg_size=0,
            protocols=[far.protocol] if far.protocol else (),
        )
        await near.prepare(request)
        ways = [asyncio.create_task(_pump(a, b)) for a, b in ((near, far), (far, near))]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            code = near.close_code or far.close_code or 1001
            for end in (near, far):
                with suppress(ClientError, ConnectionError):
                    # A code that only stands for a lost connection may not be sent.
                    await end.close(code=code if 1000 <= code < 5000 and code != 1006 else 1001)
        return near


Socket = web.WebSocketResponse | ClientWebSocketResponse


async def _pump(source: Socket, target: Socket) -> None:
    """Copy messages until an end closes."""
    with suppress(ClientError, ConnectionError):
        async for message in source:
            if message.type is WSMsgType.TEXT:
                await target.send_str(message.data)
            elif message.type is WSMsgType.BINARY:
                await target.send_bytes(message.data)
