"""Who may talk to the servers of the browser front end.

Access is limited to this machine or to clients with a token. A page of another site can make a
browser send requests to 127.0.0.1, open web sockets there, and embed the page in a frame. Even
without a token, a request must therefore name this server as its host and, if the browser sends an
origin, come from a page of this server; one that changes something must send it. The content
security policy of the page allows connections to this server only and forbids embedding.
"""

from __future__ import annotations

import hmac
import ipaddress
import re
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from std_toolkit.errors import ToolkitError

COOKIE = "std_annotate_token"

SHORTEST_TOKEN = 16

# Key of a request: in whose name it is.
PERSON: Any = getattr(web, "RequestKey", lambda name, _: name)("person", str)  # aiohttp < 3.13

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
    # With "no-referrer" a browser sends a form without its origin.
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}

_HOST = re.compile(r"[\w.\-]+(:\d+)?|\[[0-9a-fA-F:.]+\](:\d+)?")

# The person to whom a token belongs ("" for anybody), or None if it is worthless.
Door = Callable[[str], str | None]


def opens_to(token: str) -> Door:
    """The door of a server with one token."""
    return lambda given: (
        "" if hmac.compare_digest(given.encode(errors="replace"), token.encode()) else None
    )


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


def guard(door: Door | None, *, loopback: bool) -> Middleware:
    """Return a middleware that rejects unauthorized requests, and notes whose the others are.

    Args:
        door: knows the tokens, or None if only this machine can connect. A token is read from the
            query (`?token=...`), which sets a cookie, or from the cookie.
        loopback: whether the server listens on loopback; the host named by a request must then be
            loopback, too.
    """

    @web.middleware
    async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            _check_origin(request, loopback=loopback)
            if door is not None:
                _check_token(request, door)
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
    # A browser sends it with everything that is no plain look.
    unknown = origin is None and request.method not in ("GET", "HEAD")
    if unknown or (origin is not None and urlsplit(origin).netloc != request.host):
        raise web.HTTPForbidden(text="Requests from pages of other sites are refused.\n")


def _check_token(request: web.Request, door: Door) -> None:
    given = request.query.get("token")
    known = given if given is not None else request.cookies.get(cookie_name(request), "")
    person = door(known)
    if person is None:
        raise web.HTTPUnauthorized(
            text="A token is needed: open the address that std-annotate printed, "
            "which ends in ?token=...\n"
        )
    if given is not None and request.method == "GET" and "Upgrade" not in request.headers:
        # Removes the secret from the address bar (and thus from history and screenshots).
        query = {k: v for k, v in request.query.items() if k != "token"}
        answer = web.HTTPFound(request.rel_url.with_query(query))
        answer.set_cookie(cookie_name(request), known, httponly=True, samesite="Strict", path="/")
        raise answer
    request[PERSON] = person


def _protect(request: web.Request, answer: web.StreamResponse) -> None:
    # In some browsers 'self' does not include web sockets.
    own = f" ws://{request.host} wss://{request.host}" if _HOST.fullmatch(request.host) else ""
    answer.headers.update(_HEADERS)
    # Pages without Vue have a stricter one.
    answer.headers.setdefault("Content-Security-Policy", _POLICY.format(sockets=own))
