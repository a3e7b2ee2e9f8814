"""Textured real meshes on real frames: exported in every layout and read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from same_scene import assert_same_scene
from scene_factory import SERIAL
from scipy.io import loadmat

from std_toolkit.exporters import export_scene
from std_toolkit.geometry import SE3
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.options import ImportRequest
from std_toolkit.labels.entry.label import add_model
from std_toolkit.options import RenderOptions
from std_toolkit.rendering.render_step import render_ground_truth
from std_toolkit.scene import CameraPoses, FramePose, Label, Labels, Object, ObjectTable, Scene

pytestmark = pytest.mark.real


@pytest.fixture(scope="module")
def scene(test_data, tmp_path_factory) -> Scene:
    """The first frame with its refined reference poses; it alone has a camera pose."""
    folder = str(test_data / "realsense_ycb_frames")
    request = ImportRequest(
        source=Path(folder), name="ycb", color=folder, depth=folder, intrinsics=f"{folder}/meta.yml"
    )
    root = tmp_path_factory.mktemp("real") / "scene"
    scene = import_recording(request, root)
    left_out = "051_large_clamp"
    names = sorted(p.name for p in (test_data / "ycb_meshes").iterdir() if p.name != left_out)
    poses = loadmat(Path(folder) / "reference_poses/000000-color.png.mat")
    objects, labels = [], []
    pairs = zip(poses["rois"][:, 1].astype(int), poses["poses_refined"], strict=True)
    for i, (class_id, pose) in enumerate(list(pairs)[:3], start=1):
        name = names[class_id - 1]
        mesh = test_data / "ycb_meshes" / name / "textured.obj"
        add_model(scene, mesh, model_id=name)
        objects.append(Object(id=i, name=name, model=name, material="diffuse"))
        T = SE3.from_quat(pose[:4], pose[4:]).flat()
        labels.append(Label(object=i, frame=0, T_cam_obj=T, T_world_obj=T))
    scene.save_objects(ObjectTable(models=scene.objects.models, objects=objects))
    rows = [FramePose(frame=0, status="registered", T_world_cam=SE3.identity().flat())]
    scene.save_poses(CameraPoses(frames=rows, source="given"))
    scene.save_labels(Labels(labels=labels))
    options = RenderOptions(renderer="raycast", policy="sensor")
    render_ground_truth(scene, options, frames=[0], jobs=SERIAL).raise_if_failed()
    return Scene.open(root)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rounding"), [("std", 1e-6), ("bop", 1e-6), ("nocs", 1e-6)])
def test_textured_models_survive(scene, name, rounding, tmp_path):
    out = tmp_path / name
    export_scene(scene, name, out, jobs=SERIAL)
    again = import_recording(ImportRequest(source=out, name="ycb"), tmp_path / "again")
    for model in again.objects.models:
        mesh, old = again.mesh(model.id), scene.mesh(model.id)
        assert model.mesh.endswith(".glb")
        picture = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB"))
        np.testing.assert_array_equal(picture, np.asarray(old.visual.material.image.convert("RGB")))
        # The same picture at the same place of the surface.
        for m in (mesh, old):
            assert len(m.visual.uv) == len(m.vertices)
        from scipy.spatial import cKDTree

        tree = cKDTree(np.hstack([old.vertices, np.asarray(old.visual.uv) * 0.1]))
        off = tree.query(np.hstack([mesh.vertices, np.asarray(mesh.visual.uv) * 0.1]))[0]
        assert off.max() < 1e-6
    if name != "std":
        return
    assert_same_scene(scene, again, frames=[0], depth_m=rounding)
