"""Metrics of instance-level 6D poses as the BOP Challenge has them: VSD, MSSD, MSPD, AR, mAP."""

from benchmark.metrics.bop.bop_dataset import BopDataset, BopTarget, ViewGroup
from benchmark.metrics.bop.bop_detection import (
    Detections,
    DetectionScores,
    detection_intervals,
    detection_scores,
)
from benchmark.metrics.bop.bop_distances import ModelDistances, fisheye624, pinhole
from benchmark.metrics.bop.bop_errors import SeenSurface, mspd, see, vsd
from benchmark.metrics.bop.bop_file import BopEstimate, read_bop_results, write_bop_results
from benchmark.metrics.bop.bop_open import open_bop
from benchmark.metrics.bop.bop_recall import (
    BopScores,
    PoseErrors,
    average_recalls,
    found_of,
    mean_recalls,
)
from benchmark.metrics.bop.bop_scorer import (
    BOP_ERRORS,
    BopError,
    BopScorer,
    ObjectErrors,
    score_bop,
    score_bop_detection,
    seconds_per_image,
)

__all__ = [
    "BOP_ERRORS",
    "BopDataset",
    "BopError",
    "BopEstimate",
    "BopScorer",
    "BopScores",
    "BopTarget",
    "DetectionScores",
    "Detections",
    "ModelDistances",
    "ObjectErrors",
    "PoseErrors",
    "SeenSurface",
    "ViewGroup",
    "average_recalls",
    "detection_intervals",
    "detection_scores",
    "fisheye624",
    "found_of",
    "mean_recalls",
    "mspd",
    "open_bop",
    "pinhole",
    "read_bop_results",
    "score_bop",
    "score_bop_detection",
    "seconds_per_image",
    "see",
    "vsd",
    "write_bop_results",
]
