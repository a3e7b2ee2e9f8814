"""Arguments of `std-sim` for a small set, and what it writes."""

from __future__ import annotations

import hashlib
from pathlib import Path


def arguments(out: Path, shapes: Path, *more: str) -> list[str]:
    return [
        *("--out", str(out), "--assets", "folder", "--assets-root", str(shapes)),
        *("--preset", "tiny", "--width", "160", "--height", "90", "--views", "2"),
        *more,
    ]


def contents(folder: Path) -> dict[str, str]:
    return {
        p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }
