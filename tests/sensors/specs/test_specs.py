"""Sensors as data: what is built in, scaling of intrinsics, and files of one's own."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from sensors.simulation.equipment import Equipment
from sensors.simulation.options import SimulationOptions
from sensors.specs import load_sensor, names
from sensors.specs.sensor import FOLDER, SCHEMA, SensorSpec, figures, schema_bytes
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera


def without_source(spec: SensorSpec) -> list[str]:
    """Fields whose figures nobody vouches for."""
    leaves = [f for f in figures(spec) if f not in ("depth", "projector", "time_of_flight")]
    return [f for f in leaves if f not in spec.sources and f.split(".")[0] not in spec.sources]


def test_built_in_sensors() -> None:
    assert names() == ["azure_kinect", "d415", "d435", "d455"]
    assert load_sensor("D415").title == "Intel RealSense D415"


@pytest.mark.parametrize("name", names())
def test_every_figure_has_a_source(name: str) -> None:
    spec = load_sensor(name)
    assert without_source(spec) == []
    assert all(len(source.text) > 10 for source in spec.sources.values())


@pytest.mark.parametrize("name", [n for n in names() if load_sensor(n).depth_model == "stereo"])
def test_figures_fit_each_other(name: str) -> None:
    spec = load_sensor(name)
    camera = spec.infrared_camera(640, 360)
    across = np.rad2deg(2 * np.arctan(320 / camera.fx))
    # Part of the picture has no partner in the other one, hence no depth: the field of depth,
    # told for two metres, is narrower.
    assert 0 < across - spec.depth.field_of_view_deg[0] < 8
    assert spec.depth.disparities is not None
    near = camera.fx * spec.baseline_m / spec.depth.disparities
    assert spec.depth.range_m[0] == pytest.approx(near, abs=0.17)
    # The infrared cameras and the projector stand on one line, the colour camera near to it.
    assert spec.projector is not None
    assert 0 < spec.projector.position_m[0] < spec.baseline_m
    pose = spec.pose_of_color
    assert abs(pose.t[1]) < 0.002 and abs(pose.t[2]) < 0.002
    assert np.rad2deg(np.arccos((np.trace(pose.R) - 1) / 2)) < 1


def test_a_listed_size_is_taken_as_the_firmware_gives_it() -> None:
    spec = load_sensor("d415")
    camera = spec.infrared_camera(640, 480)
    # A crop of the sensor: the focal length is that of 848x480, not half of 1280x720's.
    assert camera.fx == spec.infrared_camera(848, 480).fx
    assert camera.cx == pytest.approx(spec.infrared_camera(848, 480).cx - 104)


def test_other_sizes_are_scaled_about_the_edges() -> None:
    spec = load_sensor("d435")
    full, half = spec.infrared_camera(1280, 720), spec.infrared_camera(640, 360)
    assert half.fx == full.fx / 2
    # The right edge of the picture: 1279.5 there, 639.5 here.
    for u in (-0.5, 300.0, 1279.5):
        ray = full.unproject(np.array([u, 100.0]))
        assert half.project(ray)[0] == pytest.approx((u + 0.5) / 2 - 0.5, abs=1e-9)
    third = spec.color_camera(426, 240)
    assert isinstance(third, Camera) and third.size == (426, 240)
    assert third.fx == pytest.approx(spec.color_camera(1280, 720).fx * 426 / 1280)


def test_a_size_of_another_shape_is_refused() -> None:
    with pytest.raises(ToolkitError, match=r"d435: infrared.*no image of this shape.*1280x720"):
        load_sensor("d435").infrared_camera(640, 480)


def test_disparity_range_covers_the_depth_range() -> None:
    spec = load_sensor("d415")
    low, high = spec.disparity_range(640, 360)
    fb = 443.914642333984 * 0.0547803528606892
    assert low < fb / 10.0 < low + 2
    # 126 disparities begin at 0.19 m: nearer than that this camera is blind at this size.
    assert high - low == 125
    assert load_sensor("d415").disparity_range(424, 240)[1] == pytest.approx(
        295.943 * 0.05478 / 0.16 + 1, abs=1
    )


def test_unknown_sensor() -> None:
    with pytest.raises(
        ToolkitError, match=r"sensor: no such sensor \(got 'd999'\); known: azure_kinect, d415"
    ):
        load_sensor("d999")
    with pytest.raises(ToolkitError, match=r"nowhere/own\.json.*No such file"):
        load_sensor("nowhere/own.json")


def own(tmp_path: Path, **changes: object) -> Path:
    """The D435's file with some fields changed; `depth__unit_m` is a field of a field."""
    document = json.loads((FOLDER / "d435.json").read_text())
    for key, value in changes.items():
        at = document
        *above, last = key.split("__")
        for part in above:
            at = at[part]
        at[last] = value
    path = tmp_path / "own.json"
    path.write_text(json.dumps(document))
    return path


def test_own_file(tmp_path: Path) -> None:
    spec = load_sensor(own(tmp_path, name="mine", baseline_m=0.07, projector=None, sources={}))
    assert (spec.name, spec.baseline_m, spec.projector) == ("mine", 0.07, None)
    assert "baseline_m" in without_source(spec)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"baseline_m": 50.0}, "baseline_m: .*< 1"),
        ({"baseline": 0.05}, "unknown field `baseline`"),
        ({"depth__range_m": [10, 0.1]}, "depth.range_m: near must be less than far"),
        ({"depth__range_m": [0.1, 1e308]}, r"depth.range_m\[1\]: .*<= 1000"),
        ({"depth__unit_m": 5e-324}, "depth.unit_m: .*>= 1e-06|depth.unit_m: .*0.000001"),
        ({"depth__noise_px": "low"}, "depth.noise_px: Expected `float`"),
        ({"projector__style": "stripes"}, "projector.style: Invalid enum value 'stripes'"),
        ({"T_ir_color": [1.0] * 16}, "T_ir_color"),
        ({"infrared": []}, "infrared: Expected `array` of length >= 1"),
        ({"baseline_m": 0.0}, "baseline_m: a stereo camera needs it"),
        ({"depth__disparities": None}, "depth.disparities: a stereo camera needs it"),
        ({"sources": {"depth.noise": {"text": "a figure"}}}, "sources: a source for a field"),
        (
            {"infrared": [{"width": 640, "height": 360, "fx": 640.0, "fy": 640.0, "cx": 640.0,
                           "cy": 360.0}]},
            r"infrared\[0\].cx: is far from the centre of a 640x360 image",
        ),
        (
            {"infrared": [{"width": 640, "height": 360, "fx": 400.0, "fy": 400.0, "cx": 320.0,
                           "cy": 180.0, "distortion": [0.1, 0, 0, 0]}]},
            "infrared: infrared images are rectified",
        ),
    ],
    ids=str,
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_field(
    tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    path = own(tmp_path, **changes)
    with pytest.raises(ToolkitError, match=message) as caught:
        load_sensor(path)
    assert str(path) in str(caught.value)


def test_schema_is_stored_and_holds() -> None:
    stored = SCHEMA.read_bytes()
    assert stored == schema_bytes()
    validator = jsonschema.Draft202012Validator(json.loads(stored))
    for name in names():
        validator.validate(json.loads((FOLDER / f"{name}.json").read_text()))
    assert not validator.is_valid({"name": "x"})


def test_sources_may_name_any_figure() -> None:
    known = figures(load_sensor("d415"))
    assert {"infrared", "T_ir_color", "depth.noise_px", "projector", "projector.style"} <= set(
        known
    )


@pytest.mark.real
def test_d415_is_the_camera_of_the_real_pair(test_data: Path) -> None:
    text = (test_data / "d415_stereo_pair" / "intrinsics.txt").read_text()
    block = text.split('Intrinsic of "Infrared 1" / 640x360')[1]
    fx = float(block.split("Fx:")[1].split()[0])
    spec = load_sensor("d415")
    assert spec.infrared_camera(640, 360).fx == pytest.approx(fx, abs=1e-9)
    block = text.split('Extrinsic from "Color"\t  To\t  "Infrared 1"')[1]
    t = [float(v) for v in block.split("Translation Vector:")[1].split()[:3]]
    assert spec.pose_of_color.t == pytest.approx(t, abs=1e-9)
    R = np.array([float(v) for v in block.split("Matrix:")[1].split()[:9]]).reshape(3, 3)
    assert abs(spec.pose_of_color.R - R).max() < 1e-5


def test_a_file_runs_no_code_unless_allowed(tmp_path: Path) -> None:
    code = tmp_path / "mine.py"
    code.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    sensor = str(own(tmp_path, depth_model=f"{code}:Mine"))
    with pytest.raises(ToolkitError, match=r"depth_model: .*names code.*--allow-code"):
        Equipment.of(SimulationOptions(sensor=sensor))
    assert not (tmp_path / "ran").exists()
    with pytest.raises(ToolkitError, match="cannot import plug-in"):
        Equipment.of(SimulationOptions(sensor=sensor, allow_code=True))
    assert (tmp_path / "ran").exists()
