"""Objects that float above, sink into or tilt on the plane of the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh

from std_toolkit.checks.gates.hypotheses import weigh
from std_toolkit.checks.measure.standing import Standing
from std_toolkit.checks.result import ObjectCheck, Value
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.labels.support.solid import PlacedObject
from std_toolkit.options import CheckOptions

UP = np.array([0.0, 0.0, 1.0])
HIGH_M = 0.08


# From the front, 35 degrees above the table.
_BACK = np.array([0.0, -np.cos(0.6), np.sin(0.6)])
CAMERAS = [
    SE3(np.stack([[1.0, 0, 0], np.cross([-1.0, 0, 0], _BACK) * -1, -_BACK], axis=1), 0.8 * _BACK)
]


def box(x: float, up_m: float = 0.0, turn: Sequence[float] = (0, 0, 0)) -> PlacedObject:
    """60 x 40 x 80 mm on the table z = 0."""
    mesh = trimesh.creation.box([0.06, 0.04, HIGH_M])
    T = SE3(so3_exp(np.asarray(turn, float)), np.array([x, 0.1, HIGH_M / 2 + up_m]))
    return PlacedObject("box", mesh, T)


OTHERS = [box(x) for x in (-0.2, 0.0, 0.3)]
ALL = np.zeros((0, 6))


def seen(
    own: PlacedObject, others: Sequence[PlacedObject] = OTHERS, up: np.ndarray = UP
) -> Value | None:
    planes = Standing(dict(enumerate([own, *others])), CAMERAS, up)
    return planes.value(0, own.T_frame_obj.t, ALL)


@pytest.mark.parametrize("up_mm", [-6.0, 0.0, 5.0])
def test_an_object_is_put_on_the_plane_of_the_others(up_mm: float) -> None:
    found = seen(box(0.15, up_mm / 1000))
    assert found is not None and found.motion is not None and found.covariance is not None
    assert found.motion[2] == pytest.approx(-up_mm, abs=0.15)
    assert found.motion[:2] == pytest.approx([0, 0], abs=0.01)
    sigma = np.sqrt(np.diag(np.reshape(found.covariance, (6, 6))))
    # Height and tilt are known, and neither where it stands nor how it is turned.
    assert sigma[2] < 1.0 and sigma[3] < 1.5 and sigma[4] < 1.5
    assert min(sigma[0], sigma[1]) > 20 and sigma[5] > 10


def test_a_tilt_is_undone() -> None:
    found = seen(box(0.15, turn=np.deg2rad([0, 4, 0])))
    assert found is not None and found.motion is not None
    assert found.motion[3:] == pytest.approx([0, -4, 0], abs=0.5)


def test_one_other_object_is_no_plane() -> None:
    assert seen(box(0.15, 0.005), OTHERS[:1]) is None


def test_others_that_contradict_each_other_say_little() -> None:
    """A curved thing lies on no face: the level that its mesh tells is 5 degrees off."""
    askew = [box(-0.02), box(0.05, turn=np.deg2rad([0, 5, 0]))]
    found = seen(box(0.25), askew)
    assert found is not None and found.motion is not None and found.covariance is not None
    sigma = np.sqrt(np.diag(np.reshape(found.covariance, (6, 6))))
    assert abs(found.motion[2]) < 2 * sigma[2] and abs(found.motion[4]) < 2 * sigma[4]
    assert sigma[2] > 2 and sigma[4] > 1


def test_one_of_many_that_stands_askew_hardly_counts() -> None:
    found = seen(box(0.4), [*OTHERS, box(0.05, turn=np.deg2rad([0, 5, 0]))])
    assert found is not None and found.motion is not None
    assert abs(found.motion[2]) < 1.0 and abs(found.motion[4]) < 0.5


def test_a_plane_is_known_less_far_away() -> None:
    sigma = []
    for x in (0.05, 0.6):
        found = seen(box(x))
        assert found is not None and found.covariance is not None
        sigma.append(np.sqrt(found.covariance[2 * 6 + 2]))
    assert sigma[1] > 1.5 * sigma[0]


def test_objects_at_other_heights_are_left_out() -> None:
    shelf = [*OTHERS, box(0.4, 0.1)]
    found = seen(box(0.15, 0.003), shelf)
    assert found is not None and found.motion is not None
    assert found.motion[2] == pytest.approx(-3, abs=0.15)
    assert "3 other objects" in found.text
    # An object on top of another one stands on no plane of the others.
    assert seen(box(0.15, 0.08)) is None


def test_an_object_that_hangs_askew_says_nothing() -> None:
    assert seen(box(0.15, turn=np.deg2rad([25, 10, 0]))) is None


def item(
    contour: Sequence[float],
    standing_value: Value | None,
    mm: float,
    material: str = "transparent",
    deg: float = 0.4,
) -> ObjectCheck:
    covariance = np.diag([0.5**2, 0.5**2, mm**2, deg**2, deg**2, deg**2]).ravel().tolist()
    values = [
        Value(key="size_m", value=0.1, source="label"),
        Value(key="motion_mm", source="contour", motion=list(contour), covariance=covariance),
        Value(key="confirmed", value=1.0, source="contour", text="yes"),
    ]
    return ObjectCheck(
        object=1,
        name="glass",
        model="glass",
        category="glass",
        material=material,
        label="refined",
        values=values + ([standing_value] if standing_value else []),
    )


def test_standing_tells_a_height_that_a_contour_does_not() -> None:
    unseen = weigh(item([0, 0, 1.0, 0, 0, 0], None, 4.0), CheckOptions())
    assert unseen is not None and (unseen.verdict, unseen.cause) == ("unknown", "blind")
    told = weigh(item([0, 0, 1.0, 0, 0, 0], seen(box(0.15)), 4.0), CheckOptions())
    assert told is not None and told.verdict == "fits"
    assert "contour and support confirm it" in told.reason
    wrong = weigh(item([0, 0, -9.0, 0, 0, 0], seen(box(0.15, 0.009)), 4.0), CheckOptions())
    assert wrong is not None and wrong.verdict == "wrong"


def test_a_contour_that_contradicts_the_plane_is_told() -> None:
    # Its contour fits the label, which floats 9 mm above the plane of the others.
    floats = seen(box(0.15, 0.009))
    found = weigh(item([0] * 6, floats, 0.4, "diffuse"), CheckOptions())
    assert found is not None and found.verdict == "fits"
    assert "contour and support disagree by 9" in found.reason
    assert "it does not stand on the plane of the others" in found.reason
    # Reflections inside of steel and glass may look like an outline: nothing is known.
    for material in ("specular", "transparent"):
        found = weigh(item([0] * 6, floats, 0.4, material), CheckOptions())
        assert found is not None and (found.verdict, found.cause) == ("unknown", "misled")
        assert "contour and support disagree by 9" in found.reason


@pytest.mark.parametrize(
    ("contour", "support", "told"),
    [
        (6.5, -2.5, ("unknown", "contradicted")),  # likely right, and nobody knows
        (6.5, -1.0, ("doubtful", "label")),  # no contradiction
        (8.0, -2.0, ("doubtful", "label")),  # likely wrong
        (9.0, -1.0, ("wrong", "label")),
    ],
)
def test_sources_that_contradict_each_other_accuse_no_label_that_is_likely_right(
    contour: float, support: float, told: tuple[str, str]
) -> None:
    """Tilts in degrees, by a contour of 1.3 deg and a plane of 2 deg."""
    plane = Value(
        key="standing_mm",
        value=0.0,
        source="support",
        text="on the plane of 5 other objects",
        motion=[0, 0, 0, support, 0, 0],
        covariance=np.diag([1e4, 1e4, 0.36, 4.0, 4.0, 1e4]).ravel().tolist(),
    )
    seen_at = item([0.3, 0, 0.2, contour, 0, 0], plane, 0.5, "diffuse", deg=1.3)
    found = weigh(seen_at, CheckOptions())
    assert found is not None and (found.verdict, found.cause) == told
    assert ("nothing explains it" in found.reason) == (contour - support >= 9)


def test_the_cameras_tell_up_roughly() -> None:
    # Without points of the table, up is that of the images: 35 deg off.
    held = CAMERAS[0].R @ [0.0, -1.0, 0.0]
    assert np.degrees(np.arccos(held @ UP)) > 30
    found = seen(box(0.15, 0.005), up=held)
    assert found is not None and found.motion is not None
    assert found.motion[2] == pytest.approx(-5, abs=0.15)
    planes = Standing(dict(enumerate(OTHERS)), CAMERAS, held)
    np.testing.assert_allclose(planes.up, UP, atol=1e-9)
    assert Standing({}, CAMERAS, held).up is held
