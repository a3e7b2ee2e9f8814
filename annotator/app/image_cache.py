"""Colour images of a scene without lens distortion, read lazily and kept within a bound.

A store that never holds more bytes than allowed, shared by threads.

A few threads that work off a list which may be replaced or dropped at any time.
"""

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
    """Calls `read(item)` for items in order; threads live only while there is work.

    Args:
        read: what to do; a ToolkitError is logged and the next item taken.
        threads: how many work at once.
    """

    def __init__(self, read: Callable[[int], object], *, threads: int = 1) -> None:
        self._read = read
        self._threads = threads
        self._waiting: deque[int] = deque()
        self._running = 0
        self._closed = False
        self._changed = threading.Condition()

    def request(self, items: Iterable[int]) -> None:
        """Read these, instead of what is still waiting. Nothing once closed."""
        with self._changed:
            if self._closed:
                return
            self._waiting = deque(dict.fromkeys(items))
            for _ in range(min(self._threads, len(self._waiting)) - self._running):
                self._running += 1
                threading.Thread(target=self._work, name="read-frames").start()

    def cancel(self) -> None:
        """Drop what is waiting; what is being read now ends by itself."""
        self.request(())

    def close(self) -> None:
        """Cancel, and wait for what is being read now; call it from outside of `read`."""
        with self._changed:
            self._waiting.clear()
            self._closed = True
        self.wait()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until nothing is left to read; False if that took longer than `timeout_s`."""
        with self._changed:
            return self._changed.wait_for(lambda: self._running == 0, timeout_s)

    def _work(self) -> None:
        while True:
            with self._changed:
                # When the program ends, Python waits for this thread: stop after this item.
                if not self._waiting or not threading.main_thread().is_alive():
                    self._waiting.clear()
                    self._running -= 1
                    self._changed.notify_all()
                    return
                item = self._waiting.popleft()
            try:
                self._read(item)
            except ToolkitError as error:
                # Whoever needs it gets the error when asking for it.
                logger.debug("reading ahead: %s", error)
            except Exception:
                logger.exception("reading ahead failed")


class BoundedStore(Generic[K, V]):
    """What was made and used last, up to a number of bytes; the rest is made again when asked for.

    A value that several threads ask for at once is made once, and a failure is not kept. What is
    larger than the bound is handed out without being kept.

    Args:
        max_bytes: bound on the values held here; callers may hold others.
        size: bytes of a value.
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
        """The value of `key`, by `make()` if it is not held; raises what `make` raises."""
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
        """The value if it is held; does not count as a use."""
        with self._lock:
            return self._values.get(key)

    def clear(self) -> None:
        """Forget everything, also what is being made now."""
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
        """Keys of what is held; the first is the next to go."""
        with self._lock:
            return list(self._values)

    def _end(self, key: K, result: Future[V]) -> None:
        # After `clear` the same key may be under way a second time.
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
    """The image of a frame as a camera without lens distortion would have seen it.

    Attributes:
        frame: frame id.
        rgb: (H, W, 3) uint8, read-only; black where the lens saw nothing.
        camera: the camera that fits the image; its distortion is empty.
    """

    frame: int
    rgb: NDArray[np.uint8]
    camera: Camera


class ImageCache:
    """Images by frame id; may be used from several threads.

    Nothing is read before it is asked for. A file that is missing or damaged raises each time it is
    asked for, until it is mended.

    Args:
        scene: where the frames are; refined intrinsics are used as soon as the scene has them.
        max_bytes: bound on the images kept.
        max_thumbnail_bytes: bound on the thumbnails kept, besides the images.
        threads: how many images `prefetch` reads at once.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        max_bytes: int = 192 * MEGABYTE,
        max_thumbnail_bytes: int = 32 * MEGABYTE,
        threads: int = 1,
    ) -> None:
        self._scene = scene
        self._images: BoundedStore[tuple[int, Camera], FrameImage] = BoundedStore(
            max_bytes, lambda image: image.rgb.nbytes
        )
        self._thumbnails: BoundedStore[tuple[int, Camera], NDArray[np.uint8]] = BoundedStore(
            max_thumbnail_bytes, lambda rgb: rgb.nbytes
        )
        self._on_ready: Callable[[int], None] | None = None
        self._background = BackgroundReader(self._read_ahead, threads=threads)

    def __enter__(self) -> ImageCache:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- asking ------------------------------------------------------------------------------

    def image(self, frame_id: int) -> FrameImage:
        """The image of a frame, read now if it is not held.

        Raises:
            ToolkitError: no such frame, or its file is missing, damaged or of another size.
        """
        frame = self._scene.frame(frame_id)
        camera = self._scene.camera(frame)
        return self._images.get((frame_id, camera), lambda: self._read(frame, camera))

    def held(self, frame_id: int) -> FrameImage | None:
        """The image of a frame if it is held, without reading anything.

        Raises:
            ToolkitError: no such frame.
        """
        return self._images.peek((frame_id, self._scene.camera(self._scene.frame(frame_id))))

    def thumbnail(self, frame_id: int, width: int) -> NDArray[np.uint8]:
        """A small image (h, width, 3) uint8 without lens distortion, read-only.

        Args:
            width: pixels; at most the image's own width is given.

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
            # The image is not kept: hundreds of thumbnails would drive out the images in use.
            rgb = cv2.resize(rgb, small.size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
            return _frozen(undistort_image(rgb, small))

        return self._thumbnails.get((frame_id, small), make)

    # --- reading ahead -----------------------------------------------------------------------

    def prefetch(
        self, frame_ids: Iterable[int], *, on_ready: Callable[[int], None] | None = None
    ) -> None:
        """Read these in the background, in this order, instead of what was asked for before.

        At most half of the cache is filled so, and frames that cannot be read are passed over.

        Args:
            on_ready: called with the frame's id, in the thread that read it.
        """
        self._on_ready = on_ready
        room, wanted = self._images.max_bytes // 2, []
        for frame_id in frame_ids:
            camera = self._scene.camera(self._scene.frame(frame_id))
            room -= 3 * camera.width * camera.height
            if room < 0:
                break
            wanted.append(frame_id)
        self._background.request(wanted)

    def cancel_prefetch(self) -> None:
        """Read no further ahead; the image being read now still comes."""
        self._background.cancel()

    def wait_for_prefetch(self, timeout_s: float | None = None) -> bool:
        """Wait until everything is read ahead; False if that took longer."""
        return self._background.wait(timeout_s)

    def close(self) -> None:
        """Stop reading ahead and let go of all images. `image` still works, unhurriedly."""
        self._background.close()
        self.clear()

    def clear(self) -> None:
        """Forget all images, as when files were replaced."""
        self._images.clear()
        self._thumbnails.clear()

    @property
    def bytes_held(self) -> int:
        """Bytes of the images held, thumbnails not counted."""
        return self._images.bytes_held

    @property
    def frames_held(self) -> list[int]:
        """Frames whose images are held; the first is the next to go."""
        return [frame_id for frame_id, _ in self._images.held()]

    # --- reading -----------------------------------------------------------------------------

    def _read_ahead(self, frame_id: int) -> None:
        self.image(frame_id)
        if self._on_ready is not None:
            self._on_ready(frame_id)

    def _read(self, frame: Frame, camera: Camera) -> FrameImage:
        rgb = self._scene.read_color(frame)
        if camera.is_distorted:
            rgb = undistort_image(rgb, camera)  # type: ignore[assignment]
        return FrameImage(frame.id, _frozen(rgb), camera.without_distortion())


def _frozen(rgb: NDArray[np.generic] | cv2.typing.MatLike) -> NDArray[np.uint8]:
    """Read-only, as many share it."""
    shared = np.asarray(rgb, dtype=np.uint8)
    shared.flags.writeable = False
    return shared
