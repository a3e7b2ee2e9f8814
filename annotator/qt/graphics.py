"""What draws the views: a graphics card, or the processor in its place."""

from __future__ import annotations

from functools import cache

from PySide6.QtGui import QOffscreenSurface, QOpenGLContext, QSurfaceFormat
from PySide6.QtOpenGLWidgets import QOpenGLWidget
from PySide6.QtWidgets import QWidget

_GL_RENDERER = 0x1F01
_SOFTWARE = ("llvmpipe", "softpipe", "swrast", "swr", "software", "gdi generic", "basic render")


def set_surface_format() -> None:
    """What VTK needs of OpenGL, for every window made from now on: 3.2 core, no multisampling.

    The views ask for the same, but too late for the window that they are put into.
    """
    wanted = QSurfaceFormat()
    wanted.setRenderableType(QSurfaceFormat.RenderableType.OpenGL)
    wanted.setProfile(QSurfaceFormat.OpenGLContextProfile.CoreProfile)
    wanted.setVersion(3, 2)
    wanted.setSwapBehavior(QSurfaceFormat.SwapBehavior.DoubleBuffer)
    for channel in ("Red", "Green", "Blue", "Alpha", "Depth"):
        getattr(wanted, f"set{channel}BufferSize")(8)
    QSurfaceFormat.setDefaultFormat(wanted)


def prepare_window(window: QWidget) -> None:
    """Have a window ready for views before it is shown.

    Qt makes a window anew when the first view is put into it: it would flicker, and lose the focus.
    """
    seed = QOpenGLWidget(window)
    seed.resize(1, 1)
    seed.hide()


@cache
def renderer_name() -> str:
    """OpenGL's name of what draws; "" if there is no OpenGL at all."""
    context, surface = QOpenGLContext(), QOffscreenSurface()
    surface.create()
    if not context.create() or not context.makeCurrent(surface):
        return ""
    name = context.functions().glGetString(_GL_RENDERER)
    context.doneCurrent()
    return str(name or "")


def multi_samples() -> int:
    """Samples per pixel: smooth edges on a card; in software they make drawing much slower."""
    name = renderer_name().lower()
    return 0 if not name or any(word in name for word in _SOFTWARE) else 4
