"""Depth aligned to colour: planes, edges, holes and librealsense's own alignment."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sensors.align import align_depth
from sensors.specs import load_sensor
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.images import read_depth

Array = NDArray[np.float64]
DEPTH = Camera(320, 180, 222.0, 222.0, 158.0, 93.3)
TURN = SE3.from_quat([0.99995, 0.006, -0.004, 0.007], [-0.0151, 0.0003, 0.0021])


def plane_depth(camera: Camera, normal: Array, distance: float) -> Array:
    """(H, W) z-depth of the points with normal . p = distance."""
    return distance / (camera.rays() @ normal)


def moved_plane(normal: Array, distance: float, T: SE3) -> tuple[Array, float]:
    turned = T.R @ normal
    return turned, distance + float(turned @ T.t)


@pytest.mark.parametrize(
    ("other", "T"),
    [
        (Camera(320, 180, 227.0, 226.0, 156.0, 86.0), SE3(np.eye(3), np.array([0.015, 0, 0]))),
        (Camera(640, 360, 454.4, 453.4, 312.5, 173.2), TURN),
        (Camera(160, 90, 113.0, 113.0, 79.0, 44.0), TURN),
        (Camera(400, 300, 300.0, 301.0, 200.0, 148.0, (0.08, -0.11, 0.001, -0.002, 0.03)), TURN),
    ],
    ids=["same size", "twice", "half", "distorted"],
)
@pytest.mark.parametrize("normal", [(0.0, 0, 1), (0.5, -0.4, 1), (-0.9, 0.5, 1)], ids=str)
def test_plane(other: Camera, T: SE3, normal: tuple[float, float, float]) -> None:
    n, distance = np.array(normal), 0.8
    depth = plane_depth(DEPTH, n, distance)
    found = align_depth(depth, DEPTH, other, T)
    assert found.dtype == np.float32
    exact = plane_depth(other, *moved_plane(n, distance, T))
    # Where the depth camera sees the plane, a pixel from its borders.
    back = DEPTH.project((other.rays() * exact[..., None] - T.t) @ T.R)
    inside = ((back > 0.5) & (back < [DEPTH.width - 1.5, DEPTH.height - 1.5])).all(axis=-1)
    assert inside.mean() > 0.3
    assert (found[inside] > 0).all(), "a closed surface stays closed"
    # A pixel of the other image takes the depth at the centre of the patch that it lies on: half
    # a pixel of depth's image off at most, in each direction.
    there = (DEPTH.rays() * depth[..., None]) @ T.R[2] + T.t[2]
    step = abs(np.gradient(there)[0]).max() + abs(np.gradient(there)[1]).max()
    error = (found - exact)[inside]
    assert abs(error).max() < 0.55 * step + 1e-6
    assert abs(error.mean()) < 0.02 * step + 1e-5
    outside = ((back < -1) | (back > [DEPTH.width, DEPTH.height])).any(axis=-1)
    assert not found[outside].any()


def test_box_edge_hides_and_uncovers() -> None:
    """A box before a wall, seen from 60 mm further right: the wall left of it is hidden there."""
    T = SE3(np.eye(3), np.array([-0.06, 0, 0]))
    depth = np.full((180, 320), 1.0)
    depth[60:120, 100:200] = 0.5
    found = align_depth(depth, DEPTH, DEPTH, T)
    near, far = 0.06 * 222 / 0.5, 0.06 * 222 / 1.0  # 26.6 and 13.3 px to the left
    row = found[90]
    # Pixels whose centres lie on the box: from 99.5 to 199.5, moved.
    box = np.arange(320)[(np.arange(320) >= 99.5 - near) & (np.arange(320) <= 199.5 - near)]
    assert (row[box] == 0.5).all()
    hole = np.arange(320)[(np.arange(320) > 199.5 - near) & (np.arange(320) < 199.5 - far)]
    assert len(hole) in (13, 14)
    assert (row[hole] == 0).all(), "the wall that only the other camera sees is not known"
    wall = np.setdiff1d(np.arange(int(319.5 - far)), np.concatenate([box, hole]))
    assert (row[wall] == 1.0).all()
    assert (row[int(320.5 - far) :] == 0).all()
    # Above and below the box the wall has no hole.
    assert (found[40, : int(319.5 - far)] == 1.0).all()


def test_holes_stay() -> None:
    depth = np.full((180, 320), 0.7)
    depth[50:60, 80:95] = 0
    other = Camera(640, 360, 444.0, 444.0, 316.5, 187.1)  # the same view, twice the size
    found = align_depth(depth, DEPTH, other, SE3.identity())
    assert (found[100:120, 160:190] == 0).all()
    found[100:120, 160:190] = 0.7
    assert (found == np.float32(0.7)).all()


def test_same_camera_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.3, 3, (180, 320)) * (rng.random((180, 320)) < 0.7)
    # No pixel but its own holds a centre; the two hundredths by which patches overlap hold none.
    np.testing.assert_array_equal(
        align_depth(depth, DEPTH, DEPTH, SE3.identity()), depth.astype(np.float32)
    )


def test_depth_is_told_in_the_other_camera() -> None:
    depth = np.full((180, 320), 0.5)
    found = align_depth(depth, DEPTH, DEPTH, SE3(np.eye(3), np.array([0, 0, 0.1])))
    assert np.unique(found[found > 0]) == pytest.approx([0.6])
    behind = align_depth(depth, DEPTH, DEPTH, SE3(np.eye(3), np.array([0, 0, -0.5])))
    assert not behind.any()


def test_refuses_what_is_no_depth() -> None:
    with pytest.raises(ToolkitError, match="320x180"):
        align_depth(np.ones((90, 160)), DEPTH, DEPTH, SE3.identity())
    for bad in (np.nan, np.inf, -0.1):
        depth = np.ones((180, 320))
        depth[3, 4] = bad
        with pytest.raises(ToolkitError, match="depth: depth holds"):
            align_depth(depth, DEPTH, DEPTH, SE3.identity())


def by_librealsense(
    depth_mm: NDArray[np.uint16], camera: Camera, other: Camera, T: SE3
) -> NDArray[np.uint16]:
    """What `rs.align` makes of a frame of a software device."""
    import pyrealsense2 as rs

    def intrinsics(c: Camera) -> rs.intrinsics:
        out = rs.intrinsics()
        out.width, out.height, out.fx, out.fy = c.width, c.height, c.fx, c.fy
        out.ppx, out.ppy = c.cx, c.cy
        out.model, out.coeffs = rs.distortion.none, [0.0] * 5
        return out

    def stream(kind: rs.stream, c: Camera, uid: int, size: int, fmt: rs.format) -> rs.video_stream:
        out = rs.video_stream()
        out.type, out.index, out.uid, out.fps = kind, 0, uid, 30
        out.width, out.height, out.bpp, out.fmt = c.width, c.height, size, fmt
        out.intrinsics = intrinsics(c)
        return out

    device = rs.software_device()
    sensors = [device.add_sensor("Depth"), device.add_sensor("Color")]
    profiles = [
        sensors[0].add_video_stream(stream(rs.stream.depth, camera, 0, 2, rs.format.z16)),
        sensors[1].add_video_stream(stream(rs.stream.color, other, 1, 3, rs.format.rgb8)),
    ]
    sensors[0].add_read_only_option(rs.option.depth_units, 0.001)
    extrinsics = rs.extrinsics()
    extrinsics.rotation = list(T.R.T.ravel())  # by columns
    extrinsics.translation = list(T.t)
    profiles[0].register_extrinsics_to(profiles[1], extrinsics)
    device.create_matcher(rs.matchers.default)
    syncer, align = rs.syncer(), rs.align(rs.stream.color)
    for sensor, profile in zip(sensors, profiles, strict=True):
        sensor.open(profile)
        sensor.start(syncer)
    images = [depth_mm, np.zeros((other.height, other.width, 3), dtype=np.uint8)]
    deadline = time.monotonic() + 20
    for number in range(1000):
        for sensor, profile, image in zip(sensors, profiles, images, strict=True):
            frame = rs.software_video_frame()
            frame.pixels, frame.bpp = image, 2 if image.ndim == 2 else 3
            frame.stride = frame.bpp * image.shape[1]
            frame.timestamp, frame.frame_number = number * 33.3, number
            frame.domain = rs.timestamp_domain.hardware_clock
            frame.profile = profile.as_video_stream_profile()
            if image.ndim == 2:
                frame.depth_units = 0.001
            sensor.on_video_frame(frame)
        frames = syncer.wait_for_frames(5000)
        if frames.size() == 2:
            aligned = np.asanyarray(align.process(frames).get_depth_frame().get_data()).copy()
            for sensor in sensors:
                sensor.stop()
                sensor.close()
            return aligned
        assert time.monotonic() < deadline
    raise AssertionError("librealsense never paired the two frames")


def compare_with_librealsense(
    depth_mm: NDArray[np.uint16], camera: Camera, other: Camera, T: SE3
) -> tuple[float, float, float]:
    """Share of pixels valid in both or neither, of those both see equal to 2 mm, and the worst of
    the latter in millimetres after both are cut back by a pixel from edges of depth."""
    theirs = by_librealsense(depth_mm, camera, other, T).astype(float)
    ours = align_depth(depth_mm / 1000.0, camera, other, T) * 1000.0
    both = (ours > 0) & (theirs > 0)
    same = ((ours > 0) == (theirs > 0)).mean()
    error = abs(ours - theirs)
    # Away from edges, where librealsense's patches reach up to a pixel further.
    low, high = theirs.copy(), theirs.copy()
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            beside = np.roll(theirs, (dy, dx), (0, 1))
            low, high = np.minimum(low, beside), np.maximum(high, beside)
    smooth = both & (low > 0) & (high - low < 0.02 * high)
    assert smooth.mean() > 0.3
    return float(same), float((error[both] <= 2).mean()), float(error[smooth].max())


@pytest.mark.parametrize("size", [(320, 180), (640, 360)], ids=str)
def test_agrees_with_librealsense(size: tuple[int, int]) -> None:
    pytest.importorskip("pyrealsense2")
    spec = load_sensor("d415")
    other = spec.color_camera(*size)
    T = spec.pose_of_color.inverse()
    camera = DEPTH
    v, u = np.mgrid[:180, :320]
    depth_mm = (700 + 0.6 * u + 0.4 * v).astype(np.uint16)
    depth_mm[60:120, 100:200] = 500
    depth_mm[20:40, 30:60] = 0
    same, equal, worst = compare_with_librealsense(depth_mm, camera, other, T)
    assert same > 0.99
    assert equal > 0.99
    # librealsense leaves the depth camera's own z, which differs from the colour camera's by the
    # step and the turn between them; and it takes the nearest of the patches that reach a pixel.
    assert worst < 2


@pytest.mark.real
def test_agrees_with_librealsense_on_a_real_frame(test_data: Path) -> None:
    pytest.importorskip("pyrealsense2")
    depth = read_depth(test_data / "d415_stereo_pair" / "0000_depth.png", scale=0.001)
    spec = load_sensor("d415")
    depth_mm = np.rint(depth * 1000).astype(np.uint16)
    same, equal, worst = compare_with_librealsense(
        depth_mm, spec.infrared_camera(640, 360), spec.color_camera(640, 360),
        spec.pose_of_color.inverse(),
    )  # fmt: skip
    assert same > 0.98
    assert equal > 0.99
    assert worst < 10
