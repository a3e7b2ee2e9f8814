"""Handles: what is under the pointer stays under it, as far as the handle allows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from annotator.app.view_options import Gizmo
from annotator.views.drags import PlaneDrag, TrackballDrag
from annotator.views.gizmo import (
    DEPTH_GAIN,
    DISC,
    GizmoFrame,
    Handle,
    Part,
)
from annotator.views.projection import ScreenCamera
from std_toolkit.geometry import SE3, rotation_angle, so3_exp

CAMERA = ScreenCamera(900, 700, 800.0, 790.0, 455.0, 341.0)
START = SE3.exp([0.05, -0.02, 0.7, 0.4, -0.3, 0.2])

angles = st.floats(-3.0, 3.0, allow_nan=False)
rotations = st.tuples(angles, angles, angles).map(lambda v: so3_exp(np.array(v)))
centres = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.15, 0.15), st.floats(0.3, 2.0)).map(np.array)
steps = st.tuples(st.floats(-60, 60), st.floats(-60, 60)).map(np.array)


def gizmo(centre: NDArray[np.float64], axes: NDArray[np.float64]) -> GizmoFrame:
    return GizmoFrame(CAMERA, centre, axes, 90.0, np.array([0.0, -1.0, 0.0]))


def moved(frame: GizmoFrame, T: SE3) -> NDArray[np.float64]:
    """Shift of the object in eye coordinates."""
    return T.t - START.t


@given(rotations, centres, st.integers(0, 2), st.floats(0.3, 1.0), steps)
@settings(max_examples=150, deadline=None)
def test_an_arrow_shifts_along_its_axis_and_stays_below_the_pointer(
    axes: NDArray[np.float64],
    centre: NDArray[np.float64],
    axis: int,
    share: float,
    step: NDArray[np.float64],
) -> None:
    frame, handle = gizmo(centre, axes), Handle(Part.ARROW, axis)
    assume(handle in frame.handles(Gizmo.MOVE))
    start = CAMERA.project(centre + share * frame.length_m * axes[:, axis])
    T = frame.grab(handle, start, START).to(start + step)
    shift = moved(frame, T)
    assert pytest.approx(START.R) == T.R
    along = float(shift @ axes[:, axis])
    assert np.linalg.norm(shift - along * axes[:, axis]) < 1e-12  # exactly along the axis
    grabbed = centre + share * frame.length_m * axes[:, axis] + shift
    assume(grabbed[2] > 0.1)
    seen = CAMERA.project(grabbed)
    # On the axis' line on the screen, it is the point nearest to the pointer.
    line = CAMERA.project(centre + 1e-6 * axes[:, axis]) - CAMERA.project(centre)
    across = abs(float((seen - (start + step)) @ line)) / np.linalg.norm(line)
    assume(abs(along) < 0.5)
    assert across < 1e-4


@given(rotations, centres, st.integers(0, 2), st.floats(-80, 80))
@settings(max_examples=100, deadline=None)
def test_a_pointer_on_the_arrow_line_keeps_its_point(
    axes: NDArray[np.float64], centre: NDArray[np.float64], axis: int, pixels: float
) -> None:
    frame, handle = gizmo(centre, axes), Handle(Part.ARROW, axis)
    assume(handle in frame.handles(Gizmo.MOVE))
    a = axes[:, axis]
    tip = centre + frame.length_m * a
    assume(tip[2] > 0.1)
    start = CAMERA.project(tip)
    metres = pixels * CAMERA.pixel_m(float(centre[2]))
    target = tip + metres * a
    assume(target[2] > 0.1)
    shift = moved(frame, frame.grab(handle, start, START).to(CAMERA.project(target)))
    assert shift == pytest.approx(metres * a, abs=1e-9)


@given(centres, steps, st.floats(-15, 15), st.floats(-15, 15))
@settings(max_examples=100, deadline=None)
def test_the_disc_moves_parallel_to_the_image(
    centre: NDArray[np.float64], step: NDArray[np.float64], dx: float, dy: float
) -> None:
    frame = gizmo(centre, np.eye(3))
    start = frame.middle + np.array([dx, dy])
    shift = moved(frame, frame.grab(Handle(Part.DISC), start, START).to(start + step))
    assert abs(shift[2]) < 1e-12
    grabbed = CAMERA.ray(start) * centre[2]
    assert CAMERA.project(grabbed + shift) == pytest.approx(start + step, abs=1e-7)


@given(centres, steps)
@settings(max_examples=50, deadline=None)
def test_an_object_follows_the_pointer_at_the_depth_where_it_was_grabbed(
    grabbed: NDArray[np.float64], step: NDArray[np.float64]
) -> None:
    start = CAMERA.project(grabbed)
    T = PlaneDrag(CAMERA, grabbed, START).to(start + step)
    here = T @ (START.inverse() @ grabbed)
    assert CAMERA.project(here) == pytest.approx(start + step, abs=1e-7)
    assert here[2] == pytest.approx(grabbed[2])


@given(rotations, centres, st.integers(-1, 2), angles, angles)
@settings(max_examples=150, deadline=None)
def test_a_ring_turns_by_the_angle_swept(
    axes: NDArray[np.float64],
    centre: NDArray[np.float64],
    axis: int,
    begin: float,
    sweep: float,
) -> None:
    frame = gizmo(centre, axes)
    handle = Handle(Part.VIEW_RING) if axis < 0 else Handle(Part.RING, axis)
    n = frame.sight if axis < 0 else axes[:, axis]
    assume(abs(float(n @ frame.sight)) > 0.3)
    u = np.cross(n, np.eye(3)[int(np.argmin(np.abs(n)))])
    u /= np.linalg.norm(u)

    def on_ring(angle: float) -> NDArray[np.float64]:
        return centre + frame.length_m * (so3_exp(angle * n) @ u)

    drag = frame.grab(handle, CAMERA.project(on_ring(begin)), START)
    T = drag.to(CAMERA.project(on_ring(begin + sweep)))
    turn = T.R @ START.R.T
    assert turn == pytest.approx(so3_exp(sweep * n), abs=1e-7)
    # The centre stays.
    assert T @ (START.inverse() @ centre) == pytest.approx(centre, abs=1e-9)


@given(rotations, centres, st.integers(0, 2), st.floats(-12, 12))
@settings(max_examples=100, deadline=None)
def test_an_edge_on_ring_follows_the_pointer_along_its_line(
    axes: NDArray[np.float64], centre: NDArray[np.float64], axis: int, pixels: float
) -> None:
    # Turn the axes so that this ring is seen nearly from its side.
    sight = centre / np.linalg.norm(centre)
    a = axes[:, axis]
    tilt = np.cross(a, sight)
    assume(np.linalg.norm(tilt) > 0.05)
    tilt /= np.linalg.norm(tilt)
    off = np.arccos(np.clip(a @ sight, -1, 1)) - np.pi / 2
    axes = so3_exp(tilt * off) @ axes
    frame, handle = gizmo(centre, axes), Handle(Part.RING, axis)
    a = axes[:, axis]
    assert abs(float(a @ sight)) < 1e-6
    near = centre - frame.length_m * sight  # the point of the ring nearest to the eye
    start = CAMERA.project(near)
    along = CAMERA.project(near + 1e-6 * np.cross(a, -sight)) - start
    along /= np.linalg.norm(along)
    T = frame.grab(handle, start, START).to(start + pixels * along)
    seen = CAMERA.project(T @ (START.inverse() @ near))
    # To first order: a ring's arc is longer than its chord.
    assert (seen - start) @ along == pytest.approx(pixels, abs=0.5 + 0.02 * pixels**2)
    angle = rotation_angle(T.R @ START.R.T)
    assert angle == pytest.approx(abs(pixels) / 90, rel=0.25, abs=1e-3)


def test_a_trackball_brings_its_front_to_the_pointer() -> None:
    centre = np.array([0.0, 0.0, 0.7])
    T = TrackballDrag(centre, 100.0, np.array([400.0, 300.0]), START).to((410.0, 300.0))
    turn = T.R @ START.R.T
    assert rotation_angle(turn) == pytest.approx(0.1)
    assert (turn @ np.array([0.0, 0.0, -1.0]))[0] > 0  # the near side goes right
    down = TrackballDrag(centre, 100.0, np.zeros(2), START).to((0.0, 10.0))
    assert (down.R @ START.R.T @ np.array([0.0, 0.0, -1.0]))[1] > 0


def test_going_back_with_the_pointer_goes_back_with_the_object() -> None:
    frame = gizmo(np.array([0.05, -0.02, 0.7]), START.R)
    for kind in (Gizmo.MOVE, Gizmo.TURN):
        for handle in frame.handles(kind):
            start = frame.line(handle)[-1] if handle.part is not Part.DISC else frame.middle
            drag = frame.grab(handle, start, START)
            drag.to(start + np.array([40, 25]))
            T = drag.to(start)
            assert T.matrix() == pytest.approx(START.matrix(), abs=1e-9)


class TestDepth:
    """An axis along the line of sight gets a handle that can be seen."""

    frame = gizmo(np.array([0.0, 0.0, 0.7]), np.eye(3))

    def test_it_stands_in_for_the_arrow(self) -> None:
        handles = self.frame.handles(Gizmo.MOVE)
        assert Handle(Part.DEPTH, 2) in handles
        assert Handle(Part.ARROW, 2) not in handles
        assert np.ptp(self.frame.line(Handle(Part.DEPTH, 2)), axis=0).min() > 20

    def test_pulling_it_out_moves_away_by_pixels(self) -> None:
        handle = Handle(Part.DEPTH, 2)
        start = self.frame.line(handle)[-1]
        out = self.frame.depth_direction(2)
        shift = moved(self.frame, self.frame.grab(handle, start, START).to(start + 10 * out))
        metres = 10 * DEPTH_GAIN * CAMERA.pixel_m(0.7)
        assert shift == pytest.approx([0.0, 0.0, metres])

    def test_an_axis_towards_the_eye_is_pulled_the_other_way(self) -> None:
        turned = gizmo(np.array([0.0, 0.0, 0.7]), so3_exp(np.array([np.pi, 0.0, 0.0])))
        assert turned.depth_direction(2) == pytest.approx(-self.frame.depth_direction(2))


class TestHit:
    frame = gizmo(np.array([0.1, 0.05, 0.9]), so3_exp(np.array([0.5, 0.6, 0.1])))

    @pytest.mark.parametrize("kind", [Gizmo.MOVE, Gizmo.TURN])
    def test_each_handle_is_hit_on_its_line(self, kind: Gizmo) -> None:
        for handle in self.frame.handles(kind):
            line, near = self.frame.line(handle), self.frame.in_front(handle)
            hits = [self.frame.hit(kind, p) for p in line[near]]
            # Rings cross each other: there either may be hit.
            assert hits.count(handle) > 0.7 * len(hits)

    def test_the_far_half_of_a_ring_is_not_hit(self) -> None:
        handle = Handle(Part.RING, 0)
        far = self.frame.line(handle)[~self.frame.in_front(handle)]
        hits = [self.frame.hit(Gizmo.TURN, p) for p in far]
        assert hits.count(handle) < 0.2 * len(hits)

    def test_beside_the_handles_nothing_is_hit(self) -> None:
        assert self.frame.hit(Gizmo.MOVE, self.frame.middle + np.array([-300, 200])) is None
        assert self.frame.hit(Gizmo.OFF, self.frame.middle) is None

    def test_the_disc_is_hit_all_over(self) -> None:
        inside = self.frame.middle + np.array([0.6 * DISC * 90, 0])
        assert self.frame.hit(Gizmo.MOVE, inside) == Handle(Part.DISC)

    @given(centres)
    @settings(max_examples=30, deadline=None)
    def test_arrows_keep_their_size_on_the_screen(self, centre: NDArray[np.float64]) -> None:
        frame = gizmo(centre, np.eye(3))
        tip = frame.line(Handle(Part.ARROW, 0))[-1]
        assert np.linalg.norm(tip - frame.middle) == pytest.approx(90, rel=0.05)


def test_nothing_is_shown_behind_the_eye() -> None:
    frame = gizmo(np.array([0.0, 0.0, -0.5]), np.eye(3))
    assert all(len(frame.line(h)) == 0 for h in frame.handles(Gizmo.MOVE))


@pytest.mark.parametrize("towards", [1.0, -1.0], ids=["away from the eye", "towards the eye"])
@pytest.mark.parametrize("tilt", [0.4, 1.1, -0.7])
def test_beyond_the_vanishing_point_an_arrow_stays_far_in_front_of_the_eye(
    towards: float, tilt: float
) -> None:
    """There an axis' line lies behind the eye: the object goes as far away as it may, not back."""
    centre = np.array([0.1, -0.05, 0.8])
    away = so3_exp(np.array([tilt, tilt, 0.0])) @ np.array([0.0, 0.0, 1.0])
    away *= np.sign(away[2])
    axes = so3_exp(np.array([0.3, 0.2, 0.1]))
    axes[:, 0] = towards * away
    start = CAMERA.project(centre)
    vanishing = CAMERA.project(away)  # of the axis' line: the direction's own projection
    drag = gizmo(centre, axes).grab(Handle(Part.ARROW, 0), start, START)
    depths = []
    for share in (0.0, 0.5, 0.9, 0.999, 1.0, 1.001, 1.1, 2.0, 5.0):
        shift = drag.to(start + share * (vanishing - start)).t - START.t
        along = float(shift @ away)
        assert shift == pytest.approx(along * away, abs=1e-12)
        depths.append(centre[2] + float(shift[2]))
    assert depths == sorted(depths)
    farthest = centre[2] + 10 * centre[2] * away[2]
    assert depths[3:] == pytest.approx([farthest] * 6)
