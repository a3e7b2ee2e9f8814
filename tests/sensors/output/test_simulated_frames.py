"""Records of a simulation are refused where a value contradicts its meaning."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulated_views import COLOR, LABELS, make_objects, make_scene, random_frames

from sensors.output.scene_record import ReceivedFrames
from sensors.output.simulated_frame import SimulatedFrame
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3


@pytest.fixture(scope="module")
def frames() -> list[SimulatedFrame]:
    return list(random_frames(make_scene(frames=2)))


def test_label_maps_have_the_camera_of_their_own_size(frames) -> None:
    assert frames[0].label_camera == COLOR.resized(*LABELS)
    assert frames[0].depth_camera is frames[0].infrared_camera
    assert set(frames[0].instances) <= set(range(1, 7))
    assert len(frames[0].instances) >= 4


def filled(value: Any, name: str = "depth_exact"):
    def change(frame: SimulatedFrame) -> dict[str, Any]:
        array = getattr(frame, name).copy()
        array[0, 0] = value
        return {name: array}

    return change


WRONG = {
    "color of another size": (lambda f: {"color": f.color[::2]}, "color"),
    "float colour": (lambda f: {"color": f.color.astype(np.float32)}, "color"),
    "no array": (lambda _: {"infrared_left": None}, "infrared_left"),
    "coloured infrared": (lambda f: {"infrared_right": f.color}, "infrared_right"),
    "double depth": (lambda f: {"depth_exact": f.depth_exact.astype(float)}, "depth_exact"),
    "depth of another size": (lambda f: {"depth_aligned": f.depth_aligned[1:]}, "depth_aligned"),
    "labels of other proportions": (lambda f: {"mask": f.mask[:, 1:]}, "mask"),
    "sensor depth of other proportions": (
        lambda f: {"depth_sensor": f.depth_sensor[1:]},
        "depth_sensor",
    ),
    "negative depth": (filled(-0.001, "depth_sensor"), "depth_sensor"),
    "depth that is no number": (filled(np.nan), "depth_exact"),
    "infinite depth": (filled(np.inf, "depth_aligned"), "depth_aligned"),
    "depth in millimetres": (filled(1200.0), "depth_exact"),
    "an object without depth": (
        lambda f: {"depth_exact": np.where(f.mask > 0, 0, f.depth_exact).astype(np.float32)},
        "depth_exact",
    ),
    "NOCS in the background": (filled(0.5, "nocs"), "nocs"),
    "NOCS above 1": (lambda f: {"nocs": f.nocs * 3}, "nocs"),
    "normals of another length": (lambda f: {"normals": f.normals * 1.1}, "normals"),
    "objects without normals": (lambda f: {"normals": f.normals * 0}, "normals"),
    "a mirrored pose": (
        lambda f: {"T_world_cam": SE3(f.T_world_cam.R * [1, 1, -1], f.T_world_cam.t)},
        "rotation",
    ),
    "a negative index": (lambda _: {"index": -1}, "index"),
}


@pytest.mark.parametrize("what", WRONG)
def test_contradictions_are_refused(what, frames) -> None:
    change, named = WRONG[what]
    with pytest.raises(ToolkitError, match=named):
        replace(frames[0], **change(frames[0]))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("instance_id", 0),
        ("asset_id", "../up"),
        ("category", ""),
        ("class_id", 7),
        ("material_class", "glass"),
        ("scale_m", 150.0),
        ("scale_m", float("nan")),
    ],
)
def test_objects_out_of_their_range_are_refused(field, value) -> None:
    with pytest.raises(ToolkitError, match=field if field != "material_class" else "material"):
        replace(make_objects()[0], **{field: value})


def test_meshes_are_canonical() -> None:
    item = make_objects()[0]
    for wrong in (
        item.mesh.copy().apply_scale(0.2),
        item.mesh.copy().apply_translation([0, 0.1, 0]),
    ):
        with pytest.raises(ToolkitError, match="diagonal of 1"):
            replace(item, mesh=wrong)


def test_a_scene_is_consistent() -> None:
    scene = make_scene()
    with pytest.raises(ToolkitError, match="increase"):
        replace(scene, objects=scene.objects[::-1])
    with pytest.raises(ToolkitError, match="indices"):
        replace(scene, indices=(4,))
    twin = replace(scene.objects[1], asset_id=scene.objects[0].asset_id)
    with pytest.raises(ToolkitError, match="different meshes"):
        replace(scene, objects=[scene.objects[0], twin, *scene.objects[2:]])
    for field, value in (("seed", -1), ("frames", 0), ("name", "a/b")):
        with pytest.raises(ToolkitError, match=field):
            replace(scene, **{field: value})
    with pytest.raises(ToolkitError, match="finite"):
        replace(scene, parameters={"light": float("inf")})
    with pytest.raises(ToolkitError, match="JSON"):
        replace(scene, parameters={"mesh": scene.objects[0].mesh})


def test_the_frames_of_a_scene_are_its_own_and_each_comes_once(frames) -> None:
    scene = make_scene(frames=2)
    intake = ReceivedFrames(scene)
    with pytest.raises(ToolkitError, match="no frame was written"):
        _ = intake.cameras
    intake.accept(frames[1])
    with pytest.raises(ToolkitError, match="before"):
        intake.accept(frames[1])
    with pytest.raises(ToolkitError, match="1 of 2 frames"):
        intake.require_all()
    with pytest.raises(ToolkitError, match="2 frames"):
        intake.accept(replace(frames[0], index=2))
    with pytest.raises(ToolkitError, match="same cameras"):
        intake.accept(replace(frames[0], color_camera=replace(COLOR, fx=470.0)))
    mask = frames[0].mask.copy()
    mask[mask == 3] = 200
    with pytest.raises(ToolkitError, match="no such object"):
        intake.accept(replace(frames[0], mask=mask))
    intake.accept(frames[0])
    intake.require_all()
    assert intake.cameras.label.size == LABELS


def test_rounding_is_no_contradiction(frames) -> None:
    """The tip of a needle along an axis, and a triangle without area."""
    frame = frames[0]
    v, u = (int(i[0]) for i in np.nonzero(frame.mask))
    nocs, normals = frame.nocs.copy(), frame.normals.copy()
    nocs[v, u] = (1 + 2e-7, 0.5, -2e-7)
    normals[v, u] = 0
    replace(frame, nocs=nocs, normals=normals)
