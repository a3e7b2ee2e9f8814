"""The loops over light paths that `PathTracer` compiles.

Dr.Jit rewrites these functions: they are written without types, and conditions on Python values
are decided when they are compiled. Import only after a variant has been set.
"""

from typing import Any

import drjit
import mitsuba

from sensors.render import glass

mi: Any = mitsuba  # their types differ by variant
dr: Any = drjit
_MOST_CROSSINGS = 24
"""Surfaces of glass that a shadow ray may pass; a bowl in a bowl has 8."""


def _projected(beam: Any, si: Any, active: Any) -> tuple[Any, Any]:
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


def _turned(sums: list[Any], waves: list[Any], amount: Any, length: Any, turn: Any) -> list[Any]:
    """Sums of light times the cosine or sine of its phase, one for each wave."""
    return [s + amount * turn(wave * length) for s, wave in zip(sums, waves, strict=True)]


@dr.syntax
def features(shapes, table, ray_in):  # type: ignore[no-untyped-def]
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
def trace(  # type: ignore[no-untyped-def]
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
