"""The table of a run: true objects and predictions, so that any protocol can score it later.

Every frame has a row of kind `frame`, and one for each true object (`true`) and each prediction
(`found`). Poses are the upper three rows of their matrix, including the scale, in metres.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmark.data.frame import Material
from benchmark.data.true_poses import TruePose
from benchmark.evaluation.results import ERROR, FRAME, INDEX, SCENE
from benchmark.metrics.pose.pose_frames import PosePrediction, PoseTruth

POSES = "poses.parquet"
KIND = "kind"
READ = "read"  # whether the frame could be read; unreadable frames are not scored
OF_FRAME, TRUE, FOUND = "frame", "true", "found"
RT_COLUMNS = tuple(f"rt{row}{column}" for row in range(3) for column in range(4))
SIZE_COLUMNS = ("size_x", "size_y", "size_z")
COLUMNS = (
    INDEX, SCENE, FRAME, ERROR, READ, KIND, "class_id", "score", "mask_id", "material", "model",
    "pixels", "handle_visible", "box_known", *RT_COLUMNS, *SIZE_COLUMNS,
)  # fmt: skip
# Defaults that keep the type of the columns in rows of other kinds.
_NOTHING = {
    "class_id": -1, "score": np.nan, "mask_id": -1, "material": -1, "model": "", "pixels": 0,
    "handle_visible": True, "box_known": True,
    **dict.fromkeys((*RT_COLUMNS, *SIZE_COLUMNS), np.nan),
}  # fmt: skip


def rows_of_frame(
    base: dict[str, Any], truths: Iterable[TruePose], found: PosePrediction | None
) -> list[dict[str, Any]]:
    """Return the rows of a frame.

    Args:
        base: index, scene, frame, error, and whether the frame could be read.
        truths: true poses; empty for a frame that could not be read.
        found: predictions; None if the method failed.
    """
    rows = [base | {KIND: OF_FRAME} | _NOTHING]
    for truth in truths:
        instance = truth.instance
        properties = {
            "class_id": instance.class_id,
            "mask_id": instance.mask_id,
            "material": int(instance.material),
            "model": instance.model,
            "pixels": truth.pixels,
            "handle_visible": truth.handle_visible,
            "box_known": truth.box_known,
        }
        rows.append(base | {KIND: TRUE} | _NOTHING | properties | _numbers(truth.RT, truth.size))
    if found is not None:
        parts = zip(found.class_ids, found.scores, found.RT, found.sizes, strict=True)
        for class_id, score, RT, size in parts:
            properties = {"class_id": int(class_id), "score": float(score)}
            rows.append(base | {KIND: FOUND} | _NOTHING | properties | _numbers(RT, size))
    return rows


def _numbers(RT: NDArray[np.float64], size: NDArray[np.float64]) -> dict[str, float]:
    return dict(zip(RT_COLUMNS, RT[:3].ravel().tolist(), strict=True)) | dict(
        zip(SIZE_COLUMNS, size.tolist(), strict=True)
    )


@dataclass(frozen=True, eq=False)
class PoseFrames:
    """Frames of a run, ready to be scored.

    Attributes:
        indices, scenes, names: (F,) index, scene and name of each frame.
        truths, found: true objects and predictions of each frame.
    """

    indices: NDArray[np.int64]
    scenes: NDArray[Any]
    names: NDArray[Any]
    truths: Sequence[PoseTruth]
    found: Sequence[PosePrediction]

    def __len__(self) -> int:
        return len(self.indices)


def frames_of(table: pd.DataFrame, materials: frozenset[Material] = frozenset()) -> PoseFrames:
    """Return the readable frames of a table.

    Args:
        table: table of a run. Frames that could not be read are skipped; at frames where the method
            failed, all true objects count as missed.
        materials: use only objects of these materials; empty for all. A prediction belongs to the
            true object of its class in its frame with the nearest centre, and is removed with it;
            predictions of a class that the frame does not have are kept.

    Returns:
        The frames in the order of the split.
    """
    readable = table[table[READ]]
    frames = readable[readable[KIND] == OF_FRAME].sort_values(INDEX, kind="stable")
    true, found = (readable[readable[KIND] == kind] for kind in (TRUE, FOUND))
    if materials:
        keep = true["material"].isin([int(m) for m in materials]).to_numpy()
        found = found[_belongs(true, found, keep)]
        true = true[keep]
    order = frames[INDEX].to_numpy(np.int64)
    return PoseFrames(
        order,
        frames[SCENE].to_numpy(),
        frames[FRAME].to_numpy(),
        [PoseTruth(*parts) for parts in _by_frame(true, order, "handle_visible")],
        [PosePrediction(*parts) for parts in _by_frame(found, order, "score")],
    )


def _by_frame(
    rows: pd.DataFrame, order: NDArray[np.int64], more: str
) -> Iterator[tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]]:
    """Classes, poses, sizes and another column of the rows of each frame."""
    rows = rows.sort_values(INDEX, kind="stable")
    at = rows[INDEX].to_numpy(np.int64)
    RT = np.zeros((len(rows), 4, 4))
    RT[:, :3] = rows[list(RT_COLUMNS)].to_numpy(np.float64).reshape(-1, 3, 4)
    RT[:, 3, 3] = 1
    sizes = rows[list(SIZE_COLUMNS)].to_numpy(np.float64)
    classes, others = rows["class_id"].to_numpy(np.int64), rows[more].to_numpy()
    begins, ends = np.searchsorted(at, order), np.searchsorted(at, order, side="right")
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        these = slice(begin, end)
        yield classes[these], RT[these], sizes[these], others[these]


def _belongs(true: pd.DataFrame, found: pd.DataFrame, keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of the predictions that belong to a kept true object, or to none."""
    centres = ["rt03", "rt13", "rt23"]
    kept = np.ones(len(found), dtype=bool)
    places: dict[tuple[int, int], list[int]] = {}
    for row, key in enumerate(zip(true[INDEX], true["class_id"], strict=True)):
        places.setdefault(key, []).append(row)
    where, there = true[centres].to_numpy(), found[centres].to_numpy()
    for row, key in enumerate(zip(found[INDEX], found["class_id"], strict=True)):
        if key in places:
            rows = places[key]
            kept[row] = keep[rows[int(np.linalg.norm(where[rows] - there[row], axis=1).argmin())]]
    return kept
