"""One drawing area in a browser: rendered images are sent, pointer events received.

The server renders the scene off-screen and sends JPEG images when the scene has changed and a
browser can receive them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from annotator.views.interaction import interactor_of
from annotator.web.channel import Pointer
from std_toolkit.errors import ToolkitError

Later = Callable[[float, Callable[[], None]], None]

# JPEG quality during motion, and of a still image, which also has full chroma resolution.
MOVING_QUALITY, STILL_QUALITY = 75, 94

LARGEST_PX = 4096

_BUTTONS = ("Left", "Middle", "Right")


class Drawn(Protocol):
    """View drawn into the plotter: a `SceneView` or `ModelView`."""

    pixel_ratio: float

    def draw(self) -> None: ...


class StreamedPlotter:
    """Off-screen plotter whose images are sent to browsers.

    Attributes:
        plotter: off-screen plotter that the view draws into.
        view: draws into the plotter and calls `repaint`.

    Args:
        can_take: returns whether some browser can receive an image now; call `wanted` when one can.
        send: sends a JPEG image to the browsers.
        later: calls a function in this thread after a delay in seconds.
    """

    def __init__(
        self, *, can_take: Callable[[], bool], send: Callable[[bytes], None], later: Later
    ) -> None:
        import pyvista

        plotter: Any = pyvista.Plotter(off_screen=True, window_size=[640, 480])
        self.plotter = plotter
        self.plotter.render_window.SetMultiSamples(0)
        self.view: Drawn | None = None
        self._can_take, self._send, self._later = can_take, send, later
        self._dirty = self._planned = False
        self._move: Pointer | None = None

    def close(self) -> None:
        """Stop sending and release the plotter."""
        self.view = None
        self.plotter.close()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in physical pixels."""
        width, height = self.plotter.render_window.GetSize()
        return width, height

    # --- pictures out ----------------------------------------------------------------------------

    def repaint(self) -> None:
        """Render and send an image as soon as a browser can receive it."""
        self._dirty = True
        self._plan()

    def wanted(self) -> None:
        """Handle that a browser can receive an image."""
        if self._dirty:
            self._plan()

    def resize(self, width: int, height: int, ratio: float) -> None:
        """Set the size of the drawing area in the browser, physical pixels."""
        if self.view is None or not (width and height):
            return
        size = min(width, LARGEST_PX), min(height, LARGEST_PX)
        if size != self.size or ratio != self.view.pixel_ratio:
            self.view.pixel_ratio = ratio
            self.plotter.render_window.SetSize(*size)
            interactor_of(self.plotter).SetSize(*size)
            self.view.draw()

    def _plan(self) -> None:
        # Pending events are processed first.
        if not self._planned and self._can_take():
            self._planned = True
            self._later(0.0, self._paint)

    def _paint(self) -> None:
        self._planned = False
        if not self._dirty or self.view is None or not self._can_take():
            return
        self._dirty = False
        window = self.plotter.render_window
        window.Render()
        moving = bool(getattr(self.view, "moving", False))
        self._send(as_jpeg(read_pixels(window), MOVING_QUALITY if moving else STILL_QUALITY))

    # --- pointer events in -----------------------------------------------------------------------

    def pointer(self, event: Pointer) -> None:
        """Forward a pointer event to the view."""
        if event.kind == "move":
            # Moves received during rendering are merged into one to the latest position.
            waiting, self._move = self._move, event
            if waiting is None:
                self._later(0.0, self._moved)
            return
        self._moved()
        button = _BUTTONS[event.button]
        if event.kind == "down":
            self._tell(f"{button}ButtonPressEvent", event)
        elif event.kind == "up":
            self._tell(f"{button}ButtonReleaseEvent", event)
        elif event.kind == "leave":
            self._tell("LeaveEvent", event)
        elif event.kind == "wheel":
            away = event.notches > 0
            for _ in range(abs(event.notches)):
                self._tell("MouseWheelForwardEvent" if away else "MouseWheelBackwardEvent", event)

    def let_go(self) -> None:
        """Release a held button of a lost browser without producing a click."""
        self._move = None
        self._tell("LeftButtonReleaseEvent", Pointer(view=0, kind="up", x=-20, y=-20))

    def place(self, x: float, y: float) -> NDArray[np.float64]:
        """Return the screen position (2,) of fractions of the image."""
        return np.array([x, y]) * self.size

    def _moved(self) -> None:
        event, self._move = self._move, None
        if event is not None and self.view is not None:
            self._tell("MouseMoveEvent", event)

    def _tell(self, name: str, event: Pointer) -> None:
        x, y = np.floor(self.place(event.x, event.y)).astype(int)
        interactor = interactor_of(self.plotter)
        interactor.SetEventInformation(
            int(x), self.size[1] - 1 - int(y), event.ctrl, event.shift, "\0", 0, None
        )
        interactor.SetAltKey(event.alt)
        interactor.InvokeEvent(name)


def read_pixels(window: Any) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB of the last image of a VTK window, bottom row first."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkUnsignedCharArray

    width, height = window.GetSize()
    pixels = vtkUnsignedCharArray()
    window.GetPixelData(0, 0, width - 1, height - 1, 0, pixels, 0)
    return vtk_to_numpy(pixels).reshape(height, width, 3)


def as_jpeg(rgb: NDArray[np.uint8], quality: int) -> bytes:
    """Encode (H, W, 3) RGB uint8, bottom row first, as JPEG.

    Raises:
        ToolkitError: the image cannot be encoded.
    """
    still = quality >= STILL_QUALITY
    sampling = (
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444 if still else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
    )
    upright = cv2.cvtColor(cv2.flip(rgb, 0), cv2.COLOR_RGB2BGR)
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    done, data = cv2.imencode(".jpg", upright, options)
    if not done:
        raise ToolkitError("the image cannot be encoded", value=rgb.shape)
    return data.tobytes()
