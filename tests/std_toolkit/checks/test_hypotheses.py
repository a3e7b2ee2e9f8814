"""The verdict on a pose from the motions that contour and texture see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from std_toolkit.checks.gates.hypotheses import JudgeSettings, Weighed, weigh
from std_toolkit.checks.result import ObjectCheck, Value
from std_toolkit.options import CheckOptions
from std_toolkit.settings import override

OPTIONS = CheckOptions()  # 4 mm, 2.5 deg


def seen(
    contour: Sequence[float] | None = None,
    texture: Sequence[float] | None = None,
    *,
    aligned: Sequence[float] | None = None,
    standing: Sequence[float] | None = None,
    surface: Sequence[float] | None = None,
    mm: float = 0.5,
    deg: float = 0.3,
    upright_deg: float | None = None,
    size_m: float = 0.25,
    material: str = "diffuse",
    supports: tuple[float, float] | None = None,
) -> Weighed:
    """The verdict on an object that contour and texture see at these motions, mm and degrees."""
    values = [Value(key="size_m", value=size_m, source="label")]
    turns = [deg**2] * 2 + [(upright_deg or deg) ** 2]
    covariance = np.diag([mm**2] * 3 + turns).ravel().tolist()
    if contour is not None:
        values.append(
            Value(key="motion_mm", source="contour", motion=list(contour), covariance=covariance)
        )
        values.append(Value(key="confirmed", value=1.0, source="contour", text="yes"))
    for key, part in zip(("support", "label_support"), supports or (), strict=False):
        values.append(Value(key=key, source="contour", value=part, std=0.09))  # type: ignore[arg-type]
    if texture is not None:
        values.append(
            Value(key="texture_mm", source="texture", motion=list(texture), covariance=covariance)
        )
    for key, source, motion in (
        ("aligned_mm", "depth", aligned),
        ("surface_mm", "depth", surface),
        ("standing_mm", "support", standing),
    ):
        if motion is not None:
            values.append(
                Value(key=key, source=source, motion=list(motion), covariance=covariance)  # type: ignore[arg-type]
            )
    found = weigh(
        ObjectCheck(
            object=1,
            name="box",
            model="box",
            category="box",
            material=material,  # type: ignore[arg-type]
            label="refined",
            values=values,
        ),
        OPTIONS,
    )
    assert found is not None
    return found


def aside(mm: float, deg: float = 0.0) -> list[float]:
    return [mm, 0.0, 0.0, 0.0, 0.0, deg]


@pytest.mark.parametrize("off", [aside(5, 3), aside(9)])
def test_edges_that_fit_as_well_at_the_label_accuse_no_steel(off: list[float]) -> None:
    found = seen(off, material="specular", supports=(0.31, 0.25))
    assert (found.verdict, found.cause) == ("unknown", "misled")
    assert seen(off, material="specular", supports=(0.31, 0.1)).verdict in ("doubtful", "wrong")
    # The contour of an opaque object has no reflections.
    assert seen(off, supports=(0.31, 0.25)).verdict == "wrong"


def test_a_label_that_both_see_in_place_fits() -> None:
    found = seen(aside(0.3), aside(-0.2))
    assert (found.verdict, found.cause) == ("fits", "")
    assert found.probability > 0.999


@pytest.mark.parametrize("off", [aside(8), aside(0, 5), aside(-12, 3)])
def test_a_fault_that_both_see_is_no_other_shape(off: list[float]) -> None:
    found = seen(off, off)
    assert (found.verdict, found.cause) == ("wrong", "label")
    np.testing.assert_allclose(found.located.motion, off, atol=0.05)


@pytest.mark.parametrize("contour", [aside(6), aside(5, 2), aside(-8, 1)])
def test_a_texture_in_place_tells_another_shape(contour: list[float]) -> None:
    found = seen(contour, aside(0.2))
    assert (found.verdict, found.cause) == ("fits", "shape")
    assert "another shape" in found.reason


def test_a_contour_in_place_tells_another_edition() -> None:
    found = seen(aside(0.2), aside(7, 2.7))
    assert (found.verdict, found.cause) == ("fits", "texture")


def test_sources_that_see_different_faults_excuse_nothing() -> None:
    assert seen(aside(10), [0, 10, 0, 0, 0, 0]).verdict in ("doubtful", "wrong")


@pytest.mark.parametrize("mm", [4.0, 4.5, 5.0])
def test_a_motion_near_the_limit_is_doubtful(mm: float) -> None:
    assert seen(None, aside(mm), mm=1.0).verdict == "doubtful"


def test_evidence_that_could_not_see_a_fault_leaves_it_unknown() -> None:
    found = seen(aside(0), mm=3.0)
    assert (found.verdict, found.cause) == ("unknown", "blind")
    assert seen(aside(0), deg=2.0).verdict == "unknown"


@pytest.mark.parametrize("turn", [1.0, 1.4, 1.9])
def test_evidence_that_is_not_blind_rarely_mistakes_a_fault_of_twice_the_limit(turn: float) -> None:
    """Along the weakest direction, a handle's: simulated measurements of both."""
    spread = [0.4, 0.4, 0.4, 0.4, 0.4, turn]
    noise = np.random.default_rng(0).normal(size=(40, 6)) * spread

    def verdicts(deg: float) -> list[str]:
        places = [(error + aside(0, deg)).tolist() for error in noise]
        return [seen(at, mm=0.4, deg=0.4, upright_deg=turn).verdict for at in places]

    fault, right = verdicts(2 * OPTIONS.max_motion_deg), verdicts(0)
    assert fault.count("fits") <= 0.25 * len(noise)
    if turn < 1.5:
        assert right.count("fits") >= 0.8 * len(noise)
    else:  # blind
        assert "fits" not in fault + right


@pytest.mark.parametrize("material", ["specular", "transparent"])
def test_a_contour_that_reflections_may_mislead_refuses_no_likely_label(material: str) -> None:
    off = aside(1, 2.4)
    found = seen(off, mm=0.9, deg=1.1, material=material)
    assert (found.verdict, found.cause) == ("unknown", "misled")
    assert "reflections may mislead it" in found.reason
    assert seen(off, mm=0.9, deg=1.1).verdict == "doubtful"
    assert seen(aside(12), mm=0.9, deg=1.1, material=material).verdict == "wrong"
    # A texture is not misled.
    assert seen(None, off, mm=0.9, deg=1.1, material=material).verdict == "doubtful"


def test_blind_evidence_can_still_refuse() -> None:
    assert seen(aside(18), mm=3.0).verdict == "wrong"


def test_without_a_prior_the_probability_is_that_of_a_normal_distribution() -> None:
    # One direction: the others are known.
    from scipy.stats import norm

    covariance = np.diag([1.5**2, 0, 0, 0, 0, 0]).ravel().tolist()
    item = ObjectCheck(
        object=1,
        name="box",
        model="box",
        category="box",
        material="diffuse",
        label="refined",
        values=[Value(key="texture_mm", source="texture", motion=aside(3), covariance=covariance)],
    )
    flat = JudgeSettings(right_mm=100, right_deg=100, off_mm=100, off_deg=100)
    with override(flat):
        found = weigh(item, OPTIONS)
    assert found is not None
    exact = norm.cdf((4 - 3) / 1.5) - norm.cdf((-4 - 3) / 1.5)
    assert found.probability == pytest.approx(exact, abs=0.02)


def test_rounded_covariances_of_symmetric_objects_are_taken() -> None:
    axis = np.array([0.0, 0.0, 0.0, 0.3, 0.5, 0.81])
    axis /= np.linalg.norm(axis)
    kept = np.eye(6) - np.outer(axis, axis)
    rough = kept @ np.diag([0.5, 0.4, 0.9, 30.0, 40.0, 35.0]) @ kept - 2e-5 * np.outer(axis, axis)
    covariance = [float(f"{x:.6g}") for x in rough.ravel()]
    value = Value(key="motion_mm", source="contour", motion=[0.0] * 6, covariance=covariance)
    confirmed = Value(key="confirmed", value=1.0, source="contour", text="yes")
    item = ObjectCheck(
        object=1,
        name="can",
        model="can",
        category="can",
        material="specular",
        label="refined",
        values=[value, confirmed],
    )
    found = weigh(item, OPTIONS)
    assert found is not None and 0 <= found.probability <= 1


def test_the_verdict_only_gets_worse_with_the_motion() -> None:
    order = ["fits", "doubtful", "wrong"]
    grades = [order.index(seen(aside(x), aside(x)).verdict) for x in np.arange(0, 9, 0.5)]
    assert grades == sorted(grades) and set(grades) == {0, 1, 2}


def test_the_limits_are_settings() -> None:
    with override(JudgeSettings(fits=0.4, wrong=0.01)):
        assert seen(None, aside(3.9), mm=0.5).verdict == "fits"


def test_a_lone_frame_counts_where_nothing_else_does() -> None:
    found = seen(aligned=aside(9))
    assert (found.verdict, found.cause) == ("wrong", "label")
    assert "its alignment puts it 9.0 mm" in found.reason
    np.testing.assert_allclose(found.located.motion, aside(9))
    # Several frames say more than one of them, and labels of one frame agree on a plane by chance.
    assert seen(aside(0.2), aligned=aside(9)).verdict == "fits"
    assert seen(None, aside(0.2), aligned=aside(9)).verdict == "fits"
    alone = seen(aligned=aside(0.2), standing=aside(9))
    assert alone.verdict == "fits"
    np.testing.assert_allclose(alone.located.motion, aside(0.2))


def test_a_lone_frame_that_leaves_the_distance_open_is_unknown() -> None:
    assert seen(aligned=aside(1.0), mm=10.0).verdict == "unknown"
    assert seen(aligned=aside(60.0), mm=10.0).verdict in ("doubtful", "wrong")


def test_depth_turns_a_doubt_of_the_contour_into_an_answer() -> None:
    turned = aside(0.2, 2.6)
    assert seen(turned).verdict == "doubtful"
    assert seen(turned, surface=aside(0.1, 1.6)).verdict == "fits"
    assert seen(turned, surface=aside(0.1, 3.8)).verdict == "wrong"


def test_depth_that_lies_elsewhere_accuses_no_label() -> None:
    found = seen(aside(0.2), aside(0.3), surface=aside(9))
    assert found.verdict == "fits"
    assert "texture and depth disagree by 8.7 mm" in found.reason
    assert found.reason.endswith("its sensor depth errs")


def test_an_object_of_another_shape_is_so_for_depth_as_well() -> None:
    found = seen(aside(6), aside(0.2), surface=aside(1.5))
    assert (found.verdict, found.cause) == ("fits", "shape")


def test_depth_on_an_object_that_is_not_seen_is_no_evidence() -> None:
    value = Value(
        key="surface_mm", source="depth", motion=aside(0), covariance=np.eye(6).ravel().tolist()
    )
    item = ObjectCheck(
        object=1, name="box", model="box", category="box", material="diffuse", label="refined",
        values=[value],
    )  # fmt: skip
    assert weigh(item, OPTIONS) is None
