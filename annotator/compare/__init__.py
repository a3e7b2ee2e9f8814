"""Agreement of two or more annotators of one recording: compare their labels, merge them."""

from annotator.compare.joint_label import MeanPose, mean_pose
from annotator.compare.merge_labels import Merge, MergedObject, merge_labels
from annotator.compare.merge_output import write_into, write_scene
from annotator.compare.unsaved_work import compare_labels
from annotator.options import MergeOptions
from std_toolkit.labels.agreement.comparison import Comparison, ObjectAgreement
from std_toolkit.labels.agreement.options import CompareOptions
from std_toolkit.labels.agreement.pose_difference import (
    PoseDifference,
    pose_difference,
    what_differs,
)

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
