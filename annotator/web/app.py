"""`std-annotate SCENE --web PORT`: the same session in a browser."""

from __future__ import annotations

import argparse
import asyncio
import os
import secrets
from collections.abc import Callable
from functools import partial
from typing import Any

from aiohttp import web

from annotator.session import Session
from annotator.web.guard import check_address, guard, is_loopback
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

# A browser that is gone without saying so is noticed after about this time.
HEARTBEAT_S = 10


def run(args: argparse.Namespace) -> int:
    """Serve a scene until interrupted; edits that were not saved then stay recoverable.

    Raises:
        ToolkitError: an address that others can reach without a token, a port in use, or a scene
            that cannot be opened.
    """
    check_address(args.host, args.token)
    prepare_drawing()
    with Session.open(
        args.scene, annotator=args.annotator, recover=args.recover, read_only=args.read_only
    ) as session:
        asyncio.run(serve(session, host=args.host, port=args.web, token=args.token))
    return 0


def prepare_drawing() -> None:
    """Have VTK draw without a window system; to be called before it is loaded."""
    if "DISPLAY" not in os.environ:
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")


async def serve(
    session: Session,
    *,
    host: str,
    port: int,
    token: str | None,
    started: Callable[[int], None] | None = None,
) -> None:
    """Serve until cancelled.

    Args:
        started: called with the port once the server listens.
    """
    from trame.app import get_server

    from annotator.web.front_end import FrontEnd
    from annotator.web.page import STATIC, index_html

    server = get_server(
        f"std-annotate-{id(session)}", client_type="vue3", ws_heart_beat=HEARTBEAT_S
    )
    secret = secrets.token_urlsafe(24)
    _ignore_command_line(server.cli, host=host, port=port, authKey=secret)
    front_end = FrontEnd(server, session)

    async def index(_: web.Request) -> web.Response:
        page = index_html(title=f"{session.scene.info.name} · std-annotate", secret=secret)
        return web.Response(
            text=page, content_type="text/html", headers={"Cache-Control": "no-store"}
        )

    def protect(web_server: Any) -> None:
        app: web.Application = web_server.app
        app.middlewares.append(guard(token, loopback=is_loopback(host)))
        # These come before those of trame.
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
            # Ctrl-C is ours: aiohttp would end the process with status 1.
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
    """Print what is to be opened: the one place where the token is shown."""
    shown = f"[{host}]" if ":" in host else host
    query = f"/?token={token}" if token is not None else ""
    logger.info("open http://%s:%d%s in a browser; Ctrl-C ends", shown, port, query)
    if token is None:
        logger.info(
            "whoever is logged in on this machine can open it, too; --token SECRET keeps them out"
        )


def _ignore_command_line(parser: Any, **values: Any) -> None:
    """Have trame take these values, and neither our command line nor $TRAME_ARGS."""
    parser.set_defaults(**values)
    parser.parse_known_args = partial(argparse.ArgumentParser.parse_known_args, parser, [])
