"""Thread-safe cache of undistorted colour images with a memory limit and background prefetch."""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Generic, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera, undistort_image
from std_toolkit.log import logger
from std_toolkit.scene import Frame, Scene

K = TypeVar("K", bound=Hashable)

V = TypeVar("V")

MEGABYTE = 2**20


class BackgroundReader:
    """Calls `read(item)` for items in order in a thread that exists only while there is work.

    Args:
        read: processes an item; a ToolkitError is logged and the next item follows.
    """

    def __init__(self, read: Callable[[int], object]) -> None:
        self._read = read
        self._waiting: deque[int] = deque()
        self._running = False
        self._closed = False
        self._changed = threading.Condition()

    def request(self, items: Iterable[int]) -> None:
        """Read these items instead of those still waiting. No effect after `close`."""
        with self._changed:
            if self._closed:
                return
            self._waiting = deque(dict.fromkeys(items))
            if self._waiting and not self._running:
                self._running = True
                threading.Thread(target=self._work, name="read-frames").start()

    def close(self) -> None:
        """Cancel, and wait for items being read; must not be called from `read`."""
        with self._changed:
            self._waiting.clear()
            self._closed = True
        self.wait()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until all items are read; False after `timeout_s`."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._running, timeout_s)

    def _work(self) -> None:
        while True:
            with self._changed:
                # When the program ends, Python waits for this thread: stop after this item.
                if not self._waiting or not threading.main_thread().is_alive():
                    self._waiting.clear()
                    self._running = False
                    self._changed.notify_all()
                    return
                item = self._waiting.popleft()
            try:
                self._read(item)
            except ToolkitError as error:
                # A direct request raises the error.
                logger.debug("reading ahead: %s", error)
            except Exception:
                logger.exception("reading ahead failed")


class BoundedStore(Generic[K, V]):
    """Least-recently-used cache bounded in bytes; evicted values are computed again on demand.

    A value that several threads request at once is computed once. Failures are not cached. A value
    larger than the bound is returned without being cached.

    Args:
        max_bytes: bound on the cached values; callers may hold others.
        size: returns the bytes of a value.
    """

    def __init__(self, max_bytes: int, size: Callable[[V], int]) -> None:
        self.max_bytes = max_bytes
        self._size = size
        self._lock = threading.Lock()
        self._values: OrderedDict[K, V] = OrderedDict()
        self._under_way: dict[K, Future[V]] = {}
        self._bytes = 0
        self._epoch = 0

    def get(self, key: K, make: Callable[[], V]) -> V:
        """Return the value of `key`, from `make()` if not cached; raises what `make` raises."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
            result = self._under_way.get(key)
            made_elsewhere = result is not None
            if result is None:
                result = self._under_way[key] = Future()
            epoch = self._epoch
        if made_elsewhere:
            return result.result()
        try:
            value = make()
        except BaseException as error:
            with self._lock:
                self._end(key, result)
            result.set_exception(error)
            raise
        with self._lock:
            self._end(key, result)
            if epoch == self._epoch:
                self._keep(key, value)
        result.set_result(value)
        return value

    def peek(self, key: K) -> V | None:
        """Return the value if it is cached; does not count as a use."""
        with self._lock:
            return self._values.get(key)

    def clear(self) -> None:
        """Remove all values, including those being computed."""
        with self._lock:
            self._values.clear()
            self._under_way.clear()
            self._bytes = 0
            self._epoch += 1

    @property
    def bytes_held(self) -> int:
        with self._lock:
            return self._bytes

    def held(self) -> list[K]:
        """Return the cached keys, next to be evicted first."""
        with self._lock:
            return list(self._values)

    def _end(self, key: K, result: Future[V]) -> None:
        # After `clear` the same key may be computed a second time.
        if self._under_way.get(key) is result:
            del self._under_way[key]

    def _keep(self, key: K, value: V) -> None:
        size = self._size(value)
        if size > self.max_bytes:
            return
        while self._bytes + size > self.max_bytes:
            _, oldest = self._values.popitem(last=False)
            self._bytes -= self._size(oldest)
        self._values[key] = value
        self._bytes += size


@dataclass(frozen=True, eq=False)
class FrameImage:
    """Undistorted colour image of a frame.

    Attributes:
        frame: frame id.
        rgb: (H, W, 3) uint8, read-only; black outside the recorded image.
        camera: camera of the undistorted image; its distortion is empty.
    """

    frame: int
    rgb: NDArray[np.uint8]
    camera: Camera


class ImageCache:
    """Images by frame id; thread-safe.

    Images are read on demand. A missing or damaged file raises an error on each request until it
    is repaired.

    Args:
        scene: scene of the frames; refined intrinsics are used as soon as the scene has them.
        max_bytes: bound on the cached images.
        max_thumbnail_bytes: bound on the cached thumbnails, in addition to the images.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        max_bytes: int = 192 * MEGABYTE,
        max_thumbnail_bytes: int = 32 * MEGABYTE,
    ) -> None:
        self._scene = scene
        self._images: BoundedStore[tuple[int, Camera], FrameImage] = BoundedStore(
            max_bytes, lambda image: image.rgb.nbytes
        )
        self._thumbnails: BoundedStore[tuple[int, Camera], NDArray[np.uint8]] = BoundedStore(
            max_thumbnail_bytes, lambda rgb: rgb.nbytes
        )
        self._background = BackgroundReader(self.image)

    def __enter__(self) -> ImageCache:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- asking ------------------------------------------------------------------------------

    def image(self, frame_id: int) -> FrameImage:
        """Return the image of a frame, reading it if it is not cached.

        Raises:
            ToolkitError: no such frame, or its file is missing, damaged or of another size.
        """
        frame = self._scene.frame(frame_id)
        camera = self._scene.camera(frame)
        return self._images.get((frame_id, camera), lambda: self._read(frame, camera))

    def held(self, frame_id: int) -> FrameImage | None:
        """Return the image of a frame if it is cached, without reading.

        Raises:
            ToolkitError: no such frame.
        """
        return self._images.peek((frame_id, self._scene.camera(self._scene.frame(frame_id))))

    def thumbnail(self, frame_id: int, width: int) -> NDArray[np.uint8]:
        """Return an undistorted thumbnail (h, width, 3) uint8, read-only.

        Args:
            width: pixels; clipped to the width of the image.

        Raises:
            ToolkitError: as `image` does.
        """
        frame = self._scene.frame(frame_id)
        camera = self._scene.camera(frame)
        width = min(width, camera.width)
        small = camera.resized(width, max(1, round(width * camera.height / camera.width)))

        def make() -> NDArray[np.uint8]:
            whole = self._images.peek((frame_id, camera))
            if whole is not None:
                return _frozen(cv2.resize(whole.rgb, small.size, interpolation=cv2.INTER_AREA))
            rgb = self._scene.read_color(frame)
            # The image is not cached: hundreds of thumbnails would evict the images in use.
            rgb = cv2.resize(rgb, small.size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
            return _frozen(undistort_image(rgb, small))

        return self._thumbnails.get((frame_id, small), make)

    # --- reading ahead -----------------------------------------------------------------------

    def prefetch(self, frame_ids: Iterable[int]) -> None:
        """Read these frames in the background, in this order, instead of earlier requests.

        Fills at most half of the cache and skips frames that cannot be read.
        """
        room, wanted = self._images.max_bytes // 2, []
        for frame_id in frame_ids:
            camera = self._scene.camera(self._scene.frame(frame_id))
            room -= 3 * camera.width * camera.height
            if room < 0:
                break
            wanted.append(frame_id)
        self._background.request(wanted)

    def wait_for_prefetch(self, timeout_s: float | None = None) -> bool:
        """Wait until prefetching is finished; False after `timeout_s`."""
        return self._background.wait(timeout_s)

    def close(self) -> None:
        """Stop prefetching and release all images. `image` still works."""
        self._background.close()
        self.clear()

    def clear(self) -> None:
        """Remove all images, for example after files were replaced."""
        self._images.clear()
        self._thumbnails.clear()

    @property
    def bytes_held(self) -> int:
        """Return the bytes of the cached images, without thumbnails."""
        return self._images.bytes_held

    @property
    def frames_held(self) -> list[int]:
        """Return the frames of the cached images, next to be evicted first."""
        return [frame_id for frame_id, _ in self._images.held()]

    # --- reading -----------------------------------------------------------------------------

    def _read(self, frame: Frame, camera: Camera) -> FrameImage:
        rgb = self._scene.read_color(frame)
        if camera.is_distorted:
            rgb = undistort_image(rgb, camera)  # type: ignore[assignment]
        return FrameImage(frame.id, _frozen(rgb), camera.without_distortion())


def _frozen(rgb: NDArray[np.generic] | cv2.typing.MatLike) -> NDArray[np.uint8]:
    """Make an array read-only, because several callers share it."""
    shared = np.asarray(rgb, dtype=np.uint8)
    shared.flags.writeable = False
    return shared
