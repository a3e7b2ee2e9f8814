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

from sensors.render import glass, mitsuba_scene, sim_renderer, sim_scene
from sensors.render.sky import Sky
from std_toolkit.geometry import SE3, Camera

mi: Any = mitsuba  # their types differ by variant
dr: Any = drjit
_ALONE = 1e6
"""Weight of a projector when there is no other light."""
_MOST_CROSSINGS = 24
"""Surfaces of glass that a shadow ray may pass; a bowl in a bowl has 8."""


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
    ) -> NDArray[np.float32]:
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
        light = _trace(
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
        dr.eval(*parts)  # together: separately, every sum would run the whole kernel
        sums = [dr.block_sum(part, chunk) for part in parts]
        dr.eval(*sums)
        shape = (-1, camera.width, count // chunk)
        means = [np.array(s).reshape(shape) / np.float32(chunk) for s in sums]
        return np.stack(means, axis=-1)

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
    ) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
        """Means over the light paths of a pixel, of the lamp's light alone.

        The length is that of a path from the lamp over the surfaces to the camera, metres; the
        waves are in radians per metre. `late` leaves out what the lamp lights directly in view.

        Returns:
            (F, H, W) complex64 means of `light * exp(i wave * length)`, and (H, W) float32 means of
            the light.
        """
        ray, count = self._rays(camera, T_world_cam, options.samples, seed, regular=True)
        light, real, imaginary = _trace(
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
        dr.eval(*parts)
        sums = [dr.block_sum(part, count) for part in parts]
        dr.eval(*sums)
        shape = (len(sums), camera.height, camera.width)
        means = np.stack([np.array(s) for s in sums]).reshape(shape) / np.float32(count)
        real, imaginary = means[: len(waves)], means[len(waves) : -1]
        return np.asarray(real + 1j * imaginary, np.complex64), means[-1]

    def features(
        self, camera: Camera, T_world_cam: SE3 | Sequence[SE3], *, samples: int, seed: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Albedo and world-frame normal of what is seen, (N H, W, 3) float32 each.

        The albedo is that of the first surface behind glass, the normal that of the glass.
        """
        ray, count = self._rays(camera, T_world_cam, samples, seed)
        albedo, normal = _features(self._shapes, self._glass, ray)
        dr.eval(albedo, normal)
        sums = [dr.block_sum(v, count) for v in (*albedo, *normal)]
        dr.eval(*sums)
        shape = (-1, camera.width)
        maps = np.stack([np.array(s).reshape(shape) for s in sums], axis=-1) / np.float32(count)
        return np.ascontiguousarray(maps[..., :3]), np.ascontiguousarray(maps[..., 3:])

    def first_hits(
        self, camera: Camera, T_world_cam: SE3
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
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


def _camera_rays(camera: Camera, T_world_cam: SE3, x: Any, y: Any) -> Any:
    frame = _Frame.of(T_world_cam)
    right = (x - _data(camera.cx)) / _data(camera.fx)
    down = (y - _data(camera.cy)) / _data(camera.fy)
    return mi.Ray3f(frame.origin, dr.normalize(frame.x * right + frame.y * down + frame.z))


def _projected(beam: _Beam, si: Any, active: Any) -> tuple[Any, Any]:
    """Direction to the projector and its irradiance at a point that faces it."""
    away = si.p - beam.frame.origin
    z = dr.dot(away, beam.frame.z)
    u = dr.dot(away, beam.frame.x) / (z * beam.tan_x) * 0.5 + 0.5
    v = dr.dot(away, beam.frame.y) / (z * beam.tan_y) * 0.5 + 0.5
    lit = active & (z > 0) & (u > 0) & (u < 1) & (v > 0) & (v < 1)
    value = beam.texture.eval(mi.Point2f(u, v), lit)[0]
    squared = dr.squared_norm(away)
    irradiance = dr.select(lit, value * beam.power / squared, 0)
    return -away * dr.rsqrt(squared), irradiance


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


def _turned(sums: list[Any], waves: list[Any], amount: Any, length: Any, turn: Any) -> list[Any]:
    """Sums of light times the cosine or sine of its phase, one for each wave."""
    return [s + amount * turn(wave * length) for s, wave in zip(sums, waves, strict=True)]


@dr.syntax
def _features(shapes, table, ray_in):  # type: ignore[no-untyped-def]
    """Albedo of the first surface that is not glass, and the normal of the first one."""
    ray = mi.Ray3f(ray_in)
    albedo, normal = mi.Spectrum(1), mi.Normal3f(0)
    todo = mi.Bool(True)
    crossed = mi.UInt32(0)
    while dr.hint(todo, label="features"):
        si = shapes.everything.ray_intersect(ray, mi.RayFlags.All, crossed == 0, todo)
        hit = todo & si.is_valid()
        face = table.at(si.shape, hit)
        found = hit & ~face.clear
        albedo[found] = si.bsdf(ray).eval_diffuse_reflectance(si, found)
        normal[hit & (crossed == 0)] = si.sh_frame.n
        # Choice 1: always transmitted.
        onward, _, _ = glass.crossed(face, si, ray.d, mi.Float(1), mi.Point2f(0), dots=False)
        ray = si.spawn_ray(onward)
        crossed += 1
        todo = face.clear & (crossed < _MOST_CROSSINGS)
    return albedo, normal


@dr.syntax
def _unblocked(opaque, clear, table, si, target, active):  # type: ignore[no-untyped-def]
    """Fraction of light that passes from `target` to a surface, straight through glass."""
    ray = si.spawn_ray_to(target)
    share = dr.select(active, mi.Spectrum(1), mi.Spectrum(0))
    if dr.hint(opaque is not None, mode="scalar"):
        share[active & opaque.ray_test(ray, active)] = 0
    if dr.hint(clear is not None, mode="scalar"):
        todo = active & (share.x > 0)
        crossed = mi.UInt32(0)
        while dr.hint(todo, label="through glass"):
            met = clear.ray_intersect_preliminary(ray, False, todo)
            hit = todo & met.is_valid()
            between = met.compute_surface_interaction(ray, mi.RayFlags.Minimal, hit)
            face = table.at(between.shape, hit)
            share[hit] *= glass.straight(face, dr.dot(between.n, ray.d))
            crossed += 1
            todo = hit & (dr.max(share) > 1e-3) & (crossed < _MOST_CROSSINGS)
            ray[todo] = between.spawn_ray_to(target)
    return share


@dr.syntax
def _trace(  # type: ignore[no-untyped-def]
    shapes,
    table,
    sky,
    far,
    sampler,
    ray_in,
    beam,
    ambient,
    max_depth,
    diffuse_bounces,
    roulette,
    without,
    waves,
):
    """Radiance along rays, and the beam's light times cosine and sine of `wave * length`.

    `without` leaves out a part of the beam's light: "direct", at surfaces directly in view;
    "unscattered", that no diffuse surface scattered before; "", nothing. It, depths, the number of
    waves and the existence of beam and sky are compile-time constants.
    """
    context = mi.BSDFContext()
    ray = mi.Ray3f(ray_in)
    throughput = mi.Spectrum(1)
    light = mi.Spectrum(0)
    depth, diffuse = mi.UInt32(0), mi.UInt32(0)
    # Density of the last direction, for multiple importance sampling with the sky.
    last_pdf = mi.Float(dr.inf)
    active = mi.Bool(True)
    last_share = mi.Float(1)
    # Length of the path so far; a length in glass counts as in air.
    length = mi.Float(0)
    real = [mi.Float(0) for _ in waves]
    imaginary = [mi.Float(0) for _ in waves]
    while dr.hint(active, label="path"):
        si = shapes.everything.ray_intersect(ray, mi.RayFlags.All, depth == 0, active)
        if dr.hint(len(waves) > 0, mode="scalar"):
            length += dr.select(si.is_valid(), si.t, 0)
        if dr.hint(sky is not None, mode="scalar"):
            # Only the sky emits light: rays that leave the scene add its radiance.
            left = active & ~si.is_valid()
            other = sky.density(ray.d, left & dr.isfinite(last_pdf)) * last_share
            share = dr.select(dr.isfinite(last_pdf), last_pdf / (last_pdf + other), 1)
            light[left] += throughput * sky.radiance(ray.d, left) * (share * ambient)

        going = active & si.is_valid() & (depth + 1 < max_depth)
        face = table.at(si.shape, going)
        bsdf = si.bsdf(ray)
        smooth = going & ~face.clear & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        # Haze and highlights on glass; once a path was scattered, they hardly matter.
        hazy = face.clear & (diffuse == 0)
        asks_sky, sky_share = smooth | hazy, mi.Float(1)
        if dr.hint(beam is not None, mode="scalar"):
            # Directly visible surfaces sample both lights, indirectly visible ones sample one of
            # them: this choice causes most of the noise.
            asks_beam = smooth & (diffuse > 0) if without == "unscattered" else smooth | hazy
            asks_beam = asks_beam & (depth > 0) if without == "direct" else asks_beam
            chance = mi.Float(1)
            if dr.hint(sky is not None, mode="scalar"):
                both = diffuse == 0
                choice = sampler.next_1d(smooth)
                asks_beam &= both | (choice < beam.chance)
                asks_sky &= both | (choice >= beam.chance)
                sky_share = dr.select(both, 1, 1 - beam.chance)
                chance = dr.select(both, 1, beam.chance)
            to_beam, irradiance = _projected(beam, si, asks_beam)
            asks_beam &= irradiance > 0
            value = bsdf.eval(context, si, si.to_local(to_beam), asks_beam & ~face.clear)
            value[face.clear] = mi.Spectrum(glass.scattered(face, si, ray.d, to_beam))
            asks_beam &= dr.max(value) > 0
            value *= irradiance / chance
            arrived = (
                throughput
                * value
                * _unblocked(shapes.opaque, shapes.glass, table, si, beam.frame.origin, asks_beam)
            )
            light[asks_beam] += arrived
            if dr.hint(len(waves) > 0, mode="scalar"):
                amount = dr.select(asks_beam, (arrived.x + arrived.y + arrived.z) / 3, 0)
                whole = length + dr.norm(si.p - beam.frame.origin)
                real = _turned(real, waves, amount, whole, dr.cos)
                imaginary = _turned(imaginary, waves, amount, whole, dr.sin)
        opaque = going & ~face.clear
        scattered, last = mi.Bool(False), mi.Bool(False)
        if dr.hint(sky is not None, mode="scalar"):
            towards, sky_pdf, arriving = sky.draw(sampler.next_2d(asks_sky), asks_sky)
            sky_pdf *= sky_share
            arriving *= ambient / sky_pdf
            value, pdf, sample, weight = bsdf.eval_pdf_sample(
                context,
                si,
                si.to_local(towards),
                sampler.next_1d(going),
                sampler.next_2d(going),
                opaque,
            )
            value[face.clear] = mi.Spectrum(
                face.haze * dr.inv_pi * dr.abs(dr.dot(si.sh_frame.n, towards))
            )
            asks_sky &= dr.max(value * arriving) > 0
            scattered = opaque & mi.has_flag(sample.sampled_type, mi.BSDFFlags.DiffuseReflection)
            diffuse[scattered] += 1
            last = diffuse >= diffuse_bounces
            share = dr.select(last | face.clear, 1, sky_pdf / (sky_pdf + pdf))
            arriving *= _unblocked(
                shapes.opaque, shapes.glass, table, si, si.p + towards * far, asks_sky
            )
            light[asks_sky] += throughput * value * arriving * share
        else:
            sample, weight = bsdf.sample(
                context, si, sampler.next_1d(going), sampler.next_2d(going), opaque
            )
            scattered = opaque & mi.has_flag(sample.sampled_type, mi.BSDFFlags.DiffuseReflection)
            diffuse[scattered] += 1
            last = diffuse >= diffuse_bounces

        onward, kept, mirrored = glass.crossed(
            face,
            si,
            ray.d,
            sampler.next_1d(face.clear),
            sampler.next_2d(face.clear),
            dots=sky is None,
        )
        ray = si.spawn_ray(dr.select(face.clear, onward, si.to_world(sample.wo)))
        throughput *= dr.select(face.clear, kept, weight)
        # Light that is transmitted counts as going straight, as it was sampled at the last surface.
        delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        last_pdf[opaque] = dr.select(delta, dr.inf, sample.pdf)
        last_pdf[face.clear & mirrored] = dr.inf
        last_share[opaque] = sky_share
        depth[going] += 1
        brightest = dr.max(throughput)
        survival = dr.minimum(brightest, 0.95)
        tested = (depth >= roulette) & ~face.clear
        alive = sampler.next_1d(going) < survival
        throughput[tested] *= dr.rcp(survival)
        active = going & ~last & (brightest > 0) & (~tested | alive)
    return light, real, imaginary
