"""Metrics of instance-level 6D poses as the BOP Challenge has them: VSD, MSSD, MSPD and AR."""

from benchmark.metrics.bop.dataset import BopDataset, BopTarget, open_bop
from benchmark.metrics.bop.evaluate import score_bop
from benchmark.metrics.bop.projection import mspd
from benchmark.metrics.bop.recall import BopScores, PoseErrors, average_recalls
from benchmark.metrics.bop.results import BopEstimate, read_bop_results, write_bop_results
from benchmark.metrics.bop.visible_surface import SeenSurface, see, vsd

__all__ = [
    "BopDataset",
    "BopEstimate",
    "BopScores",
    "BopTarget",
    "PoseErrors",
    "SeenSurface",
    "average_recalls",
    "mspd",
    "open_bop",
    "read_bop_results",
    "score_bop",
    "see",
    "vsd",
    "write_bop_results",
]
