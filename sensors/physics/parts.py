"""The convex parts of assets, made once and kept in a folder by the shape's hash."""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensors.assets.asset import Asset
from sensors.physics.coacd_process import SETTINGS
from sensors.physics.decompose import decompose
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic

Array = NDArray[np.float64]
# Changed whenever the same settings give other parts.
_EDITION = 2


def convex_parts(asset: Asset, cache: Path | None = None) -> tuple[Array, ...]:
    """Corners (N, 3) of the asset's convex parts, canonical coordinates.

    Args:
        cache: folder that keeps them over runs; None keeps nothing. Processes may share it: each
            shape is made by one of them while the others wait for it, a killed one leaves nothing
            half-written, and a damaged file is made again.

    Raises:
        ToolkitError: the folder cannot be written to, or coacd is not installed.
    """
    if cache is None:
        return decompose(asset.vertices, asset.faces).parts
    key = _key(asset)
    path = cache / f"{key}.npz"
    if (kept := _read(path)) is not None:
        return kept
    with _lock(cache, key):
        if (kept := _read(path)) is not None:
            return kept
        made = decompose(asset.vertices, asset.faces)
        if made.lasting:
            buffer = io.BytesIO()
            sizes = np.array([len(p) for p in made.parts])
            np.savez(buffer, vertices=np.concatenate(made.parts), sizes=sizes)
            write_bytes_atomic(path, buffer.getvalue())
    return made.parts


def _key(asset: Asset) -> str:
    """What the parts depend on: the shape, the settings and the decomposer's version."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        coacd = version("coacd")
    except PackageNotFoundError:
        coacd = ""
    made_of = json.dumps([_EDITION, coacd, SETTINGS, asset.content_hash], sort_keys=True)
    return hashlib.sha256(made_of.encode()).hexdigest()[:40]


def _read(path: Path) -> tuple[Array, ...] | None:
    """The parts of a file; None if it is not there or damaged."""
    try:
        with np.load(path, allow_pickle=False) as data:
            vertices, sizes = data["vertices"], data["sizes"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    right = (
        vertices.ndim == 2
        and vertices.shape[1] == 3
        and vertices.dtype == np.float64
        and bool(np.isfinite(vertices).all())
        and sizes.ndim == 1
        and sizes.dtype.kind == "i"
        and len(sizes) > 0
        and int(sizes.min()) >= 4
        and int(sizes.sum()) == len(vertices)
    )
    return tuple(np.split(vertices, np.cumsum(sizes)[:-1])) if right else None


@contextmanager
def _lock(cache: Path, key: str) -> Iterator[None]:
    """Held by one process per shape; dying frees it."""
    folder = cache / ".locks"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / key, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise ToolkitError(
            f"cannot write to the folder of convex parts: {error.strerror}", path=cache
        ) from error
    try:
        # A file system without locks costs work done twice, nothing else: writes are atomic.
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
