"""Scores of poses against published evaluations, hand-worked rankings, and what must hold."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pose_cases import found, frame_of, oracle, oracle_frames, pose

from benchmark.metrics.pose import (
    BoxIoU,
    PoseClasses,
    PoseGate,
    PosePrediction,
    PoseScoring,
    PoseTruth,
    average_precision,
    get_pose_protocol,
    match_poses,
    pose_protocols,
    score_matches,
    score_poses,
)
from benchmark.metrics.pose.pose_frames import flatten, group
from benchmark.metrics.pose.resampling import side_by_side
from std_toolkit.errors import ToolkitError

STRICT = get_pose_protocol("strict")
CAMERA, BOTTLE, MUG = 3, 1, 6
COLUMNS = ("iou25", "iou50", "iou75", "5deg2cm", "5deg5cm", "10deg2cm", "10deg5cm")


@pytest.mark.parametrize(
    ("name", "answer", "own_scores"),
    [("nocs2019", "nocs2019_ap", True), ("paper", "dreds_accuracy", False)],
)
def test_released_evaluations(name: str, answer: str, own_scores: bool) -> None:
    truths, predictions = oracle_frames()
    if not own_scores:
        predictions = [replace(p, scores=np.ones(len(p.scores))) for p in predictions]
    scores = score_poses(truths, predictions, get_pose_protocol(name))
    assert scores.columns[:7] == COLUMNS
    expected = oracle()["expected"][answer]
    pose_key = "deg5cm2_deg5cm5_deg10cm2_deg10cm5"
    by_class = np.hstack([expected["iou25_50_75_per_class"], expected[f"{pose_key}_per_class"]])
    assert np.abs(scores.values[:, :7] - by_class).max() < 1e-6
    means = [*expected["iou25_50_75_mean"], *expected[f"{pose_key}_mean"]]
    assert [scores.mean[c] for c in COLUMNS] == pytest.approx(means, abs=1e-6, rel=0)


def test_ranking_by_hand() -> None:
    """Five objects; right, wrong, right, right, wrong: precision 1, 1/2, 2/3, 3/4, 3/5.

    Made to fall with recall: 1, 3/4, 3/4, at steps of 1/5 of recall.
    """
    scores = [0.9, 0.8, 0.7, 0.6, 0.5]
    hits = [True, False, True, True, False]
    assert average_precision(scores, hits, 5) == pytest.approx((1 + 3 / 4 + 3 / 4) / 5)
    shuffled = [3, 0, 4, 2, 1]
    again = average_precision([scores[i] for i in shuffled], [hits[i] for i in shuffled], 5)
    assert again == pytest.approx(0.5)
    # All of one score: 3 of 5 right at once.
    assert average_precision(np.ones(5), hits, 5) == pytest.approx(3 / 5 * 3 / 5)
    assert average_precision([], [], 5) == 0
    assert np.isnan(average_precision([], [], 0))


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 6), st.booleans()), min_size=1, max_size=30),
    st.integers(0, 5),
    st.randoms(),
)
def test_order_of_predictions_says_nothing(
    ranked: list[tuple[int, bool]], missed: int, random: object
) -> None:
    objects = sum(h for _, h in ranked) + missed
    if not objects:
        return
    scores, hits = zip(*ranked, strict=True)
    figure = average_precision(scores, hits, objects)
    assert 0 <= figure <= 1
    random.shuffle(ranked)  # type: ignore[attr-defined]
    scores, hits = zip(*ranked, strict=True)
    assert average_precision(scores, hits, objects) == pytest.approx(figure)
    assert average_precision(scores, hits, objects + 1) <= figure + 1e-12
    twice = average_precision(scores, hits, 2 * objects, np.full(len(hits), 2.0))
    assert twice == pytest.approx(figure)


def test_perfect_predictions() -> None:
    truths, _ = oracle_frames()
    same = [
        PosePrediction(t.class_ids, t.RT, t.sizes, np.linspace(0.5, 1, len(t.class_ids)))
        for t in truths
    ]
    for name in pose_protocols.names():
        scores = score_poses(truths, same, get_pose_protocol(name))
        assert (scores.values == 1).all(), name


def test_misses_and_false_finds_cost() -> None:
    two = frame_of((CAMERA, np.eye(4)), (CAMERA, pose(t=(3, 0, 0))))
    one_found = found((CAMERA, np.eye(4), 0.9))
    missed = score_poses([two], [one_found])
    assert missed.of_class("camera")["iou50"] == missed.of_class("camera")["5deg2cm"] == 0.5
    gated = replace(STRICT, pose_needs_iou=0.1)
    assert score_poses([two], [one_found], gated).of_class("camera")["5deg2cm"] == 1
    accuracy = replace(STRICT, score=PoseScoring.ACCURACY)
    assert score_poses([two], [one_found], accuracy).of_class("camera")["iou50"] == 1
    false_first = found((CAMERA, pose(t=(9, 0, 0)), 0.95), (CAMERA, np.eye(4), 0.9))
    assert score_poses([two], [false_first]).of_class("camera")["iou50"] == 0.25
    assert score_poses([two], [false_first], gated).of_class("camera")["5deg2cm"] == 1
    assert score_poses([two], [false_first], accuracy).of_class("camera")["iou50"] == 0.5


def test_a_true_object_answers_once() -> None:
    one = frame_of((CAMERA, np.eye(4)))
    twice = found((CAMERA, pose(t=(0.01, 0, 0)), 0.8), (CAMERA, np.eye(4), 0.9))
    matches = match_poses([one], [twice])
    assert matches.hits[:, 0].tolist() == [False, True]
    wrong_class = found((BOTTLE, np.eye(4), 1.0))
    scores = score_poses([one], [wrong_class])
    assert scores.of_class("camera")["iou25"] == 0
    assert np.isnan(scores.of_class("bottle")["iou25"])


def test_gates_include_their_ends_and_overlaps_do_not() -> None:
    one = frame_of((CAMERA, np.eye(4)))
    off = found((CAMERA, pose((0, np.deg2rad(4.999), 0), (0.0, 0.0199, 0)), 1.0))
    scores = score_poses([one], [off]).of_class("camera")
    assert scores["5deg2cm"] == scores["10deg10cm"] == 1
    off = found((CAMERA, pose((0, np.deg2rad(5.001), 0), (0.0, 0.0201, 0)), 1.0))
    scores = score_poses([one], [off]).of_class("camera")
    assert scores["5deg2cm"] == scores["5deg5cm"] == scores["10deg2cm"] == 0
    assert scores["10deg5cm"] == 1
    # All numbers here are exact in binary: 0.75 of 1.25 is 0.6, computed the same way.
    quarter = found((CAMERA, pose(t=(0.25, 0, 0)), 1.0))
    for threshold, figure in ((0.75 / 1.25, 0), (np.nextafter(0.75 / 1.25, 0), 1)):
        edge = replace(STRICT, iou_thresholds=(float(threshold),), iou=BoxIoU.AABB)
        assert score_poses([one], [quarter], edge).values[CAMERA - 1, 0] == figure


def test_mugs_are_round_while_the_handle_is_hidden() -> None:
    turned = found((MUG, pose((0, 1.2, 0)), 1.0))
    for visible, figure in ((True, 0.0), (False, 1.0)):
        truth = PoseTruth([MUG], np.eye(4)[None], np.ones((1, 3)), [visible])
        assert score_poses([truth], [turned]).of_class("mug")["5deg2cm"] == figure
    hidden = PoseTruth([MUG], np.eye(4)[None], np.ones((1, 3)), [False])
    paper = score_poses([hidden], [turned], get_pose_protocol("paper"))
    assert paper.of_class("mug")["5deg2cm"] == 0
    over = found((4, pose((np.pi, 0, 0)), 1.0))
    can = frame_of((4, np.eye(4)))
    assert score_poses([can], [over]).of_class("can")["5deg2cm"] == 0
    assert score_poses([can], [over], get_pose_protocol("paper")).of_class("can")["5deg2cm"] == 1


def test_one_sided_frames() -> None:
    one, nothing_there = frame_of((CAMERA, np.eye(4))), PoseTruth([], [], [])
    hit, nothing = found((CAMERA, np.eye(4), 1.0)), PosePrediction([], [], [], [])
    paper = get_pose_protocol("paper")
    frames = [one, nothing_there, one], [hit, hit, nothing]
    assert score_poses(*frames, paper).of_class("camera")["iou50"] == 1
    keeping = replace(paper, both_sides_only=False)
    assert score_poses(*frames, keeping).of_class("camera")["iou50"] == 0.5
    none = score_poses([one], [nothing]).of_class("camera")
    assert set(none.values()) == {0.0}
    unanswered = score_poses([one], [nothing], keeping).of_class("camera")
    assert set(unanswered.values()) == {0.0}
    assert np.isnan(score_poses([], []).mean["iou25"])


def test_class_zero_is_never_scored() -> None:
    other = frame_of((0, np.eye(4)), (CAMERA, np.eye(4)))
    pred = found((0, np.eye(4), 1.0), (CAMERA, np.eye(4), 0.5))
    scores = score_poses([other], [pred])
    assert scores.true_objects.sum() == scores.predictions.sum() == 1
    assert scores.mean["iou75"] == 1


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.permutations(range(12)), st.sampled_from(["strict", "paper", "nocs2019"]))
def test_frames_in_any_order_and_any_number(order: list[int], name: str) -> None:
    truths, predictions = oracle_frames()
    protocol = get_pose_protocol(name)
    matches = match_poses(truths[:12], predictions[:12], protocol)
    whole = score_matches(matches)
    again = score_poses([truths[i] for i in order], [predictions[i] for i in order], protocol)
    np.testing.assert_allclose(again.values, whole.values, atol=1e-12)
    chosen = order[:5]
    weights = np.bincount([*chosen, *chosen[:2]], minlength=12)
    drawn = [*chosen, *chosen[:2]]
    direct = score_poses([truths[i] for i in drawn], [predictions[i] for i in drawn], protocol)
    weighted = score_matches(matches, weights)
    np.testing.assert_allclose(weighted.values, direct.values, atol=1e-12)
    assert (weighted.true_objects == direct.true_objects).all()


def test_wider_gates_are_never_worse() -> None:
    scores = score_poses(*oracle_frames())
    for narrow, wide in (
        *pairwise(("iou75", "iou50", "iou25")),
        *pairwise(("5deg2cm", "5deg5cm", "10deg5cm", "10deg10cm")),
        *pairwise(("5deg2cm", "10deg2cm", "10deg5cm")),
    ):
        assert scores.mean[narrow] <= scores.mean[wide]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"RT": np.diag([1.0, 2.0, 1.0, 1.0])[None]}, "rotation times one positive scale"),
        ({"RT": np.diag([1.0, 1.0, -1.0, 1.0])[None]}, "rotation times one positive scale"),
        ({"RT": np.full((1, 4, 4), np.nan)}, "rotation times one positive scale"),
        ({"RT": np.eye(4)}, "shape"),
        ({"sizes": np.array([[1.0, -1.0, 1.0]])}, "not negative"),
        ({"class_ids": [-1]}, "whole numbers"),
        ({"class_ids": [1.5]}, "whole numbers"),
        ({"scores": [np.nan]}, "finite"),
        ({"scores": [1.0, 2.0]}, "shape"),
    ],
)
def test_what_is_no_prediction(change: dict[str, object], problem: str) -> None:
    right = {
        "class_ids": [1],
        "RT": np.eye(4)[None],
        "sizes": np.ones((1, 3)),
        "scores": [1.0],
    }
    with pytest.raises(ToolkitError, match=problem):
        PosePrediction(**{**right, **change})  # type: ignore[arg-type]


def test_what_is_no_evaluation() -> None:
    truth = frame_of((CAMERA, np.eye(4)))
    with pytest.raises(ToolkitError, match="as many true frames"):
        score_poses([truth], [])
    with pytest.raises(ToolkitError, match="no such class"):
        score_poses([truth], [found((8, np.eye(4), 1.0))])
    with pytest.raises(ToolkitError, match="frame_weights"):
        score_matches(match_poses([truth], [found()]), [1.0, 1.0])
    with pytest.raises(ToolkitError, match="thresholds"):
        replace(STRICT, iou_thresholds=(1.0,))
    with pytest.raises(ToolkitError, match="round about y too"):
        PoseClasses(upside_down=frozenset({"car"}))
    with pytest.raises(ToolkitError, match="no such class"):
        PoseClasses(round_about_y=frozenset({"teapot"}))


def at(degrees: float, cm: float) -> np.ndarray:
    return pose((0, np.deg2rad(degrees), 0), (0, cm / 100, 0))


@pytest.mark.parametrize(
    ("second", "first_found", "other_found"),
    [
        # By degrees times cm, the first estimate would take the object that the other needs.
        pytest.param((2.5, 1.7), (4.5, 0.2), (-3.0, 0.0), id="product"),
        # By degrees less cm too.
        pytest.param((4.5, 2.0), (2.0, 0.1), (6.5, 2.0), id="difference"),
    ],
)
def test_an_estimate_takes_the_object_with_the_smallest_sum_of_both_errors(
    second: tuple[float, float],
    first_found: tuple[float, float],
    other_found: tuple[float, float],
) -> None:
    two = frame_of((CAMERA, at(0, 0)), (CAMERA, at(*second)))
    both = found((CAMERA, at(*first_found), 0.9), (CAMERA, at(*other_found), 0.8))
    assert match_poses([two], [both]).hits[:, COLUMNS.index("5deg2cm")].all()


def test_classes_of_different_frames_do_not_meet() -> None:
    """The largest class of a frame and the smallest of the next are different objects."""
    top = [frame_of((6, np.eye(4))), frame_of((6, np.eye(4)))]
    scores = score_poses(top, [found(), found((6, np.eye(4), 1.0))])
    assert scores.of_class("mug")["iou50"] == 0.5
    groups = group(*flatten(top, [found(), found((6, np.eye(4), 1.0))], classes=7))
    assert [g.truths.tolist() for g in groups] == [[[1]]]


@pytest.mark.parametrize(("true", "predicted"), [(2, 1), (1, 2)])
def test_frames_without_their_partner_are_refused(true: int, predicted: int) -> None:
    truths, predictions = [frame_of((1, np.eye(4)))], [found((1, np.eye(4), 1.0))]
    with pytest.raises(ToolkitError, match="as many true frames as predicted"):
        score_poses(truths * true, predictions * predicted)


def test_an_overlap_of_just_the_threshold_admits_no_pose() -> None:
    one = frame_of((CAMERA, np.eye(4)))
    quarter = found((CAMERA, pose(t=(0.25, 0, 0)), 1.0))
    wide = PoseGate(10.0, 100.0)
    for threshold, figure in ((0.75 / 1.25, 0), (np.nextafter(0.75 / 1.25, 0), 1)):
        needed = replace(STRICT, pose_needs_iou=float(threshold), iou=BoxIoU.AABB, gates=(wide,))
        matches = match_poses([one], [quarter], needed)
        assert matches.hits[0, -1] == figure


def test_methods_by_different_protocols_are_not_put_side_by_side() -> None:
    one, other = frame_of((CAMERA, np.eye(4))), found((CAMERA, np.eye(4), 1.0))
    matches = match_poses([one], [other])
    fewer = match_poses([one], [other], replace(STRICT, iou_thresholds=(0.75,)))
    for pair in ((matches, fewer), (fewer, matches)):
        with pytest.raises(ToolkitError, match="on the same frames"):
            side_by_side(*pair)
