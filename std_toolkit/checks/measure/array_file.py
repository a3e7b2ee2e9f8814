"""Arrays of many frames in a temporary file, so that memory does not grow with a recording."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError


class ArrayFile:
    """A file without a name to which arrays are appended.

    The system removes it when the block ends or the process does, however it ends. The pages of a
    mapped file would count as memory of the process: arrays are read into new memory instead.

    Args:
        folder: where the file lies; on a disk, as the system's folder of temporary files may not
            be.

    Raises:
        ToolkitError: the file cannot be made.

    Examples:
        >>> import tempfile
        >>> with ArrayFile(Path(tempfile.gettempdir())) as file:
        ...     kept = file.put(np.arange(3))
        ...     np.asarray(kept).tolist()
        [0, 1, 2]
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._end = 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # Unbuffered: what was put is in the file when the next line reads it.
            self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115
        except OSError as error:
            raise self._failed(error) from error

    def __enter__(self) -> ArrayFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Remove the file."""
        self._file.close()

    def put(self, array: NDArray[Any]) -> FiledArray:
        """Append an array.

        Raises:
            ToolkitError: the disk is full.
        """
        start, left = self._end, memoryview(array.tobytes())
        try:
            while left:
                written = os.pwrite(self._file.fileno(), left, self._end)
                self._end += written
                left = left[written:]
        except OSError as error:
            raise self._failed(error) from error
        return FiledArray(self, start, array.shape, array.dtype.str)

    def read(self, start: int, size: int) -> bytearray:
        """`size` bytes from `start`.

        Raises:
            ToolkitError: the file was cut by somebody else.
        """
        data = os.pread(self._file.fileno(), size, start)
        if len(data) != size:
            raise ToolkitError("a temporary file was cut short", path=self.folder)
        # Compiled code takes arrays that can be written to.
        return bytearray(data)

    def _failed(self, error: OSError) -> ToolkitError:
        return ToolkitError(
            f"cannot write a temporary file: {error.strerror or error}", path=self.folder
        )


@dataclass(frozen=True, eq=False, slots=True)
class FiledArray:
    """An array in an `ArrayFile`; `numpy.asarray` reads it."""

    file: ArrayFile
    start: int
    shape: tuple[int, ...]
    type: str

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        del copy  # what is read is always new
        kind = np.dtype(self.type)
        size = kind.itemsize * int(np.prod(self.shape))
        found = np.frombuffer(self.file.read(self.start, size), kind).reshape(self.shape)
        return found if dtype is None else found.astype(dtype, copy=False)
