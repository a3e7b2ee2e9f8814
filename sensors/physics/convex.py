"""Convex parts of a mesh, computed once and cached in a folder by the shape's hash."""

import fcntl
import hashlib
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensors.assets.asset import Asset, surface_points
from sensors.physics.coacd_process import SETTINGS
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.foreign_files import read_npz
from std_toolkit.log import logger

Array = NDArray[np.float64]

# Tolerance for a body with a bounding-box diagonal of 1: finer details cost time without effect.
_SIMPLIFIED = 0.0015

# A body that fills at least this fraction of its convex hull is replaced by the hull.
_CONVEX = 0.98

# A body that fills less is a vessel or has arms: objects may be inside it, and its parts may
# protrude less. The parts contain the surface either way; protrusion causes a gap, no overlap.
_OPEN = 0.6

_THRESHOLD_OPEN, _THRESHOLD_FULL = 0.08, 0.12

# Processor time, which depends little on what else runs; and its multiple by the clock, for a
# process that waits forever.
_TIME_LIMIT_S, _PATIENCE = 300.0, 20

# Flat parts get this thickness: the physics engine requires a volume.
_THINNEST = 4e-4

# Sample points of a surface: about 1 % of its size apart.
_SAMPLES = 20_000

# Increased whenever the same settings give other parts.
_EDITION = 2


@dataclass(frozen=True, eq=False)
class Decomposition:
    """Convex parts of a body.

    Attributes:
        parts: corners (N, 3) of each part's hull.
        lasting: whether a retry would give the same result; false after a killed process.
    """

    parts: tuple[Array, ...]
    lasting: bool = True


def decompose(
    vertices: Array,
    faces: NDArray[np.int64],
    *,
    coarse: bool = False,
    time_limit_s: float = _TIME_LIMIT_S,
) -> Decomposition:
    """Cut a surface with a bounding-box diagonal of 1 into convex parts (CoACD).

    Every vertex is inside a part, so that the collision bodies contain the whole surface. Closed
    cavities are filled. If CoACD fails, a warning is logged and the convex hull is used. `coarse`
    uses the hull of every surface that fills at least 60 % of it.

    Raises:
        ToolkitError: coacd is not installed.
    """
    shells, preprocess = _outer_shells(vertices, faces)
    corners = np.concatenate([v for v, _ in shells])
    filling = _filling(shells, corners)
    if filling >= (_OPEN if coarse else _CONVEX):
        return Decomposition((_hull(vertices),))
    threshold = _THRESHOLD_OPEN if filling < _OPEN else _THRESHOLD_FULL
    starts = np.cumsum([0, *(len(v) for v, _ in shells[:-1])])
    joined = np.concatenate([f + s for (_, f), s in zip(shells, starts, strict=True)])
    try:
        found = _by_coacd(corners, joined, preprocess, threshold, time_limit_s)
    except _Failed as failure:
        logger.warning("CoACD failed (%s): the object collides as its convex hull", failure)
        return Decomposition((_hull(vertices),), lasting=failure.lasting)
    hulls = [_hull(p) for p in found]
    if preprocess != "off":
        hulls = _tightened(hulls, vertices, faces)
    return Decomposition(_holding_all(hulls, vertices[np.unique(faces)]))


def _outer_shells(
    vertices: Array, faces: NDArray[np.int64]
) -> tuple[list[tuple[Array, NDArray[np.int64]]], str]:
    """Closed outer surfaces with few faces, and CoACD's preprocessing; the input if not closed."""
    from manifold3d import Error, Manifold, Mesh64

    mesh = Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(faces, dtype=np.uint64))
    solid = Manifold(mesh)
    if solid.status() != Error.NoError or solid.volume() <= 0:
        return [(vertices, faces)], "auto"
    shells = []
    for part in solid.simplify(_SIMPLIFIED).decompose():
        if part.volume() > 0:
            got = part.to_mesh64()
            shells.append((np.array(got.vert_properties[:, :3]), np.array(got.tri_verts, np.int64)))
    # Already edge-manifold: remeshing, which "auto" does at any self-contact, would thicken it.
    return (shells, "off") if shells else ([(vertices, faces)], "auto")


def _filling(shells: list[tuple[Array, NDArray[np.int64]]], corners: Array) -> float:
    """Fraction of the convex hull that the shells fill."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = float(ConvexHull(corners).volume)
    except QhullError:
        return 1.0
    volume = 0.0
    for v, f in shells:
        a, b, c = (v[f[:, i]] for i in range(3))
        volume += float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6
    return volume / hull


class _Failed(Exception):
    def __init__(self, reason: str, *, lasting: bool) -> None:
        super().__init__(reason)
        self.lasting = lasting


def _by_coacd(
    vertices: Array,
    faces: NDArray[np.int64],
    preprocess: str,
    threshold: float,
    time_limit_s: float,
) -> list[Array]:
    from importlib.util import find_spec

    if find_spec("coacd") is None:
        raise ToolkitError("coacd is not installed", hint="pip install 'std-toolkit[sim]'")
    with tempfile.TemporaryDirectory(prefix="std-coacd-") as folder:
        source, target = Path(folder, "in.npz"), Path(folder, "out.npz")
        np.savez(source, vertices=vertices, faces=faces, preprocess=preprocess, threshold=threshold)
        status, said = _run(source, target, Path(folder, "said.txt"), time_limit_s)
        if status == -signal.SIGXCPU:
            raise _Failed(f"no result in {time_limit_s:g} s of processor time", lasting=True)
        if status:
            killed = status in (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT)
            reason = f"status {status}" + "".join(f", {line[:200]}" for line in said[-1:])
            raise _Failed(reason, lasting=not killed)
        with np.load(target, allow_pickle=False) as data:
            return np.split(data["vertices"], np.cumsum(data["sizes"])[:-1])


def _run(source: Path, target: Path, said: Path, time_limit_s: float) -> tuple[int, list[str]]:
    """Exit status of the process and its output lines."""
    # For the same parts on every machine: one thread and a fixed seed.
    # This package first: a folder of the user may have its name.
    path = os.pathsep.join([str(Path(__file__).resolve().parents[2]), *sys.path])
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": path}
    with said.open("wb") as file:
        process = subprocess.Popen(
            [
                *(sys.executable, "-P", "-m", "sensors.physics.coacd_process"),
                *(source, target, str(max(1, round(time_limit_s)))),
            ],
            # Kept open: its end signals to the process that its parent died.
            stdin=subprocess.PIPE,
            stdout=file,
            stderr=file,
            env=environment,
            start_new_session=True,
        )
        try:
            status = process.wait(_PATIENCE * time_limit_s)
        except subprocess.TimeoutExpired as error:
            waited = f"no result in {_PATIENCE * time_limit_s:g} s"
            raise _Failed(waited, lasting=False) from error
        finally:
            process.kill()
            process.wait()
            assert process.stdin is not None
            process.stdin.close()
    return status, said.read_text(errors="replace").strip().splitlines()


def _hull(points: Array) -> Array:
    """Corners of the convex hull; flat point sets get a minimum thickness."""
    from scipy.spatial import ConvexHull, QhullError

    centred = points - points.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2] if len(points) > 2 else np.eye(3)
    thin = [axis for axis in axes if np.ptp(centred @ axis) < _THINNEST]
    thick = points
    for axis in thin:
        thick = np.concatenate([thick - _THINNEST / 2 * axis, thick + _THINNEST / 2 * axis])
    try:
        return thick[ConvexHull(thick).vertices]
    except QhullError:
        return _box_corners(points)


def _box_corners(points: Array) -> Array:
    low, high = points.min(axis=0) - _THINNEST / 2, points.max(axis=0) + _THINNEST / 2
    return np.array(list(product(*zip(low, high, strict=True))))


def _tightened(parts: list[Array], vertices: Array, faces: NDArray[np.int64]) -> list[Array]:
    """Parts shrunk to the surface that they contain.

    Remeshing thickens a body by about 0.6 % of its size on every side: objects would float more
    than a millimetre above the floor.
    """
    surface = np.concatenate(
        [vertices[np.unique(faces)], surface_points(vertices, faces, _SAMPLES)]
    )
    shrunk = []
    for part in parts:
        mine = surface[_outside(part, surface) < 1e-6]
        if len(mine) >= 4:
            shrunk.append(_hull(mine))
    return shrunk or parts


def _outside(part: Array, points: Array) -> Array:
    """(N,) distance of points outside a convex part, negative inside."""
    from scipy.spatial import ConvexHull

    planes = ConvexHull(part).equations
    out = np.full(len(points), -np.inf)
    for block in np.array_split(np.arange(len(points)), max(1, len(points) // 4096)):
        out[block] = (points[block] @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    return out


def _holding_all(parts: list[Array], vertices: Array) -> tuple[Array, ...]:
    """Parts extended by the vertices that are outside all of them."""
    outside = np.full(len(vertices), np.inf)
    nearest = np.zeros(len(vertices), dtype=np.int64)
    for k, part in enumerate(parts):
        out = _outside(part, vertices)
        closer = out < outside
        outside[closer], nearest[closer] = out[closer], k
    grown = []
    for k, part in enumerate(parts):
        mine = vertices[(nearest == k) & (outside > 1e-7)]
        grown.append(_hull(np.concatenate([part, mine])) if len(mine) else part)
    return tuple(grown)


def convex_parts(
    asset: Asset, cache: Path | None = None, *, coarse: bool = False
) -> tuple[Array, ...]:
    """Corners (N, 3) of the asset's convex parts, canonical coordinates.

    Args:
        cache: folder that caches them across runs; None disables the cache. Processes may share
            it: one process computes each shape while the others wait for it, a killed one leaves no
            partial file, and a damaged file is computed again.
        coarse: see `decompose`.

    Raises:
        ToolkitError: the folder is not writable, or coacd is not installed.
    """
    if cache is None:
        return decompose(asset.vertices, asset.faces, coarse=coarse).parts
    key = _key(asset, coarse)
    path = cache / f"{key}.npz"
    if (kept := _read(path)) is not None:
        return kept
    with _lock(cache, key):
        if (kept := _read(path)) is not None:
            return kept
        made = decompose(asset.vertices, asset.faces, coarse=coarse)
        if made.lasting:
            buffer = io.BytesIO()
            sizes = np.array([len(p) for p in made.parts])
            np.savez(buffer, vertices=np.concatenate(made.parts), sizes=sizes)
            write_bytes_atomic(path, buffer.getvalue())
    return made.parts


def _key(asset: Asset, coarse: bool) -> str:
    """Cache key: the shape, the settings and the decomposer's version."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        coacd = version("coacd")
    except PackageNotFoundError:
        coacd = ""
    settings = {**SETTINGS, "coarse": True} if coarse else SETTINGS
    made_of = json.dumps([_EDITION, coacd, settings, asset.content_hash], sort_keys=True)
    return hashlib.sha256(made_of.encode()).hexdigest()[:40]


def _read(path: Path) -> tuple[Array, ...] | None:
    """The parts in a file; None if it does not exist or is damaged."""
    try:
        data = read_npz(path)
        vertices, sizes = data["vertices"], data["sizes"]
    except (ToolkitError, KeyError):
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
    """A lock per shape across processes; released when the process dies."""
    folder = cache / ".locks"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / key, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise ToolkitError(
            f"cannot write to the folder of convex parts: {error.strerror}", path=cache
        ) from error
    try:
        # On a file system without locks the only cost is duplicated work: writes are atomic.
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
