"""Several users of one EGL display in a process: none of them ends it for the others."""

from __future__ import annotations

import gc
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from std_toolkit.geometry import SE3, Camera
from std_toolkit.rendering.mesh import prepare_mesh
from std_toolkit.rendering.pyrender_renderer import PyrenderRenderer
from std_toolkit.rendering.renderer import image_window
from tests.skips import need_gl

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)


@pytest.fixture(autouse=True)
def _only_on_egl() -> None:
    need_gl("egl")


def depth_of_a_box(renderer: PyrenderRenderer) -> np.ndarray:
    mesh = prepare_mesh(trimesh.creation.box((0.1, 0.1, 0.1)))
    T_cam_obj = SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))
    return renderer.draw(CAMERA, mesh, T_cam_obj, window=image_window(CAMERA)).depth


@pytest.mark.slow
def test_a_renderer_that_goes_leaves_the_others_theirs() -> None:
    stays, goes = PyrenderRenderer(), PyrenderRenderer()
    before = depth_of_a_box(stays)
    assert before[23, 31] == pytest.approx(0.45, abs=3e-4)
    np.testing.assert_array_equal(depth_of_a_box(goes), before)
    del goes
    gc.collect()
    np.testing.assert_array_equal(depth_of_a_box(stays), before)


WITH_VTK = """
import numpy as np
from std_toolkit.rendering.pyrender_renderer import PyrenderRenderer
from tests.std_toolkit.rendering.test_shared_display import depth_of_a_box
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderWindow
renderer = PyrenderRenderer()
before = depth_of_a_box(renderer)
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.Render()
window.Finalize()
del window
np.testing.assert_array_equal(depth_of_a_box(renderer), before)
print(before[23, 31])
"""


@pytest.mark.slow
def test_a_window_of_vtk_that_closes_ends_no_renderer(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("vtkmodules", reason="the extras gui and web are not installed")
    monkeypatch.setenv("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    run = subprocess.run([sys.executable, "-c", WITH_VTK], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert float(run.stdout) == pytest.approx(0.45, abs=3e-4)


def test_drawing_leaves_the_thread_without_a_context() -> None:
    """Qt could not make its own current in a thread that has one of EGL."""
    renderer = PyrenderRenderer()
    assert depth_of_a_box(renderer)[23, 31] == pytest.approx(0.45, abs=3e-4)
    from OpenGL import EGL

    assert not EGL.eglGetCurrentContext()
