"""How large objects of a category are."""

from __future__ import annotations

from functools import cache
from importlib import resources

import msgspec
import numpy as np

from sensors.assets.asset import Asset


class ScaleTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """scales.json.

    Attributes:
        source: where the numbers come from.
        diagonal_m: smallest and largest bounding-box diagonal of each category, metres; "other"
            stands for all categories without a row.
    """

    source: str
    diagonal_m: dict[str, tuple[float, float]]


@cache
def scale_table() -> ScaleTable:
    """The built-in table."""
    data = resources.files("sensors.assets").joinpath("scales.json").read_bytes()
    return msgspec.json.decode(data, type=ScaleTable)


def scale_range(category: str) -> tuple[float, float]:
    """Smallest and largest bounding-box diagonal of a category, metres."""
    rows = scale_table().diagonal_m
    return rows.get(category, rows["other"])


def draw_diagonal(rng: np.random.Generator, asset: Asset) -> float:
    """Bounding-box diagonal for an object in metres: the real one if known, else drawn."""
    if asset.diagonal_m is not None:
        return asset.diagonal_m
    low, high = scale_range(asset.category)
    return float(rng.uniform(low, high))
