"""Metrics of instance-level 6D poses as the BOP Challenge has them: VSD, MSSD, MSPD and AR."""

from benchmark.metrics.bop.bop_dataset import BopDataset, BopTarget, open_bop
from benchmark.metrics.bop.bop_errors import SeenSurface, mspd, see, vsd
from benchmark.metrics.bop.bop_file import BopEstimate, read_bop_results, write_bop_results
from benchmark.metrics.bop.bop_recall import (
    BopScorer,
    BopScores,
    PoseErrors,
    average_recalls,
    found_of,
    mean_recalls,
    score_bop,
    seconds_per_image,
)

__all__ = [
    "BopDataset",
    "BopEstimate",
    "BopScorer",
    "BopScores",
    "BopTarget",
    "PoseErrors",
    "SeenSurface",
    "average_recalls",
    "found_of",
    "mean_recalls",
    "mspd",
    "open_bop",
    "read_bop_results",
    "score_bop",
    "seconds_per_image",
    "see",
    "vsd",
    "write_bop_results",
]
