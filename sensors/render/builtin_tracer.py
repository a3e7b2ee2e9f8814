"""Path tracing with Mitsuba's own integrator, for the variant without a compiler.

Slower than `path_tracer`, with the same physics and pixel centres; tests compare the two. It
ignores the option `diffuse_bounces`: its paths end by `max_depth` alone.
Import only after a variant has been set.
"""

from typing import Any

import mitsuba
import numpy as np
from numpy.typing import NDArray

from sensors.render.sim_renderer import RenderOptions
from sensors.render.sim_scene import Projector
from std_toolkit.geometry import SE3, Camera

mi: Any = mitsuba  # its types differ by variant


class BuiltinTracer:
    """Renders views of one scene.

    Args:
        scene: Mitsuba scene of the active variant.
        environment: its emitter, of strength 1.
    """

    def __init__(self, scene: Any, environment: Any) -> None:
        self._parts = {f"s{i}": s for i, s in enumerate(scene.shapes())}
        self._environment = environment

    def radiance(
        self,
        camera: Camera,
        T_world_cam: SE3,
        projector: Projector | None,
        *,
        ambient: float,
        options: RenderOptions,
        seed: int,
        grey: bool,
    ) -> NDArray[np.float32]:
        """(H, W, n, c) float32: mean of every chunk of every pixel; c is 1 where `grey`."""
        scene = self._view_scene(projector, ambient, options.projector_weight)
        integrator = mi.load_dict(
            {
                "type": "volpath",
                "max_depth": options.max_depth,
                "rr_depth": options.roulette_depth,
            }
        )
        chunk = options.chunk or options.samples
        sensor = _sensor(camera, T_world_cam, chunk)
        count = options.samples // chunk
        chunks = [
            np.array(
                mi.render(
                    scene,
                    sensor=sensor,
                    integrator=integrator,
                    spp=chunk,
                    seed=(seed * count + i) % 2**32,  # Mitsuba accepts 32 bits
                )
            )
            for i in range(count)
        ]
        image = np.stack(chunks, axis=2)[..., :3].astype(np.float32)
        return image.mean(axis=-1, keepdims=True) if grey else image

    def _view_scene(self, projector: Projector | None, ambient: float, weight: float) -> Any:
        parameters = mi.traverse(self._environment)
        parameters["scale"] = ambient
        parameters.update()
        parts: dict[str, Any] = {"type": "scene", **self._parts, "environment": self._environment}
        if projector is not None:
            parts["projector"] = _projector(projector, weight)
        return mi.load_dict(parts, optimize=False)


def _projector(projector: Projector, weight: float) -> dict[str, Any]:
    h, w = projector.pattern.shape
    tan_x, tan_y = projector.tan_half
    x = ((np.arange(w) + 0.5) / w * 2 - 1) * tan_x
    y = ((np.arange(h) + 0.5) / h * 2 - 1) * tan_y
    # Mitsuba expects irradiance on the plane at distance 1; ours is on facing surfaces.
    cosine = 1 / np.sqrt(1 + x[None] ** 2 + y[:, None] ** 2)
    image = np.asarray(projector.image * cosine**3, np.float32)
    return {
        "type": "projector",
        "irradiance": {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(image[..., None])),
            "raw": True,
            "filter_type": "bilinear",
            "wrap_mode": "clamp",
        },
        "scale": projector.power / np.pi,  # unit: radiance of a white surface
        "fov": projector.fov_x_deg,
        "to_world": _to_world(projector.T_world_projector),
        "sampling_weight": weight,
    }


def _sensor(camera: Camera, T_world_cam: SE3, samples: int) -> Any:
    """A perspective sensor; Mitsuba has one focal length and a principal point offset."""
    width, height = camera.width, camera.height
    film = {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "pixel_format": "rgb",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    return mi.load_dict(
        {
            "type": "perspective",
            "fov_axis": "x",
            "fov": float(np.rad2deg(2 * np.arctan(width / 2 / camera.fx))),
            "principal_point_offset_x": 0.5 - (camera.cx + 0.5) / width,
            "principal_point_offset_y": 0.5 - (camera.cy + 0.5) / height,
            "near_clip": 0.001,
            "far_clip": 1000.0,
            "to_world": _to_world(T_world_cam),
            "film": film,
            "sampler": {"type": "multijitter", "sample_count": samples},
        }
    )


def _to_world(T: SE3) -> Any:
    # Mitsuba's cameras look along z with x to the left and y up.
    matrix: Any = T.matrix() @ np.diag([-1.0, -1.0, 1.0, 1.0])
    return mi.ScalarTransform4f(matrix)
