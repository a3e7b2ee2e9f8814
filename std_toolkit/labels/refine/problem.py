"""Input and result of a refinement: views, objects, options, progress."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera, Symmetry, rotation_angle, undistort_image
from std_toolkit.geometry.se3 import SE3
from std_toolkit.geometry.surface_colors import SurfaceColors
from std_toolkit.labels.refine.object_surface import ObjectSurface, surface_of
from std_toolkit.rendering.texture import TexturedSurface
from std_toolkit.scene.model import DIFFUSE_MATERIALS

# Called with the completed fraction, 0 to 1, never decreasing. To cancel the computation, raise an
# exception.
Progress = Callable[[float], None]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RefineView:
    """One image with its camera pose; create it with `RefineView.of`, which undistorts.

    Attributes:
        camera: intrinsics without distortion.
        T_world_cam: camera pose, metres.
        color: (H, W, 3) uint8.
        depth: sensor z-depth (H, W) float32 metres, 0 = none, or None.
        frame: id of the frame, for reports.
        pose_covariance: (6, 6) of a right perturbation `T_world_cam @ SE3.exp(xi)`, if known.
    """

    camera: Camera
    T_world_cam: SE3
    color: NDArray[np.uint8]
    depth: NDArray[np.float32] | None = None
    frame: int = -1
    pose_covariance: Array | None = None

    @staticmethod
    def of(
        camera: Camera,
        T_world_cam: SE3,
        color: NDArray[np.uint8],
        depth: NDArray[np.float32] | None = None,
        *,
        frame: int = -1,
        pose_covariance: Array | None = None,
    ) -> RefineView:
        """A view with the lens distortion removed from its images.

        Raises:
            ToolkitError: an image of another size than the camera's.
        """
        for image in (color, depth):
            if image is not None and image.shape[:2] != (camera.height, camera.width):
                raise ToolkitError(
                    f"image size differs from that of the camera, {camera.width}x{camera.height}",
                    field=f"frame {frame}",
                    value=image.shape[:2],
                )
        straight = undistort_image(color, camera).astype(np.uint8, copy=False)
        if depth is not None:
            depth = undistort_image(depth, camera, interpolation=cv2.INTER_NEAREST).astype(
                np.float32, copy=False
            )
        straight_camera = camera.without_distortion()
        return RefineView(straight_camera, T_world_cam, straight, depth, frame, pose_covariance)

    def at_scale(self, factor: float) -> tuple[Camera, NDArray[np.uint8]]:
        """Camera and image resized by `factor` <= 1."""
        if factor >= 1:
            return self.camera, self.color
        size = (round(self.camera.width * factor), round(self.camera.height * factor))
        small = cv2.resize(self.color, size, interpolation=cv2.INTER_AREA)
        return self.camera.resized(*size), np.asarray(small, dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class RefineObject:
    """One object whose world pose is refined.

    Attributes:
        name: name in reports.
        vertices: (V, 3) mesh vertices, metres.
        faces: (F, 3) triangles.
        T_world_obj: start pose.
        material: sensor depth is used on "raw" and "diffuse" only.
        symmetry: directions without visible effect are not refined.
        fixed: the object keeps its pose and acts as an occluder only.
        rough: search poses around the start before edge refinement, if there are two views or
            more; see `RefineOptions.rough_m`.
        colors: colours of its surface, if the mesh has a texture that distinguishes its sides.
        texture: the mesh with its colours at full resolution, if it has any.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    T_world_obj: SE3
    material: str = "diffuse"
    symmetry: Symmetry = field(default_factory=Symmetry)
    fixed: bool = False
    rough: bool = False
    colors: SurfaceColors | None = None
    texture: TexturedSurface | None = None

    @property
    def trusts_depth(self) -> bool:
        return self.material in DIFFUSE_MATERIALS

    @property
    def centre(self) -> NDArray[np.float64]:
        """(3,) centre of the bounding box, mesh frame."""
        return self.surface.centre

    @property
    def radius(self) -> float:
        """Largest distance of a vertex from `centre`, metres."""
        return self.surface.radius

    @property
    def surface(self) -> ObjectSurface:
        # Computed once for all copies of the object at other poses.
        return surface_of(self.vertices, self.faces)


@dataclass(frozen=True, kw_only=True)
class RefineOptions:
    """Options of a refinement.

    Attributes:
        use_depth: use sensor depth on diffuse objects.
        refine_scale: also estimate the scale of the camera positions.
        search_px: search radius for edges around the predicted contour at the coarsest level, in
            full-resolution pixels.
        largest_image: largest image width, pixels; wider images are reduced.
        depth_factor_std: prior standard deviation of the sensor's depth factor around 1.
        scale_std: prior standard deviation of the scale of the camera positions around 1.
        translation_std, rotation_std: weak prior of the start pose, metres and radians, for
            directions that are otherwise undetermined.
        iterations: largest number of Gauss-Newton steps per level.
        depth_samples: number of independent samples that a view's sensor depth on an object
            counts as.
        rough_m, rough_turn: largest error of the start of a rough object: its centre, metres,
            and its rotation, radians.
        use_textures: match the textures of meshes with the images.
        restarts: number of other starts near the result from which the last level is repeated, for
            the spread in the covariance.
    """

    use_depth: bool = True
    refine_scale: bool = False
    search_px: float = 48.0
    largest_image: int = 1280
    depth_factor_std: float = 0.02
    scale_std: float = 0.03
    translation_std: float = 0.05
    rotation_std: float = 0.35
    iterations: int = 4
    depth_samples: float = 1.5
    rough_m: float = 0.035
    rough_turn: float = float(np.deg2rad(18))
    use_textures: bool = True
    restarts: int = 1


@dataclass(frozen=True, eq=False)
class RefinedObject:
    """Outcome for one object.

    Attributes:
        name: as given.
        T_world_obj: refined pose; in the rescaled world if the scale was refined.
        covariance: (6, 6) of a right perturbation `T_world_obj @ SE3.exp(xi)`.
        weak_direction: sentence on the least determined direction.
        edge_rms_px: robust standard deviation of the edges found around the final contour,
            full-resolution pixels.
        depth_rms_m: RMS of the sensor depth around the surface along its normal, metres; None if
            depth was not used.
        views: number of views in which the object's contour was measured.
        converged: the last step was small and enough edges agree with the contour.
        scale_coupling: (6,) change of the pose (right perturbation) that fits best per unit of
            change of the log scale of the camera positions; zeros if it was not refined.
        texture_offset: where the texture is relative to its place on the mesh, T_obj_texture, if
            it contradicts the contour and was not followed.
    """

    name: str
    T_world_obj: SE3
    covariance: NDArray[np.float64]
    weak_direction: str
    edge_rms_px: float
    depth_rms_m: float | None
    views: int
    converged: bool
    scale_coupling: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6))
    texture_offset: SE3 | None = None

    def texture_sentence(self, centre: NDArray[np.floating]) -> str:
        """One sentence on a texture that was not followed; "" if there is none.

        Args:
            centre: (3,) of the object, mesh frame.
        """
        if self.texture_offset is None:
            return ""
        away = 1000 * float(np.linalg.norm(self.texture_offset @ centre - centre))
        turn = np.rad2deg(rotation_angle(self.texture_offset.R))
        return (
            f"its texture is {away:.1f} mm and {turn:.1f} deg beside that of the mesh (another "
            "production run?), so the contour was followed"
        )


@dataclass(frozen=True, eq=False)
class RefineResult:
    """Outcome of a refinement.

    Attributes:
        objects: in the order given.
        scale: factor on all camera positions (and on the world); 1 if it was not refined.
        scale_std: its standard deviation; 0 if it was not refined.
        scale_converged: whether the last steps of the scale and of the objects were small.
        depth_factor: estimated true depth = depth_factor * sensor depth; 1 without depth.
        depth_factor_std: its standard deviation.
    """

    objects: tuple[RefinedObject, ...]
    scale: float = 1.0
    scale_std: float = 0.0
    depth_factor: float = 1.0
    depth_factor_std: float = 0.0
    scale_converged: bool = True


def large_views(
    cameras: Sequence[Camera],
    poses: Sequence[SE3],
    centre: Array,
    radius: float,
    *,
    count: int,
    smallest_px: float = 40.0,
) -> list[int]:
    """Indices of views that show an object large, from directions far apart.

    Args:
        cameras: cameras of the views.
        poses: T_world_cam of the views.
        centre: (3,) centre of the object in the world.
        radius: of the object, metres.
        count: largest number.
        smallest_px: smallest size of the object in the image.
    """
    sizes, directions, usable = [], [], []
    for k, (camera, T) in enumerate(zip(cameras, poses, strict=True)):
        p = T.inverse() @ centre
        if p[2] < 1.5 * radius:
            continue
        uv = camera.without_distortion().project(p)
        size = 2 * radius * camera.fx / p[2]
        inside = (uv >= 0.25 * size).all() and (uv < np.array(camera.size) - 0.25 * size).all()
        if size >= smallest_px and inside:
            usable.append(k)
            sizes.append(size)
            directions.append((centre - T.t) / np.linalg.norm(centre - T.t))
    if not usable:
        return []
    way, size = np.array(directions), np.minimum(np.array(sizes), 300.0)
    picks = [int(np.argmax(size))]
    while len(picks) < min(count, len(usable)):
        apart = np.min([np.linalg.norm(way - way[k], axis=1) for k in picks], axis=0)
        # A near view shows more, a far one from another side shows other parts.
        gain = (apart + 0.02) * size
        gain[picks] = -1
        picks.append(int(np.argmax(gain)))
    return sorted(usable[k] for k in picks)


def no_progress(_: float) -> None:
    """Ignore the progress."""


def sub_progress(whole: Progress, start: float, end: float) -> Progress:
    """Progress of a step that takes the computation from `start` to `end`."""
    return lambda fraction: whole(start + (end - start) * min(max(fraction, 0.0), 1.0))
