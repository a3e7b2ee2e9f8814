"""COLMAP models: what their files claim is compared with their sizes before COLMAP reads them.

COLMAP believes counts. A file of 8 bytes that claims 10^12 frames is read for hours. Layout of the
files: https://colmap.github.io/format.html and `src/colmap/scene/reconstruction_io_binary.cc`.
"""

import struct
from collections.abc import Callable
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.io.regular import open_regular_file

# The largest real models have points of some 10^7 images: 4 GB.
_LARGEST_BYTES = 8 * 2**30
_LARGEST_IMAGE = 100_000
# Number of parameters by the number of the camera model.
_PARAMETERS = (3, 4, 4, 5, 8, 8, 12, 5, 4, 5, 12, 16, 4, 5, 3, 4, 6, 2)
_POSE = 56  # quaternion and translation


def check_colmap_model(folder: Path) -> None:
    """Check that the binary files of a model hold what they claim.

    Raises:
        ToolkitError: a file is no regular one or damaged; names the file and the entry.
    """
    for name, walk in _WALKS.items():
        path = folder / f"{name}.bin"
        if path.exists() or path.is_symlink():
            with open_regular_file(path, "COLMAP file", _LARGEST_BYTES) as file:
                _check(_Entries(path, file.read()), walk)
        path = folder / f"{name}.txt"
        if path.exists() or path.is_symlink():
            open_regular_file(path, "COLMAP file", _LARGEST_BYTES).close()


class _Entries:
    """Bytes of a file, read from its beginning."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self.data, self.at, self.number = path, data, 0, 0

    def numbers(self, layout: str) -> tuple[int, ...]:
        layout = f"<{layout}"
        self.skip(struct.calcsize(layout))
        return struct.unpack_from(layout, self.data, self.at - struct.calcsize(layout))

    def skip(self, count: int) -> None:
        self.at += count
        if self.at > len(self.data):
            raise self.damaged("the file ends within it")

    def name(self) -> None:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise self.damaged("its name has no end")
        try:
            self.data[self.at : end].decode()
        except UnicodeDecodeError:
            shown = self.data[self.at : end][:40]
            raise self.damaged("its name is not UTF-8", shown) from None
        self.at = end + 1

    def damaged(self, problem: str, value: object = None) -> ToolkitError:
        return ToolkitError(
            f"the COLMAP file is damaged: {problem}", path=self.path,
            field=f"entry {self.number}", value=value,
        )  # fmt: skip


def _check(entries: _Entries, walk: Callable[[_Entries], bool | None]) -> None:
    if len(entries.data) < 8:
        raise entries.damaged("it has no number of entries")
    (count,) = entries.numbers("Q")
    if count > len(entries.data):
        raise ToolkitError(
            f"the COLMAP file is damaged: it claims {count} entries in {len(entries.data)} bytes",
            path=entries.path,
        )
    for number in range(count):
        entries.number = number
        if walk(entries):
            return


def _camera(entries: _Entries) -> bool:
    """Whether the number of parameters is not known here, and so where the next entry begins."""
    _, model, width, height = entries.numbers("IiQQ")
    if not 0 <= model < len(_PARAMETERS):
        return True
    if not (0 < width <= _LARGEST_IMAGE and 0 < height <= _LARGEST_IMAGE):
        raise entries.damaged("an implausible size", f"{width}x{height}")
    entries.skip(8 * _PARAMETERS[model])
    return False


def _image(entries: _Entries) -> None:
    entries.skip(4 + _POSE + 4)
    entries.name()
    (points,) = entries.numbers("Q")
    entries.skip(24 * points)


def _point(entries: _Entries) -> None:
    entries.skip(8 + 24 + 3 + 8)
    (track,) = entries.numbers("Q")
    entries.skip(8 * track)


def _rig(entries: _Entries) -> None:
    _, sensors = entries.numbers("II")
    entries.skip(8 if sensors else 0)
    for _ in range(sensors - 1):
        entries.skip(8)
        (has_pose,) = entries.numbers("B")
        entries.skip(_POSE if has_pose else 0)


def _frame(entries: _Entries) -> None:
    entries.skip(8 + _POSE)
    (data,) = entries.numbers("I")
    entries.skip(16 * data)


_WALKS: dict[str, Callable[[_Entries], bool | None]] = {
    "cameras": _camera,
    "images": _image,
    "points3D": _point,
    "rigs": _rig,
    "frames": _frame,
}
