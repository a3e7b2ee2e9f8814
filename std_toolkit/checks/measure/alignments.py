"""Where one image and its sensor depth put each object, for frames that stand alone.

Contours and textures of one image leave the distance open, errors of mesh and lens move them as a
whole, and edges on glass and steel mislead them: alone they are no evidence. The refinement of
labels solves depth and edges together; the motion from a label to where it ends, with the deviation
that the refinement states, is what a lone frame tells of a label on an object that depth shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from std_toolkit.checks.measure.contours import mesh_problem, object_centre
from std_toolkit.checks.measure.motion import motion_value
from std_toolkit.checks.measure.motion_solver import symmetry_motions, without_free
from std_toolkit.checks.result import ObjectCheck, Value
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.mesh import hull_vertices
from std_toolkit.geometry.se3 import so3_log
from std_toolkit.geometry.symmetry import nearest_variant
from std_toolkit.labels.auto_refine import RefinedPose, refine_objects
from std_toolkit.labels.refine.directions import covariance_at
from std_toolkit.scene import Frame, Scene
from std_toolkit.scene.model import DIFFUSE_MATERIALS


def measure_alignments(scene: Scene, frame: Frame) -> dict[int, Value]:
    """The motions from the labels to where one frame puts the objects, by object id.

    Args:
        scene: with labels in the world.
        frame: a registered frame.

    Returns:
        Values with the key `aligned_mm`; see `ObjectCheck`. Objects that the frame does not show
        well enough, or whose depth is not to be trusted, are missing.

    Raises:
        ToolkitError: the frame cannot be read.
    """
    poses = {
        o.id: T
        for o in scene.objects.objects
        if (T := scene.T_world_obj(o.id)) is not None and mesh_problem(scene, o.model) is None
    }
    if not poses:
        return {}
    trusted = [i for i in poses if scene.objects.object(i).material in DIFFUSE_MATERIALS]
    if not trusted or scene.read_depth(frame) is None:
        return {}
    try:
        found = refine_objects(scene, poses, trusted, frames=[frame.id]).objects
    except ToolkitError:  # no object is visible enough
        return {}
    known = {i: pose for i, pose in found.items() if pose.depth_m is not None}
    return {i: _value(scene, i, poses[i], pose) for i, pose in known.items()}


def with_alignments(
    objects: Sequence[ObjectCheck], found: Mapping[int, Value] | None
) -> list[ObjectCheck]:
    """The rows with `aligned_mm`."""
    found = found or {}
    return [o.with_values([found[o.object]]) if o.object in found else o for o in objects]


def _value(scene: Scene, object_id: int, label: SE3, refined: RefinedPose) -> Value:
    model = scene.objects.model_of(object_id)
    mesh, symmetry = scene.mesh(model.id), model.symmetry.symmetry()
    middle = np.asarray(mesh.bounds).mean(axis=0)
    pose = nearest_variant(refined.pose, label, hull_vertices(mesh), symmetry)
    motion = np.concatenate([pose @ middle - label @ middle, so3_log(pose.R @ label.R.T)])
    # Of the pose that was refined: a symmetric variant has other axes, and the same covariance.
    R = np.kron(np.eye(2), refined.pose.R)
    covariance = R @ covariance_at(refined.covariance, middle) @ R.T
    centre = object_centre(scene, object_id)
    kept = without_free(symmetry_motions(symmetry, label, centre))
    return motion_value(
        "aligned_mm", "depth", kept @ motion, kept @ covariance @ kept.T,
        frames=refined.views, text=refined.method,
    )  # fmt: skip
