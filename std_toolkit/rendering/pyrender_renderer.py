"""Pixel-exact renderer on pyrender (EGL or OSMesa).

Unmodified pyrender is not exact enough for labels: it draws into a four-sample buffer and keeps
the depth of one sample, which is (-0.125, 0.375) px off the pixel centre under Mesa; it culls back
faces; it outputs the colour of an object but not the triangle; and GL has pixel centres at 0.5.
This module therefore:

- uses pyrender's segmentation pass, which has no multisampling, with a custom fragment shader that
  writes the triangle number into the 24 bits of colour, and a buffer of one sample, which a
  software GL draws in less than half the time;
- duplicates every triangle of meshes that are not closed, with inverted winding;
- shifts the principal point by half a pixel, to GL's pixel grid;
- fits the near and far planes to the object, so that the resolution of the 24-bit depth buffer is
  below 0.1 um.

The context belongs to the thread that created it and is reused for every window.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from typing import Any

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.rendering.choose import (
    complete_osmesa,
    find_gl,
    leave_display,
    loaded_platform,
    release_thread,
)
from std_toolkit.rendering.mesh import RenderMesh
from std_toolkit.rendering.renderer import NEAR_M, Raster, Window, check_no_distortion, depth_range

_KEPT_MESHES = 64
_LARGEST_TILE = 2048
_MAX_FACES = 2**23  # numbered from 1 in 24 bits of colour, each possibly drawn in two windings

_VERTEX = """#version 330 core
layout(location = 0) in vec3 position;
uniform mat4 P;
uniform mat4 V;
uniform mat4 M;
void main() { gl_Position = P * (V * (M * vec4(position, 1.0))); }
"""
_FRAGMENT = """#version 330 core
out vec4 frag_color;
void main()
{
    int number = gl_PrimitiveID + 1;
    frag_color = vec4(number & 255, (number >> 8) & 255, (number >> 16) & 255, 255) / 255.0;
}
"""
_GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])


class PyrenderRenderer:
    """Pinhole renderer on pyrender.

    Raises:
        ToolkitError: no GL context can be created here.
    """

    name = "pyrender"
    handles_distortion = False

    def __init__(self) -> None:
        platform, reason = find_gl()
        if platform is None:
            raise ToolkitError(
                f"pyrender cannot create a GL context here ({reason})",
                hint="install libegl1 and libgl1-mesa-dri, or use --renderer raycast",
            )
        self._canvas = GlCanvas(platform)

    def draw(self, camera: Camera, mesh: RenderMesh, T_cam_obj: SE3, *, window: Window) -> Raster:
        """See `Renderer.draw`. Rejects cameras with distortion."""
        check_no_distortion(self.name, camera)
        near, far = depth_range(mesh, T_cam_obj)
        depth = np.zeros((window.height, window.width), np.float32)
        face = np.full((window.height, window.width), -1, np.int32)
        if far <= NEAR_M:
            return Raster(depth, face)
        double_sided = not mesh.closed or near <= NEAR_M  # cut open by the near plane
        near = max(near * 0.999 - 1e-4, NEAR_M)
        far = max(far * 1.001 + 1e-4, near * 1.01)
        pose = np.eye(4)
        pose[:3, :3] = T_cam_obj.R
        pose[:3, 3] = T_cam_obj.R @ mesh.centre + T_cam_obj.t
        for y in range(0, window.height, _LARGEST_TILE):
            for x in range(0, window.width, _LARGEST_TILE):
                w = min(_LARGEST_TILE, window.width - x)
                h = min(_LARGEST_TILE, window.height - y)
                tile = self._canvas.draw(
                    mesh,
                    pose,
                    camera.fx,
                    camera.fy,
                    camera.cx - window.x - x,
                    camera.cy - window.y - y,
                    w,
                    h,
                    near,
                    far,
                    double_sided=double_sided,
                )
                depth[y : y + h, x : x + w] = tile.depth
                face[y : y + h, x : x + w] = tile.face
        return Raster(depth, face)


class GlCanvas:
    """An off-screen GL context with the meshes uploaded to it.

    Args:
        platform: `egl` or `osmesa`; must match the platform if OpenGL is already loaded.
    """

    def __init__(self, platform: str) -> None:
        loaded = loaded_platform()
        if loaded not in (None, platform):
            raise ToolkitError(
                f"OpenGL is bound to {loaded} in this process and cannot change to {platform}",
                hint="set PYOPENGL_PLATFORM before the first import of OpenGL",
            )
        os.environ["PYOPENGL_PLATFORM"] = platform
        if platform == "osmesa":
            complete_osmesa()
        import pyrender

        self._resizable = platform == "egl"
        self._flags = pyrender.RenderFlags.SEG
        self._size = (0, 0)
        self._renderer: Any = None
        self._scene = pyrender.Scene()
        self._camera = pyrender.IntrinsicsCamera(1, 1, 0, 0)
        self._scene.add(self._camera)
        self._nodes: OrderedDict[tuple[int, bool], tuple[RenderMesh, Any]] = OrderedDict()

    def draw(
        self,
        mesh: RenderMesh,
        pose: np.ndarray,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        width: int,
        height: int,
        near: float,
        far: float,
        *,
        double_sided: bool = True,
    ) -> Raster:
        """Draw a mesh. The 4x4 `pose` maps centred vertices into the OpenCV camera frame."""
        self._fit(width, height)
        camera = self._camera
        # The first pixel centre is at 0.5 in GL and at 0 in the toolkit.
        camera.fx, camera.fy, camera.cx, camera.cy = fx, fy, cx + 0.5, cy + 0.5
        camera.zfar = max(far, camera.znear * 2)  # the setters require near < far at all times
        camera.znear, camera.zfar = near, far
        node = self._node(mesh, double_sided)
        self._scene.set_pose(node, _GL_FROM_CV @ pose)
        color, depth = self._renderer.render(self._scene, self._flags, {node: (0, 0, 0)})
        color = color[:height, :width]
        if color.shape[2] == 4:
            number = (color.view("<u4")[..., 0] & 0xFFFFFF).astype(np.int32)
        else:
            color = color.astype(np.int32)
            number = color[..., 0] + (color[..., 1] << 8) + (color[..., 2] << 16)
        face = number - 1
        drawn = number > 0
        face[drawn] %= len(mesh.faces)
        return Raster(np.where(drawn, depth[:height, :width], np.float32(0)), face)

    def _fit(self, width: int, height: int) -> None:
        """Make the drawing surface at least width x height.

        Sizes are rounded up, so that windows of about the same size share a surface. An OSMesa
        context has to be recreated to change its size, so there the surface only grows.
        """
        w, h = (-(-n // 64) * 64 for n in (width, height))
        if not self._resizable:
            w, h = max(w, self._size[0]), max(h, self._size[1])
        elif self._renderer is not None and self._is_lost():
            self._forget_meshes()
            self._renderer, self._size = None, (0, 0)
        if (w, h) == self._size:
            return
        if self._renderer is None:
            self._renderer = self._make_renderer(w, h)
        else:
            self._renderer.viewport_width, self._renderer.viewport_height = w, h
            if not self._resizable:
                self._renderer.delete()
                self._forget_meshes()
                self._renderer = self._make_renderer(w, h)
        self._size = (w, h)

    def _forget_meshes(self) -> None:
        """Drop the meshes of a lost context; they are uploaded again when drawn."""
        self._nodes.clear()
        for node in list(self._scene.mesh_nodes):
            self._scene.remove_node(node)

    @staticmethod
    def _make_renderer(width: int, height: int) -> Any:
        import pyrender

        renderer = pyrender.OffscreenRenderer(width, height)
        renderer._renderer._program_cache = _own_shaders()
        if os.environ["PYOPENGL_PLATFORM"] == "egl":
            _draw_one_sample(renderer._renderer)
            platform = renderer._platform
            platform.delete_context = lambda: leave_display(platform)
            platform.make_uncurrent = lambda: release_thread(platform)
        return renderer

    def _is_lost(self) -> bool:
        """Whether other code in this process, such as VTK, has terminated the EGL display."""
        from OpenGL.error import GLError

        try:
            self._renderer._platform.make_current()
        except GLError:
            return True
        return False

    def _node(self, mesh: RenderMesh, double_sided: bool) -> Any:
        key = (id(mesh), double_sided)
        kept = self._nodes.get(key)
        if kept is not None:
            self._nodes.move_to_end(key)
            return kept[1]
        import pyrender

        if len(mesh.faces) > _MAX_FACES:
            raise ToolkitError(
                "mesh has too many faces for the GL renderer",
                field="faces",
                value=len(mesh.faces),
                hint=f"simplify it to at most {_MAX_FACES} faces or use --renderer raycast",
            )
        faces = mesh.faces
        if double_sided:  # pyrender culls back faces in this pass
            faces = np.concatenate([faces, faces[:, ::-1]])
        primitive = pyrender.Primitive(
            positions=mesh.vertices.astype(np.float32), indices=faces.astype(np.uint32), mode=4
        )
        node = self._scene.add(pyrender.Mesh([primitive]))
        self._nodes[key] = (mesh, node)
        while len(self._nodes) > _KEPT_MESHES:
            _, (_, oldest) = self._nodes.popitem(last=False)
            self._scene.remove_node(oldest)
        return node


def _draw_one_sample(renderer: Any) -> None:
    """Let pyrender draw into the framebuffer that it otherwise copies its samples to."""
    from OpenGL import GL

    configure = renderer._configure_forward_pass_viewport

    def configure_pass(flags: int) -> None:
        configure(flags)
        GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, renderer._main_fb)

    def read(scene: Any, flags: int) -> tuple[np.ndarray, np.ndarray]:  # noqa: ARG001
        """(H,W,4) uint8 colour and (H,W) float32 depth in metres; that of the background is any."""
        width, height = renderer._main_fb_dims
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, renderer._main_fb)
        place = (0, 0, width, height)
        data = GL.glReadPixels(*place, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT)
        depth = np.frombuffer(data, np.float32).reshape(height, width)[::-1]
        data = GL.glReadPixels(*place, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE)
        color = np.frombuffer(data, np.uint8).reshape(height, width, 4)[::-1]
        camera = scene.main_camera_node.camera
        near, far = camera.znear, camera.zfar
        metres = (2.0 * near * far) / (far + near - (2.0 * depth - 1.0) * (far - near))
        return color, metres

    renderer._configure_forward_pass_viewport = configure_pass
    renderer._read_main_framebuffer = read


def _own_shaders() -> Any:
    """Replacement for pyrender's program cache that returns the custom program."""
    from pyrender.shader_program import ShaderProgram, ShaderProgramCache

    class Program(ShaderProgram):
        def _load(self, shader_filename: str) -> str:
            return _VERTEX if shader_filename.endswith(".vert") else _FRAGMENT

    class Programs(ShaderProgramCache):
        def get_program(
            self,
            vertex_shader: str,
            fragment_shader: str,
            geometry_shader: str | None = None,  # noqa: ARG002 - the signature is pyrender's
            defines: dict[str, Any] | None = None,  # noqa: ARG002
        ) -> ShaderProgram:
            if not self._program_cache:
                self._program_cache["own"] = Program(vertex_shader, fragment_shader)
            return self._program_cache["own"]

    return Programs()
