"""A page that shows the last picture of a program that runs until it is stopped."""

from __future__ import annotations

import hmac
import os
import re
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from urllib.parse import parse_qs

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.html.page import script_digest

_QUALITY = 80

_PROGRAM = """
const p = document.getElementById("p");
const token = new URLSearchParams(location.search).get("token");
const asked = token === null ? "" : "&token=" + encodeURIComponent(token);
function next() { p.src = "preview.jpg?t=" + Date.now() + asked; }
p.onload = () => setTimeout(next, 150);
p.onerror = () => setTimeout(next, 1000);
next();
"""
_PAGE = f"""<!doctype html><meta charset="utf-8"><title>preview</title>
<style>body{{margin:0;background:#111}}img{{display:block;width:100%}}</style>
<img id="p" alt="waiting for the camera"><script>{_PROGRAM}</script>
""".encode()

_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; "
    f"script-src '{script_digest(_PROGRAM)}'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}

# A page of another site whose name was rebound to 127.0.0.1 sends its own name.
_HOST = re.compile(r"(localhost|127\.0\.0\.1)(:\d+)?")


def encoded(picture: NDArray[np.uint8]) -> bytes:
    """The (H, W, 3) RGB picture as JPEG."""
    _, data = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return bytes(data)


TOKEN_VARIABLE = "STD_PREVIEW_TOKEN"


def asked_token(option: str | None) -> str | None:
    """The token of a preview: that of the option, or of the environment; None for none."""
    return option or os.environ.get(TOKEN_VARIABLE) or None


class PreviewPage:
    """Serves the last picture to browsers; use as a context manager.

    It listens on localhost only, so that images are not visible to the network. From another
    machine, use `ssh -L PORT:localhost:PORT`. Other users of this machine see the page, too, unless
    it asks for a token.

    Args:
        port: 0 for any free one.
        token: what the address must end with, `?token=...`; None for nothing.

    Raises:
        ToolkitError: the port is taken.
    """

    def __init__(self, port: int, token: str | None = None) -> None:
        page, self._token = self, token
        self._picture = b""

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                path, _, query = self.path.partition("?")
                if not _HOST.fullmatch(self.headers.get("Host", "")):
                    self._send(403, "text/plain", b"open http://localhost\n")
                elif not page._admits(query):
                    self._send(403, "text/plain", b"the address ends with ?token=...\n")
                elif path == "/":
                    self._send(200, "text/html; charset=utf-8", _PAGE)
                elif path == "/preview.jpg" and page._picture:
                    self._send(200, "image/jpeg", page._picture)
                else:
                    self._send(404, "text/plain", b"nothing here yet\n")

            def _send(self, status: int, kind: str, body: bytes) -> None:
                try:
                    self.send_response(status)
                    self.send_header("Content-Type", kind)
                    self.send_header("Content-Length", str(len(body)))
                    for name, value in _HEADERS.items():
                        self.send_header(name, value)
                    self.end_headers()
                    self.wfile.write(body)
                except OSError:
                    self.close_connection = True  # the browser closed the connection

            def log_message(self, format: str, *args: object) -> None:
                """Log nothing: the terminal shows the status line."""

        try:
            self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        except (OSError, OverflowError) as error:
            raise ToolkitError(
                f"cannot serve the preview: {error}", field="--web", value=port
            ) from error
        self._server.daemon_threads = True
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="preview page", daemon=True
        )

    @property
    def address(self) -> str:
        """Where it is, without the token."""
        return f"http://localhost:{self._server.server_address[1]}/"

    def _admits(self, query: str) -> bool:
        if self._token is None:
            return True
        given = parse_qs(query).get("token", [""])[0]
        return hmac.compare_digest(given.encode(), self._token.encode())

    def show(self, picture: bytes) -> None:
        """Replace the picture."""
        self._picture = picture

    def __enter__(self) -> PreviewPage:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._server.shutdown()
        self._server.server_close()
