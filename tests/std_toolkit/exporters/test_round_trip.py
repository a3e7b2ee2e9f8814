"""Every export can be imported again and gives the same scene to rounding."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from same_scene import assert_same_scene, same_pose
from scene_factory import MODELS_OF, SERIAL, make_scene

from std_toolkit.exporters import export_scene
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.documents import write_document
from std_toolkit.rendering.ground_truth import rendered_frames
from std_toolkit.scene import Frames, Scene
from std_toolkit.scene.model import pose_from_list

# 16-bit millimetres, and what float32 holds of a metre.
DEPTH_ROUNDING = {"std": 1e-6, "bop": 1e-6, "nocs": 0.51e-3}

angles = st.floats(-2.5, 2.5)
object_poses = st.builds(
    lambda r, x, y, z: SE3(so3_exp(r), np.array([x, y, z])),
    st.tuples(angles, angles, angles),
    st.floats(-0.5, 0.5),
    st.floats(-0.4, 0.4),
    st.floats(0.4, 1.5),
)
camera_poses = st.builds(
    lambda r, t: SE3(so3_exp(r), np.array(t)),
    st.tuples(*[st.floats(-0.5, 0.5)] * 3),
    st.tuples(*[st.floats(-0.3, 0.3)] * 3),
)


@st.composite
def scenes(draw):
    """Arguments of a random scene: objects may lie outside the image or behind each other."""
    count = draw(st.integers(1, 3))
    ids = draw(st.sets(st.sampled_from(sorted(MODELS_OF)), min_size=1))
    return {
        "camera_poses": draw(st.lists(camera_poses, min_size=count, max_size=count)),
        "world_poses": {i: draw(object_poses) for i in sorted(ids)},
        "depth": draw(st.booleans()),
        "depth_correction": draw(st.sampled_from([1.0, 0.98])),
        "unregistered": [count - 1] if count > 1 and draw(st.booleans()) else [],
        "policy": "models",
    }


def round_trip(folder: Path, name: str, **arguments) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    scene = make_scene(folder / "scene", **arguments)
    sidecar = export_scene(scene, name, folder / "export", jobs=SERIAL)
    request = ImportRequest(source=folder / "export", name=scene.info.name)
    again = import_recording(request, folder / "again")
    exported = rendered_frames(scene)
    assert [f.id for f in sidecar.frames] == exported
    assert {f.id for f in sidecar.left_out} == {f.id for f in scene.frames} - set(exported)
    assert_same_scene(scene, again, frames=exported, depth_m=DEPTH_ROUNDING[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["std", "bop", "nocs"])
def test_random_scenes_survive_export_and_import(name, tmp_path):
    @settings(
        max_examples=10,
        deadline=None,
        derandomize=True,
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(arguments=scenes())
    def check(arguments):
        round_trip(tmp_path / "case", name, size=(64, 48), **arguments)

    check()


@pytest.mark.parametrize("name", ["std", "bop", "nocs"])
def test_export_of_the_imported_scene_is_byte_identical(name, tmp_path):
    """The second generation loses nothing: what rounding there is happens once."""
    from std_toolkit.options import RenderOptions
    from std_toolkit.rendering.render_step import render_ground_truth

    scene = make_scene(tmp_path / "scene", frames=2)
    first = export_scene(scene, name, tmp_path / "first", jobs=SERIAL)
    request = ImportRequest(source=tmp_path / "first", name=scene.info.name)
    again = import_recording(request, tmp_path / "again")
    options = RenderOptions(renderer="raycast", policy="models")
    render_ground_truth(again, options, jobs=SERIAL).raise_if_failed()
    second = export_scene(again, name, tmp_path / "second", jobs=SERIAL)
    assert set(first.files) == set(second.files)
    pictures = [n for n in first.files if n.endswith(".png") and not n.endswith("coord.png")]
    assert pictures
    same = [n for n in pictures if first.files[n] == second.files[n]]
    assert same == pictures


@pytest.mark.parametrize("name", ["std", "bop", "nocs"])
def test_an_export_without_the_annotated_frame_can_be_imported(name, tmp_path):
    from std_toolkit.options import RenderOptions
    from std_toolkit.rendering.render_step import render_ground_truth

    scene = make_scene(tmp_path / "scene", frames=3, render=False)
    options = RenderOptions(renderer="raycast", policy="models")
    render_ground_truth(scene, options, frames=[2, 4], jobs=SERIAL).raise_if_failed()
    export_scene(scene, name, tmp_path / "export", jobs=SERIAL)
    request = ImportRequest(source=tmp_path / "export", name="again")
    again = import_recording(request, tmp_path / "again")
    assert [x.frame for x in scene.labels.labels] == [0, 0, 0]
    for label in again.labels.labels:
        assert label.frame == 2
        same_pose(pose_from_list(label.T_cam_obj), scene.T_cam_obj(2, label.object))
        same_pose(again.T_cam_obj(4, label.object), scene.T_cam_obj(4, label.object))


def test_cameras_of_equal_intrinsics_stay_two(tmp_path):
    scene = make_scene(tmp_path / "scene", frames=2)
    info, frames = scene.info, list(scene.frames)
    cameras = {"left": info.cameras["color"], "right": info.cameras["color"]}
    scene_file, frame_file = scene.root / "scene.json", scene.root / "frames.json"
    write_document(scene_file, msgspec.structs.replace(info, cameras=cameras))
    pairs = zip(frames, ("left", "right"), strict=True)
    rows = [msgspec.structs.replace(f, camera=key) for f, key in pairs]
    write_document(frame_file, Frames(frames=rows))
    scene = Scene.open(scene.root)
    for name in ("std", "bop", "nocs"):
        export_scene(scene, name, tmp_path / name, jobs=SERIAL)
        request = ImportRequest(source=tmp_path / name, name="again")
        again = import_recording(request, tmp_path / f"again_{name}")
        assert [f.camera for f in again.frames] == ["left", "right"]
