"""True and predicted poses of one frame, as category-level evaluations hold them.

A pose is a 4x4 matrix with a uniform scale inside, which maps the object's normalised coordinates
into the camera frame in metres; a box is that matrix and its size along x, y, z before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]

# A rotation of released results is stored with 6 digits at least.
_ROTATION_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class PoseTruth:
    """What is in a frame. Anything array-like is taken and kept as arrays.

    Attributes:
        class_ids: (N,) numbers of the classes; 0 is "other" and never scored.
        RT: (N, 4, 4) object to camera, the scale inside, metres.
        sizes: (N, 3) of the boxes before RT.
        handle_visible: (N,) whether the handle of a mug can be seen; all by default.

    Raises:
        ToolkitError: shapes that do not belong together, or a pose or size that is none.
    """

    class_ids: Ids
    RT: Floats
    sizes: Floats
    handle_visible: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        n = _keep_poses(self)
        seen = np.ones(n, dtype=bool) if self.handle_visible is None else self.handle_visible
        _keep(self, "handle_visible", np.asarray(seen).astype(bool).reshape(-1), (n,))

    @property
    def visible(self) -> NDArray[np.bool_]:
        """(N,) `handle_visible`, which is always there once built."""
        assert self.handle_visible is not None
        return self.handle_visible


@dataclass(frozen=True, eq=False)
class PosePrediction:
    """What a method found in a frame. Anything array-like is taken and kept as arrays.

    Attributes:
        class_ids: (N,) numbers of the classes.
        RT: (N, 4, 4) object to camera, the scale inside, metres.
        sizes: (N, 3) of the boxes before RT; 0 is allowed, such a box overlaps nothing.
        scores: (N,) confidences: predictions are matched and ranked by them, highest first.

    Raises:
        ToolkitError: shapes that do not belong together, or a pose, size or score that is none.
    """

    class_ids: Ids
    RT: Floats
    sizes: Floats
    scores: Floats

    def __post_init__(self) -> None:
        n = _keep_poses(self)
        scores = np.asarray(self.scores, dtype=np.float64).reshape(-1)
        if not np.isfinite(scores).all():
            raise ToolkitError("must be finite", field="scores", value=scores.tolist())
        _keep(self, "scores", scores, (n,))


def _keep_poses(frame: Any) -> int:
    ids = np.asarray(frame.class_ids).reshape(-1)
    if ids.size and (not np.issubdtype(ids.dtype, np.integer) or ids.min() < 0):
        raise ToolkitError("must be whole numbers from 0", field="class_ids", value=ids.tolist())
    n = len(ids)
    _keep(frame, "class_ids", ids.astype(np.int64), (n,))
    sizes = np.asarray(frame.sizes, dtype=np.float64)
    RT = np.asarray(frame.RT, dtype=np.float64)
    _keep(frame, "sizes", sizes.reshape(0, 3) if sizes.size == 0 else sizes, (n, 3))
    _keep(frame, "RT", RT.reshape(0, 4, 4) if RT.size == 0 else RT, (n, 4, 4))
    bad = ~(np.isfinite(frame.sizes) & (frame.sizes >= 0)).all(axis=1)
    if bad.any():
        value = frame.sizes[bad][0].tolist()
        raise ToolkitError("must be finite and not negative", field="sizes", value=value)
    bad = ~_is_similarity(frame.RT)
    if bad.any():
        raise ToolkitError(
            "must be a rotation times one positive scale, and a translation",
            field=f"RT[{int(np.flatnonzero(bad)[0])}]",
            value=frame.RT[bad][0].round(4).tolist(),
            hint="give 4x4 matrices with the scale inside, metres",
        )
    return n


def _keep(frame: Any, name: str, value: NDArray[Any], shape: tuple[int, ...]) -> None:
    if value.shape != shape:
        raise ToolkitError(f"must have shape {shape}", field=name, value=value.shape)
    object.__setattr__(frame, name, value)


def _is_similarity(RT: Floats) -> NDArray[np.bool_]:
    A = RT[:, :3, :3]
    with np.errstate(invalid="ignore"):
        det = np.linalg.det(A)
        scale_squared = np.cbrt(np.maximum(det, 0))[:, None, None] ** 2
        off = np.abs(A @ A.transpose(0, 2, 1) - scale_squared * np.eye(3)).max(axis=(1, 2))
        right = (det > 0) & (off <= _ROTATION_TOLERANCE * scale_squared[:, 0, 0])
    plain = (RT[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    return np.isfinite(RT).all(axis=(1, 2)) & plain & right
