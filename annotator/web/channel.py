"""Web socket that sends images of the views to browsers and receives their input events.

Each browser receives images at its own rate: at most two images of a view are in flight, so a slow
connection lowers the frame rate but adds no delay, and no browser waits for another. Messages from
a page are validated as they are read.
"""

from __future__ import annotations

import asyncio
import itertools
import struct
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol

import msgspec
from aiohttp import WSCloseCode, WSMsgType, web
from msgspec import Meta

from std_toolkit.log import logger

# With a button held, positions outside the view are valid within this range.
Share = Annotated[float, Meta(ge=-20, le=20)]

Pixels = Annotated[int, Meta(ge=0, le=16384)]

View = Annotated[int, Meta(ge=0, le=63)]

UNDER_WAY = 2

# A browser that vanished without closing the socket is detected after about this time, seconds.
HEARTBEAT_S = 10.0

_LONGEST_MESSAGE = 16_384

_HEAD = struct.Struct("<BxxxI")


class Pointer(msgspec.Struct, tag="pointer", frozen=True, forbid_unknown_fields=True):
    """Event of a mouse, pen or finger in a view.

    Attributes:
        x, y: position as fractions of the image from its top left corner.
        button: 0 left, 1 middle, 2 right.
        notches: wheel rotation; up, away from the user, is positive.
        number: number of a move, which the server acknowledges after processing it.
    """

    view: View
    kind: Literal["down", "move", "up", "cancel", "leave", "wheel", "double"]
    x: Share = 0.0
    y: Share = 0.0
    button: Annotated[int, Meta(ge=0, le=2)] = 0
    notches: Annotated[int, Meta(ge=-10, le=10)] = 0
    number: int = 0
    shift: bool = False
    ctrl: bool = False
    alt: bool = False


class Key(msgspec.Struct, tag="key", frozen=True, forbid_unknown_fields=True):
    """Pressed key, named as in the table of actions: "Ctrl+Shift+Z"."""

    name: Annotated[str, Meta(max_length=40)]
    repeat: bool = False


class Sizes(msgspec.Struct, tag="sizes", frozen=True, forbid_unknown_fields=True):
    """Size of each view on the screen.

    Attributes:
        sizes: width and height in physical pixels; 0 for a hidden view.
        ratio: physical pixels per logical one.
    """

    sizes: Annotated[list[tuple[Pixels, Pixels]], Meta(max_length=64)]
    ratio: Annotated[float, Meta(ge=0.1, le=16)] = 1.0


class Shown(msgspec.Struct, tag="shown", frozen=True, forbid_unknown_fields=True):
    """Acknowledgement that an image is on the screen."""

    view: View
    number: int


class Visibility(msgspec.Struct, tag="sight", frozen=True, forbid_unknown_fields=True):
    """Whether the page is visible; a hidden tab receives no images."""

    visible: bool


class Drop(msgspec.Struct, tag="drop", frozen=True, forbid_unknown_fields=True):
    """Drop of a library mesh, or of an object of the list, onto a view."""

    view: View
    x: Share
    y: Share
    what: Literal["model", "object"]
    name: Annotated[str, Meta(max_length=200)]


PageMessage = Pointer | Key | Sizes | Shown | Visibility | Drop

_decoder = msgspec.json.Decoder(PageMessage)


def read_message(text: str | bytes) -> PageMessage:
    """Decode a message; raises msgspec.ValidationError or DecodeError for an invalid one."""
    return _decoder.decode(text)


class Receiver(Protocol):
    """Draws the views and handles input events."""

    def pointer(self, event: Pointer) -> None: ...
    def give_up(self, view: int) -> None:
        """Handle the loss of a browser that held a button in a view."""

    def key(self, event: Key) -> None: ...
    def drop(self, event: Drop) -> None: ...
    def resize(self, sizes: Sequence[tuple[int, int]], ratio: float) -> None: ...
    def wanted(self, view: int) -> None:
        """Handle that a browser can receive an image of a view again."""

    def failed(self, error: Exception) -> None:
        """Handle an unexpected error."""


@dataclass(frozen=True)
class Picture:
    """Numbered JPEG image of a view."""

    number: int
    jpeg: bytes


class ViewChannel:
    """Connections of all browsers of a session.

    Args:
        views: number of views.
        keys: names of the keys that browsers send.
    """

    def __init__(self, receiver: Receiver, *, views: int, keys: Sequence[str]) -> None:
        self._receiver = receiver
        self._keys = list(keys)
        self._latest: list[Picture | None] = [None] * views
        self._numbers = itertools.count(1)
        self._browsers: list[_Browser] = []
        # The browser with the last input; the views have its sizes.
        self._leader: _Browser | None = None
        # While a button is held, pointer events of other browsers are ignored.
        self._holder: tuple[_Browser, int] | None = None

    # --- pictures out ----------------------------------------------------------------------------

    def can_take(self, view: int) -> bool:
        """Whether some browser waits for an image of a view."""
        return any(b.can_take(view) for b in self._browsers)

    def send(self, view: int, jpeg: bytes) -> None:
        """Send an image to all browsers; a slow one receives the latest image when it is ready."""
        picture = self._latest[view] = Picture(next(self._numbers), jpeg)
        for browser in self._browsers:
            browser.offer(view, picture)

    # --- connections -----------------------------------------------------------------------------

    async def serve(self, request: web.Request) -> web.StreamResponse:
        """Serve a web socket connection until it closes."""
        # JPEG images are already compressed.
        socket = web.WebSocketResponse(
            heartbeat=HEARTBEAT_S, compress=False, max_msg_size=_LONGEST_MESSAGE
        )
        await socket.prepare(request)
        browser = _Browser(socket, views=len(self._latest))
        self._browsers.append(browser)
        sending = asyncio.create_task(browser.send_all())
        try:
            browser.say({"keys": self._keys})
            async for message in socket:
                if message.type is not WSMsgType.TEXT or not self._receive(browser, message.data):
                    await socket.close(code=WSCloseCode.POLICY_VIOLATION)
        finally:
            self._leave(browser)
            sending.cancel()
        return socket

    async def close(self) -> None:
        """Close the connections to all browsers."""
        for browser in list(self._browsers):
            await browser.socket.close(code=WSCloseCode.GOING_AWAY)

    def _leave(self, browser: _Browser) -> None:
        self._browsers.remove(browser)
        if self._holder is not None and self._holder[0] is browser:
            view, self._holder = self._holder[1], None
            self._call(lambda: self._receiver.give_up(view))
        if self._leader is browser:
            self._leader = None
            if self._browsers:
                self._lead(self._browsers[-1])

    # --- messages in -----------------------------------------------------------------------------

    def _receive(self, browser: _Browser, text: str) -> bool:
        try:
            received = read_message(text)
        except msgspec.DecodeError as error:
            logger.warning("ignored an invalid message of a browser: %s", error)
            return False
        if isinstance(received, Pointer | Drop | Shown) and received.view >= len(self._latest):
            return False
        self._call(lambda: self._heed(browser, received))
        return True

    def _call(self, action: Any) -> None:
        try:
            action()
        except Exception as error:  # an error in one event must not end the session
            logger.exception("an event of a browser")
            self._receiver.failed(error)

    def _heed(self, browser: _Browser, received: PageMessage) -> None:
        if isinstance(received, Shown):
            browser.shown(received.view, received.number)
            self._refill(browser, received.view)
        elif isinstance(received, Visibility):
            browser.visible = received.visible
            self._refill_all(browser)
        elif isinstance(received, Sizes):
            self._resized(browser, received)
        elif isinstance(received, Pointer):
            self._pointed(browser, received)
        else:
            self._lead(browser)
            if isinstance(received, Key):
                self._receiver.key(received)
            elif self._holder is None:
                self._receiver.drop(received)

    def _resized(self, browser: _Browser, received: Sizes) -> None:
        sizes = [*received.sizes, *[(0, 0)] * len(self._latest)][: len(self._latest)]
        first = not any(any(size) for size in browser.sizes)
        browser.sizes, browser.ratio = sizes, received.ratio
        if self._leader is None or first:
            self._leader = browser
        if self._leader is browser:
            self._receiver.resize(sizes, received.ratio)
        self._refill_all(browser)

    def _pointed(self, browser: _Browser, received: Pointer) -> None:
        if received.kind == "move":
            browser.say({"moved": received.number})
        holder = self._holder
        if holder is not None and (holder[0] is not browser or received.kind in ("down", "wheel")):
            return
        if received.kind in ("up", "cancel"):
            if holder is None or holder[1] != received.view:
                return
            self._holder = None
        elif received.kind in ("down", "wheel", "double"):
            self._lead(browser)
        if received.kind == "down":
            self._holder = (browser, received.view)
        if received.kind == "cancel":
            self._receiver.give_up(received.view)
        else:
            self._receiver.pointer(received)

    def _lead(self, browser: _Browser) -> None:
        if self._leader is not browser and any(any(size) for size in browser.sizes):
            self._leader = browser
            self._receiver.resize(browser.sizes, browser.ratio)

    def _refill_all(self, browser: _Browser) -> None:
        for view in range(len(self._latest)):
            self._refill(browser, view)

    def _refill(self, browser: _Browser, view: int) -> None:
        latest = self._latest[view]
        if latest is not None and latest.number > browser.sent[view]:
            browser.offer(view, latest)
        if browser.can_take(view):
            self._receiver.wanted(view)


class _Browser:
    """Connection of one page.

    Attributes:
        sizes: sizes of its views, physical pixels.
        sent: number of the last image of each view that is in flight or shown.
    """

    def __init__(self, socket: web.WebSocketResponse, *, views: int) -> None:
        self.socket = socket
        self.visible = True
        self.sizes: list[tuple[int, int]] = [(0, 0)] * views
        self.ratio = 1.0
        self.sent = [0] * views
        self._under_way: list[deque[int]] = [deque() for _ in range(views)]
        self._queue: asyncio.Queue[str | bytes] = asyncio.Queue()

    def can_take(self, view: int) -> bool:
        return self.visible and any(self.sizes[view]) and len(self._under_way[view]) < UNDER_WAY

    def offer(self, view: int, picture: Picture) -> None:
        """Send an image unless too many are in flight to this browser."""
        if self.can_take(view):
            self.sent[view] = picture.number
            self._under_way[view].append(picture.number)
            self._queue.put_nowait(_HEAD.pack(view, picture.number) + picture.jpeg)

    def shown(self, view: int, number: int) -> None:
        """Record that the browser shows an image, which acknowledges all earlier ones."""
        under_way = self._under_way[view]
        while under_way and under_way[0] <= number:
            under_way.popleft()

    def say(self, message: dict[str, Any]) -> None:
        self._queue.put_nowait(msgspec.json.encode(message).decode())

    async def send_all(self) -> None:
        """Send queued data until cancelled; a slow connection delays no other browser."""
        try:
            while True:
                message = await self._queue.get()
                if isinstance(message, bytes):
                    await self.socket.send_bytes(message)
                else:
                    await self.socket.send_str(message)
        except ConnectionError:
            pass  # the browser is gone; its reader handles this
