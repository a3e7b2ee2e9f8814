"""Point clouds of sensor depth, of one frame or fused over many.

Depth on glass and metal is included as measured, without a plausibility check. The fused cloud
leaves out depth at discontinuities, where points lie between two surfaces. It averages the points
of many frames in the cells of a voxel grid, in bounded memory.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.depth_maps import on_depth_step
from std_toolkit.geometry.ray_caster import import_open3d
from std_toolkit.geometry.se3 import SE3
from std_toolkit.rendering.renderer import image_window, normalised_rays
from std_toolkit.scene.scene import Frame, Scene, require_metres

# Beyond this the noise of a table-top sensor is larger than any useful voxel.
FARTHEST_M = 3.0

# With at least this number of frames, a point must be measured in two of them.
_FRAMES_FOR_SUPPORT = 4

# Two measurements of a surface are within this number of voxels of each other.
_SUPPORT_VOXELS = 3.0

# Cell indices have 21 bits per axis, which at 1 mm is a cube of 2 km.
_BITS = 21

_MIDDLE = 1 << (_BITS - 1)

# Maximum number of rows (56 bytes each) that are collected before they are added to the grid.
_PENDING_ROWS = 1_000_000


@dataclass(frozen=True, eq=False)
class FusedCloud:
    """Point cloud fused from the sensor depth of several frames.

    Attributes:
        points: (N, 3) float32, world frame, metres.
        colors: (N, 3) uint8 RGB.
        voxel_m: edge of the cells over which points and colours are averaged; larger than
            requested if there would have been more points than the limit.
        frames: ids of the fused frames.
        skipped: reasons by id of the frames that were skipped.
        missing: fraction of the pixels of `frames` without depth, 0 to 1.
    """

    points: Floats
    colors: NDArray[np.uint8]
    voxel_m: float
    frames: tuple[int, ...]
    skipped: dict[int, str]
    missing: float


class FusionCancelled(Exception):
    """`cancel` of the caller returned True."""


def frame_cloud(scene: Scene, frame: Frame, *, stride: int = 1) -> tuple[Floats, NDArray[np.uint8]]:
    """Return the point cloud of one frame.

    Args:
        scene: the recording.
        frame: frame with sensor depth.
        stride: step between pixels in x and y.

    Returns:
        Points (N, 3) float32 in the camera frame, metres, and their colours (N, 3) uint8 RGB.

    Raises:
        ToolkitError: the frame has no sensor depth, or one of its images cannot be read.
    """
    depth = _required_depth(scene, frame)
    part = _part(stride)
    points, use = _points(depth, scene.camera(frame), stride)
    return points[use], scene.read_color(frame)[part][use]


def fuse_clouds(
    scene: Scene,
    frames: Sequence[Frame],
    *,
    voxel_m: float = 0.003,
    limit: int = 200_000,
    farthest_m: float = FARTHEST_M,
    progress: Callable[[float], None] | None = None,
    cancel: Callable[[], bool] | None = None,
) -> FusedCloud:
    """Fuse the sensor depth of several frames into one cloud in the world, averaged in voxels.

    Leaves out depth at discontinuities and, with four or more frames, points measured in only one
    frame. Memory is bounded for any number of frames.

    Args:
        scene: the recording.
        frames: frames to fuse; those without depth or camera pose are skipped and listed in the
            result.
        voxel_m: edge of the cells.
        limit: maximum number of points; cells grow to keep it.
        farthest_m: depth beyond this z is left out.
        progress: called with the completed fraction, 0 to 1.
        cancel: called before every frame; True stops the fusion.

    Raises:
        ToolkitError: no frame has both depth and a camera pose, the unit of the poses is unknown,
            or an image cannot be read.
        FusionCancelled: `cancel` returned True.
    """
    require_metres(scene)
    skipped = {f.id: reason for f in frames if (reason := _unusable(scene, f)) is not None}
    usable = [f for f in frames if f.id not in skipped]
    if not usable:
        raise ToolkitError(_nothing_to_fuse(frames, skipped), path=scene.root)
    grid = VoxelGrid(voxel_m, limit=limit)
    seen_twice = MultiViewCells(_SUPPORT_VOXELS * voxel_m)
    missing = []
    for i, frame in enumerate(usable):
        if cancel is not None and cancel():
            raise FusionCancelled
        T_world_cam = scene.T_world_cam(frame.id)
        depth = _required_depth(scene, frame)
        assert T_world_cam is not None
        missing.append(1 - np.count_nonzero(depth) / depth.size)
        solid = np.where(on_depth_step(depth) | (depth > farthest_m), np.float32(0), depth)
        stride = _stride(solid, scene.camera(frame), grid.voxel_m)
        points, use = _points(solid, scene.camera(frame), stride)
        colors = scene.read_color(frame)[_part(stride)][use]
        seen_twice.add(grid.add(_moved(T_world_cam, points[use]), colors))
        if progress is not None:
            progress((i + 1) / len(usable))
    if len(usable) >= _FRAMES_FOR_SUPPORT:
        grid.keep(seen_twice.holds(grid.points))
    grid.shrink()
    return FusedCloud(
        grid.points.astype(np.float32),
        grid.colors,
        grid.voxel_m,
        tuple(f.id for f in usable),
        skipped,
        float(np.mean(missing)),
    )


def sparse_points(scene: Scene) -> tuple[Array, NDArray[np.uint8]] | None:
    """Read the points of the reconstruction (poses/points.ply); None if there are none.

    Returns:
        Points (N, 3) in the world, in the unit of the camera poses, and their colours (N, 3) uint8
        RGB.
    """
    path = scene.root / "poses" / "points.ply"
    if not path.is_file():
        return None
    o3d = import_open3d()

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        cloud = o3d.io.read_point_cloud(path)
    xyz = np.asarray(cloud.points)
    rgb = np.asarray(cloud.colors)
    if len(rgb) != len(xyz):
        rgb = np.full((len(xyz), 3), 120 / 255)
    good = np.isfinite(xyz).all(axis=1)
    if not good.any():
        return None
    return xyz[good], (255 * rgb[good]).round().astype(np.uint8)


def _points(depth: Floats, camera: Camera, stride: int) -> tuple[Floats, Mask]:
    """Camera-frame points (h, w, 3) of every stride-th pixel, and where depth was measured."""
    x, y = normalised_rays(camera, image_window(camera))
    z = depth[_part(stride)]
    step = slice(None, None, stride)
    points = np.empty((*z.shape, 3), np.float32)
    points[..., 0] = x[step if x.shape[0] > 1 else slice(None), step] * z
    points[..., 1] = y[step, step if y.shape[1] > 1 else slice(None)] * z
    points[..., 2] = z
    return points, z > 0


def _moved(T: SE3, points: Floats) -> Floats:
    # Written out, because a threaded product of N x 3 with 3 x 3 mostly waits for its threads.
    R, t = T.R.astype(np.float32), T.t.astype(np.float32)
    x, y, z = points.T
    return np.stack([R[i, 0] * x + R[i, 1] * y + R[i, 2] * z + t[i] for i in range(3)], axis=1)


def _part(stride: int) -> tuple[slice, slice]:
    if stride < 1:
        raise ToolkitError("must be at least 1", field="stride", value=stride)
    return slice(None, None, stride), slice(None, None, stride)


def _stride(depth: Floats, camera: Camera, voxel_m: float) -> int:
    """Step for two pixels per voxel edge at the median depth; more would not change the means."""
    measured = depth[::8, ::8]
    measured = measured[measured > 0]
    if len(measured) == 0:
        return 1
    pixels = voxel_m * camera.fx / float(np.median(measured))
    return int(np.clip(pixels / 2, 1, 8))


def _required_depth(scene: Scene, frame: Frame) -> Floats:
    depth = scene.read_depth(frame)
    if depth is None:
        raise ToolkitError(
            f"frame {frame.id} has no sensor depth, so there is no point cloud of it",
            path=scene.root,
            hint="show the image instead",
        )
    return depth


def _unusable(scene: Scene, frame: Frame) -> str | None:
    if frame.depth is None:
        return "no sensor depth"
    return "no camera pose" if scene.T_world_cam(frame.id) is None else None


def _nothing_to_fuse(frames: Sequence[Frame], skipped: dict[int, str]) -> str:
    if not frames:
        return "no frames were given to fuse a point cloud from"
    if set(skipped.values()) == {"no sensor depth"}:
        return "no sensor depth in these frames, so no point cloud can be fused; show the images"
    if set(skipped.values()) == {"no camera pose"}:
        return (
            "none of these frames has a camera pose, so their depth cannot be fused; "
            "run `std-curate poses`, or show the cloud of one frame"
        )
    return "no frame has both sensor depth and a camera pose, so no point cloud can be fused"


class VoxelGrid:
    """Mean position and colour per occupied cell.

    Args:
        voxel_m: edge of a cell, metres.
        limit: maximum number of cells; cells grow to keep it.
    """

    def __init__(self, voxel_m: float, *, limit: int) -> None:
        self.voxel_m = voxel_m
        self._limit = limit
        self._keys = np.zeros(0, np.int64)
        # Sums of x y z r g b, and the number of points.
        self._sums = np.zeros((0, 7))
        self._pending: list[tuple[NDArray[np.int64], Array]] = []

    def __len__(self) -> int:
        self._settle()
        return len(self._keys)

    def add(self, points: NDArray[np.floating], colors: NDArray[np.uint8]) -> Array:
        """Add the points (N, 3), metres, and colours (N, 3) of one frame.

        Returns:
            (M, 3) mean points of this frame per cell.
        """
        rows = np.empty((len(points), 7))
        rows[:, :3], rows[:, 3:6], rows[:, 6] = points, colors, 1
        keys, sums = _summed(cell_keys(points, self.voxel_m), rows)
        self._pending.append((keys, sums))
        if sum(len(k) for k, _ in self._pending) > _PENDING_ROWS:
            self._settle()
            # Slack, because cells measured in only one frame are dropped at the end.
            while len(self._keys) > 3 * self._limit:
                self._coarsen()
        return sums[:, :3] / sums[:, 6:7]

    def shrink(self) -> None:
        """Grow the cells until there are at most `limit`."""
        while len(self) > self._limit:
            self._coarsen()

    def keep(self, chosen: Mask) -> None:
        """Drop the cells that are not chosen (one flag per cell)."""
        self._settle()
        self._keys, self._sums = self._keys[chosen], self._sums[chosen]

    @property
    def points(self) -> Array:
        """(N, 3) mean position per cell, metres; in the order of the cells."""
        self._settle()
        return self._sums[:, :3] / self._sums[:, 6:7]

    @property
    def colors(self) -> NDArray[np.uint8]:
        """(N, 3) mean colour per cell."""
        self._settle()
        return (self._sums[:, 3:6] / self._sums[:, 6:7]).round().astype(np.uint8)

    def _settle(self) -> None:
        if self._pending:
            keys, sums = zip((self._keys, self._sums), *self._pending, strict=True)
            self._pending = []
            self._keys, self._sums = _summed(np.concatenate(keys), np.concatenate(sums))

    def _coarsen(self) -> None:
        # The points lie on surfaces, so the number of cells falls with the square of the edge.
        self.voxel_m *= float(np.clip(1.05 * np.sqrt(len(self) / self._limit), 1.05, 2.0))
        self._keys, self._sums = _summed(cell_keys(self.points, self.voxel_m), self._sums)


class MultiViewCells:
    """Set of the cells measured in at least two frames.

    Args:
        voxel_m: edge of a cell.
    """

    def __init__(self, voxel_m: float) -> None:
        self._voxel_m = voxel_m
        self._once = np.zeros(0, np.int64)
        self._twice = np.zeros(0, np.int64)

    def add(self, points: NDArray[np.floating]) -> None:
        """Add the points (N, 3) of one frame, metres."""
        keys = np.unique(cell_keys(points, self._voxel_m))
        again = keys[np.isin(keys, self._once, assume_unique=True)]
        self._twice = np.union1d(self._twice, again)
        self._once = np.union1d(self._once, keys)

    def holds(self, points: NDArray[np.floating]) -> Mask:
        """Return (N,) whether each point (N, 3) is in such a cell."""
        return np.isin(cell_keys(points, self._voxel_m), self._twice)


def cell_keys(points: NDArray[np.floating], voxel_m: float) -> NDArray[np.int64]:
    """Return (N,) the key of the cell of each point (N, 3)."""
    cell = np.floor(np.asarray(points, dtype=np.float64) / voxel_m).astype(np.int64) + _MIDDLE
    cell = np.clip(cell, 0, (1 << _BITS) - 1)
    return (cell[:, 0] << (2 * _BITS)) | (cell[:, 1] << _BITS) | cell[:, 2]


def _summed(keys: NDArray[np.int64], rows: Array) -> tuple[NDArray[np.int64], Array]:
    unique, inverse = np.unique(keys, return_inverse=True)
    index = inverse.reshape(-1)
    columns = [np.bincount(index, column, minlength=len(unique)) for column in rows.T]
    return unique, np.stack(columns, axis=1)
