"""Procedural textures as images that tile: wood, fabric, leather, paper, marble, print.

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
    if texture.kind in _COLORED:
        linear = _COLORED[texture.kind](rng, tint, texture.contrast, size)
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


def _collage(rng: np.random.Generator, tint: Field, contrast: float, size: int) -> Field:
    """Colours of their own in one of five patterns, as of carpets, posters and stone."""
    colors = rng.uniform(0, 1, (int(rng.integers(2, 8)), 3)).astype(np.float32) ** 2
    # Most prints and carpets are duller than colours drawn by chance.
    grey = colors.mean(axis=1, keepdims=True)
    colors = np.asarray(grey + rng.uniform(0, 1) ** 2 * (colors - grey), np.float32)
    layout = (_leaves, _blobs, _mosaic, _terrazzo, _text)[int(rng.integers(5))]
    image = layout(rng, colors, size)
    shade = 1 + rng.uniform(0, 0.2) * tiling_noise(rng, size, slope=float(rng.uniform(0.3, 1.5)))
    return np.asarray(tint + contrast * (image * shade[..., None] - tint), dtype=np.float32)


def _leaves(rng: np.random.Generator, colors: Field, size: int) -> Field:
    """Shapes over each other with radii that fall by a power law, as in natural images [1]_.

    .. [1] Lee, Mumford and Huang, "Occlusion models for natural images", IJCV 41 (2001).
    """
    image = np.ones((size, size, 3), np.float32) * colors[0]
    low, high = float(rng.uniform(0.01, 0.05)), float(rng.uniform(0.1, 0.35))
    for _ in range(int(rng.integers(40, 300))):
        # Density of radii ~ r^-3 between the limits.
        u = rng.random()
        radius = size / np.sqrt(u / low**2 + (1 - u) / high**2)
        axes = (max(1, int(radius)), max(1, int(radius * rng.uniform(0.3, 1))))
        layer = np.zeros((size, size), np.uint8)
        middle = (size // 2, size // 2)
        if rng.random() < 0.5:
            cv2.ellipse(layer, middle, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
        else:
            box = (middle, (2.0 * axes[0], 2.0 * axes[1]), float(rng.uniform(0, 180)))
            cv2.fillPoly(layer, [cv2.boxPoints(box).astype(np.int32)], 1)
        rows, columns = np.nonzero(layer)
        x, y = rng.integers(0, size, 2)
        color = colors[int(rng.integers(len(colors)))] * rng.uniform(0.6, 1.2)
        image[(rows + y) % size, (columns + x) % size] = color
    return image


def _blobs(rng: np.random.Generator, colors: Field, size: int) -> Field:
    noise = tiling_noise(rng, size, slope=float(rng.uniform(0.8, 2.2)))
    borders = np.quantile(noise, np.sort(rng.random(len(colors) - 1)))
    return colors[np.digitize(noise, borders)]


def _mosaic(rng: np.random.Generator, colors: Field, size: int) -> Field:
    rows, columns = (int(n) for n in rng.integers(2, 24, 2))
    tiles = rng.integers(len(colors), size=(rows, columns)).astype(np.uint8)
    return colors[cv2.resize(tiles, (size, size), interpolation=cv2.INTER_NEAREST)]


def _terrazzo(rng: np.random.Generator, colors: Field, size: int) -> Field:
    from scipy.spatial import cKDTree

    count = int(rng.integers(30, 600))
    tree = cKDTree(rng.random((count, 2)), boxsize=1.0)
    axis = (np.arange(size) + 0.5) / size
    _, nearest = tree.query(np.stack(np.meshgrid(axis, axis), axis=-1))
    return colors[rng.integers(len(colors), size=count)[nearest]]


def _text(rng: np.random.Generator, colors: Field, size: int) -> Field:
    """Lines of letters of several sizes, whole ones."""
    ink, y = np.zeros((size, size), np.uint8), 0
    while (y := y + int(size * rng.uniform(0.03, 0.2))) < size - 8:
        scale = size / 256 * float(rng.uniform(0.2, 1.5))
        letters = "".join(chr(int(c)) for c in rng.integers(33, 127, 80))
        color, bold = int(rng.integers(len(colors))), max(1, int(scale * rng.uniform(1, 4)))
        font = cv2.FONT_HERSHEY_SIMPLEX
        wide = cv2.getTextSize(letters, font, scale, bold)[0][0]
        fitting = letters[: int(len(letters) * 0.95 * size / wide)]
        cv2.putText(ink, fitting, (2, y), font, scale, color, bold)
    return colors[ink]


_COLORED: dict[TextureKind, Callable[[np.random.Generator, Field, float, int], Field]] = {
    "collage": _collage,
    "print": _print,
}
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
