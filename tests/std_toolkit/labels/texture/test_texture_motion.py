"""Where the texture of a mesh puts an object, against where the recording has it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sensors.synthetic import RecordingOptions, scene_from_truth
from sensors.synthetic.recording import textured_meshes
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.labels.refine.problem import RefineObject
from std_toolkit.labels.refine_step import scene_object
from std_toolkit.labels.texture.motion import TextureMotion, texture_motion
from std_toolkit.labels.texture.scores import cut_window
from std_toolkit.labels.texture_step import scene_views
from std_toolkit.rendering.texture import TexturedSurface
from std_toolkit.scene import Scene

NAME = "cereal_box"


def found(
    scene: Scene, obj: RefineObject, others: list[RefineObject], free: np.ndarray | None = None
) -> TextureMotion | None:
    views = scene_views(scene)
    windows = []
    assert obj.texture is not None
    for k in views.large(obj.T_world_obj @ obj.centre, obj.radius, count=8):
        view = views.read(k)
        assert view is not None
        window = cut_window(view, obj.texture, obj.T_world_obj, others)
        if window is not None:
            windows.append((views.frames[k], window))
    return texture_motion(windows, obj.texture, obj, free=free)


@pytest.mark.slow
def test_the_texture_tells_all_six_degrees_of_freedom(
    synthetic_table: Path, tmp_path: Path
) -> None:
    scene = scene_from_truth(synthetic_table, tmp_path / "scene")
    ids = {o.name: o.id for o in scene.objects.objects}
    right = scene.T_world_obj(ids[NAME])
    assert right is not None
    mesh = textured_meshes(RecordingOptions(frames=9, seed=1))[NAME]
    base = scene_object(scene, ids[NAME], right, mesh=mesh)
    base = replace(base, texture=TexturedSurface.from_mesh(mesh))
    others = [
        scene_object(scene, i, T)
        for name, i in ids.items()
        if name != NAME and (T := scene.T_world_obj(i)) is not None
    ]
    rng = np.random.default_rng(0)
    centre = right @ base.centre
    for mm, deg in ((0.0, 0.0), (8.0, 0.0), (0.0, 6.0), (12.0, 5.0)):
        shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        shift, turn = shift * mm / 1000, axis * np.deg2rad(deg)
        R = so3_exp(turn)
        wrong = SE3(R @ right.R, R @ (right.t - centre) + centre + shift)
        motion = found(scene, replace(base, T_world_obj=wrong), others)
        assert motion is not None and len(motion.frames) >= 6
        error = motion.vector + np.concatenate([shift, turn])
        assert np.linalg.norm(error[:3]) < 0.0008
        assert np.rad2deg(np.linalg.norm(error[3:])) < 0.6
        deviations = np.abs(error) / np.sqrt(np.diag(motion.covariance))
        assert deviations.max() < 3.5
        assert motion.agreement > 0.8
    # What a symmetry leaves open is not moved.
    about_z = np.concatenate([np.zeros(3), right.R[:, 2]])[None]
    R = so3_exp(np.deg2rad(4) * right.R[:, 2])
    turned = SE3(R @ right.R, R @ (right.t - centre) + centre)
    motion = found(scene, replace(base, T_world_obj=turned), others, about_z)
    assert motion is None or abs(about_z[0] @ motion.vector) < 0.002
    # Another texture is found nowhere.
    assert base.texture is not None
    mesh.visual.material.image = mesh.visual.material.image.transpose(0)
    other = replace(base, texture=TexturedSurface.from_mesh(mesh))
    wrong_texture = found(scene, other, others)
    assert wrong_texture is None or wrong_texture.agreement < 0.6
