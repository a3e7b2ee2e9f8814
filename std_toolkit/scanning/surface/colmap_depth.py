"""Depth maps by the stereo of COLMAP on a GPU, as the user installed it: `std-scan --depth colmap`.

The photos are written as a workspace of COLMAP with their known poses, `patch_match_stereo` runs in
it (J. L. Schoenberger et al., "Pixelwise View Selection for Unstructured Multi-View Stereo", 2016),
and its depth and normals are read where photos agree. It is run by the program `colmap` on the
PATH, or by pycolmap where that was built with CUDA.
"""

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.io.images import write_color
from std_toolkit.log import logger
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.photos.visibility import hull_depth
from std_toolkit.scanning.surface.depth_maps import DepthMap, choose_neighbours, object_window
from std_toolkit.scanning.surface.patch_match import Map
from std_toolkit.settings import Settings, limit

# COLMAP states no cost. Pixels on which its photos agree count as well-matched ones.
_COST = 0.1
# Pixels of the window in which the contrast is measured, as of the built-in engine.
_WINDOW_PX = 11


@dataclass(frozen=True, kw_only=True)
class ColmapDepthSettings(Settings):
    """Depth of COLMAP that is taken."""

    before: float = limit(0.06, source="as the built-in engine searches")
    """part of the largest depth below the hull by which a surface may lie before it"""


def check_colmap() -> None:
    """Raise an error unless COLMAP can run its stereo here.

    Raises:
        ToolkitError: there is neither a program nor a pycolmap with CUDA.
    """
    import pycolmap

    if shutil.which("colmap") is None and not pycolmap.has_cuda:
        raise ToolkitError(
            "needs COLMAP with CUDA: no program colmap is on the PATH, and pycolmap was built "
            "without it", field="--depth", value="colmap",
            hint="install COLMAP with CUDA, or take the built-in engine: --depth patchmatch",
        )  # fmt: skip


def colmap_depth(
    views: Sequence[View],
    hull: tuple[Array, NDArray[np.int64]],
    *,
    deepest: float,
    neighbours: int,
    threads: int,
) -> list[DepthMap | None]:
    """Depth maps as `depth_maps.depth_maps` makes them; `threads` is COLMAP's own choice.

    Raises:
        ToolkitError: COLMAP is not installed, or fails.
    """
    del threads
    check_colmap()
    vertices, faces = hull
    target = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    chosen = choose_neighbours(views, target, neighbours)
    far = [np.linalg.norm(vertices - view.centre, axis=1) for view in views]
    reach = (0.9 * min(d.min() for d in far), 1.1 * max(d.max() for d in far))
    caster = RayCaster(vertices - target, faces, threads=1)
    with tempfile.TemporaryDirectory(prefix="std-scan-") as folder:
        write_workspace(Path(folder), views, chosen)
        _run(Path(folder), reach)
        return [
            _map(Path(folder), k, view, caster, target, deepest) if chosen[k] else None
            for k, view in enumerate(views)
        ]


colmap_depth.check = check_colmap  # type: ignore[attr-defined]


def write_workspace(folder: Path, views: Sequence[View], chosen: Sequence[Sequence[int]]) -> None:
    """Write the photos with their poses as an undistorted workspace of COLMAP.

    Args:
        folder: an empty one.
        views: the photos.
        chosen: indices of the photos that each is compared with.
    """
    for name in ("images", "sparse", "stereo/depth_maps", "stereo/normal_maps"):
        (folder / name).mkdir(parents=True)
    (folder / "stereo/consistency_graphs").mkdir()
    cameras, images, pairs = [], [], []
    for k, view in enumerate(views):
        c, T = view.camera, view.T_world_cam.inverse()
        # COLMAP puts the middle of the first pixel at 0.5.
        cameras.append(
            f"{k + 1} PINHOLE {c.width} {c.height} {c.fx} {c.fy} {c.cx + 0.5} {c.cy + 0.5}"
        )
        numbers = " ".join(repr(float(x)) for x in (*T.quat(), *T.t))
        images.append(f"{k + 1} {numbers} {k + 1} {_name(k)}\n")
        write_color(folder / "images" / _name(k), view.image)
        if chosen[k]:
            pairs += [_name(k), ", ".join(_name(j) for j in chosen[k])]
    (folder / "sparse/cameras.txt").write_text("\n".join(cameras) + "\n", "utf-8")
    (folder / "sparse/images.txt").write_text("\n".join(images) + "\n", "utf-8")
    (folder / "sparse/points3D.txt").write_text("", "utf-8")
    (folder / "stereo/patch-match.cfg").write_text("\n".join(pairs) + "\n", "utf-8")


def read_array(path: Path) -> NDArray[np.float32]:
    """(H, W) or (H, W, C) values of a depth or normal map of COLMAP.

    Raises:
        ToolkitError: the file is cut off or no such map.
    """
    data = path.read_bytes()
    parts = data.split(b"&", 3)
    try:
        width, height, channels = (int(x) for x in parts[:3])
        values = np.frombuffer(parts[3], "<f4").reshape(channels, height, width)
    except (ValueError, IndexError):
        raise ToolkitError("no map of COLMAP, or it is cut off", path=path) from None
    return np.ascontiguousarray(values[0] if channels == 1 else np.moveaxis(values, 0, 2))


def _name(index: int) -> str:
    return f"{index:05d}.png"


def _run(folder: Path, reach: tuple[float, float]) -> None:
    program = shutil.which("colmap")
    if program is None:
        import pycolmap

        options = pycolmap.PatchMatchOptions()
        options.depth_min, options.depth_max = reach
        pycolmap.patch_match_stereo(folder, options=options)
        return
    words = [program, "patch_match_stereo", "--workspace_path", str(folder)]
    words += ["--workspace_format", "COLMAP", "--PatchMatchStereo.geom_consistency", "true"]
    words += ["--PatchMatchStereo.depth_min", f"{reach[0]:.6f}"]
    words += ["--PatchMatchStereo.depth_max", f"{reach[1]:.6f}"]
    logger.info("depth maps by %s", program)
    done = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        said = [line.strip() for line in (done.stderr + done.stdout).splitlines() if line.strip()]
        raise ToolkitError(
            f"colmap patch_match_stereo ended with status {done.returncode}: "
            f"{said[-1] if said else 'it says nothing'}", field="--depth", value="colmap",
            hint="does COLMAP see a CUDA GPU? --depth patchmatch needs none",
        )  # fmt: skip


def _map(
    folder: Path, index: int, view: View, caster: RayCaster, target: Array, deepest: float
) -> DepthMap | None:
    window = object_window(view.shown, 2)
    path = folder / "stereo/depth_maps" / f"{_name(index)}.geometric.bin"
    if window is None or not path.is_file():
        return None
    x0, y0, x1, y1 = window
    part = np.s_[y0:y1, x0:x1]
    depth = read_array(path)
    normal = read_array(folder / "stereo/normal_maps" / path.name)
    size = view.image.shape[:2]
    if depth.shape != size or normal.shape != (*size, 3):
        raise ToolkitError(
            "a map of COLMAP has another size than its photo", path=path, value=depth.shape
        )
    start, _ = hull_depth(view, caster, target, window)
    before = ColmapDepthSettings.current().before
    kept = view.shown[part] & (start > 0)
    kept &= (depth[part] > start - before * deepest) & (depth[part] < start + deepest)
    return DepthMap(
        x0,
        y0,
        np.where(kept, depth[part], 0).astype(np.float32),
        np.where(kept[..., None], normal[part], 0).astype(np.float32),
        np.full(kept.shape, _COST, np.float32),
        _contrast(view.grey())[part],
    )


def _contrast(grey: Map) -> Map:
    size = (_WINDOW_PX, _WINDOW_PX)
    mean, square = cv2.blur(grey, size), cv2.blur(grey * grey, size)
    return np.asarray(np.sqrt(np.maximum(square - mean * mean, 0)), np.float32)
