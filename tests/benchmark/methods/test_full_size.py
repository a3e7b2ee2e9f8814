"""Restored depth at the sensor's size: details where it is trusted, nothing between surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.data.frame import resize_nearest
from benchmark.methods.depth.full_size import at_full_size, to_full_size
from benchmark.methods.protocol import Restored

FULL, OWN = (640, 360), (224, 126)
NOTHING = np.zeros(FULL[::-1], np.float32)


def plane() -> np.ndarray:
    v, u = np.mgrid[: FULL[1], : FULL[0]].astype(np.float32)
    return (0.5 + 2e-4 * u + 3e-4 * v).astype(np.float32)


def step() -> np.ndarray:
    depth = np.full(FULL[::-1], 0.6, np.float32)
    depth[100:250, 201:403] = 0.5
    return depth


def restored(depth: np.ndarray, confidence: float | None = None) -> Restored:
    own = resize_nearest(depth, OWN)
    trust = None if confidence is None else np.full(own.shape, confidence, np.float32)
    return Restored(own, trust)


def test_a_tilted_plane_is_enlarged_to_itself():
    """But for the last pixels, beyond the last one that was taken."""
    found = at_full_size(NOTHING, restored(plane()))
    assert np.abs(found - plane())[:-3, :-3].max() < 2e-5


def test_nothing_floats_between_two_surfaces():
    found = at_full_size(NOTHING, restored(step()))
    assert set(np.unique(found)) == set(np.unique(step()))
    assert (found != step()).mean() < 0.005


@pytest.mark.parametrize("confidence", [0.9, None])
def test_a_trusted_sensor_keeps_its_pixels_and_edges(confidence):
    noise = np.random.default_rng(0).normal(0, 5e-4, step().shape).astype(np.float32)
    sensor = step() + noise
    assert np.array_equal(at_full_size(sensor, restored(step(), confidence)), sensor)


def test_a_doubted_sensor_is_not_heard():
    sensor = step() + np.float32(0.004)
    found = at_full_size(sensor, restored(step(), 0.1))
    assert set(np.unique(found)) == set(np.unique(step()))


def test_a_pixel_far_from_all_that_was_restored_around_it_is_not_believed():
    sensor = step()
    sensor[30, 31] = 0.9
    assert at_full_size(sensor, restored(step(), 1.0))[30, 31] == np.float32(0.6)


def test_a_method_without_confidence_keeps_a_sensor_that_is_within_3_cm_of_it():
    sensor = plane() + np.float32(0.025)
    assert np.array_equal(at_full_size(sensor, restored(plane())), sensor)
    assert not np.array_equal(at_full_size(sensor, restored(plane(), 0.9)), sensor)
    farther = sensor + np.float32(0.01)
    assert not np.array_equal(at_full_size(farther, restored(plane())), farther)


def test_where_there_is_no_answer_there_is_no_depth():
    answer = restored(step(), 0.0)
    answer.depth[:50] = np.nan
    answer.depth[50:70] = -1
    answer.depth[70:80] = np.inf
    found = at_full_size(step(), answer)
    assert (found[: 80 * 360 // 126 - 2] == 0).all()
    assert (found[80 * 360 // 126 + 3 :] > 0).all()


def test_what_is_restored_at_full_size_stays_as_it_is():
    answer = Restored(plane(), np.ones(FULL[::-1], np.float32))
    assert np.array_equal(at_full_size(plane() + np.float32(0.002), answer), plane())


def test_beside_a_pixel_without_an_answer_the_sensor_must_be_near_the_others():
    answer = restored(step(), 1.0)
    answer.depth[60, 60] = 0
    sensor = step()
    v, u = 60 * 360 // 126 + 4, 60 * 640 // 224 + 4  # of the pixel below, to the right
    sensor[v, u] = 0.3
    assert at_full_size(sensor, answer)[v, u] == step()[v, u]


def test_colour_leads_an_edge_to_where_it_is():
    """Without it, edges lie at the pixels that the answer has."""
    color = np.where(step()[..., None] < 0.55, np.uint8(180), np.uint8(60)).repeat(3, 2)
    plain, guided = (
        to_full_size(NOTHING, restored(step()), image).depth for image in (None, color)
    )
    assert (plain != step()).sum() > 200
    assert np.array_equal(guided, step())


def test_colour_does_not_change_what_is_smooth_or_unknown():
    noise = np.random.default_rng(0).integers(0, 256, (*plane().shape, 3), np.uint8)
    answer = restored(plane())
    answer.depth[:40] = 0
    plain, guided = (to_full_size(NOTHING, answer, image).depth for image in (None, noise))
    assert np.array_equal(plain == 0, guided == 0)
    assert np.array_equal(plain[130:], guided[130:])


def test_a_trusted_sensor_is_kept_at_the_size_of_the_answer_too():
    sensor = plane() + np.float32(0.002)
    sensor[40, 50] = 0.9
    found = to_full_size(sensor, Restored(plane(), np.ones(sensor.shape, np.float32)))
    assert found.believed.sum() == sensor.size - 1 and found.depth[40, 50] == plane()[40, 50]
    assert np.array_equal(found.depth[found.believed], sensor[found.believed])
