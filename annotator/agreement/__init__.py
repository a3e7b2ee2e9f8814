"""Agreement of two or more annotators of one recording: compare their labels, merge them."""

from annotator.agreement.agreement import (
    CompareOptions,
    Comparison,
    ObjectAgreement,
    compare_labels,
)
from annotator.agreement.choice import MergeOptions
from annotator.agreement.difference import PoseDifference, pose_difference, what_differs
from annotator.agreement.mean import MeanPose, mean_pose
from annotator.agreement.merge import Merge, MergedObject, merge_labels
from annotator.agreement.write import write_into, write_scene

__all__ = [
    "CompareOptions",
    "Comparison",
    "MeanPose",
    "Merge",
    "MergeOptions",
    "MergedObject",
    "ObjectAgreement",
    "PoseDifference",
    "compare_labels",
    "mean_pose",
    "merge_labels",
    "pose_difference",
    "what_differs",
    "write_into",
    "write_scene",
]
