"""Simulated depth against the bounds that real depth sets, on surfaces of known material."""

from __future__ import annotations

import numpy as np
import pytest

from perf.trial import measurable_pixels, small_holes
from sensors.simulation.set_report import ErrorTally
from sensors.specs import load_sensor
from std_toolkit.geometry.camera import Camera

SPEC = load_sensor("d415")
WHOLE = SPEC.infrared_camera(640, 360)


def part(width: int, height: int) -> Camera:
    """A part of the infrared image, at its full resolution."""
    return Camera(width, height, WHOLE.fx, WHOLE.fy, 0.5 * width, 0.5 * height)


def clear_of(exact: np.ndarray) -> np.ndarray:
    return measurable_pixels(exact, focal_px=WHOLE.fx, baseline_m=SPEC.baseline_m)


def test_clear_pixels_keep_off_the_left_edge_shadows_and_borders() -> None:
    exact = np.full((60, 300), 1.0)
    exact[:, 150:200] = 0.5
    far, near = (WHOLE.fx * SPEC.baseline_m / z for z in (1.0, 0.5))
    found = clear_of(exact)[30]
    # Seen by the right eye, a window from its edge.
    first = int(np.ceil(far + 7))
    assert not found[:first].any() and found[first]
    # The block hides what lies left of it by the difference of the disparities.
    hidden = round(near - far)
    assert not found[150 - hidden : 150].any()
    assert found[150 - hidden - 9] and not found[150 - hidden - 5]
    for edge in (150, 200):
        assert not found[edge - 7 : edge + 7].any()
    assert found[160:190].all() and found[210:].all()
    # A steep slope is no step.
    slope = np.linspace(0.5, 0.8, 300)[None].repeat(60, axis=0)
    assert clear_of(slope)[30, 80:].all()


@pytest.fixture(scope="module")
def renderer():
    pytest.importorskip("mitsuba", reason="the simulator's extra is not installed")
    from sensors.render.mitsuba_renderer import MitsubaRenderer

    return MitsubaRenderer()


@pytest.mark.slow
def test_diffuse_surfaces_at_60_cm_are_measured(renderer) -> None:
    """All 36 materials: 95 % complete, median error 1.2 mm."""
    from perf.trial import render_view, tiles
    from sensors.render.sim_renderer import DRAFT_INFRARED

    camera = part(280, 160)
    board = tiles(camera, 0)
    assert len({m.name for m in board.materials}) == 36
    view = render_view(board, SPEC, camera, renderer, options=DRAFT_INFRARED, seed=0)
    clear = clear_of(view.exact)
    assert clear.mean() > 0.7
    tally = ErrorTally()
    tally.add(view.depth[clear], view.exact[clear])
    row = tally.row()
    assert row["complete %"] >= 95
    assert row["median mm"] <= 1.2
    assert row["off by > 1 cm %"] < 1
    # The image is exposed as a real one, and its dots stand out as much.
    assert view.left.mean() == pytest.approx(54, abs=4)
    deviation = view.left[clear].std() / view.left[clear].mean()
    assert 0.15 < deviation < 0.7


@pytest.mark.slow
def test_glass_and_metal_are_measured_much_less_than_paper(renderer) -> None:
    from perf.trial import render_view, vessels
    from sensors.render.sim_renderer import DRAFT_INFRARED

    camera = part(400, 240)
    rows = {}
    for material_class, name in (
        ("diffuse", "paper_white"),
        ("specular", "chrome"),
        ("transparent", "glass_refractive"),
    ):
        trial = vessels([(material_class, name, c) for c in ("mug", "bottle", "bowl")], 5)
        view = render_view(trial, SPEC, camera, renderer, options=DRAFT_INFRARED, seed=5)
        where = view.mask > 0
        tally = ErrorTally()
        tally.add(view.depth[where], view.exact[where])
        rows[material_class] = tally.row()
    glass, metal, paper = (rows[c] for c in ("transparent", "specular", "diffuse"))
    assert glass["complete %"] < paper["complete %"]
    assert metal["complete %"] < paper["complete %"]
    right = {c: r["complete %"] * (1 - r["off by > 1 cm %"] / 100) for c, r in rows.items()}
    assert max(right["transparent"], right["specular"]) < right["diffuse"] / 2
    # Of three real captures of glass, the sensor is right on 7, 8 and 33 % of the pixels.
    assert right["transparent"] <= 40


def test_small_holes_are_counted_by_size() -> None:
    missing = np.zeros((40, 60), bool)
    missing[2:6, 2:6] = True
    missing[20:30, 20:30] = True
    missing[35, 50] = True
    found = small_holes(missing)
    assert found.sum() == 17 and not found[20:30, 20:30].any()


def check_random_view(renderer, seed: int, index: int = 0) -> None:
    """The bounds of real D4xx cameras: holes, completeness and error of the floor."""
    from perf.trial import TrialScene, render_view
    from sensors.render.sim_renderer import DRAFT_INFRARED
    from sensors.simulation.options import SimulationOptions
    from sensors.simulation.simulated_set import parts_cache
    from sensors.simulation.simulator import Simulator

    world = Simulator(SimulationOptions(views=2), parts_cache=parts_cache()).world(seed, "x")
    eye = world.T_world_cam[index] @ SPEC.pose_of_color.inverse()
    trial = TrialScene(world.scene, eye, ())
    view = render_view(trial, SPEC, WHOLE, renderer, options=DRAFT_INFRARED, seed=seed)
    share = small_holes((view.depth == 0) & (view.exact > 0)).mean()
    assert 0.002 <= share <= 0.01
    floor = clear_of(view.exact) & (view.mask == 0) & (view.exact > 0.5) & (view.exact < 0.9)
    tally = ErrorTally()
    tally.add(view.depth[floor], view.exact[floor])
    assert tally.row()["complete %"] >= 98
    assert tally.row()["median mm"] <= 1


@pytest.mark.slow
def test_a_random_scene_has_the_holes_of_a_real_camera(renderer) -> None:
    pytest.importorskip("pyoidn", reason="the denoiser is not installed")
    check_random_view(renderer, 7)
