"""Frames that are judged together, and the bounds of what is measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from benchmark.data.labelled import LabelledFrame, LabelledObject
from benchmark.data.splits import FrameKey
from benchmark.evaluation.audit.judged import size_of
from benchmark.evaluation.audit.rigid import groups_of
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.scene.model import ContinuousSymmetry, SymmetryModel

PLACES = {
    "a": SE3(so3_exp([0.3, 0.1, 0]), np.array([0.0, 0, 0])),
    "b": SE3(so3_exp([0, 0.5, 0.2]), np.array([0.2, 0, 0.05])),
    "c": SE3(so3_exp([0.1, 0, 0.9]), np.array([-0.1, 0.2, 0])),
}
NO_MOTION = SE3.identity()
ROUND = SymmetryModel(continuous=[ContinuousSymmetry(axis=[0.0, 0, 1], offset=[0.0, 0, 0])])


def camera(index: int, arc: float = 0.2) -> SE3:
    """Looks at the middle from 0.8 m; one step of an arc further."""
    R = so3_exp([0, -arc * index, 0])
    return SE3(R, R @ np.array([0, 0, -0.8]))


def frames(
    count: int = 6,
    *,
    arc: float = 0.2,
    cameras: bool = True,
    names: Sequence[str] = "abc",
    symmetry: SymmetryModel | None = None,
) -> list[LabelledFrame]:
    found = []
    for i in range(count):
        T = camera(i, arc)
        objects = tuple(
            LabelledObject(
                n, n, None, T.inverse() @ PLACES[n], "diffuse", symmetry or SymmetryModel()
            )
            for n in names
        )
        found.append(LabelledFrame(i, FrameKey("s", f"{i:03d}"), objects, T if cameras else None))
    return found


def changed(frame: LabelledFrame, name: str, motion: SE3) -> LabelledFrame:
    """The frame with one label moved in the frame of its object."""
    objects = tuple(
        LabelledObject(o.name, o.model, None, o.T_cam_obj @ motion, o.material, o.symmetry)
        if o.name == name
        else o
        for o in frame.objects
    )
    return LabelledFrame(frame.index, frame.key, objects, frame.T_world_cam)


@pytest.mark.parametrize("known", [True, False])
def test_a_scene_that_stands_still(known: bool) -> None:
    (group,) = groups_of(frames(cameras=known))
    assert group.cameras == ("of the set" if known else "from the labels")
    assert len(group.frames) == 6
    assert max(max(o) for o in group.off.values()) < 1e-6
    for f in group.frames:
        for item in f.objects:
            seen = group.T_world_cam[f.index].inverse() @ group.T_world_obj[item.name]
            assert np.allclose(seen.matrix(), item.T_cam_obj.matrix(), atol=1e-9)


@pytest.mark.parametrize("known", [True, False])
def test_one_label_of_one_frame_is_told_with_its_size(known: bool) -> None:
    wrong = frames(8, cameras=known)
    wrong[3] = changed(wrong[3], "b", SE3(so3_exp([0, 0, np.deg2rad(6)]), np.array([0.012, 0, 0])))
    (group,) = groups_of(wrong)
    mm, deg = group.off[3, "b"]
    assert (mm, deg) == (pytest.approx(12), pytest.approx(6))
    others = [max(o) for key, o in group.off.items() if key != (3, "b")]
    assert max(others) < 1e-6


def test_a_wrong_camera_of_the_set_is_replaced() -> None:
    """Poses that are the inverse of what they should be are poses, too."""
    inverted = [
        LabelledFrame(f.index, f.key, f.objects, camera(f.index).inverse()) for f in frames()
    ]
    (group,) = groups_of(inverted)
    assert group.cameras == "from the labels"
    assert max(max(o) for o in group.off.values()) < 1e-6


def test_objects_that_were_moved_begin_a_new_run() -> None:
    moved = frames(10, cameras=False)
    for i in range(5, 10):
        for k, name in enumerate("ab"):
            moved[i] = changed(moved[i], name, SE3(np.eye(3), np.array([0.05, 0.03 * k, 0])))
    first, second = groups_of(moved)
    assert [[f.index for f in g.frames] for g in (first, second)] == [[*range(5)], [*range(5, 10)]]


@pytest.mark.parametrize("known", [True, False])
def test_one_object_that_was_moved_begins_a_new_run(known: bool) -> None:
    """It is no label that is off, as one in a single frame is; that one stays in its run."""
    moved = frames(12, cameras=known)
    for i in range(6, 12):
        moved[i] = changed(moved[i], "b", SE3(np.eye(3), np.array([0.05, 0, 0])))
    moved[2] = changed(moved[2], "a", SE3(np.eye(3), np.array([0.02, 0, 0])))
    first, second = groups_of(moved)
    assert [[f.index for f in g.frames] for g in (first, second)] == [[*range(6)], [*range(6, 12)]]
    assert first.off[2, "a"][0] == pytest.approx(20)
    assert sum(max(o) > 1e-6 for g in (first, second) for o in g.off.values()) == 1


def test_labels_that_agree_on_nothing_stand_alone() -> None:
    rng = np.random.default_rng(0)
    loose = frames(5, cameras=False)
    for i in range(5):
        for name in "abc":
            loose[i] = changed(loose[i], name, SE3(np.eye(3), rng.normal(0, 0.02, 3)))
    found = groups_of(loose)
    assert [len(g.frames) for g in found] == [1] * 5
    assert {g.cameras for g in found} == {"none"}
    assert all(g.T_world_obj["a"] is o.T_cam_obj for g, f in zip(found, loose, strict=True)
               for o in f.objects[:1])  # fmt: skip


@pytest.mark.parametrize(
    ("made", "why"),
    [
        (frames(3), "too few"),
        (frames(8, arc=0.001), "the camera stands still, so that frames repeat each other"),
        (frames(8, cameras=False, names="a"), "one object would follow its own label"),
    ],
)
def test_frames_that_are_no_scene(made: list[LabelledFrame], why: str) -> None:
    assert [len(g.frames) for g in groups_of(made)] == [1] * len(made), why


def test_a_round_object_may_be_labelled_at_any_turn() -> None:
    rng = np.random.default_rng(1)
    turned = frames(6, symmetry=ROUND)
    for i in range(6):
        turned[i] = changed(turned[i], "b", SE3(so3_exp([0, 0, rng.uniform(0, 6)]), np.zeros(3)))
    (group,) = groups_of(turned)
    assert max(max(o) for o in group.off.values()) < 1e-4


@pytest.mark.parametrize("truth", [(0.0, 0, 0), (5.0, 0, 0), (0, 0, 9.0), (0.4, -0.2, 0.1)])
@pytest.mark.parametrize("spread", [(1.0, 1, 1), (0.3, 0.3, 8.0), (1.0, 2.0, 0.0)])
def test_bounds_hold_the_truth(truth: tuple[float, ...], spread: tuple[float, ...]) -> None:
    """In at least 95 of 100 measurements, whatever the shape of their errors."""
    rng = np.random.default_rng(0)
    R = so3_exp([0.4, 0.2, 0.9])
    sigma = np.array(spread)
    covariance = R @ np.diag(sigma**2) @ R.T
    kept = R @ np.diag((sigma > 0).astype(float)) @ R.T
    real = kept @ np.array(truth)
    length = float(np.linalg.norm(real))
    inside = 0
    for _ in range(200):
        size = size_of(real + R @ (sigma * rng.normal(size=3)), covariance)
        assert size.low <= size.value <= size.high
        inside += size.low - 0.006 <= length <= size.high + 0.006
    assert inside >= 0.93 * 200


def test_bounds_of_one_direction_are_the_normal_ones() -> None:
    size = size_of(np.array([5.0]), np.array([[1.0]]))
    assert (size.low, size.value, size.high) == (pytest.approx(3.04), 5.0, pytest.approx(6.96))
