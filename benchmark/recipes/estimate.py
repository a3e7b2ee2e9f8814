"""What a recipe is going to cost, before it is run."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sensors.simulation.options import SimulationOptions

# Processor seconds of a frame of 640x360 at draft quality: `perf/simulate.py`.
_INFRARED_S, _COLOR_S, _DENOISING_S, _REST_S = 4.62, 2.13, 0.48, 0.77
_MEASURED_PIXELS = 640 * 360
_DRAFT_SAMPLES = 16
# A shape's convex parts, found once; so many shapes are drawn from on one side of the split.
_SHAPE_S, _SHAPES = 1.6, 8 * 250
# Colour as PNG of a picture larger than the labels.
_COLOR_BYTES = 2.0


def simulation_s(options: SimulationOptions, scenes: int) -> float:
    """Processor seconds that scenes take where no shape is known from before: by pixels and light
    paths from what was measured at draft quality."""
    from sensors.simulation.quality import quality_of

    quality = quality_of(options.quality)
    pixels = options.width * options.height / _MEASURED_PIXELS
    color_pixels = pixels * options.color_factor**2
    infrared = _INFRARED_S * quality.infrared.samples / _DRAFT_SAMPLES
    color = _COLOR_S * quality.color.samples / _DRAFT_SAMPLES + _DENOISING_S
    frame = pixels * (infrared + _REST_S) + color_pixels * color
    shapes = min(scenes * (options.min_objects + options.max_objects) / 2, _SHAPES)
    return scenes * options.views * frame + shapes * _SHAPE_S


def simulation_bytes(options: SimulationOptions, frames: int) -> float:
    """Room on the disk that frames take."""
    from sensors.simulation.dataset import BYTES_PER_PIXEL

    larger = options.color_factor**2 - 1
    pixels = options.width * options.height
    return frames * pixels * (BYTES_PER_PIXEL["dreds"] + larger * _COLOR_BYTES)


def pack_bytes(size: tuple[int, int], frames: int) -> float:
    """Room that packed frames take: colour, two maps of depth, mask."""
    return frames * size[0] * size[1] * (3 + 4 + 4 + 1)


def as_size(number: float) -> str:
    """Bytes for people."""
    for factor, unit in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB")):
        if number >= factor:
            return f"{number / factor:.1f} {unit}"
    return f"{number / 1e3:.0f} kB"


def as_time(seconds: float) -> str:
    """A duration for people."""
    if seconds >= 2 * 3600:
        return f"{seconds / 3600:.0f} h"
    return f"{seconds / 60:.0f} min" if seconds >= 120 else f"{seconds:.0f} s"
