"""What is told of a table that was corrected: nothing that the digits do not show."""

from __future__ import annotations

import numpy as np
import pytest

from std_toolkit.labels.support.evidence import correction_by_points
from std_toolkit.labels.support.plane import WORLD, Plane

HEIGHT_M = 0.6


def note(shift_m: float) -> str:
    """Of a table that the sensor sees so much below the points of a reconstruction."""
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(-0.3, 0.3, (400, 2)), np.zeros((400, 1))], axis=1)
    points[:, 2] = shift_m + rng.normal(0, 2e-5, 400)
    plane = Plane(np.array([0.0, 0.0, 1.0]), 0.0, WORLD)
    found = correction_by_points(plane, points, HEIGHT_M, np.zeros(3), 0.4)
    assert found is not None
    assert found.shift_m == pytest.approx(shift_m, abs=1e-5)
    return found.note


@pytest.mark.parametrize("shift_m", [0.0, 3e-5, -3e-5])
def test_no_correction_to_speak_of_is_a_confirmation(shift_m: float) -> None:
    assert note(shift_m) == "confirmed by the points of the reconstruction"


def test_a_small_one_does_not_blame_the_sensor() -> None:
    assert note(0.0002) == (
        "moved by +0.2 mm onto the points of the reconstruction: the sensor is accurate to 0.1 %"
    )


@pytest.mark.parametrize(("shift_m", "told"), [(0.01, "1.7 % too far"), (-0.01, "1.6 % too near")])
def test_a_large_one_tells_how_wrong_the_sensor_is(shift_m: float, told: str) -> None:
    assert note(shift_m) == (
        f"moved by {1000 * shift_m:+.1f} mm onto the points of the reconstruction: the sensor "
        f"reads {told}"
    )
