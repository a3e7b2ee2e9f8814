"""What the stages of a scan pass on: photos with poses, and the finished model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.scanning.bake import Texture
from std_toolkit.scanning.photos import Photos
from std_toolkit.scanning.views import Array, View


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedPhotos:
    """Photos with camera poses, before the masks.

    Attributes:
        views: photos without lens distortion, in the frame of the board.
        corners: of the board on the table, metres.
        points: (P, 3) of the reconstruction, metres.
        on_table: whether a board on a table was in sight.
        facts: name and value of what was measured so far.
        warnings: sentences on what to do better.
        digest: of all inputs.
        photos: the files.
        found: tag corners in the photos, by name of the array.
    """

    views: list[View]
    corners: Array
    points: Array
    on_table: bool
    facts: dict[str, Any]
    warnings: list[str]
    digest: str
    photos: Photos
    found: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """A finished scan.

    Attributes:
        name: name of the model.
        vertices: (V, 3) metres, frame of the model.
        faces: (F, 3).
        texture: its texture.
        supported: (F,) faces that depth maps support; the others are from outlines alone.
        views: photos with masks, in the frame of the model.
        facts: name and value of what was measured.
        warnings: sentences on what to do better.
        seconds: time of each stage.
    """

    name: str
    vertices: Array
    faces: NDArray[np.int64]
    texture: Texture
    supported: NDArray[np.bool_]
    views: Sequence[View]
    facts: dict[str, Any]
    warnings: list[str]
    seconds: dict[str, float] = field(default_factory=dict)
