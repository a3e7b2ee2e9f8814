"""The table of frames of a recording in progress, kept on disk.

Writing the whole table for every frame would become slower and slower. The interval is such that
writing takes a tenth of the time: every frame at first, every half second after some thousand
frames. In between, a line per finished frame is appended to a journal; `recovered` completes the
table from it after a killed recording.
"""

import os
import threading
import time
from contextlib import suppress
from pathlib import Path

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import sweep_temporaries
from std_toolkit.io.documents import write_document
from std_toolkit.scene import Frame, Frames, Scene

_SHARE = 0.1


def journal_path(root: Path) -> Path:
    return root / ".std" / "recording.jsonl"


def recovered(root: Path) -> Scene:
    """The scene with all frames that a killed recording finished; requires the scene's lock.

    Raises:
        ToolkitError: the scene is damaged, or cannot be written.
    """
    sweep_temporaries(root)
    scene = Scene.open(root)
    path = journal_path(root)
    if not path.is_file():
        return scene
    known = {frame.id for frame in scene.frames}
    found = [
        row
        for row in _journal_rows(path)
        if row.id not in known
        and (root / row.color).is_file()
        and (row.depth is None or (root / row.depth).is_file())
    ]
    if found:
        rows = sorted([*scene.frames, *found], key=lambda row: row.id)
        write_document(root / "frames.json", Frames(frames=rows))
        scene.reread()
    path.unlink()
    return scene


def _journal_rows(path: Path) -> list[Frame]:
    rows: dict[int, Frame] = {}
    for line in path.read_bytes().split(b"\n"):
        # Only the last line can be incomplete.
        with suppress(msgspec.MsgspecError, ToolkitError):
            row = msgspec.json.decode(line, type=Frame)
            rows[row.id] = row
    return list(rows.values())


class FrameTable:
    """Accepts rows by `add` from any thread; `close` writes the final table.

    Attributes:
        error: reason why the table could not be written, if that happened.
    """

    def __init__(self, root: Path, rows: list[Frame]) -> None:
        self._root = root
        self._rows = {row.id: row for row in rows}
        self._written = len(self._rows)
        self._mutex = threading.Lock()
        self._wake = threading.Condition(self._mutex)
        self._closing = False
        self.error: Exception | None = None
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW
        self._journal = os.open(journal_path(root), flags, 0o666)
        self._thread = threading.Thread(target=self._publish, name="frames.json", daemon=True)
        self._thread.start()

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, row: Frame) -> None:
        """Add a frame whose files are written.

        Raises:
            OSError: the journal cannot be written.
        """
        line = msgspec.json.encode(row) + b"\n"
        with self._wake:
            os.write(self._journal, line)
            self._rows[row.id] = row
            self._wake.notify()

    def close(self) -> None:
        """Write the remaining rows and stop.

        Raises:
            ToolkitError: the table cannot be written; the journal stays.
        """
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()
        os.close(self._journal)
        if self._written < len(self._rows):
            self._write(sorted(self._rows.values(), key=lambda row: row.id))
        with suppress(OSError):
            journal_path(self._root).unlink()

    def _publish(self) -> None:
        pause = 0.0
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._closing, timeout=pause)
                self._wake.wait_for(lambda: self._closing or self._written < len(self._rows))
                if self._closing:
                    return
                rows = sorted(self._rows.values(), key=lambda row: row.id)
            began = time.monotonic()
            try:
                self._write(rows)
            except Exception as error:
                self.error = error
                return
            pause = (time.monotonic() - began) * (1 / _SHARE - 1)

    def _write(self, rows: list[Frame]) -> None:
        write_document(self._root / "frames.json", Frames(frames=rows))
        self._written = len(rows)
