"""Web server of `std-annotate SCENE --web PORT`, with access control.

Access is limited to this machine or to clients with the token. A page of another site can make a
browser send requests to 127.0.0.1, open web sockets there, and embed the page in a frame. Even
without a token, a request must therefore name this server as its host and, if the browser sends an
origin, come from a page of this server. The content security policy of the page allows
connections to this server only and forbids embedding.
"""

from __future__ import annotations

import argparse
import asyncio
import hmac
import ipaddress
import os
import re
import secrets
import signal
from collections.abc import Awaitable, Callable
from functools import partial
from types import FrameType
from typing import Any
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from annotator.app.mesh_folder import MeshFolder, choose_folder
from annotator.options import AnnotateOptions
from annotator.session import Session
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs.interrupt import whole_imports
from std_toolkit.log import logger

# A browser that vanished without closing the socket is detected after about this time, seconds.
HEARTBEAT_S = 10

COOKIE = "std_annotate_token"

SHORTEST_TOKEN = 16

# Vue compiles the page's template in the browser, hence 'unsafe-eval'. `connect-src` limits the
# connections of the page: a link could name another web socket, whose server could inject scripts.
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'{sockets}; "
    "object-src 'none'; base-uri 'self'; form-action 'none'; frame-ancestors 'none'"
)

_HEADERS = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}

_HOST = re.compile(r"[\w.\-]+(:\d+)?|\[[0-9a-fA-F:.]+\](:\d+)?")


def run(args: AnnotateOptions) -> int:
    """Serve a scene until interrupted; unsaved edits stay recoverable.

    Raises:
        ToolkitError: the address is reachable by others and no token is set, the port is in use, or
            the scene cannot be opened, or the folder of meshes does not exist or contains none.
        KeyboardInterrupt: SIGINT or SIGTERM ended the server.
    """
    assert args.scene is not None and args.web is not None  # ensured by the options
    check_address(args.host, args.token)
    meshes = choose_folder(args.meshes)
    prepare_drawing()
    with Session.open(
        args.scene, annotator=args.annotator, recover=args.recover, read_only=args.read_only
    ) as session:
        asyncio.run(
            _until_signal(
                serve(session, host=args.host, port=args.web, token=args.token, meshes=meshes)
            )
        )
    return 0


async def _until_signal(serving: Awaitable[None]) -> None:
    """Run the server; the first SIGINT or SIGTERM ends it between two tasks of the event loop.

    VTK ends the process with status 1 if a callback that it calls raises KeyboardInterrupt, which
    the default handler does wherever the program is.
    """
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    assert task is not None
    signals: list[int] = []

    def end(number: int, _frame: FrameType | None) -> None:
        if signals:  # again, while tasks that write to the scene are waited for
            raise KeyboardInterrupt
        signals.append(number)
        loop.call_soon_threadsafe(task.cancel)

    if callable(signal.getsignal(signal.SIGINT)):  # not ignored, as in the background of a script
        signal.signal(signal.SIGINT, end)  # SIGTERM does here what SIGINT does
    try:
        await serving
    except asyncio.CancelledError:
        if not signals:
            raise
    if signals:
        raise KeyboardInterrupt


def prepare_drawing() -> None:
    """Select off-screen rendering of VTK; must be called before VTK is imported."""
    if "DISPLAY" not in os.environ:
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")


async def serve(
    session: Session,
    *,
    host: str,
    port: int,
    token: str | None,
    meshes: MeshFolder | None = None,
    started: Callable[[int], None] | None = None,
) -> None:
    """Serve until cancelled.

    Args:
        meshes: folder whose meshes are in the library.
        started: called with the port once the server listens.
    """
    with whole_imports():
        import pyvista  # noqa: F401 - the views import it when they are made
        from trame.app import get_server

        from annotator.web.front_end import FrontEnd
        from annotator.web.page import STATIC, index_html

    server = get_server(
        f"std-annotate-{id(session)}", client_type="vue3", ws_heart_beat=HEARTBEAT_S
    )
    secret = secrets.token_urlsafe(24)
    _ignore_command_line(server.cli, host=host, port=port, authKey=secret)
    front_end = FrontEnd(server, session, meshes)

    async def index(_: web.Request) -> web.Response:
        page = index_html(title=f"{session.scene.info.name} · std-annotate", secret=secret)
        return web.Response(
            text=page, content_type="text/html", headers={"Cache-Control": "no-store"}
        )

    def protect(web_server: Any) -> None:
        app: web.Application = web_server.app
        app.middlewares.append(guard(token, loopback=is_loopback(host)))
        # These routes precede those of trame.
        app.router.add_get("/", index)
        app.router.add_get("/index.html", index)
        app.router.add_get("/views", front_end.channel.serve)
        app.router.add_static("/annotator", STATIC)

    def ready(**_: Any) -> None:
        tell_address(host, server.port, token)
        if started is not None:
            started(server.port)

    server.controller.on_server_bind.add(protect)
    server.controller.on_server_ready.add(ready)
    try:
        await server.start(
            host=host,
            port=port,
            open_browser=False,
            show_connection_info=False,
            disable_logging=True,
            exec_mode="coroutine",
            timeout=0,
            # Ctrl-C is handled here: aiohttp would end the process with status 1.
            thread=True,
        )
    except OSError as error:
        raise ToolkitError(
            f"cannot listen: {error.strerror or error}",
            field="--web",
            value=f"{host}:{port}",
            hint="is the port in use? 0 takes a free one",
        ) from error
    finally:
        front_end.close()


def tell_address(host: str, port: int, token: str | None) -> None:
    """Log the address to open; the token is printed only here."""
    shown = f"[{host}]" if ":" in host else host
    query = f"/?token={token}" if token is not None else ""
    logger.info("open http://%s:%d%s in a browser; Ctrl-C ends", shown, port, query)
    if token is None:
        logger.info("other users of this machine can open it, too; --token SECRET prevents this")


def _ignore_command_line(parser: Any, **values: Any) -> None:
    """Make trame use these values instead of the command line and $TRAME_ARGS."""
    parser.set_defaults(**values)
    parser.parse_known_args = partial(argparse.ArgumentParser.parse_known_args, parser, [])


def is_loopback(host: str) -> bool:
    """Whether an address or name is a loopback address of this machine."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def check_address(host: str, token: str | None) -> None:
    """Check that an address reachable by others is protected by a token.

    Raises:
        ToolkitError: a non-loopback address without a token, or a token that is too short.
    """
    if token is None and not is_loopback(host):
        raise ToolkitError(
            "others could reach this address, so it needs a token",
            field="--host",
            value=host,
            hint="give --token SECRET (16 characters or more; `openssl rand -hex 16` makes one), "
            "or stay on 127.0.0.1 and use `ssh -L`",
        )
    if token is not None and (len(token) < SHORTEST_TOKEN or not token.isprintable()):
        raise ToolkitError(
            f"a token needs {SHORTEST_TOKEN} printable characters or more",
            field="--token",
            hint="`openssl rand -hex 16` makes one",
        )


def guard(token: str | None, *, loopback: bool) -> Middleware:
    """Return a middleware that rejects unauthorized requests.

    Args:
        token: the secret, or None if only this machine can connect. It is read from the query
            (`?token=...`), which sets a cookie, or from the cookie.
        loopback: whether the server listens on loopback; the host named by a request must then be
            loopback, too.
    """

    @web.middleware
    async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            _check_origin(request, loopback=loopback)
            if token is not None:
                _check_token(request, token)
            answer = await handler(request)
        except web.HTTPException as refusal:
            _protect(request, refusal)
            raise
        if not answer.prepared:
            _protect(request, answer)
        return answer

    return check


def cookie_name(request: web.Request) -> str:
    """Return the name of the token cookie, which contains the port: ports share cookies."""
    return f"{COOKIE}_{urlsplit(f'//{request.host}').port or 80}"


def _check_origin(request: web.Request, *, loopback: bool) -> None:
    if not _HOST.fullmatch(request.host):
        raise web.HTTPBadRequest(text="The request names no host.\n")
    name = urlsplit(f"//{request.host}").hostname or ""
    if loopback and not is_loopback(name):
        raise web.HTTPForbidden(text="This server answers to its own address only.\n")
    origin = request.headers.get("Origin")
    if origin is not None and urlsplit(origin).netloc != request.host:
        raise web.HTTPForbidden(text="Requests from pages of other sites are refused.\n")


def _check_token(request: web.Request, token: str) -> None:
    given = request.query.get("token")
    known = given if given is not None else request.cookies.get(cookie_name(request), "")
    if not hmac.compare_digest(known.encode(errors="replace"), token.encode()):
        raise web.HTTPUnauthorized(
            text="A token is needed: open the address that std-annotate printed, "
            "which ends in ?token=...\n"
        )
    if given is not None and request.method == "GET" and "Upgrade" not in request.headers:
        # Removes the secret from the address bar (and thus from history and screenshots).
        query = {k: v for k, v in request.query.items() if k != "token"}
        answer = web.HTTPFound(request.rel_url.with_query(query))
        answer.set_cookie(cookie_name(request), token, httponly=True, samesite="Strict", path="/")
        raise answer


def _protect(request: web.Request, answer: web.StreamResponse) -> None:
    # In some browsers 'self' does not include web sockets.
    own = f" ws://{request.host} wss://{request.host}" if _HOST.fullmatch(request.host) else ""
    answer.headers.update(_HEADERS)
    answer.headers["Content-Security-Policy"] = _POLICY.format(sockets=own)
