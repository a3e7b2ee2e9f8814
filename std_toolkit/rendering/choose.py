"""Choice of the renderer, detection of a working off-screen GL platform, and its contexts.

A broken GL driver may abort the process that creates a context, so the probe renders a triangle in
a child process. The result is kept for this process and, in an environment variable, for the
worker processes that it starts.
"""

import ctypes
import os
import subprocess
import sys
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.log import logger
from std_toolkit.rendering.renderer import RENDERERS, Renderer

DEFAULT_RENDERER = "pyrender"

PLATFORMS = ("egl", "osmesa")

ANSWER_VARIABLE = "STD_TOOLKIT_GL"
"""Environment variable with `egl`, `osmesa` or `none`; if set, the probe is skipped."""


def choose_renderer(name: str = DEFAULT_RENDERER, *, cameras: Iterable[Camera] = ()) -> str:
    """Return the name of the renderer to use for these cameras.

    `pyrender` is replaced by `raycast`, with a log message, if no GL context can be created and
    for cameras with distortion. Both draw the same maps (see docs/ground-truth.md). A plug-in is
    never replaced.

    Raises:
        ToolkitError: no renderer has this name.
    """
    if name != "pyrender":
        RENDERERS.get(name)
        return name
    if any(camera.is_distorted for camera in cameras):
        logger.info(
            "pyrender does not support the lens distortion of this camera: using the ray caster"
        )
        return "raycast"
    platform, reason = find_gl()
    if platform is None:
        logger.warning("cannot create a GL context (%s): using the ray caster", reason)
        return "raycast"
    return "pyrender"


@lru_cache(maxsize=4)
def get_renderer(name: str = DEFAULT_RENDERER) -> Renderer:
    """Return the renderer `name`. Created once per process, because a GL context is expensive.

    Raises:
        ToolkitError: no plug-in has this name, it is not a renderer, or it cannot run here.
    """
    renderer = RENDERERS.get(name)()
    if not isinstance(renderer, Renderer):
        raise ToolkitError("plug-in is not a renderer (name, handles_distortion, draw)", value=name)
    return renderer


_PROBE_SECONDS = 60

_PROBE = """
import numpy as np
from std_toolkit.rendering.mesh import RenderMesh
from std_toolkit.rendering.pyrender_renderer import GlCanvas
corners = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
mesh = RenderMesh.from_arrays(corners, np.array([[0, 1, 2]]))
pose = np.eye(4)
pose[2, 3] = 2
raster = GlCanvas("{platform}").draw(mesh, pose, 32.0, 32.0, 16.0, 16.0, 32, 32, 1.0, 3.0)
assert abs(float(raster.depth[16, 16]) - 2) < 1e-3, raster.depth[16, 16]
print("gl-works")
"""


@lru_cache(maxsize=1)
def find_gl() -> tuple[str | None, str]:
    """Return the GL platform that works here (`egl`, `osmesa` or None) and the reason.

    If PYOPENGL_PLATFORM names a platform, only that one is tried. A process that has already loaded
    OpenGL cannot change its platform.
    """
    answered = os.environ.get(ANSWER_VARIABLE)
    if answered in (*PLATFORMS, "none"):
        return (None, "as found before") if answered == "none" else (answered, "as found before")
    wished = os.environ.get("PYOPENGL_PLATFORM")
    candidates = PLATFORMS if wished is None else tuple(p for p in PLATFORMS if p == wished)
    loaded = loaded_platform()
    if loaded is not None:
        candidates = tuple(p for p in candidates if p == loaded)
    reasons = [] if candidates else [f"OpenGL is set to {loaded or wished!r} in this process"]
    for platform in candidates:
        problem = _probe(platform)
        if problem is None:
            os.environ[ANSWER_VARIABLE] = platform
            return platform, "rendered a test triangle"
        reasons.append(f"{platform}: {problem}")
    os.environ[ANSWER_VARIABLE] = "none"
    return None, "; ".join(reasons)


def loaded_platform() -> str | None:
    """Return the platform that PyOpenGL is bound to in this process; None if not loaded."""
    module = sys.modules.get("OpenGL.platform")
    bound = getattr(module, "PLATFORM", None)
    if bound is None:
        return None
    return type(bound).__name__.removesuffix("Platform").lower()


def _probe(platform: str) -> str | None:
    """Return None if a triangle could be drawn, or else the problem in one line."""
    environment = {**os.environ, "PYOPENGL_PLATFORM": platform}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE.format(platform=platform)],
            env=environment,
            capture_output=True,
            text=True,
            timeout=_PROBE_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"the probe failed to run ({type(error).__name__})"
    if done.returncode == 0 and "gl-works" in done.stdout:
        return None
    lines = [line for line in done.stderr.strip().splitlines() if line.strip()]
    problem = lines[-1] if lines else f"exit status {done.returncode}"
    logger.debug("GL probe %s: %s", platform, done.stderr.strip())
    return problem


def release_thread(platform: Any) -> None:
    """Release the context of the thread; Qt cannot make its own current while EGL's is."""
    from OpenGL import EGL

    EGL.eglMakeCurrent(
        platform._egl_display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT
    )


def leave_display(platform: Any) -> None:
    """Destroy only the context; pyrender would also terminate the display, which others use."""
    from OpenGL import EGL

    if platform._egl_context is not None:
        release_thread(platform)
        EGL.eglDestroyContext(platform._egl_display, platform._egl_context)
    platform._egl_display = platform._egl_context = None


def complete_osmesa() -> None:
    """Add the OSMesa function that pyrender needs to PyOpenGL 3.1.0, which pyrender pins.

    Names and constants are from Mesa's GL/osmesa.h.
    """
    from OpenGL import osmesa

    if hasattr(osmesa, "OSMesaCreateContextAttribs"):
        return
    from OpenGL import platform

    library = platform.PLATFORM.OSMesa
    # PyOpenGL uses contexts as dictionary keys, and its pointer type is not hashable.
    platform.PLATFORM.GetCurrentContext.restype = ctypes.c_void_p
    create = library.OSMesaCreateContextAttribs
    create.argtypes = [ctypes.POINTER(ctypes.c_int), ctypes.c_void_p]
    create.restype = osmesa.OSMesaContext

    def create_context(attributes: Any, shared: Any) -> Any:
        numbers = [int(n) for n in attributes]
        return create((ctypes.c_int * len(numbers))(*numbers), shared)

    osmesa.OSMesaCreateContextAttribs = create_context
    osmesa.OSMESA_DEPTH_BITS = 0x30
    osmesa.OSMESA_PROFILE = 0x33
    osmesa.OSMESA_CORE_PROFILE = 0x34
    osmesa.OSMESA_CONTEXT_MAJOR_VERSION = 0x36
    osmesa.OSMESA_CONTEXT_MINOR_VERSION = 0x37
