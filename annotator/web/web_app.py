"""Web server of `std-annotate SCENE --web PORT`: one scene; `guard` says who may use it."""

from __future__ import annotations

import argparse
import asyncio
import os
import secrets
import signal
import sys
import threading
from collections.abc import Awaitable, Callable
from functools import partial
from types import FrameType
from typing import Any

from aiohttp import web

from annotator.app.mesh_folder import MeshFolder, choose_folder
from annotator.options import HOME_VARIABLE, AnnotateOptions
from annotator.session import Session
from annotator.web.guard import check_address, guard, is_loopback, opens_to
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs.interrupt import whole_imports
from std_toolkit.log import logger

# A browser that vanished without closing the socket is detected after about this time, seconds.
HEARTBEAT_S = 10


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
    home = os.environ.get(HOME_VARIABLE, "")
    if home:
        threading.Thread(target=_end_with_parent, name="end with parent", daemon=True).start()
    with Session.open(
        args.scene,
        annotator=args.annotator,
        recover=args.recover,
        read_only=args.read_only,
        take_over=args.take_over,
    ) as session:
        asyncio.run(
            until_signal(
                serve(
                    session, host=args.host, port=args.web, token=args.token, meshes=meshes,
                    home=home,
                )
            )
        )  # fmt: skip
    return 0


def _end_with_parent() -> None:
    """End this process when the server of the project is gone, however that ended."""
    # Not by `sys.stdin`, whose lock would be held when the interpreter ends.
    while os.read(sys.stdin.fileno(), 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


async def until_signal(serving: Awaitable[None]) -> None:
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
    home: str = "",
    started: Callable[[int], None] | None = None,
) -> None:
    """Serve until cancelled, or until the page leaves for its home.

    Args:
        meshes: folder whose meshes are in the library.
        home: address of the board that "Close" leads to, or "".
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
    front_end = FrontEnd(server, session, meshes, home=home)
    door = None if token is None else opens_to(token)

    async def index(_: web.Request) -> web.Response:
        page = index_html(title=f"{session.scene.info.name} · std-annotate", secret=secret)
        return web.Response(
            text=page, content_type="text/html", headers={"Cache-Control": "no-store"}
        )

    def protect(web_server: Any) -> None:
        app: web.Application = web_server.app
        app.middlewares.append(guard(door, loopback=is_loopback(host)))
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
        raise cannot_listen(error, host, port) from error
    finally:
        front_end.close()


def cannot_listen(error: OSError, host: str, port: int) -> ToolkitError:
    """Say that the address is not to be had."""
    return ToolkitError(
        f"cannot listen: {error.strerror or error}",
        field="--web",
        value=f"{host}:{port}",
        hint="is the port in use? 0 takes a free one",
    )


def tell_address(host: str, port: int, token: str | None, *, people: bool = False) -> None:
    """Log the address to open; the token is printed only here.

    Args:
        people: whether each person has a token of their own, which is known only to them.
    """
    shown = f"[{host}]" if ":" in host else host
    query = f"/?token={token}" if token is not None else ""
    logger.info("open http://%s:%d%s in a browser; Ctrl-C ends", shown, port, query)
    if token is None and people:
        logger.info("each person adds their token: http://%s:%d/?token=...", shown, port)
    elif token is None:
        logger.info("other users of this machine can open it, too; --token SECRET prevents this")


def _ignore_command_line(parser: Any, **values: Any) -> None:
    """Make trame use these values instead of the command line and $TRAME_ARGS."""
    parser.set_defaults(**values)
    parser.parse_known_args = partial(argparse.ArgumentParser.parse_known_args, parser, [])
