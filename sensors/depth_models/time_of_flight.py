"""Time of flight: distance from the phase of amplitude-modulated light.

The renderer sums, over all light paths of a pixel, the phasor of each path's length at each
modulation frequency. Light that was scattered by several surfaces therefore lengthens the distance
(multipath), and a pixel that sees two surfaces mixes their phasors (flying pixels). Ambient light
is not modulated; its shot noise is part of the read noise.

The phases are unwrapped as in the weighted search over the wraps of all frequencies, see Droeschel,
Holz, Behnke, "Multi-frequency Phase Unwrapping for Time-of-Flight cameras" (IROS 2010).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensors.depth_models.depth_model import DepthModelOptions, Illumination, Reading
from sensors.render import sim_scene
from sensors.render.sim_renderer import LoadedScene, RenderOptions
from sensors.specs import SensorSpec, TimeOfFlightSpec
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3

LIGHT_M_S = 299_792_458.0
# A white diffuse surface reflects 1 / pi of its irradiance as radiance.
_WHITE = 1 / np.pi
# Grey value of an amplitude of 1: most surfaces between 0.5 and 1 m are neither black nor white.
_GREY = 120.0
_SIDE = 64
# Paths beyond this multiple of the sensor's range are taken for wraps of shorter ones.
_BEYOND = 1.2

Phasors = NDArray[np.complex64]
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Distances:
    """Path lengths from phases.

    Attributes:
        path_m: (h, w) length of the path from the light to the surface and to the camera.
        error_rad: (h, w) root mean square of the phases' deviations from that length.
    """

    path_m: Array
    error_rad: Array


class TimeOfFlight:
    """See `DepthModel`.

    Args:
        sensor: a camera with `time_of_flight`.
        options: `width`, `height` and `noise` are used.

    Raises:
        ToolkitError: the sensor does not describe a time-of-flight camera.
    """

    def __init__(self, sensor: SensorSpec, options: DepthModelOptions) -> None:
        if sensor.time_of_flight is None:
            raise ToolkitError("not a time-of-flight camera", field="sensor", value=sensor.name)
        self.camera = sensor.depth_camera(options.width, options.height)
        self._spec, self._range_m = sensor.time_of_flight, sensor.depth.range_m
        self._noise = options.noise

    def look(
        self,
        loaded: LoadedScene,
        T_world_ir: SE3,
        light: Illumination,
        *,
        options: RenderOptions,
        seed: int,
    ) -> Phasors:
        """(F, h, w) complex64: amplitude and phase at every frequency.

        Raises:
            ToolkitError: the renderer does not measure the lengths of paths.
        """
        across, down = np.tan(np.deg2rad(self._spec.illumination_deg) / 2)
        lamp = sim_scene.Projector(
            np.ones((max(2, round(_SIDE * down / across)), _SIDE), np.float32),
            self._spec.illumination_deg[0],
            T_world_ir @ SE3(np.eye(3), np.array(self._spec.illuminator_m)),
            power=light.factor / _WHITE,
        )
        measure = getattr(loaded, "phasors", None)
        if measure is None:
            raise ToolkitError(
                "this renderer does not measure the lengths of light paths, which a time-of-flight "
                "camera needs",
                field="renderer",
                hint="use a compiled variant of Mitsuba (llvm_ad_rgb needs libllvm)",
            )
        waves = [2 * np.pi * f / LIGHT_M_S for f in self._spec.frequencies_hz]
        return np.asarray(measure(self.camera, T_world_ir, lamp, waves, options=options, seed=seed))

    def read(self, received: Phasors, *, seed: int) -> Reading:
        """Add the imager's noise and compute depth and the image of the amplitude."""
        spec = self._spec
        phasors = received
        if self._noise:
            phasors = with_phasor_noise(phasors, spec, np.random.default_rng([seed, 0]))
        amplitude = np.abs(phasors).mean(axis=0)
        found = unwrap(phasors, spec.frequencies_hz, longest_m=2 * _BEYOND * self._range_m[1])
        depth = self._depth(found.path_m)
        near, far = self._range_m
        good = (
            (amplitude >= spec.least_amplitude)
            & (found.error_rad <= spec.most_phase_error_rad)
            & (depth >= near)
            & (depth <= far)
        )
        grey = np.clip(np.rint(_GREY * amplitude), 0, 255).astype(np.uint8)
        return Reading(np.where(good, depth, 0).astype(np.float32), grey)

    def _depth(self, path_m: Array) -> Array:
        """z-depth (h, w) of points whose path from the light to the camera has this length."""
        rays = self.camera.rays()
        stretch = np.linalg.norm(rays, axis=-1)
        light = np.array(self._spec.illuminator_m)
        # |p| + |p - light| = path, with p = range * ray / stretch.
        along = (rays @ light) / stretch
        distance = (path_m**2 - light @ light) / np.maximum(2 * (path_m - along), 1e-9)
        return np.asarray(np.maximum(distance, 0) / stretch)


def with_phasor_noise(
    phasors: Phasors, spec: TimeOfFlightSpec, rng: np.random.Generator
) -> Phasors:
    """Phasors (F, h, w) with the read and shot noise of an imager."""
    deviation = np.sqrt(spec.read_noise**2 + spec.shot_noise**2 * np.abs(phasors))
    noise = rng.standard_normal((2, *phasors.shape)).astype(np.float32)
    return np.asarray(phasors + deviation * (noise[0] + 1j * noise[1]), np.complex64)


def unwrap(phasors: Phasors, frequencies_hz: list[float], *, longest_m: float) -> Distances:
    """The path lengths that explain the phases at all frequencies.

    Args:
        phasors: (F, h, w) one per frequency.
        frequencies_hz: the frequencies.
        longest_m: longest path that is considered.
    """
    waves = 2 * np.pi * np.array(frequencies_hz) / LIGHT_M_S
    phases = np.mod(np.angle(phasors).astype(np.float64), 2 * np.pi)
    # The highest frequency measures best; its wraps give the candidates.
    first = int(np.argmax(waves))
    period = 2 * np.pi / waves[first]
    weight = (waves / waves.max()) ** 2
    best = np.full(phases.shape[1:], np.inf)
    path = np.zeros_like(best)
    for wrap in range(max(1, int(np.ceil(longest_m / period)))):
        candidate = phases[first] / waves[first] + wrap * period
        turns = np.rint((waves[:, None, None] * candidate - phases) / (2 * np.pi))
        lengths = (phases + 2 * np.pi * turns) / waves[:, None, None]
        mean = np.einsum("f,fhw->hw", weight / weight.sum(), lengths)
        error = np.sqrt(np.mean((waves[:, None, None] * (lengths - mean)) ** 2, axis=0))
        better = (error < best) & (mean <= longest_m)
        best[better], path[better] = error[better], mean[better]
    return Distances(path, np.where(np.isfinite(best), best, np.pi))
