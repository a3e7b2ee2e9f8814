"""Which renderer to use: the one asked for, or the ray caster where GL or the camera forbid it."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import TYPE_CHECKING

from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger
from std_toolkit.rendering.gl_context import find_gl
from std_toolkit.rendering.protocol import RENDERERS, Renderer

if TYPE_CHECKING:
    from std_toolkit.geometry.camera import Camera

DEFAULT_RENDERER = "pyrender"


def choose_renderer(name: str = DEFAULT_RENDERER, *, cameras: Iterable[Camera] = ()) -> str:
    """Name of the renderer that will draw these cameras.

    `pyrender` gives way to `raycast`, with a notice in the log, where no GL context can be made
    and for cameras with distortion. Both draw the same maps (see docs/ground-truth.md). A plug-in
    never gives way.

    Raises:
        ToolkitError: there is no renderer of this name.
    """
    if name != "pyrender":
        RENDERERS.get(name)
        return name
    if any(camera.is_distorted for camera in cameras):
        logger.info(
            "the camera has lens distortion, which pyrender cannot draw: using the ray caster"
        )
        return "raycast"
    platform, reason = find_gl()
    if platform is None:
        logger.warning("no GL context can be made (%s): using the ray caster", reason)
        return "raycast"
    return "pyrender"


@lru_cache(maxsize=4)
def get_renderer(name: str = DEFAULT_RENDERER) -> Renderer:
    """The renderer of this name, made once per process (a GL context is dear).

    Raises:
        ToolkitError: there is none, it is not a renderer, or it cannot work here.
    """
    renderer = RENDERERS.get(name)()
    if not isinstance(renderer, Renderer):
        raise ToolkitError("plug-in is not a renderer (name, handles_distortion, draw)", value=name)
    return renderer
