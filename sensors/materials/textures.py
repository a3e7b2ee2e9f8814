"""Procedural textures as images that tile: wood, fabric, leather, paper, marble and the like.

Every pattern consists of periodic components (noise filtered in the Fourier domain, whole numbers
of waves), so that tiles join without a seam.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.materials.material_draw import DrawnTexture
from sensors.materials.material_library import TextureKind

Field = NDArray[np.float32]
SIZE = 256


def make_texture(
    texture: DrawnTexture, color: tuple[float, float, float], *, size: int = SIZE
) -> NDArray[np.uint8]:
    """Draw a tile.

    Args:
        texture: kind, contrast and seed.
        color: linear RGB in 0..1 that the pattern modulates.
        size: side of the tile in pixels; at least 16.

    Returns:
        (size, size, 3) uint8 sRGB image that tiles in both directions. Its mean is close to
        `color`; at contrast 0 it is that colour everywhere.
    """
    rng = np.random.default_rng(texture.seed)
    tint = np.asarray(color, np.float32)
    if texture.kind == "print":
        linear = _print(rng, tint, texture.contrast, size)
    else:
        shade = _PATTERNS[texture.kind](rng, size)
        shade = (shade - shade.mean()) / max(float(np.abs(shade).max()), 1e-6)
        # Multiplicative, so that dark materials keep their hue. The second colour is slightly brown
        # or blue, since real surfaces vary in more than brightness.
        lean = 1 + 0.15 * rng.uniform(-1, 1, 3).astype(np.float32)
        factor = 1 + texture.contrast * shade[..., None] * np.where(shade[..., None] < 0, lean, 1)
        linear = tint * factor
    return to_srgb(linear)


def to_srgb(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """8-bit sRGB of linear values 0..1 (clipped), any shape."""
    x = np.clip(linear, 0, 1)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(encoded * 255), dtype=np.uint8)


def to_linear(srgb: NDArray[np.uint8]) -> Field:
    """Linear float32 values 0..1 of 8-bit sRGB, any shape."""
    return _LINEAR[srgb]


def _linear_table() -> Field:
    x = np.arange(256) / 255
    table = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    return table.astype(np.float32)


_LINEAR = _linear_table()


def tiling_noise(
    rng: np.random.Generator, size: int, *, slope: float = 1.0, stretch: float = 1.0
) -> Field:
    """(size, size) float32 periodic noise, mean 0, deviation 1.

    Args:
        slope: amplitude falls with frequency to this power; 0 is white, 2 very smooth.
        stretch: > 1 stretches the noise along the rows (x), < 1 along the columns.
    """
    spectrum = np.fft.rfft2(rng.standard_normal((size, size)))
    fy = np.fft.fftfreq(size)[:, None] * size / np.sqrt(stretch)
    fx = np.fft.rfftfreq(size)[None] * size * np.sqrt(stretch)
    radius = np.hypot(fx, fy)
    radius[0, 0] = np.inf
    noise = np.fft.irfft2(spectrum / radius**slope, (size, size))
    return np.asarray(noise / noise.std(), dtype=np.float32)


def _grid(size: int) -> tuple[Field, Field]:
    """x and y of every pixel in 0..1, broadcastable."""
    axis = ((np.arange(size) + 0.5) / size).astype(np.float32)
    return axis[None, :], axis[:, None]


def _wood(rng: np.random.Generator, size: int) -> Field:
    x, _ = _grid(size)
    rings = int(rng.integers(5, 12))
    bend = 0.35 * tiling_noise(rng, size, slope=1.8, stretch=0.15)
    ring = np.mod(rings * x + bend, 1.0)
    fibre = tiling_noise(rng, size, slope=0.6, stretch=0.02)
    # Growth rings darken slowly and end abruptly.
    return np.asarray(0.6 - 1.2 * ring**2 + 0.15 * fibre, dtype=np.float32)


def _weave(rng: np.random.Generator, size: int) -> Field:
    x, y = _grid(size)
    threads = int(rng.integers(4, 9)) * 2
    warp, weft = np.abs(np.sin(np.pi * threads * x)), np.abs(np.sin(np.pi * threads * y))
    over = (np.floor(threads * x) + np.floor(threads * y)) % 2 == 0
    return np.asarray(
        np.where(over, warp, 0.75 * weft) + 0.12 * tiling_noise(rng, size, slope=0.5),
        dtype=np.float32,
    )


def _leather(rng: np.random.Generator, size: int) -> Field:
    """Cells with creases between them: second-nearest minus nearest distance to random points."""
    first, second = _cells(rng, size, count=int(rng.integers(90, 220)))
    crease = np.clip((second - first) * np.sqrt(len(first)) * 2.2, 0, 1)
    return np.asarray(crease + 0.15 * tiling_noise(rng, size, slope=1.2), dtype=np.float32)


def _speckle(rng: np.random.Generator, size: int) -> Field:
    first, _ = _cells(rng, size, count=int(rng.integers(60, 200)))
    radius = 0.35 / np.sqrt(120)
    soft = 1 / (1 + np.exp(np.clip((first - radius) * size, -30, 30)))
    return np.asarray(-soft + 0.05 * tiling_noise(rng, size, slope=1.0), dtype=np.float32)


def _cells(rng: np.random.Generator, size: int, *, count: int) -> tuple[Field, Field]:
    """Distances (in tiles) from every pixel to the nearest and second nearest of random points."""
    from scipy.spatial import cKDTree

    tree = cKDTree(rng.random((count, 2)), boxsize=1.0)
    x, y = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size)
    distance, _ = tree.query(np.stack([x, y], axis=-1), k=2)
    return distance[..., 0].astype(np.float32), distance[..., 1].astype(np.float32)


def _marble(rng: np.random.Generator, size: int) -> Field:
    x, y = _grid(size)
    turns = rng.integers(1, 4, 2)
    bend = 0.9 * tiling_noise(rng, size, slope=2.4)
    vein = 1 - np.abs(np.sin(np.pi * (turns[0] * x + turns[1] * y + bend)))
    return np.asarray(-(vein**4) + 0.1 * tiling_noise(rng, size, slope=1.5), dtype=np.float32)


def _paper(rng: np.random.Generator, size: int) -> Field:
    fibres = tiling_noise(rng, size, slope=0.8, stretch=3.0)
    return fibres + tiling_noise(rng, size, slope=0.8, stretch=1 / 3.0)


def _grain(rng: np.random.Generator, size: int) -> Field:
    return tiling_noise(rng, size, slope=float(rng.uniform(0.3, 0.9)))


def _brushed(rng: np.random.Generator, size: int) -> Field:
    return tiling_noise(rng, size, slope=0.4, stretch=2000.0)


def _stripes(rng: np.random.Generator, size: int) -> Field:
    x, _ = _grid(size)
    waves = int(rng.integers(3, 9))
    wave = np.tanh(3 * np.sin(2 * np.pi * waves * x))
    return np.asarray(wave + 0.1 * tiling_noise(rng, size, slope=0.8), dtype=np.float32)


def _checks(rng: np.random.Generator, size: int) -> Field:
    x, y = _grid(size)
    waves = int(rng.integers(2, 6))
    bands = np.tanh(6 * np.sin(2 * np.pi * waves * x)) + np.tanh(6 * np.sin(2 * np.pi * waves * y))
    return np.asarray(bands + 0.15 * tiling_noise(rng, size, slope=0.5), dtype=np.float32)


def _print(rng: np.random.Generator, tint: Field, contrast: float, size: int) -> Field:
    """Paper with printed blocks and lines."""
    image = np.ones((size, size, 3), np.float32) * tint
    for _ in range(int(rng.integers(15, 40))):
        ink = rng.uniform(0.02, 0.8, 3).astype(np.float32)
        layer = np.zeros((size, size), np.float32)
        x, y = rng.integers(0, size, 2)
        w = int(size * rng.uniform(0.03, 0.35))
        h = max(2, int(size * rng.choice([0.01, 0.02, 0.15]) * rng.uniform(0.7, 1.5)))
        cv2.rectangle(layer, (0, 0), (min(w, size - 1), min(h, size - 1)), 1.0, -1)
        layer = np.roll(layer, (int(y), int(x)), axis=(0, 1))[..., None]
        image = image * (1 - contrast * layer) + ink * contrast * layer
    return image


_PATTERNS: dict[TextureKind, Callable[[np.random.Generator, int], Field]] = {
    "brushed": _brushed,
    "checks": _checks,
    "grain": _grain,
    "leather": _leather,
    "marble": _marble,
    "paper": _paper,
    "speckle": _speckle,
    "stripes": _stripes,
    "weave": _weave,
    "wood": _wood,
}
