"""Time of flight: unwrapping, noise, several paths, several surfaces in a pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sensors.depth_models import DepthModelOptions, Illumination, make_depth_model
from sensors.depth_models.time_of_flight import LIGHT_M_S, unwrap, with_phasor_noise
from sensors.specs import load_sensor
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3

KINECT = load_sensor("azure_kinect")
assert KINECT.time_of_flight is not None
SPEC = KINECT.time_of_flight
WAVES = 2 * np.pi * np.array(SPEC.frequencies_hz) / LIGHT_M_S


def phasors(path_m: np.ndarray, amplitude: float = 1.0) -> np.ndarray:
    """Phasors (3, h, w) of single paths."""
    return (amplitude * np.exp(1j * WAVES[:, None, None] * path_m)).astype(np.complex64)


def test_lengths_are_unwrapped_over_the_range() -> None:
    path = np.linspace(0.8, 9.0, 500).reshape(1, -1)
    found = unwrap(phasors(path), SPEC.frequencies_hz, longest_m=9.3)
    np.testing.assert_allclose(found.path_m, path, atol=1e-4)
    assert found.error_rad.max() < 1e-3


def test_a_wrap_that_was_taken_wrongly_would_be_seen() -> None:
    # One frequency alone repeats after 1.5 m: the longest candidate wins by chance.
    path = np.full((1, 50), 4.0)
    alone = unwrap(phasors(path)[2:], SPEC.frequencies_hz[2:], longest_m=9.3)
    assert np.abs(alone.path_m - path).min() > 1.0


def test_noise_at_the_least_amplitude_is_the_specified_random_error() -> None:
    path = np.full((100, 100), 2 * 3.86)
    noisy = with_phasor_noise(phasors(path, SPEC.least_amplitude), SPEC, np.random.default_rng(0))
    found = unwrap(noisy, SPEC.frequencies_hz, longest_m=9.3)
    close = np.abs(found.path_m - path) < 0.3
    assert close.mean() > 0.98
    assert 0.005 < (found.path_m[close] / 2).std() < 0.017


def test_two_surfaces_in_a_pixel_mix() -> None:
    near, far = phasors(np.full((1, 1), 1.2)), phasors(np.full((1, 1), 1.36))
    found = unwrap(0.5 * near + 0.5 * far, SPEC.frequencies_hz, longest_m=9.3)
    assert 1.22 < found.path_m[0, 0] < 1.34
    # Two equal parts always look like their mean; unequal ones far apart fit no common length.
    far = phasors(np.full((1, 1), 2.0))
    found = unwrap(0.7 * near + 0.5 * far, SPEC.frequencies_hz, longest_m=9.3)
    assert found.error_rad[0, 0] > SPEC.most_phase_error_rad


def test_depth_of_a_plane_is_flat_though_the_lamp_stands_aside() -> None:
    model = make_depth_model(KINECT, DepthModelOptions(width=320, height=180, noise=False))
    rays = model.camera.unproject(model.camera.pixel_grid().reshape(-1, 2))
    points = rays / rays[:, 2:] * 0.9
    path = np.linalg.norm(points, axis=1) + np.linalg.norm(points - SPEC.illuminator_m, axis=1)
    reading = model.read(phasors(path.reshape(model.camera.height, -1)), seed=0)
    assert reading.right is None
    np.testing.assert_allclose(reading.depth, 0.9, atol=1e-4)


def test_dark_and_near_pixels_have_no_depth() -> None:
    model = make_depth_model(KINECT, DepthModelOptions(width=320, height=180, noise=False))
    path = np.full((model.camera.height, model.camera.width), 2.0)
    dark = model.read(phasors(path, 0.5 * SPEC.least_amplitude), seed=0)
    near = model.read(phasors(0.2 * path), seed=0)
    assert not dark.depth.any() and not near.depth.any()


def test_a_stereo_camera_is_no_time_of_flight_camera(tmp_path: Path) -> None:
    text = (Path(load_sensor.__code__.co_filename).parent / "d415.json").read_text()
    own = tmp_path / "own.json"
    own.write_text(text.replace('"name": "d415"', '"name": "x", "depth_model": "time_of_flight"'))
    with pytest.raises(ToolkitError, match=r"own\.json.*time_of_flight: a time-of-flight camera"):
        load_sensor(own)
    own.write_text(text.replace('"name": "d415"', '"name": "x", "depth_model": "sonar"'))
    with pytest.raises(ToolkitError, match="sonar"):
        make_depth_model(load_sensor(own), DepthModelOptions(width=320, height=180))


def test_a_depth_model_of_a_file_is_used(tmp_path: Path) -> None:
    (tmp_path / "flat.py").write_text(
        "import numpy as np\n"
        "from sensors.depth_models import Reading\n"
        "class Flat:\n"
        "    def __init__(self, sensor, options):\n"
        "        self.camera = sensor.depth_camera(options.width, options.height)\n"
        "    def look(self, loaded, T_world_ir, light, *, options, seed):\n"
        "        return None\n"
        "    def read(self, received, *, seed):\n"
        "        shape = (self.camera.height, self.camera.width)\n"
        "        return Reading(np.ones(shape, np.float32), np.zeros(shape, np.uint8))\n"
    )
    text = (Path(load_sensor.__code__.co_filename).parent / "d415.json").read_text()
    own = tmp_path / "own.json"
    own.write_text(
        text.replace('"name": "d415"', f'"name": "x", "depth_model": "{tmp_path}/flat.py:Flat"')
    )
    model = make_depth_model(load_sensor(own), DepthModelOptions(width=424, height=240))
    assert model.read(None, seed=0).depth.shape == (240, 424)


@pytest.mark.slow
def test_a_corner_and_glass_lengthen_the_path() -> None:
    """Rendered: a floor is exact, glass on it reads too far, and noise is about 1 mm at 0.8 m."""
    pytest.importorskip("mitsuba", reason="the simulator's extra is not installed")
    from sensors.render.mitsuba_renderer import MitsubaRenderer
    from sensors.render.sim_renderer import DRAFT_INFRARED
    from sensors.render.sim_scene import TruthCaster
    from sensors.render.smoke import looking_down, smallest_scene
    from sensors.render.variant import choose_variant

    variant = choose_variant()
    if variant.startswith("scalar"):
        pytest.skip("no compiler for Mitsuba here; tools/system-libraries simulator installs it")
    scene, T = smallest_scene(), looking_down(0.8)
    loaded = MitsubaRenderer(variant=variant, check=False).load(scene)
    light = Illumination(ambient=0.2, factor=1.0, pattern_seed=0)
    options = DepthModelOptions(width=320, height=180)
    model = make_depth_model(KINECT, options)
    received = model.look(loaded, T, light, options=DRAFT_INFRARED, seed=0)
    again = model.look(loaded, T, light, options=DRAFT_INFRARED, seed=0)
    np.testing.assert_array_equal(received, again)
    reading = model.read(received, seed=1)
    exact, mask = TruthCaster(scene).depth_and_mask(model.camera, T)
    error = 1000 * np.where(reading.depth > 0, reading.depth - exact, np.nan)
    floor = error[mask == 0]
    assert np.isfinite(floor).mean() > 0.9  # the others are outside the light
    assert 0 < np.nanmedian(floor) < 0.8  # the objects scatter light onto it
    assert 0.4 < np.nanpercentile(np.abs(floor), 68) < 1.5
    wood, glass = np.nanmedian(error[mask == 3]), np.nanmedian(error[mask == 2])
    assert 1 < wood < 20  # light that the floor scatters onto it comes later
    assert glass > 20  # light that passes through
    # The renderer's own noise is below the camera's.
    quiet = make_depth_model(KINECT, DepthModelOptions(width=320, height=180, noise=False))
    one, two = (
        quiet.read(model.look(loaded, T, light, options=DRAFT_INFRARED, seed=s), seed=0).depth
        for s in (0, 1)
    )
    assert 1000 * np.median(np.abs(one - two)[mask == 3]) < 1.5
    # The camera's frame counts, not the world's.
    moved = SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    assert not np.array_equal(
        model.look(loaded, moved @ T, light, options=DRAFT_INFRARED, seed=0), received
    )


def test_its_images_have_their_own_size_unless_one_is_given() -> None:
    """As labels of 640x360 most of the colour image has no depth."""
    from sensors.simulation.options import with_preset

    own = ["--width", "1280", "--height", "720"]
    assert with_preset(["--sensor", "azure_kinect"]) == [*own, "--sensor", "azure_kinect"]
    assert with_preset(["run", "--sensor=azure_kinect"])[:5] == ["run", *own]
    for kept in (
        ["--sensor", "d415"],
        ["--sensor", "no_such_sensor"],
        ["--sensor", "azure_kinect", "--width", "640"],
        ["stats", "set", "--sensor", "azure_kinect"],
    ):
        assert with_preset(kept) == kept
    tiny = with_preset(["--sensor", "azure_kinect", "--preset", "tiny"])
    assert tiny[tiny.index("--width") + 1] == "320"
    assert (KINECT.color_camera(1280, 720).width, KINECT.color_camera(1280, 720).height) == (
        1280,
        720,
    )
