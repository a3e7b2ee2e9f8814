"""Images as a camera without lens distortion sees them, read late and kept within a bound."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from distorted_scene import LENS, colour_of_rays, write_distorted_scene
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scene_on_disk import CAMERA, write_scene

from annotator.app.image_cache import ImageCache
from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import read_color
from std_toolkit.scene import Scene

BYTES = 96 * 72 * 3


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return write_scene(tmp_path / "scene", frames=8)


@pytest.fixture(scope="module")
def kept_scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return write_scene(tmp_path_factory.mktemp("frames") / "scene", frames=8)


def test_an_image_of_an_undistorted_camera_is_the_file(scene: Scene) -> None:
    image = ImageCache(scene).image(3)
    assert image.frame == 3
    assert image.camera == CAMERA
    np.testing.assert_array_equal(image.rgb, read_color(scene.root / "color/000003.png"))


def test_every_pixel_shows_what_its_camera_says(tmp_path: Path) -> None:
    """The image's own camera, which has no distortion, gives the ray that each pixel shows."""
    image = ImageCache(write_distorted_scene(tmp_path)).image(0)
    assert image.camera == LENS.without_distortion()
    expected = colour_of_rays(image.camera)
    # Rounding of the file, of the result and of remapping to 1/32 px on a slope of 3 a pixel.
    assert np.abs(image.rgb[2:-2, 2:-2] - expected[2:-2, 2:-2]).max() <= 1.1


def test_the_image_cannot_be_changed_by_one_of_those_who_share_it(scene: Scene) -> None:
    with pytest.raises(ValueError, match="read-only"):
        ImageCache(scene).image(0).rgb[0, 0] = 0


def test_files_are_read_when_asked_for_and_once(scene: Scene) -> None:
    with mock.patch.object(scene, "read_color", wraps=scene.read_color) as read:
        images = ImageCache(scene)
        assert read.call_count == 0
        assert images.held(2) is None
        assert images.image(2) is images.image(2) is images.held(2)
        assert read.call_count == 1


def test_what_was_used_last_stays(scene: Scene) -> None:
    images = ImageCache(scene, max_bytes=3 * BYTES)
    for frame in (0, 1, 2, 0, 3):
        images.image(frame)
    assert images.frames_held == [2, 0, 3]
    assert images.bytes_held == 3 * BYTES


def test_an_image_larger_than_the_bound_is_shown_but_not_kept(scene: Scene) -> None:
    images = ImageCache(scene, max_bytes=BYTES - 1)
    assert images.image(0).rgb.shape == (72, 96, 3)
    assert images.bytes_held == 0


CALLS = st.tuples(st.sampled_from(["image", "prefetch", "thumbnail"]), st.integers(0, 7))


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(CALLS, max_size=25), st.integers(0, 5 * BYTES))
def test_the_bound_holds_whatever_is_asked_for(
    kept_scene: Scene, calls: list[tuple[str, int]], max_bytes: int
) -> None:
    with ImageCache(kept_scene, max_bytes=max_bytes, max_thumbnail_bytes=4000) as images:
        for call, frame in calls:
            if call == "image":
                assert images.image(frame).frame == frame
            elif call == "thumbnail":
                assert images.thumbnail(frame, 24).shape == (18, 24, 3)
            else:
                images.prefetch([frame, (frame + 1) % 8, (frame + 2) % 8])
            assert images.bytes_held <= max_bytes
        assert images.wait_for_prefetch(10)
        assert images.bytes_held == BYTES * len(images.frames_held) <= max_bytes


def test_many_threads_see_the_right_images(scene: Scene) -> None:
    files = [read_color(scene.color_path(f)) for f in scene.frames]
    images = ImageCache(scene, max_bytes=3 * BYTES)

    def use(seed: int) -> None:
        for i in range(60):
            frame = (seed + i * i) % 8
            np.testing.assert_array_equal(images.image(frame).rgb, files[frame])

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(use, range(6)))


# --- thumbnails ---------------------------------------------------------------------------------


def test_a_thumbnail_shows_the_undistorted_image_small(tmp_path: Path) -> None:
    scene = write_distorted_scene(tmp_path)
    small = ImageCache(scene).thumbnail(0, 32)
    assert small.shape == (24, 32, 3)
    expected = colour_of_rays(LENS.without_distortion().resized(32, 24))
    assert np.abs(small[2:-2, 2:-2] - expected[2:-2, 2:-2]).max() <= 2
    images = ImageCache(scene)
    images.image(0)
    # The image in memory gives the same as the file does.
    both = images.thumbnail(0, 32)[2:-2, 2:-2], small[2:-2, 2:-2]
    assert np.abs(both[0].astype(int) - both[1]).max() <= 2


def test_thumbnails_do_not_drive_out_images(scene: Scene) -> None:
    images = ImageCache(scene, max_bytes=2 * BYTES)
    images.image(0)
    for frame in range(1, 8):
        images.thumbnail(frame, 24)
    assert images.frames_held == [0]


def test_thumbnails_outlive_images(scene: Scene) -> None:
    images = ImageCache(scene, max_bytes=BYTES)
    small = images.thumbnail(5, 24)
    for frame in range(8):
        images.image(frame)
    assert images.thumbnail(5, 24) is small


def test_a_thumbnail_is_never_larger_than_the_image(scene: Scene) -> None:
    np.testing.assert_array_equal(
        ImageCache(scene).thumbnail(0, 500), read_color(scene.color_path(scene.frames[0]))
    )


# --- damage -------------------------------------------------------------------------------------


@pytest.mark.parametrize("damage", ["missing", "cut"])
def test_a_bad_image_is_named_and_read_again_once_mended(scene: Scene, damage: str) -> None:
    path = scene.color_path(scene.frame(1))
    whole = path.read_bytes()
    path.unlink()
    if damage == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    images = ImageCache(scene)
    for _ in range(2):
        with pytest.raises(ToolkitError, match=r"000001\.png"):
            images.image(1)
        with pytest.raises(ToolkitError, match=r"000001\.png"):
            images.thumbnail(1, 24)
    path.write_bytes(whole)
    np.testing.assert_array_equal(images.image(1).rgb, read_color(path))
    assert images.thumbnail(1, 24).shape == (18, 24, 3)


def test_a_frame_that_does_not_exist_is_refused(scene: Scene) -> None:
    images = ImageCache(scene)
    for ask in (images.image, images.held, lambda frame: images.prefetch([frame])):
        with pytest.raises(ToolkitError, match="no such frame"):
            ask(99)


# --- reading ahead ------------------------------------------------------------------------------


def test_reading_ahead_passes_over_bad_frames(scene: Scene) -> None:
    scene.color_path(scene.frame(1)).unlink()
    with ImageCache(scene) as images:
        images.prefetch([0, 1, 2])
        assert images.wait_for_prefetch(10)
        assert images.frames_held == [0, 2]


def test_reading_ahead_leaves_half_of_the_cache_to_the_images_in_use(scene: Scene) -> None:
    with ImageCache(scene, max_bytes=4 * BYTES) as images:
        images.image(7)
        images.image(6)
        images.prefetch(range(6))
        assert images.wait_for_prefetch(10)
        assert images.frames_held == [7, 6, 0, 1]


def test_a_new_request_replaces_the_old_one(scene: Scene) -> None:
    begun, go_on, read = threading.Event(), threading.Event(), []

    def slow(frame: object, original=scene.read_color) -> object:
        read.append(frame.id)  # type: ignore[attr-defined]
        begun.set()
        assert go_on.wait(10)
        return original(frame)

    with mock.patch.object(scene, "read_color", slow), ImageCache(scene) as images:
        images.prefetch([0, 1, 2])
        assert begun.wait(10)
        images.prefetch([5])
        images.prefetch([6])
        images.prefetch([3])
        go_on.set()
        assert images.wait_for_prefetch(10)
        assert read == [0, 3]


def test_closing_lets_go_of_memory_and_threads(scene: Scene) -> None:
    images = ImageCache(scene)
    images.image(0)
    images.prefetch(range(8))
    images.close()
    assert images.bytes_held == 0
    assert not [t for t in threading.enumerate() if t.name == "read-frames"]
    images.prefetch(range(8))
    assert images.wait_for_prefetch(0)
    assert images.frames_held == []
    assert images.image(0).frame == 0
