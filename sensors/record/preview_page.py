"""The preview in a browser on this machine."""

from __future__ import annotations

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType

from std_toolkit.errors import ToolkitError

_PAGE = b"""<!doctype html><meta charset="utf-8"><title>std-record</title>
<style>body{margin:0;background:#111}img{display:block;width:100%}</style>
<img id="p" alt="waiting for the camera"><script>
const p = document.getElementById("p");
function next() { p.src = "preview.jpg?" + Date.now(); }
p.onload = () => setTimeout(next, 150);
p.onerror = () => setTimeout(next, 1000);
next();
</script>
"""


class PreviewPage:
    """Serves the last picture to browsers; use as a context manager.

    It listens on this machine alone: pictures of a laboratory are nobody else's business. From
    another one, `ssh -L PORT:localhost:PORT` leads here.

    Raises:
        ToolkitError: the port is taken.
    """

    def __init__(self, port: int) -> None:
        page = self
        self._picture = b""

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                path = self.path.split("?")[0]
                if path == "/":
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
                    self.send_header("Cache-Control", "no-store")
                    self.end_headers()
                    self.wfile.write(body)
                except OSError:
                    self.close_connection = True  # the browser went away

            def log_message(self, format: str, *args: object) -> None:
                """Nothing: the status line is the terminal's."""

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
        return f"http://localhost:{self._server.server_address[1]}/"

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
