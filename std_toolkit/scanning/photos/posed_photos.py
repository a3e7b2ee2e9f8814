"""Photos of a scan with camera poses, as its stages pass them on."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.scanning.photos.photos import Photos
from std_toolkit.scanning.photos.views import View


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedPhotos:
    """Photos with camera poses, before the masks.

    Attributes:
        views: photos without lens distortion, in the frame of the board.
        corners: of the board on the table, metres.
        ids: of these corners, four to a tag; empty if unknown.
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
    ids: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def tags(self) -> dict[int, Array]:
        """Corners (4, 3) of each tag in the world; none without ids."""
        if not len(self.ids):
            return {}
        whole = [int(i) for i in self.ids[self.ids % 4 == 0]]
        places = {int(i): xyz for i, xyz in zip(self.ids, self.corners, strict=True)}
        return {i // 4: np.stack([places[i + k] for k in range(4)]) for i in whole}
