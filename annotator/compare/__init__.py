"""Agreement of two or more annotators of one recording: compare their labels, merge them."""

from annotator.compare.comparison import (
    Comparison,
    ObjectAgreement,
    compare_labels,
)
from annotator.compare.joint_label import MeanPose, mean_pose
from annotator.compare.merge_labels import Merge, MergedObject, merge_labels
from annotator.compare.merge_output import write_into, write_scene
from annotator.compare.pose_difference import PoseDifference, pose_difference, what_differs
from annotator.options import CompareOptions, MergeOptions

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
