"""A first look: coarse, coloured hulls in small photos, by the poses of the board alone.

It takes seconds and comes before features are matched, so that wrong photos, a wrong pick or a
forgotten object on the board show early.
"""

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.jobs.door import own_files
from std_toolkit.log import logger
from std_toolkit.scanning.board.board_poses import board_starts
from std_toolkit.scanning.board.photo_poses import BoardFound
from std_toolkit.scanning.masks.masks import hull_surface
from std_toolkit.scanning.masks.object_masks import Things, own_masks, table_masks
from std_toolkit.scanning.masks.standing import StandingSettings, small_view
from std_toolkit.scanning.options import ScanOptions
from std_toolkit.scanning.photos.photos import make_view
from std_toolkit.scanning.photos.posed_photos import PosedPhotos
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.photos.visibility import depth_of, seen_from, vertex_normals

PREVIEW = "preview.ply"

# Voxels of the hull of one object.
_CELLS = 400_000
_SMOOTHED = 8

Mesh = tuple[Array, NDArray[np.int64]]


def write_preview(options: ScanOptions, found: BoardFound) -> None:
    """Write `preview.ply` into the folder of the model, and say so or why not in one line.

    It has metres, the frame of the board and vertex colours. It holds the object, if there is one
    or one is picked, and else everything on the board.

    Args:
        options: of the scan.
        found: the board in the photos.

    Raises:
        ToolkitError: a file of the user has its name.
    """
    began = perf_counter()
    reason = _not_wanted(options)
    if reason is None:
        try:
            posed = _small(options, found)
            meshes = _meshes(options, posed)
        except ToolkitError as error:
            # The scan itself, with all photos, decides and says what to do.
            reason = error.problem
    if reason is not None:
        logger.info("preview: none: %s", reason)
        return
    vertices, faces = _joined(meshes)
    colors = _colors(vertices, faces, posed.views)
    with own_files(options.out, [PREVIEW]):
        write_bytes_atomic(options.out / PREVIEW, _ply(vertices, faces, colors))
    logger.info(
        "preview: %s: %s, by the board alone, in %.0f s", options.out / PREVIEW,
        "the object" if len(meshes) == 1 else f"{len(meshes)} objects", perf_counter() - began,
    )  # fmt: skip


def remove_preview(options: ScanOptions) -> None:
    """Remove the preview: the model is there."""
    if (options.out / PREVIEW).exists():
        with own_files(options.out, [PREVIEW]):
            (options.out / PREVIEW).unlink()


def _not_wanted(options: ScanOptions) -> str | None:
    if not options.preview:
        return "--no-preview"
    if options.revolve and options.masks is None:
        return "--revolve finds glass in all photos only"
    return None


def _small(options: ScanOptions, found: BoardFound) -> PosedPhotos:
    """Some photos, small, with the poses of the board.

    Raises:
        ToolkitError: the board gives too few poses.
    """
    limits = StandingSettings.current()
    poses, placed = board_starts(found.detections, found.cameras)
    known = sorted(poses)
    spread = np.linspace(0, len(known) - 1, min(len(known), limits.photos)).round().astype(int)
    chosen = {known[n] for n in spread.tolist()}
    for text in (options.pick, options.box):
        name = "" if text is None else text.rpartition(":")[0]
        chosen |= {n for n in known if _named(found, n, name)}
    views, sizes = [], [found.photos.size_of(i) for i in range(len(found.photos.paths))]
    for n in sorted(chosen):
        view = make_view(found.photos, found.kept[n], found.cameras.of(n), poses[n])
        views.append(small_view(view, limits.longest_px))
        sizes[found.kept[n]] = views[-1].camera.size
    if len(views) < limits.fewest_photos:
        raise ToolkitError(f"the board gives a pose in {len(views)} photos")
    corners = np.unique(np.concatenate([p.xyz for p in placed]), axis=0)
    return PosedPhotos(
        views=views, corners=corners, points=np.zeros((0, 3)), on_table=True, facts={}, warnings=[],
        digest="", photos=replace(found.photos, sizes=tuple(sizes)),
    )  # fmt: skip


def _named(found: BoardFound, n: int, name: str) -> bool:
    path = found.photos.paths[found.kept[n]]
    return name in (path.name, path.stem)


def _meshes(options: ScanOptions, posed: PosedPhotos) -> list[Mesh]:
    """The hull of the object, or those of all."""
    threads = options.jobs.worker_count
    own = own_masks(options.masks, posed)
    masked = [v.with_mask(own[v.name]) for v in posed.views if v.name in own]
    if len(masked) < StandingSettings.current().fewest_photos:
        things = Things(posed, threads)
        found = things.standing.candidates
        if not found:
            raise ToolkitError("nothing was found standing on the board")
        if len(found) > 1 and options.pick is None and options.box is None:
            return [c.agreed or (c.vertices, c.faces) for c in found]
        masked = table_masks(options, things, threads)
    vertices, faces = hull_surface(masked, cells=_CELLS, allowed=1, threads=threads)
    # No photo sees the foot from below: there the hull of few goes on into the table.
    vertices[:, 2] = np.maximum(vertices[:, 2], 0)
    return [(vertices, faces)]


def _joined(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of all, smoothed: steps of voxels are no shape."""
    import trimesh

    together = trimesh.util.concatenate(
        [trimesh.Trimesh(vertices, faces, process=False) for vertices, faces in meshes]
    )
    assert isinstance(together, trimesh.Trimesh)
    trimesh.smoothing.filter_taubin(together, iterations=_SMOOTHED)
    return np.asarray(together.vertices), np.asarray(together.faces, np.int64)


def _colors(vertices: Array, faces: NDArray[np.int64], views: Sequence[View]) -> NDArray[np.uint8]:
    """(V, 3) mean colours of the photos that show the vertices, grey without one."""
    caster = RayCaster(vertices, faces, threads=1)
    normals = vertex_normals(vertices, faces)
    total, weight = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for view in views:
        color, w = seen_from(view, vertices, normals, depth_of(view, caster))
        total += color * w[:, None] ** 2
        weight += w**2
    colors = np.where(weight[:, None] > 0, total / np.maximum(weight, 1e-12)[:, None], 128)
    return np.clip(np.rint(colors), 0, 255).astype(np.uint8)


def _ply(vertices: Array, faces: NDArray[np.int64], colors: NDArray[np.uint8]) -> bytes:
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, vertex_colors=colors, process=False)
    written = mesh.export(file_type="ply")
    assert isinstance(written, bytes)
    return written
