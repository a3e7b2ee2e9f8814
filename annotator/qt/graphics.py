"""OpenGL setup, and detection of hardware or software rendering."""

from __future__ import annotations

from functools import cache

from PySide6.QtGui import QOffscreenSurface, QOpenGLContext, QSurfaceFormat
from PySide6.QtOpenGLWidgets import QOpenGLWidget
from PySide6.QtWidgets import QWidget

_GL_RENDERER = 0x1F01
_SOFTWARE = ("llvmpipe", "softpipe", "swrast", "swr", "software", "gdi generic", "basic render")


def set_surface_format() -> None:
    """Set the OpenGL format that VTK needs for all new windows: 3.2 core, no multisampling.

    The views request the same format, but too late for their parent window.
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
    """Prepare a window for OpenGL views before it is shown.

    Otherwise Qt recreates the window when the first view is added: it flickers and loses the focus.
    """
    seed = QOpenGLWidget(window)
    seed.resize(1, 1)
    seed.hide()


@cache
def renderer_name() -> str:
    """Return the OpenGL renderer name; "" without OpenGL."""
    context, surface = QOpenGLContext(), QOffscreenSurface()
    surface.create()
    if not context.create() or not context.makeCurrent(surface):
        return ""
    name = context.functions().glGetString(_GL_RENDERER)
    context.doneCurrent()
    return str(name or "")


def multi_samples() -> int:
    """Return the samples per pixel: none for software rendering, which they slow down a lot."""
    name = renderer_name().lower()
    return 0 if not name or any(word in name for word in _SOFTWARE) else 4
