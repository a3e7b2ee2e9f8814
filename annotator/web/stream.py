"""One drawing area in a browser: pictures go out, pointer events come back.

The scene is drawn on the server into a plotter without a window, and goes out as JPEG images, when
there is something new and a browser can take it.
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

# JPEG quality while something moves, and of a still picture, which has its colours in full, too.
MOVING_QUALITY, STILL_QUALITY = 75, 94

LARGEST_PX = 4096

_BUTTONS = ("Left", "Middle", "Right")


class Drawn(Protocol):
    """What is drawn into the plotter: a `SceneView` or `ModelView`."""

    pixel_ratio: float

    def draw(self) -> None: ...


class StreamedPlotter:
    """A plotter without a window whose pictures go to browsers.

    Attributes:
        plotter: to be drawn into by the view.
        view: what draws; `repaint` is to be called by it.

    Args:
        can_take: whether some browser can take a picture now; `repaint` is called when it can.
        send: hands a JPEG image to the browsers.
        later: calls a function in this thread after some seconds.
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
        """Send nothing any more, and let go of the plotter."""
        self.view = None
        self.plotter.close()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in physical pixels."""
        width, height = self.plotter.render_window.GetSize()
        return width, height

    # --- pictures out ----------------------------------------------------------------------------

    def repaint(self) -> None:
        """Show the plotter anew, as soon as a browser can take it."""
        self._dirty = True
        self._plan()

    def wanted(self) -> None:
        """A browser can take a picture."""
        if self._dirty:
            self._plan()

    def resize(self, width: int, height: int, ratio: float) -> None:
        """The drawing area in the browser has so many physical pixels."""
        if self.view is None or not (width and height):
            return
        size = min(width, LARGEST_PX), min(height, LARGEST_PX)
        if size != self.size or ratio != self.view.pixel_ratio:
            self.view.pixel_ratio = ratio
            self.plotter.render_window.SetSize(*size)
            interactor_of(self.plotter).SetSize(*size)
            self.view.draw()

    def _plan(self) -> None:
        # What came in meanwhile is heeded first.
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
        """Let the view see what the pointer did."""
        if event.kind == "move":
            # Moves that came while a picture was drawn are one move to where the pointer is now.
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
        """The hand that held a button is gone: no click is made of it."""
        self._move = None
        self._tell("LeftButtonReleaseEvent", Pointer(view=0, kind="up", x=-20, y=-20))

    def place(self, x: float, y: float) -> NDArray[np.float64]:
        """(2,) screen position of shares of the picture."""
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
    """(H, W, 3) RGB of what a VTK window drew last, the lowest row first."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkUnsignedCharArray

    width, height = window.GetSize()
    pixels = vtkUnsignedCharArray()
    window.GetPixelData(0, 0, width - 1, height - 1, 0, pixels, 0)
    return vtk_to_numpy(pixels).reshape(height, width, 3)


def as_jpeg(rgb: NDArray[np.uint8], quality: int) -> bytes:
    """JPEG image of (H, W, 3) RGB uint8, the lowest row first.

    Raises:
        ToolkitError: the picture cannot be encoded.
    """
    still = quality >= STILL_QUALITY
    sampling = (
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444 if still else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
    )
    upright = cv2.cvtColor(cv2.flip(rgb, 0), cv2.COLOR_RGB2BGR)
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    done, data = cv2.imencode(".jpg", upright, options)
    if not done:
        raise ToolkitError("the picture cannot be encoded", value=rgb.shape)
    return data.tobytes()
