"""Sources of environment maps: procedural studios, or a folder of yours."""

from functools import lru_cache
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from sensors.lighting.environment import EnvironmentFolder, EnvironmentMap, Split

HEIGHT = 256

Directions = NDArray[np.float32]

# Number of different procedural maps; the last quarter of them is for testing.
STUDIOS, TRAIN_STUDIOS = 100, 76


def studio_map(seed: int, *, height: int = HEIGHT) -> EnvironmentMap:
    """Make a map of height x 2 height pixels; the same seed gives the same map.

    Walls with a gradient from floor to ceiling colour and a few light sources of different kind,
    size, softness and warmth, which give metal and glass something to reflect.
    """
    rng = np.random.default_rng(seed)
    d = _directions(height)
    up = d[..., 2:3]
    ground, wall, ceiling = (_warmth(rng, 0.25) * rng.uniform(*b) for b in _WALLS)
    pixels = np.where(
        up > 0,
        wall + (ceiling - wall) * np.maximum(up, 0) ** 0.7,
        wall + (ground - wall) * np.abs(up) ** 0.4,
    )
    pixels = pixels * (1 + 0.25 * _furniture(rng, d))
    for _ in range(int(rng.integers(1, 4))):
        pixels = _soft_box(rng, d, pixels)
    if rng.random() < 0.6:
        pixels = _window(rng, d, pixels)
    for _ in range(int(rng.integers(0, 5))):
        pixels = _lamp(rng, d, pixels)
    return EnvironmentMap.normalised(f"studio-{seed}", pixels)


_WALLS = ((0.05, 0.25), (0.15, 0.5), (0.2, 0.8))


def _directions(height: int) -> Directions:
    """(H, 2H, 3) unit vectors of the pixel centres, z up."""
    polar = (np.arange(height) + 0.5) / height * np.pi
    around = (np.arange(2 * height) + 0.5) / height * np.pi
    flat = np.sin(polar)[:, None]
    out = np.stack(
        np.broadcast_arrays(
            flat * np.cos(around)[None], flat * np.sin(around)[None], np.cos(polar)[:, None]
        ),
        axis=-1,
    )
    return out.astype(np.float32)


def _warmth(rng: np.random.Generator, amount: float) -> NDArray[np.float32]:
    """A light colour between warm and cold, mean 1."""
    shift = rng.uniform(-amount, amount)
    return np.array([1 + shift, 1.0, 1 - shift], np.float32)


def _frame(rng: np.random.Generator, d: Directions, low: float, high: float) -> Directions:
    """Directions seen from a source: x and y across it, z towards it; elevation low..high rad."""
    elevation, around = rng.uniform(low, high), rng.uniform(0, 2 * np.pi)
    ahead = np.array(
        [
            np.cos(elevation) * np.cos(around),
            np.cos(elevation) * np.sin(around),
            np.sin(elevation),
        ]
    )
    side = np.array([-np.sin(around), np.cos(around), 0])
    axes = np.stack([side, np.cross(ahead, side), ahead], axis=1)
    return d @ axes.astype(np.float32)


def _edge(distance: NDArray[np.floating], softness: float) -> NDArray[np.float32]:
    """1 where distance > 0, with a smooth edge."""
    return np.asarray(1 / (1 + np.exp(-np.clip(distance / softness, -30, 30))), dtype=np.float32)


def _rectangle(local: Directions, half: tuple[float, float], softness: float) -> Directions:
    """(H, W, 1) mask of a rectangle at distance 1 ahead."""
    ahead = np.maximum(local[..., 2], 1e-3)
    x, y = local[..., 0] / ahead, local[..., 1] / ahead
    inside = _edge(half[0] - np.abs(x), softness) * _edge(half[1] - np.abs(y), softness)
    return np.where(local[..., 2] > 1e-3, inside, 0)[..., None].astype(np.float32)


def _soft_box(
    rng: np.random.Generator, d: Directions, pixels: NDArray[np.floating]
) -> NDArray[np.floating]:
    local = _frame(rng, d, 0.2, 1.4)
    half = (float(rng.uniform(0.1, 0.5)), float(rng.uniform(0.1, 0.5)))
    light = _warmth(rng, 0.2) * rng.uniform(3, 15)
    mask = _rectangle(local, half, float(rng.uniform(0.005, 0.05)))
    return pixels * (1 - mask) + light * mask


def _window(
    rng: np.random.Generator, d: Directions, pixels: NDArray[np.floating]
) -> NDArray[np.floating]:
    """Panes with a sky that darkens downwards, divided by bars."""
    local = _frame(rng, d, 0.0, 0.5)
    half = (float(rng.uniform(0.25, 0.6)), float(rng.uniform(0.2, 0.5)))
    mask = _rectangle(local, half, 0.006)
    ahead = np.maximum(local[..., 2:], 1e-3)
    panes = rng.integers(1, 4, 2)
    for axis in (0, 1):
        across = (local[..., axis : axis + 1] / ahead / half[axis] + 1) / 2 * panes[axis]
        mask = mask * _edge(0.5 - np.abs(across % 1 - 0.5) - 0.04, 0.01)
    sky = np.array([0.8, 0.95, 1.2], np.float32) * rng.uniform(4, 14)
    return pixels * (1 - mask) + sky * (0.6 + 0.6 * d[..., 2:]) * mask


def _lamp(
    rng: np.random.Generator, d: Directions, pixels: NDArray[np.floating]
) -> NDArray[np.floating]:
    local = _frame(rng, d, 0.3, 1.5)
    radius = rng.uniform(0.02, 0.07)
    light = _warmth(rng, 0.3) * rng.uniform(15, 60)
    return pixels + light * _edge(local[..., 2:] - np.float32(np.cos(radius)), 4e-4)


def _furniture(rng: np.random.Generator, d: Directions) -> Directions:
    """(H, W, 1) darker and brighter blocks around the horizon, -1..1."""
    out = np.zeros((*d.shape[:2], 1), np.float32)
    for _ in range(int(rng.integers(4, 10))):
        local = _frame(rng, d, -0.6, 0.5)
        half = (float(rng.uniform(0.05, 0.5)), float(rng.uniform(0.05, 0.4)))
        out += rng.uniform(-2.5, 2.0) * _rectangle(local, half, 0.01)
    return np.clip(out, -3, 3)


@runtime_checkable
class EnvironmentSource(Protocol):
    """A source of environment maps."""

    def draw(self, rng: np.random.Generator) -> EnvironmentMap:
        """A random map; the same state of `rng` gives the same map."""
        ...


class StudioSource:
    """Procedural maps; training and test use different ones.

    Args:
        split: maps to draw from.
    """

    def __init__(self, *, split: Split = "train") -> None:
        numbers = {
            "train": range(TRAIN_STUDIOS),
            "test": range(TRAIN_STUDIOS, STUDIOS),
            "all": range(STUDIOS),
        }
        self.seeds = numbers[split]

    def draw(self, rng: np.random.Generator) -> EnvironmentMap:
        """See `EnvironmentSource.draw`."""
        return _kept(self.seeds[int(rng.integers(len(self.seeds)))])


@lru_cache(maxsize=8)
def _kept(seed: int) -> EnvironmentMap:
    return studio_map(seed)


def environment_source(
    folder: Path | str | None = None, *, split: Split = "train"
) -> EnvironmentSource:
    """The maps of the folder, or procedural ones without a folder.

    Raises:
        ToolkitError: see `EnvironmentFolder`.
    """
    return StudioSource(split=split) if folder is None else EnvironmentFolder(folder, split=split)
