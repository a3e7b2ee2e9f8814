"""Path tracing in one wavefront, for the compiled variants of Mitsuba.

Mitsuba's own integrators support films and volumes; this one handles surfaces only. Shadow rays
pass straight through glass (`render.glass`), so that the projector's light reaches the surfaces
behind it. Cameras are passed as data, so that no view triggers a compilation. The samples
of a pixel are contiguous, so that sums need no atomic operation and an image is reproducible to the
bit.

Import only after a variant has been set.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit
import mitsuba
import numpy as np
from numpy.typing import NDArray

from sensors.render import glass, mitsuba_scene, path_loops, sim_renderer, sim_scene
from sensors.render.sky import Sky
from std_toolkit.arrays import Floats
from std_toolkit.geometry import SE3, Camera

mi: Any = mitsuba  # their types differ by variant
dr: Any = drjit
_ALONE = 1e6
"""Weight of a projector when there is no other light."""


@dataclass(eq=False)  # not frozen: a loop writes its state back into its arguments
class _Frame:
    """Rotation and position of a camera or projector as data of the kernel."""

    x: Any
    y: Any
    z: Any
    origin: Any

    @staticmethod
    def of(T: SE3) -> _Frame:
        x, y, z = (mi.Vector3f(*(_data(v) for v in T.R[:, i])) for i in range(3))
        return _Frame(x, y, z, mi.Point3f(*(_data(v) for v in T.t)))


@dataclass(eq=False)
class _Beam:
    frame: _Frame
    texture: Any
    tan_x: Any
    tan_y: Any
    power: Any
    chance: Any


def _stratifies(count: int) -> bool:
    """Whether the sampler's grid, as square as possible, has exactly this many cells."""
    across = int(count**0.5)
    return across * -(-count // across) == count


def _data(value: float) -> Any:
    """A number passed to the kernel as data instead of a literal."""
    return dr.opaque(mi.Float, float(value))


class PathTracer:
    """Renders views of one scene.

    Args:
        shapes: surfaces of the active variant.
        meshes: the meshes among them, with what they are made of.
        sky: its environment.
    """

    def __init__(
        self,
        shapes: mitsuba_scene.Shapes,
        meshes: Sequence[tuple[Any, sim_scene.SceneObject]],
        sky: Sky,
    ) -> None:
        self._shapes, self.sky = shapes, sky
        self._glass = glass.Table([m for m, _ in meshes], [_glass_of(item) for _, item in meshes])
        self._far = _data(4 * shapes.everything.bbox().bounding_sphere().radius + 1)
        self._sampler = mi.load_dict({"type": "multijitter"})
        self._patterns: dict[int, tuple[sim_scene.Projector, Any]] = {}

    def radiance(
        self,
        camera: Camera,
        T_world_cam: SE3 | Sequence[SE3],
        projector: sim_scene.Projector | None,
        *,
        ambient: float,
        options: sim_renderer.RenderOptions,
        seed: int,
        grey: bool,
        indirect: bool = False,
    ) -> Floats:
        """(N H, W, n, c) float32: mean of every chunk of every pixel; c is 1 where `grey`.

        The images of N cameras are one below the other, rendered in one launch. `indirect` leaves
        out the projector's light that was not scattered by a diffuse surface: all dots.
        """
        # Without ambient light, dots at the same places in every pixel are less noisy.
        regular = projector is not None and ambient == 0
        ray, count = self._rays(camera, T_world_cam, options.samples, seed, regular=regular)
        # Without other light, sampling it would be wasted.
        weight = options.projector_weight if ambient > 0 else _ALONE
        beam = None if projector is None else self._beam(projector, weight)
        light = path_loops.trace(
            self._shapes,
            self._glass,
            self.sky if ambient > 0 else None,
            self._far,
            self._sampler,
            ray,
            beam,
            _data(ambient),
            options.max_depth,
            options.diffuse_bounces,
            options.roulette_depth,
            "unscattered" if indirect else "",
            [],
        )[0]
        chunk = options.chunk or options.samples
        parts = [(light.x + light.y + light.z) / 3] if grey else [light.x, light.y, light.z]
        return np.stack(_means(parts, chunk, (-1, camera.width, count // chunk)), axis=-1)

    def phasors(
        self,
        camera: Camera,
        T_world_cam: SE3,
        lamp: sim_scene.Projector,
        waves: Sequence[float],
        *,
        options: sim_renderer.RenderOptions,
        seed: int,
        late: bool = False,
    ) -> tuple[NDArray[np.complex64], Floats]:
        """Means over the light paths of a pixel, of the lamp's light alone.

        The length is that of a path from the lamp over the surfaces to the camera, metres; the
        waves are in radians per metre. `late` leaves out what the lamp lights directly in view.

        Returns:
            (F, H, W) complex64 means of `light * exp(i wave * length)`, and (H, W) float32 means of
            the light.
        """
        ray, count = self._rays(camera, T_world_cam, options.samples, seed, regular=True)
        light, real, imaginary = path_loops.trace(
            self._shapes,
            self._glass,
            None,
            self._far,
            self._sampler,
            ray,
            self._beam(lamp, _ALONE),
            _data(0),
            options.max_depth,
            options.diffuse_bounces,
            options.roulette_depth,
            "direct" if late else "",
            [_data(wave) for wave in waves],
        )
        parts = [*real, *imaginary, (light.x + light.y + light.z) / 3]
        means = np.stack(_means(parts, count, (camera.height, camera.width)))
        real, imaginary = means[: len(waves)], means[len(waves) : -1]
        return np.asarray(real + 1j * imaginary, np.complex64), means[-1]

    def features(
        self, camera: Camera, T_world_cam: SE3 | Sequence[SE3], *, samples: int, seed: int
    ) -> tuple[Floats, Floats]:
        """Albedo and world-frame normal of what is seen, (N H, W, 3) float32 each.

        The albedo is that of the first surface behind glass, the normal that of the glass.
        """
        ray, count = self._rays(camera, T_world_cam, samples, seed)
        albedo, normal = path_loops.features(self._shapes, self._glass, ray)
        maps = np.stack(_means([*albedo, *normal], count, (-1, camera.width)), axis=-1)
        return np.ascontiguousarray(maps[..., :3]), np.ascontiguousarray(maps[..., 3:])

    def first_hits(self, camera: Camera, T_world_cam: SE3) -> tuple[Floats, Floats]:
        """z-depth (H, W), 0 = none, and world normal (H, W, 3) at every pixel centre."""
        x, y = (g.ravel().astype(np.float32) for g in np.moveaxis(camera.pixel_grid(), -1, 0))
        ray = _camera_rays(camera, T_world_cam, mi.Float(x), mi.Float(y))
        si = self._shapes.everything.ray_intersect(ray)
        frame = _Frame.of(T_world_cam)
        z = dr.select(si.is_valid(), dr.dot(si.p - frame.origin, mi.Point3f(frame.z)), 0)
        n = dr.select(si.is_valid(), si.n, mi.Normal3f(0))
        shape = (camera.height, camera.width)
        return np.array(z).reshape(shape), np.array(n).T.reshape(*shape, 3)

    def _rays(
        self,
        camera: Camera,
        T: SE3 | Sequence[SE3],
        samples: int,
        seed: int,
        *,
        regular: bool = False,
    ) -> tuple[Any, int]:
        eyes = [T] if isinstance(T, SE3) else list(T)
        total = len(eyes) * camera.width * camera.height * samples
        group = self._group(samples)
        self._sampler.set_sample_count(group)
        self._sampler.set_samples_per_wavefront(group)
        self._sampler.seed(seed, total)
        pixel = dr.arange(mi.UInt32, total) // dr.opaque(mi.UInt32, samples)
        width = dr.opaque(mi.UInt32, camera.width)
        row = pixel // width
        jitter = self._sampler.next_2d()
        across = int(samples**0.5)
        if regular and across**2 == samples:
            cell = dr.arange(mi.UInt32, total) % dr.opaque(mi.UInt32, samples)
            side = dr.opaque(mi.UInt32, across)
            at = mi.Point2f(mi.Float(cell % side), mi.Float(cell // side))
            jitter = (at + 0.5) / mi.Float(side)
        height = dr.opaque(mi.UInt32, camera.height)
        eye = row // height
        x = mi.Float(pixel - row * width) + jitter.x - 0.5
        y = mi.Float(row - eye * height) + jitter.y - 0.5
        ray = _camera_rays(camera, eyes[0], x, y)
        for i, other in enumerate(eyes[1:], start=1):
            ray = dr.select(eye == i, _camera_rays(camera, other, x, y), ray)
        return ray, samples

    def _group(self, samples: int) -> int:
        """Largest divisor of the samples that the sampler can stratify directly (16 of 32)."""
        for count in range(samples, 0, -1):
            if samples % count == 0 and _stratifies(count):
                return count
        return 1

    def _beam(self, projector: sim_scene.Projector, weight: float) -> _Beam:
        kept = self._patterns.get(id(projector.pattern))
        if kept is None or kept[0].pattern is not projector.pattern:
            texture = mi.Texture2f(
                mi.TensorXf(projector.image[..., None]),
                filter_mode=dr.FilterMode.Linear,
                wrap_mode=dr.WrapMode.Clamp,
            )
            self._patterns = {id(projector.pattern): (projector, texture)}
            kept = (projector, texture)
        tan_x, tan_y = projector.tan_half
        return _Beam(
            _Frame.of(projector.T_world_projector),
            kept[1],
            _data(tan_x),
            _data(tan_y),
            _data(projector.power),
            _data(weight / (1 + weight)),
        )


def _means(parts: list[Any], count: int, shape: tuple[int, ...]) -> list[Floats]:
    """Mean of every `count` consecutive numbers of each part, float32 of a shape."""
    dr.eval(*parts)  # together: separately, every sum would run the whole kernel
    sums = [dr.block_sum(part, count) for part in parts]
    dr.eval(*sums)
    return [np.array(s, np.float32).reshape(shape) / np.float32(count) for s in sums]


def _camera_rays(camera: Camera, T_world_cam: SE3, x: Any, y: Any) -> Any:
    frame = _Frame.of(T_world_cam)
    right = (x - _data(camera.cx)) / _data(camera.fx)
    down = (y - _data(camera.cy)) / _data(camera.fy)
    return mi.Ray3f(frame.origin, dr.normalize(frame.x * right + frame.y * down + frame.z))


def _glass_of(item: sim_scene.SceneObject) -> glass.GlassSurface | None:
    material = item.material.glass
    if material is None:
        return None
    mesh = item.mesh.prepared
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1).sum() / 2
    volume = abs(np.einsum("ij,ij->i", corners[:, 0], cross).sum()) / 6
    solid = 2 * volume / max(area, 1e-12) > glass.THICK_SHARE * mesh.diagonal
    return glass.GlassSurface(material, item.material.color, bool(solid), item.instance_id)
