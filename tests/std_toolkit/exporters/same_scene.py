"""Whether two scenes are the same to rounding."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from std_toolkit.geometry import SE3, rotation_angle
from std_toolkit.scene import Scene
from std_toolkit.scene.model import pose_from_list


def same_pose(a: SE3 | None, b: SE3 | None, *, metres: float = 1e-8) -> None:
    assert (a is None) == (b is None)
    if a is not None and b is not None:
        assert np.abs(a.t - b.t).max() < metres
        assert rotation_angle(a.R.T @ b.R) < 1e-7


def assert_same_scene(before: Scene, after: Scene, *, frames: list[int], depth_m: float) -> None:
    """Compare everything that an export must keep.

    Args:
        frames: ids of the frames that were exported.
        depth_m: what rounding of depth may do.
    """
    assert after.info.name == before.info.name
    assert [f.id for f in after.frames] == frames
    for frame in after.frames:
        old = before.frame(frame.id)
        assert (frame.name, frame.camera, frame.timestamp) == (old.name, old.camera, old.timestamp)
        assert after.camera(frame) == before.camera(old).without_distortion()
        np.testing.assert_array_equal(after.read_color(frame), before.read_color(old))
        a, b = after.read_depth(frame), before.read_depth(old)
        assert (a is None) == (b is None)
        if a is not None:
            np.testing.assert_allclose(a, b, atol=depth_m)
        same_pose(after.T_world_cam(frame.id), before.T_world_cam(frame.id))
        for thing in before.objects.objects:
            same_pose(after.T_cam_obj(frame.id, thing.id), before.T_cam_obj(frame.id, thing.id))
    assert after.objects.objects == before.objects.objects
    assert after.poses.scale == before.poses.scale
    poses = {p.frame: p for p in before.poses.frames}
    for new in after.poses.frames:
        old = poses[new.frame]
        assert (new.points, new.reprojection_px) == (old.points, old.reprojection_px)
    for new, old in zip(after.labels.labels, before.labels.labels, strict=True):
        assert (new.object, new.frame, new.refined, new.annotator, new.method) == (
            old.object,
            old.frame,
            old.refined,
            old.annotator,
            old.method,
        )
        assert new.provenance == old.provenance
        same_pose(pose_from_list(new.T_cam_obj), pose_from_list(old.T_cam_obj))
        same_pose(pose_from_list(new.T_world_obj), pose_from_list(old.T_world_obj))
    for new, old in zip(after.objects.models, before.objects.models, strict=True):
        assert (new.id, new.category, new.class_id) == (old.id, old.category, old.class_id)
        np.testing.assert_allclose(new.size_m, old.size_m, atol=1e-7)
        assert abs(new.diameter_m - old.diameter_m) < 1e-7
        a, b = after.mesh(new.id), before.mesh(old.id)
        assert len(a.faces) == len(b.faces)
        for p, q in ((a, b), (b, a)):
            assert cKDTree(p.vertices).query(q.vertices)[0].max() < 1e-7
        for x, y in zip(new.symmetry.discrete, old.symmetry.discrete, strict=True):
            np.testing.assert_allclose(x, y, atol=1e-7)
        for c, d in zip(new.symmetry.continuous, old.symmetry.continuous, strict=True):
            np.testing.assert_allclose([c.axis, c.offset], [d.axis, d.offset], atol=1e-7)
