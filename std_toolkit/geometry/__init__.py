"""Poses, cameras, depth and meshes. Conventions are those of data_spec.md.

SI units; OpenCV camera frame (x right, y down, z forward); pixel centres at integer coordinates;
`T_a_b` maps points of frame b into frame a; quaternions are wxyz; depth is z-depth, 0 = none.
"""

from std_toolkit.geometry.alignment import Similarity, ransac_similarity, umeyama
from std_toolkit.geometry.camera import Camera, undistort_image
from std_toolkit.geometry.depth_maps import unproject_depth
from std_toolkit.geometry.se3 import SE3, rotation_angle, so3_exp, so3_log
from std_toolkit.geometry.symmetry import Symmetry, mssd, rotation_error, translation_error

__all__ = [
    "SE3",
    "Camera",
    "Similarity",
    "Symmetry",
    "mssd",
    "ransac_similarity",
    "rotation_angle",
    "rotation_error",
    "so3_exp",
    "so3_log",
    "translation_error",
    "umeyama",
    "undistort_image",
    "unproject_depth",
]
