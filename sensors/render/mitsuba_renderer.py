"""The simulator's renderer on Mitsuba 3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.lighting.environment import EnvironmentMap
from sensors.render import mitsuba_scene
from sensors.render.color_image import Denoiser, denoiser
from sensors.render.sim_renderer import DRAFT_COLOR, DRAFT_INFRARED, ColorLight, RenderOptions
from sensors.render.sim_scene import Projector, SceneObject, SimScene
from sensors.render.variant import choose_variant
from std_toolkit.arrays import Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.depth_maps import z_to_distance
from std_toolkit.jobs.interrupt import whole_imports
from std_toolkit.rendering.renderer import check_no_distortion

_FEATURE_SAMPLES, _FAST_FEATURE_SAMPLES = 4, 2
# Paths of time of flight, beside those of light that is directly in view.
_LATE_FACTOR = 4
# This share of the pixels is darker than the brightest dots, mirrored ones aside.
_DOT_QUANTILE = 0.995
_CLIP_FACTOR = 2.0
_CLIP_FLOOR = 0.37
"""Fraction of the image's mean: 0.02 in the measurement, at a mean of 0.054."""


class MitsubaRenderer:
    """Renders with the fastest variant that works on this machine.

    Args:
        variant: of Mitsuba; None chooses one by a test in a child process.
        threads: of a compiled variant and of the denoiser; None uses all cores.
        check: whether to test the variant in a child process first.

    Raises:
        ToolkitError: Mitsuba is not installed, or the variant does not work here.
    """

    def __init__(
        self, *, variant: str | None = None, threads: int | None = None, check: bool = True
    ) -> None:
        chosen = choose_variant(variant) if check or variant is None else variant
        try:
            with whole_imports():
                import drjit
                import mitsuba
        except ImportError as error:
            raise ToolkitError(
                f"the simulator needs Mitsuba: {error}", hint="pip install 'std-toolkit[sim]'"
            ) from error
        mitsuba.set_variant(chosen)
        if threads is not None:
            drjit.set_thread_count(threads)
        self.name = f"mitsuba/{chosen}"
        self._mi: Any = mitsuba
        self._variant, self._threads = chosen, threads

    def load(self, scene: SimScene) -> MitsubaScene:
        """See `SimRenderer.load`."""
        # Another renderer in this process may have changed the variant.
        self._mi.set_variant(self._variant)
        return MitsubaScene(scene, self._mi, self._variant, self._threads)


class MitsubaScene:
    """See `LoadedScene`."""

    def __init__(self, scene: SimScene, mi: Any, variant: str, threads: int | None = None) -> None:
        self._mi, self._variant, self._threads = mi, variant, threads
        self._scalar = variant.startswith("scalar")  # without a compiler
        self._scene = scene
        # Surfaces differ between colour and infrared; each tracer is built on first use.
        self._tracers: dict[bool, Any] = {}
        self._floors: dict[bool, Any] = {}

    def _tracer(self, *, infrared: bool) -> Any:
        if infrared in self._tracers:
            return self._tracers[infrared]
        mi, scene = self._mi, self._scene
        shapes, meshes = mitsuba_scene.build(mi, scene, infrared=infrared)
        self._floors[infrared] = meshes[0][0]
        if self._scalar:
            from sensors.render.builtin_tracer import BuiltinTracer

            light = mitsuba_scene.environment(mi, scene)
            self._tracers[infrared] = BuiltinTracer(shapes.everything, light)
        else:
            from sensors.render.path_tracer import PathTracer
            from sensors.render.sky import Sky

            sky = Sky(scene.environment, scene.environment_rotation_rad)
            self._tracers[infrared] = PathTracer(shapes, meshes, sky)
        return self._tracers[infrared]

    def change(self, environment: EnvironmentMap, rotation_rad: float, floor: SceneObject) -> None:
        """See `LoadedScene.change`."""
        was = self._scene
        self._mi.set_variant(self._variant)
        self._scene = replace(
            was,
            objects=(floor, *was.objects[1:]),
            environment=environment,
            environment_rotation_rad=rotation_rad,
        )
        if self._scalar:
            self._tracers.clear()
            return
        from sensors.render.sky import Sky

        relit = environment is not was.environment or rotation_rad != was.environment_rotation_rad
        for infrared, tracer in self._tracers.items():
            if relit:
                tracer.sky = Sky(environment, rotation_rad)
            if floor is not was.objects[0]:
                mesh = self._floors[infrared]
                mitsuba_scene.repaint(self._mi, mesh, floor, infrared=infrared)

    def infrared_pair(
        self,
        camera: Camera,
        T_world_cams: tuple[SE3, SE3],
        projector: Projector | None,
        *,
        ambient: float,
        options: RenderOptions = DRAFT_INFRARED,
        seed: int = 0,
    ) -> tuple[Floats, Floats]:
        """See `LoadedScene.infrared_pair`; one launch where the variant is compiled."""
        rest: dict[str, Any] = {"ambient": ambient, "options": options}
        if self._lights_apart(projector, ambient, options):
            light = self._both_lights(camera, T_world_cams, projector, **rest, seed=seed)
            return light[0], light[1]
        left, right = (
            self.infrared(camera, T, projector, **rest, seed=2 * seed + eye)
            for eye, T in enumerate(T_world_cams)
        )
        return left, right

    def infrared(
        self,
        camera: Camera,
        T_world_cam: SE3,
        projector: Projector | None,
        *,
        ambient: float,
        options: RenderOptions = DRAFT_INFRARED,
        seed: int = 0,
    ) -> Floats:
        """See `LoadedScene.infrared`.

        Without a denoiser, or a compiled variant, both lights are rendered together, with four
        times as many paths.
        """
        if self._lights_apart(projector, ambient, options):
            rest: dict[str, Any] = {"ambient": ambient, "options": options, "seed": seed}
            return self._both_lights(camera, (T_world_cam,), projector, **rest)[0]
        if options.ambient_samples:
            many = 4 * options.samples
            options = replace(options, samples=many, chunk=options.samples, ambient_samples=0)
        chunks = self._radiance(
            camera, T_world_cam, projector, ambient=ambient, options=options, seed=seed, grey=True
        )
        return clipped_mean(chunks)[..., 0]

    def _lights_apart(
        self, projector: Projector | None, ambient: float, options: RenderOptions
    ) -> bool:
        """Whether the projector's direct light is rendered apart from all other light."""
        wanted = options.ambient_samples and projector is not None and ambient > 0
        return bool(wanted and not self._scalar and denoiser(self._threads))

    def _both_lights(
        self,
        camera: Camera,
        T_world_cams: Sequence[SE3],
        projector: Projector | None,
        *,
        ambient: float,
        options: RenderOptions,
        seed: int,
    ) -> Floats:
        """(N, H, W) the projector's direct light, and all other light, denoised."""
        views = len(T_world_cams)
        clean = denoiser(self._threads)
        assert clean is not None
        # A path ends at the first diffuse surface: light scattered by one forms no dots.
        dots = replace(options, chunk=1, diffuse_bounces=1)
        paths = self._radiance(
            camera, T_world_cams, projector, ambient=0.0, options=dots, seed=seed, grey=True
        )
        projected = np.stack([bounded_mean(p[..., 0]) for p in np.split(paths, views)])
        rest = replace(options, samples=options.ambient_samples, chunk=0)
        light: dict[str, Any] = {"ambient": ambient, "grey": True, "indirect": True}
        paths = self._radiance(camera, T_world_cams, projector, options=rest, seed=seed, **light)
        albedo, normal = self._tracer(infrared=True).features(
            camera, T_world_cams, samples=_feature_samples(options), seed=seed
        )
        # Both views as one image, side by side, would mix at the border: one after the other.
        parts = [
            clean(np.repeat(clipped_mean(p), 3, axis=-1), a, n, fast=options.fast_denoiser).mean(
                axis=-1
            )
            for p, a, n in zip(*(np.split(x, views) for x in (paths, albedo, normal)), strict=True)
        ]
        return np.asarray(projected + np.maximum(np.stack(parts), 0), np.float32)

    def color(
        self,
        camera: Camera,
        T_world_cam: SE3,
        *,
        ambient: float,
        options: RenderOptions = DRAFT_COLOR,
        seed: int = 0,
    ) -> ColorLight:
        """See `LoadedScene.color`."""
        chunks = self._radiance(
            camera, T_world_cam, None, ambient=ambient, options=options, seed=seed, grey=False
        )
        radiance = clipped_mean(chunks)
        if self._scalar:
            return ColorLight(radiance)
        features = self._tracer(infrared=False).features(
            camera, T_world_cam, samples=_feature_samples(options), seed=seed
        )
        return ColorLight(radiance, *features)

    def phasors(
        self,
        camera: Camera,
        T_world_cam: SE3,
        lamp: Projector,
        waves: Sequence[float],
        *,
        options: RenderOptions = DRAFT_INFRARED,
        seed: int = 0,
    ) -> NDArray[np.complex64]:
        """(F, H, W) complex64: see `PathTracer.phasors`.

        All light but that of surfaces directly in view is rendered separately and denoised: with
        few paths its noise would exceed that of a camera.

        Raises:
            ToolkitError: the variant is not compiled.
        """
        if self._scalar:
            raise ToolkitError(
                "only compiled variants of Mitsuba measure the lengths of light paths",
                field="variant",
                value=self._variant,
                hint="install libllvm19 (tools/system-libraries simulator does)",
            )
        check_no_distortion("mitsuba", camera)
        self._mi.set_variant(self._variant)
        tracer = self._tracer(infrared=True)
        view = (camera, T_world_cam, lamp, waves)
        direct, _ = tracer.phasors(*view, options=replace(options, max_depth=2), seed=seed)
        clean = denoiser(self._threads)
        factor = _LATE_FACTOR * (1 if clean else 4)
        many = replace(options, samples=factor * options.samples)
        late, light = tracer.phasors(*view, options=many, seed=seed, late=True)
        if clean is not None:
            samples = _feature_samples(options)
            features = tracer.features(camera, T_world_cam, samples=samples, seed=seed)
            # Relative to the phase of the surface in view, the phases vary slowly.
            z, _ = tracer.first_hits(camera, T_world_cam)
            there_and_back = 2 * z_to_distance(z, camera)
            turns = np.exp(-1j * np.array(waves)[:, None, None] * there_and_back)
            late = np.stack(
                [
                    turn.conj()
                    * _denoised_phasor(part * turn, light, clean, features, options.fast_denoiser)
                    for part, turn in zip(late, turns, strict=True)
                ]
            )
        return np.asarray(direct + late, np.complex64)

    def first_hits(self, camera: Camera, T_world_cam: SE3) -> tuple[Floats, Floats]:
        """z-depth (H, W) and world normal (H, W, 3) of the surfaces at pixel centres.

        Only compiled variants support it. The maps of a data set come from `truth`; tests compare
        them with these.
        """
        return self._tracer(infrared=False).first_hits(camera, T_world_cam)

    def _radiance(self, camera: Camera, *args: Any, **keywords: Any) -> Floats:
        check_no_distortion("mitsuba", camera)
        self._mi.set_variant(self._variant)
        return self._tracer(infrared=keywords["grey"]).radiance(camera, *args, **keywords)


def _feature_samples(options: RenderOptions) -> int:
    return _FAST_FEATURE_SAMPLES if options.fast_denoiser else _FEATURE_SAMPLES


def _denoised_phasor(
    phasor: NDArray[np.complexfloating],
    light: Floats,
    clean: Denoiser,
    features: tuple[Floats, Floats],
    fast: bool,
) -> NDArray[np.complexfloating]:
    """(H, W) complex sums of light after a denoiser, which accepts no negative numbers."""
    # Neither part exceeds the sum of the light.
    channels = np.stack([light + phasor.real, light + phasor.imag, light], axis=-1)
    found = clean(np.maximum(channels, 0).astype(np.float32), *features, fast=fast)
    return np.asarray(found[..., 0] - found[..., 2] + 1j * (found[..., 1] - found[..., 2]))


def bounded_mean(paths: Floats) -> Floats:
    """(H, W) mean of single paths (H, W, n), each at most twice as bright as the brightest dots.

    Dots are sharp: the paths of a pixel at the border of one differ, so that, unlike in
    `clipped_mean`, a pixel's median bounds nothing. Brighter paths are fireflies, or highlights
    that saturate in any case.
    """
    dots = float(np.quantile(paths.mean(axis=2), _DOT_QUANTILE))
    return np.asarray(np.minimum(paths, 2 * dots).mean(axis=2), np.float32)


def clipped_mean(chunks: Floats) -> Floats:
    """(H, W, c) mean of chunks (H, W, n, c); values far above a pixel's median are clipped.

    Otherwise single paths of extreme brightness (fireflies) would speckle the image. The bound is
    twice the median plus a fraction of the image's mean, so that nothing is clipped where the
    chunks agree.
    """
    if chunks.shape[2] < 3:
        return np.asarray(chunks.mean(axis=2), np.float32)
    level = chunks.mean(axis=-1, keepdims=True)
    middle = np.median(level, axis=2, keepdims=True)
    bound = _CLIP_FACTOR * middle + _CLIP_FLOOR * middle.mean()
    scale = np.minimum(1, bound / np.maximum(level, 1e-12))
    return np.asarray((chunks * scale).mean(axis=2), np.float32)
