"""Every document of a scene, damaged in every way: one clear line, and the scene as it was."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scene_on_disk import contents

DOCUMENTS = ("scene.json", "frames.json", "objects.json", "poses.json", "labels.json")


def at(document: Any, place: str) -> tuple[Any, Any]:
    """The container and key of a place such as "frames.0.T_world_cam.3"."""
    *parents, last = [int(p) if p.isdigit() else p for p in place.split(".")]
    for parent in parents:
        document = document[parent]
    return document, last


def put(place: str, value: Any) -> Callable[[Any], Any]:
    def change(document: Any) -> Any:
        container, key = at(document, place)
        container[key] = value
        return document

    return change


def drop(place: str) -> Callable[[Any], Any]:
    def change(document: Any) -> Any:
        container, key = at(document, place)
        del container[key]
        return document

    return change


def twice(place: str, **changes: Any) -> Callable[[Any], Any]:
    def change(document: Any) -> Any:
        container, key = at(document, place)
        container[key].append({**container[key][0], **changes})
        return document

    return change


MIRROR = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1]
SCALED = [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1]
MILLIMETRE_ROW = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1000]
IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
HALF_SIZE = {"width": 96, "height": 72, "fx": 45, "fy": 45, "cx": 23.5, "cy": 17.5}
OTHER_SIZE = {"width": 48, "height": 36, "fx": 45, "fy": 45, "cx": 23.5, "cy": 17.5}

# (document, field that the error names, damage)
CASES: dict[str, tuple[str, str, Callable[[Any], Any]]] = {
    "foreign_format": ("scene.json", "format", put("format", "bop")),
    "future_version": ("scene.json", "version", put("version", 2)),
    "unknown_field": ("scene.json", "depht_scale", put("depht_scale", 0.001)),
    "no_name": ("scene.json", "name", drop("name")),
    "name_up": ("scene.json", "name", put("name", "../scene")),
    "name_nul": ("scene.json", "name", put("name", "a\0b")),
    "name_escape_code": ("scene.json", "name", put("name", "\x1b[2J")),
    "no_cameras": ("scene.json", "cameras", put("cameras", {})),
    "camera_key_up": ("scene.json", "cameras", put("cameras", {"../c": HALF_SIZE})),
    "zero_width": ("scene.json", "width", put("cameras.color.width", 0)),
    "text_width": ("scene.json", "width", put("cameras.color.width", "96")),
    "fractional_width": ("scene.json", "width", put("cameras.color.width", 96.5)),
    "negative_focal_length": ("scene.json", "fx", put("cameras.color.fx", -90)),
    "focal_length_in_mm": ("scene.json", "fx", put("cameras.color.fx", 1.93)),
    "focal_length_null": ("scene.json", "fy", put("cameras.color.fy", None)),
    "intrinsics_of_half_size": ("scene.json", "cx", put("cameras.color", HALF_SIZE)),
    "intrinsics_of_double_size": ("scene.json", "cx", put("cameras.color.cx", 95)),
    "three_distortion_numbers": (
        "scene.json",
        "distortion",
        put("cameras.color.distortion", [0.1] * 3),
    ),
    "zero_depth_scale": ("scene.json", "depth_scale", put("depth_scale", 0)),
    "negative_depth_scale": ("scene.json", "depth_scale", put("depth_scale", -0.001)),
    "wild_depth_correction": ("scene.json", "depth_correction", put("depth_correction", 5)),
    "frames_unsorted": ("frames.json", "frames", lambda d: {"frames": d["frames"][::-1]}),
    "frame_id_twice": ("frames.json", "frames", put("frames.1.id", 0)),
    "frame_name_twice": ("frames.json", "frames[1].name", put("frames.1.name", "000000")),
    "frame_id_negative": ("frames.json", "frames[0].id", put("frames.0.id", -1)),
    "frame_id_fractional": ("frames.json", "frames[0].id", put("frames.0.id", 0.5)),
    "frame_id_huge": ("frames.json", "frames[2].id", put("frames.2.id", 2**70)),
    "frame_name_dots": ("frames.json", "frames[1].name", put("frames.1.name", "..")),
    "frame_name_empty": ("frames.json", "frames[1].name", put("frames.1.name", "")),
    "frame_name_newline": ("frames.json", "frames[1].name", put("frames.1.name", "a\n")),
    "color_absolute": ("frames.json", "frames[1].color", put("frames.1.color", "/etc/passwd")),
    "color_up": ("frames.json", "frames[1].color", put("frames.1.color", "../../etc/passwd")),
    "color_up_inside": (
        "frames.json",
        "frames[1].color",
        put("frames.1.color", "color/../../x.png"),
    ),
    "color_nul": ("frames.json", "frames[1].color", put("frames.1.color", "color/a\0.png")),
    "color_backslash": ("frames.json", "frames[1].color", put("frames.1.color", "..\\x.png")),
    "color_missing": ("frames.json", "color", drop("frames.1.color")),
    "depth_up": ("frames.json", "frames[1].depth", put("frames.1.depth", "../depth.png")),
    "depth_number": ("frames.json", "frames[1].depth", put("frames.1.depth", 5)),
    "unknown_camera": ("frames.json", "frames[1].camera", put("frames.1.camera", "infrared")),
    "time_as_text": ("frames.json", "timestamp", put("frames.1.timestamp", "12:00")),
    "frames_null": ("frames.json", "frames", put("frames", None)),
    "frames_object": ("frames.json", "frames", put("frames", {})),
    "object_id_twice": ("objects.json", "objects[1].id", twice("objects", name="other")),
    "object_name_twice": ("objects.json", "objects[1].name", twice("objects", id=2)),
    "model_id_twice": ("objects.json", "models[1].id", twice("models")),
    "unknown_model": ("objects.json", "objects[0].model", put("objects.0.model", "mug")),
    "object_id_zero": ("objects.json", "objects[0].id", put("objects.0.id", 0)),
    "object_id_255": ("objects.json", "objects[0].id", put("objects.0.id", 255)),
    "unknown_material": ("objects.json", "objects[0].material", put("objects.0.material", "glass")),
    "object_name_up": ("objects.json", "objects[0].name", put("objects.0.name", "../box")),
    "mesh_up": ("objects.json", "models[0].mesh", put("models.0.mesh", "../box.ply")),
    "mesh_absolute": ("objects.json", "models[0].mesh", put("models.0.mesh", "/tmp/box.ply")),
    "model_id_up": ("objects.json", "models[0].id", put("models.0.id", "../../box")),
    "class_out_of_range": ("objects.json", "models[0].class_id", put("models.0.class_id", 9)),
    "negative_size": ("objects.json", "size_m", put("models.0.size_m.1", -0.04)),
    "two_sizes": ("objects.json", "size_m", put("models.0.size_m", [0.1, 0.1])),
    "zero_diameter": ("objects.json", "diameter_m", put("models.0.diameter_m", 0)),
    "symmetry_mirrors": (
        "objects.json",
        "models[0].symmetry",
        put("models.0.symmetry.discrete", [MIRROR]),
    ),
    "symmetry_axis_length": (
        "objects.json",
        "models[0].symmetry",
        put("models.0.symmetry.continuous", [{"axis": [0, 0, 2], "offset": [0, 0, 0]}]),
    ),
    "pose_of_15_numbers": (
        "poses.json",
        "frames[1].T_world_cam",
        put("frames.1.T_world_cam", IDENTITY[1:]),
    ),
    "pose_with_null": ("poses.json", "frames[1].T_world_cam", put("frames.1.T_world_cam.3", None)),
    "pose_mirrored": ("poses.json", "frames[1].T_world_cam", put("frames.1.T_world_cam", MIRROR)),
    "pose_scaled": ("poses.json", "frames[1].T_world_cam", put("frames.1.T_world_cam", SCALED)),
    "pose_last_row": (
        "poses.json",
        "frames[1].T_world_cam",
        put("frames.1.T_world_cam", MILLIMETRE_ROW),
    ),
    "pose_zeros": ("poses.json", "frames[1].T_world_cam", put("frames.1.T_world_cam", [0] * 16)),
    "pose_missing": ("poses.json", "frames[1]", put("frames.1.T_world_cam", None)),
    "pose_of_unregistered": ("poses.json", "frames[1]", put("frames.1.status", "unregistered")),
    "status_unknown": ("poses.json", "frames[1].status", put("frames.1.status", "lost")),
    "pose_frame_twice": ("poses.json", "frames[1].frame", put("frames.1.frame", 0)),
    "pose_frame_unknown": ("poses.json", "frames[2].frame", put("frames.2.frame", 77)),
    "covariance_of_35": (
        "poses.json",
        "frames[0].covariance",
        put("frames.0.covariance", [0] * 35),
    ),
    "negative_reprojection": ("poses.json", "reprojection_px", put("frames.0.reprojection_px", -1)),
    "refined_other_size": ("poses.json", "cameras.color", put("cameras", {"color": OTHER_SIZE})),
    "refined_unknown_camera": (
        "poses.json",
        "cameras",
        put("cameras", {"left": HALF_SIZE | {"cx": 47, "cy": 35, "fx": 90, "fy": 90}}),
    ),
    "label_of_unknown_object": ("labels.json", "labels[0].object", put("labels.0.object", 9)),
    "label_in_unknown_frame": ("labels.json", "labels[0].frame", put("labels.0.frame", 9)),
    "label_twice": ("labels.json", "labels[1].object", twice("labels")),
    "label_mirrored": ("labels.json", "labels[0].T_cam_obj", put("labels.0.T_cam_obj", MIRROR)),
    "label_scaled": ("labels.json", "labels[0].T_world_obj", put("labels.0.T_world_obj", SCALED)),
    "label_of_12_numbers": (
        "labels.json",
        "labels[0].T_cam_obj",
        put("labels.0.T_cam_obj", IDENTITY[:12]),
    ),
    "label_object_text": ("labels.json", "labels[0].object", put("labels.0.object", "box_1")),
    "view_key": ("labels.json", "labels[0].views", put("labels.0.views", {"first": IDENTITY})),
    "view_in_unknown_frame": (
        "labels.json",
        "labels[0].views",
        put("labels.0.views", {"9": IDENTITY}),
    ),
    "view_mirrored": ("labels.json", "labels[0].views", put("labels.0.views", {"1": MIRROR})),
}


@pytest.mark.parametrize("case", CASES)
def test_a_wrong_field_is_named_with_its_file(root: Path, refuse: Any, case: str) -> None:
    name, field, damage = CASES[case]
    path = root / name
    path.write_text(json.dumps(damage(json.loads(path.read_text()))))
    line = refuse("info", root, names=name)
    assert field in line
    refuse("propagate", root, names=name)


RAW = {
    "empty": lambda _: b"",
    "truncated": lambda data: data[: len(data) // 2],
    "last_byte_lost": lambda data: data.rstrip()[:-1],
    "trailing_text": lambda data: data + b"x",
    "not_a_number": lambda _: b"NaN",
    "png": lambda data: b"\x89PNG\r\n\x1a\n" + data,
    "utf16": lambda data: data.decode().encode("utf-16"),
    "bad_utf8": lambda data: data.replace(b'"', b'"\xff', 1),
    "deep": lambda _: b"[" * 200_000,
    "wrong_top": lambda _: b"[]",
    "null": lambda _: b"null",
    "key_twice": lambda data: data.replace(b"{", b'{"a": 1, "a": 2, ', 1),
}


@pytest.mark.parametrize("document", DOCUMENTS)
@pytest.mark.parametrize("damage", RAW)
def test_a_damaged_document_is_named(root: Path, refuse: Any, document: str, damage: str) -> None:
    path = root / document
    path.write_bytes(RAW[damage](path.read_bytes()))
    refuse("info", root, names=document)


@pytest.mark.parametrize("literal", ["NaN", "Infinity", "-Infinity", "1e999", '"0"', "true"])
@pytest.mark.parametrize("document", ["poses.json", "labels.json"])
def test_a_pose_that_is_not_finite_is_refused(
    root: Path, refuse: Any, document: str, literal: str
) -> None:
    """Python's own JSON reader takes NaN and Infinity for numbers."""
    path = root / document
    data = json.loads(path.read_text())
    (data["frames"][1]["T_world_cam"] if "frames" in data else data["labels"][0]["T_cam_obj"])[
        3
    ] = 123456.5
    path.write_text(json.dumps(data).replace("123456.5", literal))
    refuse("info", root, names=document)


@pytest.mark.parametrize("document", ["scene.json", "frames.json"])
def test_a_scene_without_its_documents_is_no_scene(root: Path, refuse: Any, document: str) -> None:
    (root / document).unlink()
    refuse("info", root, names=document)
    refuse("propagate", root, names=document)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
    ),
    max_leaves=6,
)


def places(document: Any, prefix: str = "") -> list[str]:
    """All places in a document, for `put`."""
    pairs: list = []
    if isinstance(document, dict):
        pairs = [(k, v) for k, v in document.items() if "." not in k and not k.isdigit()]
    elif isinstance(document, list):
        pairs = list(enumerate(document))
    found = []
    for key, value in pairs:
        found += [f"{prefix}{key}", *places(value, f"{prefix}{key}.")]
    return found


@pytest.mark.slow
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data(), document=st.sampled_from(DOCUMENTS), value=json_values)
def test_any_value_anywhere_is_read_or_refused_in_one_line(
    root: Path, run: Any, data: st.DataObject, document: str, value: Any
) -> None:
    path = root / document
    original = path.read_bytes()
    try:
        parsed = json.loads(original)
        place = data.draw(st.sampled_from(places(parsed)))
        path.write_text(json.dumps(put(place, value)(parsed)))
        before = contents(root)
        outcome = run("info", root)
        assert contents(root) == before
        assert len(outcome.error_lines) == (outcome.status != 0), outcome.err
        assert "a defect of" not in outcome.err
        assert "Traceback" not in outcome.err
        if outcome.status:
            assert str(root) in outcome.err
    finally:
        path.write_bytes(original)


@pytest.mark.slow
@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(document=st.sampled_from(DOCUMENTS), where=st.floats(0, 1), junk=st.binary(max_size=6))
def test_any_bytes_anywhere_are_read_or_refused_in_one_line(
    root: Path, run: Any, document: str, where: float, junk: bytes
) -> None:
    path = root / document
    original = path.read_bytes()
    try:
        cut = int(len(original) * where)
        path.write_bytes(original[:cut] + junk + original[cut + len(junk) :])
        outcome = run("info", root)
        assert len(outcome.error_lines) == (outcome.status != 0), outcome.err
        assert "a defect of" not in outcome.err
    finally:
        path.write_bytes(original)
