"""The real RealSense frames with YCB objects: reference poses, symmetries, and one residual."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import scipy.io
import trimesh
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.geometry.se3 import SE3
from std_toolkit.geometry.surface_colors import SurfaceColors
from std_toolkit.io.images import read_color, read_depth
from std_toolkit.labels.entry.symmetry_argument import parse_symmetry
from std_toolkit.labels.refine.caster import WorldCaster
from std_toolkit.labels.refine.depth.observed import fit_background, plane_depth
from std_toolkit.labels.refine.problem import RefineObject, RefineView
from std_toolkit.rendering.texture import TexturedSurface

CAMERA = Camera(640, 480, 618.0172729492188, 618.0033569335938, 312.376953125, 232.37530517578125)
# Shapes that look the same turned: cans, bowl and marker about their axis; the wood block is a
# square beam; the foam brick and the clamp look alike after half a turn.
SYMMETRIES = {
    "002_master_chef_can": ["axis:z"],
    "005_tomato_soup_can": ["axis:z"],
    "007_tuna_fish_can": ["axis:z"],
    "024_bowl": ["axis:z"],
    "036_wood_block": ["fold:z:4", "fold:x:2"],
    "040_large_marker": ["axis:y"],
    "052_extra_large_clamp": ["fold:x:2"],
    "061_foam_brick": ["fold:z:2"],
}
# A pixel that is off by more than this is off: by how much says nothing any more.
TRUNCATION_M = 0.02


@dataclass(frozen=True, eq=False)
class YcbFrame:
    """One frame.

    Attributes:
        view: with the identity as camera pose.
        objects: at their refined reference poses.
        initial: their initial poses, in the same order.
        table: (H, W) z-depth of the table plane, metres.
    """

    view: RefineView
    objects: list[RefineObject]
    initial: list[SE3]
    table: NDArray[np.float64]


def load_frame(data: Path, index: int) -> YcbFrame:
    """One of the four frames with reference poses."""
    folder, meshes = data / "realsense_ycb_frames", data / "ycb_meshes"
    names = sorted(p.name for p in meshes.iterdir() if p.is_dir() and p.name != "051_large_clamp")
    reference = scipy.io.loadmat(str(folder / "reference_poses" / f"{index:06d}-color.png.mat"))
    objects, initial = [], []
    for row, first, refined in zip(
        reference["rois"], reference["poses"], reference["poses_refined"], strict=True
    ):
        name = names[int(row[1]) - 1]
        mesh = load_mesh(meshes / name / "textured.obj")
        objects.append(_object(name, mesh, SE3.from_quat(refined[:4], refined[4:7])))
        initial.append(SE3.from_quat(first[:4], first[4:7]))
    view = RefineView.of(
        CAMERA,
        SE3.identity(),
        read_color(folder / f"{index:06d}-color.png", size=CAMERA.size),
        read_depth(folder / f"{index:06d}-depth.png", scale=0.001, size=CAMERA.size),
        frame=index,
    )
    return YcbFrame(view, objects, initial, _table(view, objects))


def depth_residuals_mm(frame: YcbFrame, index: int, poses: list[SE3]) -> list[float]:
    """Depth residual of one object at each of several poses, millimetres.

    The same pixels count for all poses: those with a reading where the object is visible at any
    of them. At each, the whole scene is rendered (the object at the pose, the other objects at
    their refined references, the table plane) and its depth compared with the reading; the mean of
    |rendered - measured|, cut off at 20 mm. So a pose gains nothing by leaving out pixels, and pays
    for covering the table as for leaving a part of the object unexplained.
    """
    assert frame.view.depth is not None
    rendered, shown = [], []
    for pose in poses:
        placed = [o.T_world_obj for o in frame.objects]
        placed[index] = pose
        caster = WorldCaster(frame.objects, placed)
        hits = caster.cast(CAMERA, SE3.identity(), CAMERA.pixel_grid())
        rendered.append(np.minimum(hits.depth, frame.table))
        shown.append(hits.object == index)
    counted = np.any(shown, axis=0) & (frame.view.depth > 0)
    return [
        1000 * float(np.minimum(np.abs(z - frame.view.depth), TRUNCATION_M)[counted].mean())
        for z in rendered
    ]


def _object(name: str, mesh: trimesh.Trimesh, pose: SE3) -> RefineObject:
    symmetry = parse_symmetry(SYMMETRIES.get(name, []), centre=mesh.bounds.mean(axis=0)).symmetry()
    return RefineObject(
        name,
        np.asarray(mesh.vertices, dtype=np.float64),
        np.asarray(mesh.faces, dtype=np.int64),
        pose,
        "diffuse",
        symmetry,
        colors=SurfaceColors.from_mesh(mesh),
    )


def _table(view: RefineView, objects: list[RefineObject]) -> NDArray[np.float64]:
    """The plane of the readings around, but not on, the objects."""
    assert view.depth is not None
    hits = WorldCaster(objects, [o.T_world_obj for o in objects]).cast(
        CAMERA, SE3.identity(), CAMERA.pixel_grid()
    )
    covered = (hits.object >= 0).astype(np.uint8)
    near, on = (cv2.dilate(covered, np.ones((s, s), np.uint8)) > 0 for s in (41, 15))
    free = near & ~on & (view.depth > 0)
    rays = CAMERA.rays()
    plane = fit_background(rays[free] * view.depth[free, None])
    assert plane is not None
    return plane_depth(plane, rays.reshape(-1, 3)).reshape(view.depth.shape)


def texture_of(data: Path, name: str) -> TexturedSurface | None:
    """The textured mesh of an object at full resolution."""
    return TexturedSurface.from_mesh(load_mesh(data / "ycb_meshes" / name / "textured.obj"))
