"""Boxes, frames and the known answers that the tests of pose metrics share."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmark.metrics.pose import PosePrediction, PoseTruth

ORACLE = Path(__file__).resolve().parents[3] / "data" / "pose_metrics_oracle.json"


def oracle() -> dict[str, Any]:
    return json.loads(ORACLE.read_text())


def oracle_frames() -> tuple[list[PoseTruth], list[PosePrediction]]:
    frames = oracle()["frames"]
    truths = [
        PoseTruth(f["gt_class_ids"], f["gt_RTs"], f["gt_scales"], f["gt_handle_visibility"])
        for f in frames
    ]
    predictions = [
        PosePrediction(f["pred_class_ids"], f["pred_RTs"], f["pred_scales"], f["pred_scores"])
        for f in frames
    ]
    return truths, predictions


def pose(rotvec: Any = (0, 0, 0), t: Any = (0, 0, 0), scale: float = 1.0) -> np.ndarray:
    """(4, 4) with the scale inside."""
    RT = np.eye(4)
    RT[:3, :3] = scale * Rotation.from_rotvec(np.asarray(rotvec, float)).as_matrix()
    RT[:3, 3] = t
    return RT


_ANGLES = st.floats(-3, 3, width=32)
_PLACES = st.floats(-0.75, 0.75, width=32)
_SIDES = st.floats(0.125, 2, width=32)
poses = st.builds(
    pose, st.tuples(*[_ANGLES] * 3), st.tuples(*[_PLACES] * 3), st.floats(0.25, 4, width=32)
)
boxes = st.tuples(poses, st.tuples(*[_SIDES] * 3).map(np.array))
rigid = st.builds(pose, st.tuples(*[_ANGLES] * 3), st.tuples(*[_PLACES] * 3))


def frame_of(*objects: tuple[int, np.ndarray]) -> PoseTruth:
    """True objects (class, RT) whose boxes are cubes."""
    return PoseTruth([c for c, _ in objects], [RT for _, RT in objects], np.ones((len(objects), 3)))


def found(*objects: tuple[int, np.ndarray, float]) -> PosePrediction:
    """Predictions (class, RT, score) whose boxes are cubes."""
    return PosePrediction(
        [c for c, _, _ in objects],
        [RT for _, RT, _ in objects],
        np.ones((len(objects), 3)),
        [s for _, _, s in objects],
    )
