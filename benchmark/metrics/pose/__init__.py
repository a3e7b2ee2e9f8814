"""Metrics of category-level 6D poses: overlap of boxes, angles and distances, and their scores."""

from benchmark.metrics.pose.box_iou import BoxIoU, box_iou
from benchmark.metrics.pose.matching import PoseMatches, rotation_errors_deg, translation_errors_cm
from benchmark.metrics.pose.pose_frames import PosePrediction, PoseTruth
from benchmark.metrics.pose.pose_protocol import (
    DREDS_CLASSES,
    PoseClasses,
    PoseGate,
    PoseProtocol,
    PoseScoring,
    get_pose_protocol,
    pose_protocols,
)
from benchmark.metrics.pose.scores import (
    PoseScores,
    average_precision,
    match_poses,
    score_matches,
    score_poses,
)

__all__ = [
    "DREDS_CLASSES",
    "BoxIoU",
    "PoseClasses",
    "PoseGate",
    "PoseMatches",
    "PosePrediction",
    "PoseProtocol",
    "PoseScores",
    "PoseScoring",
    "PoseTruth",
    "average_precision",
    "box_iou",
    "get_pose_protocol",
    "match_poses",
    "pose_protocols",
    "rotation_errors_deg",
    "score_matches",
    "score_poses",
    "translation_errors_cm",
]
