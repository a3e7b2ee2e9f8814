"""Joint label of several annotators: the mean of their poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Symmetry
from std_toolkit.geometry.se3 import skew
from std_toolkit.geometry.symmetry import nearest_variant
from std_toolkit.labels.agreement.annotated_scene import AnnotatedScene, LabelledObject
from std_toolkit.labels.agreement.pose_difference import surface_distance
from std_toolkit.labels.propagate import AnnotatedView, fuse_views
from std_toolkit.scene import Label, LabelProvenance

# Number of frames used to transfer a label to a world without its annotated frames.
_SPREAD = 9

Array = NDArray[np.float64]


def joint_label(
    members: Sequence[LabelledObject],
    target: AnnotatedScene,
    *,
    object_id: int,
    symmetry: Symmetry,
    time: str,
) -> Label:
    """Compute one label of the target scene from the labels of one or several annotators.

    Several labels give the mean of their poses. In a scene with metric camera poses that is one
    pose in its world; otherwise one pose in every annotated frame in which all of them have one.

    Args:
        members: labels of one object, with the frame ids of `target`.
        target: the scene that gets the label.
        object_id: id of the object in the target scene.
        symmetry: symmetry of the object.
        time: UTC, ISO 8601, for the provenance.

    Raises:
        ToolkitError: the labels cannot be transferred to the target scene.
    """
    if len(members) == 1 and members[0].owner.scene is target.scene:
        return msgspec.structs.replace(members[0].label, object=object_id)
    outline = members[0].outline
    first = _pose_of(members, target, object_id, symmetry)
    if len(members) == 1:
        return _signed_by_one(first, members[0])
    apart = max(
        surface_distance(x.poses[f], y.poses[f], outline, symmetry)
        for x, y in combinations(members, 2)
        for f in [min(x.poses.keys() & y.poses.keys())]
    )
    names = [
        f"{m.owner.name} ({m.label.annotator})" if m.label.annotator else m.owner.name
        for m in members
    ]
    worked = [s for m in members if (s := _hands_on(m.label)) is not None]
    return msgspec.structs.replace(
        first,
        method="merge",
        annotator=", ".join(dict.fromkeys(m.label.annotator for m in members if m.label.annotator)),
        refined=all(m.label.refined for m in members),
        weak_direction=next(
            (m.label.weak_direction for m in members if m.label.weak_direction), ""
        ),
        provenance=LabelProvenance(
            time=time,
            tool="std-annotate",
            version=__version__,
            refinement=f"mean of {' and '.join(names)}, {1000 * apart:.1f} mm apart",
            hands_on_s=float(sum(worked)) if worked else None,
        ),
    )


def _pose_of(
    members: Sequence[LabelledObject], target: AnnotatedScene, object_id: int, symmetry: Symmetry
) -> Label:
    worlds = [_in_world_of(target, m, symmetry) for m in members]
    if all(w is not None for w in worlds):
        covariances = [_covariance(m, target) for m in members]
        poses = [w for w in worlds if w is not None]
        mean = mean_pose(poses, members[0].outline, symmetry, covariances)
        frame = _annotated_frame(members, target)
        T_world_cam = target.T_world_cam(frame)
        assert T_world_cam is not None
        return Label(
            object=object_id,
            frame=target.own_frame[frame],
            T_cam_obj=(T_world_cam.inverse() @ mean.pose).flat(),
            T_world_obj=mean.pose.flat() if any(m.label.T_world_obj for m in members) else None,
            covariance=None if mean.covariance is None else mean.covariance.ravel().tolist(),
        )
    common = set.intersection(*(set(m.poses) for m in members)) & set(target.own_frame)
    annotated = {f for m in members for f in m.views}
    frames = sorted(common & annotated)
    if not frames:
        raise ToolkitError(
            "no annotated frame in which all have a pose",
            field=members[0].name,
            hint="annotate in a common frame, or recover the camera poses",
        )
    first = members[0].label.frame
    shared = members[0].owner.shared_frame.get(first)
    start = shared if shared in frames else frames[0]
    means = {
        f: mean_pose([m.poses[f] for m in members], members[0].outline, symmetry).pose.flat()
        for f in frames
    }
    return Label(
        object=object_id,
        frame=target.own_frame[start],
        T_cam_obj=means[start],
        views={str(target.own_frame[f]): T for f, T in means.items() if f != start},
    )


def _in_world_of(target: AnnotatedScene, member: LabelledObject, symmetry: Symmetry) -> SE3 | None:
    """Return the pose in the target's world; None if no camera poses connect the label to it."""
    if not target.posed:
        return None
    if member.owner.scene is target.scene:
        return member.T_world_obj
    reachable = sorted(f for f in member.poses if target.T_world_cam(f) is not None)
    annotated = [f for f in reachable if f in member.views]
    if not annotated and reachable:
        # Not annotated in a frame with a pose here: use frames spread over the recording.
        spread = np.linspace(0, len(reachable) - 1, min(_SPREAD, len(reachable)))
        annotated = [reachable[int(i)] for i in spread]
    views = []
    for frame in annotated:
        T_world_cam = target.T_world_cam(frame)
        assert T_world_cam is not None
        views.append(AnnotatedView(target.camera(frame), T_world_cam, member.poses[frame]))
    return fuse_views(views, member.outline, symmetry) if views else None


def _annotated_frame(members: Sequence[LabelledObject], target: AnnotatedScene) -> int:
    """Return the frame of the joint label: the first annotator's, if it has a camera pose."""
    for member in members:
        for frame in member.views:
            if target.T_world_cam(frame) is not None:
                return frame
    return min(f for f in members[0].poses if target.T_world_cam(f) is not None)


def _covariance(member: LabelledObject, target: AnnotatedScene) -> np.ndarray | None:
    """Return the covariance of the world pose; right perturbations are equal in every world."""
    numbers = member.label.covariance
    if numbers is None or member.owner.as_annotated or not target.posed:
        return None
    return np.reshape(np.asarray(numbers, dtype=np.float64), (6, 6))


def _signed_by_one(pose: Label, member: LabelledObject) -> Label:
    label = member.label
    return msgspec.structs.replace(
        pose,
        refined=label.refined and pose.T_world_obj is not None,
        weak_direction=label.weak_direction,
        method=label.method,
        annotator=label.annotator,
        provenance=label.provenance,
    )


def _hands_on(label: Label) -> float | None:
    provenance = label.provenance
    return provenance.hands_on_s if isinstance(provenance, LabelProvenance) else None


@dataclass(frozen=True, eq=False)
class MeanPose:
    """Mean pose and its covariance.

    Attributes:
        pose: mean in the frame of the poses.
        covariance: (6, 6) of a right perturbation `pose @ SE3.exp(xi)`; None if the covariance of
            an input pose is unknown.
    """

    pose: SE3
    covariance: Array | None


def mean_pose(
    poses: Sequence[SE3],
    points: NDArray[np.floating],
    symmetry: Symmetry,
    covariances: Sequence[NDArray[np.floating] | None] = (),
) -> MeanPose:
    """Return the mean of several poses on SE(3).

    At the mean the twists to all poses sum to zero. For two poses it is half-way along the screw
    motion between them, independent of the origin of the mesh frame. If all covariances are known,
    they are the weights. Annotators see the same images, so their errors are correlated to an
    unknown degree. The covariance is therefore that of covariance intersection with equal weights,
    which is consistent for any correlation.

    Source: S. Julier, J. Uhlmann, "A non-divergent estimation algorithm in the presence of unknown
    correlations", American Control Conference 1997.

    Args:
        poses: at least one; the result has the symmetric variant of the first one.
        points: (P, 3) hull vertices of the mesh, mesh frame, metres; used to match symmetric
            variants.
        symmetry: symmetry of the object.
        covariances: one per pose: (6, 6) of right perturbations, or None.

    Raises:
        ToolkitError: no poses.
    """
    if not poses:
        raise ToolkitError("no poses to average")
    variants = [poses[0], *(nearest_variant(T, poses[0], points, symmetry) for T in poses[1:])]
    known = [
        _carried(np.asarray(c, dtype=np.float64), T, V)
        for c, T, V in zip(covariances, poses, variants, strict=bool(covariances))
        if c is not None and _is_positive(np.asarray(c, dtype=np.float64))
    ]
    weighted = len(known) == len(poses)
    weights = [np.linalg.inv(c) for c in known] if weighted else [np.eye(6)] * len(poses)
    total = np.sum(weights, axis=0)
    mean = variants[0]
    for _ in range(50):
        twists = [(mean.inverse() @ V).log() for V in variants]
        step = np.linalg.solve(
            total, np.sum([W @ x for W, x in zip(weights, twists, strict=True)], axis=0)
        )
        if np.linalg.norm(step) < 1e-13:
            break
        mean = mean @ SE3.exp(step)
    return MeanPose(mean, len(poses) * np.linalg.inv(total) if weighted else None)


def _carried(covariance: Array, T: SE3, variant: SE3) -> Array:
    """Return the covariance of `variant = T @ S`: T exp(xi) S = T S exp(Ad(S^-1) xi)."""
    back = variant.inverse() @ T
    adjoint = np.block([[back.R, skew(back.t) @ back.R], [np.zeros((3, 3)), back.R]])
    return np.asarray(adjoint @ covariance @ adjoint.T)


def _is_positive(covariance: Array) -> bool:
    return bool(np.linalg.eigvalsh((covariance + covariance.T) / 2).min() > 0)
