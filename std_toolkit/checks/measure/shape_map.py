"""By how much and where an object differs from its mesh.

At the pose at which all evidence puts the object, its contour lies beside that of the mesh where
the two have another shape. Along the normal of a contour point the nearest image edge is uncertain:
clutter and texture have edges, too. Each place of the surface therefore takes the distance at which
the edges of many frames agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.contours import LabelCaster, object_centre
from std_toolkit.checks.measure.coverage import spread
from std_toolkit.checks.measure.edges import edge_peaks, noise_level, read_profiles, smooth_image
from std_toolkit.checks.measure.residuals import render_view
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.geometry.mesh import decimate_mesh, mesh_bounds
from std_toolkit.geometry.turned_surface import turn_about
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Frame, Scene
from std_toolkit.scene.memory_scene import MemoryScene
from std_toolkit.scene.model import pose_from_list
from std_toolkit.settings import Settings, limit

# Size of the triangles between places, in parts of the object's size.
_EDGE = 0.07
# Step of the distances that are compared, in mm, and edges of a contour point.
_STEP_MM, _EDGES = 0.1, 4


@dataclass(frozen=True, kw_only=True)
class ShapeMapSettings(Settings):
    """How the difference of shape is measured."""

    most_frames: int = limit(24, source="all sides of a recording around an object")
    """evenly spaced frames"""
    most_faces: int = limit(3000, source="the page of the report stays small")
    """faces of the mesh, before large ones are divided"""
    reach: float = limit(0.08, source="objects of other production runs differ by less")
    """largest difference, in parts of the object's size"""
    around: float = limit(0.06, source="a place has some dozens of contour points")
    """contour points this near, in parts of the size, count for a place"""
    fewest_points: int = limit(12, source="fewer agree by chance")
    """contour points for a place"""
    width_mm: float = limit(0.6, unit="mm", source="half a pixel of usual recordings")
    """edges agree within this"""
    usual: float = limit(0.015, source="boxes that bulge, bottles of other production runs")
    """usual difference, in parts of the object's size"""
    agreement: float = limit(0.5, source="clutter agrees by less")
    """share of the points that must have an edge there"""
    noted: float = limit(0.9, source="the rest is the largest difference")
    """the largest difference is this quantile over the places"""


@dataclass(frozen=True, eq=False)
class ShapeMap:
    """Differences between an object and its mesh.

    Attributes:
        points: (N, 3) places on the surface of the mesh, mesh frame, metres.
        faces: (F, 3) triangles between them.
        mm: (N,) distance of the object's surface from that of the mesh, positive outside; NaN where
            no contour was seen.
        largest_mm: difference of the place that 90 % of the places do not exceed.
        where: in words, such as "at its +z end".
        frames: number of frames that were used.
    """

    points: Array
    faces: Array
    mm: Array
    largest_mm: float
    where: str
    frames: int

    def sentence(self) -> str:
        """The finding, such as "it is up to 3.1 mm larger at its +z end than its mesh"."""
        word = "larger" if self.largest_mm > 0 else "smaller"
        return f"it is up to {abs(self.largest_mm):.1f} mm {word} {self.where} than its mesh"


def map_shape(
    scene: Scene,
    object_id: int,
    motion: Array,
    frames: Sequence[Frame],
    options: CheckOptions,
) -> ShapeMap | None:
    """Measure the difference in shape of one object.

    Args:
        scene: a scene with a label of the object in the world.
        object_id: its id.
        motion: (6,) from the label to where the object is, as in `gates.hypotheses`.
        frames: registered frames; those that cannot be read are left out.
        options: search ranges.

    Returns:
        None if too little of its contour is seen.
    """
    limits = ShapeMapSettings.current()
    moved = _at(scene, object_id, motion)
    mesh = scene.mesh(scene.objects.object(object_id).model)
    low, high = mesh_bounds(mesh)
    size_mm = 1000 * float(np.linalg.norm(high - low))
    caster = LabelCaster.of_scene(moved)
    T_obj_world = moved.T_world_obj(object_id).inverse()  # type: ignore[union-attr]
    found = []
    for frame in spread(frames, limits.most_frames):
        try:
            found.append(_contour_edges(moved, caster, frame, object_id, T_obj_world, options))
        except ToolkitError:
            continue
    seen = [f for f in found if f is not None]
    if not seen:
        return None
    at, mm, strength = (np.concatenate([f[k] for f in seen]) for k in range(3))
    points, faces = _places(mesh, size_mm / 1000)
    distance = _agreed(points, at, mm, strength, size_mm)
    known = np.isfinite(distance)
    if not known.any():
        return None
    quantile = np.quantile(np.abs(distance[known]), limits.noted)
    far = known & (np.abs(distance) >= quantile)
    sign = 1.0 if np.median(distance[far]) > 0 else -1.0
    where = _where(points[far & (np.sign(distance) == sign)], low, high)
    return ShapeMap(points, faces, distance, sign * float(quantile), where, len(seen))


def _at(scene: Scene, object_id: int, motion: Array) -> MemoryScene:
    """The scene with the label moved to where the object is."""
    label = scene.labels.of(object_id)
    assert label is not None and label.T_world_obj is not None
    T = pose_from_list(label.T_world_obj)
    turn = turn_about(object_centre(scene, object_id), so3_exp(np.deg2rad(motion[3:])))
    change = SE3(turn.R, turn.t + motion[:3] / 1000)
    moved = msgspec.structs.replace(label, T_world_obj=(change @ T).flat())
    return MemoryScene(scene, labels=scene.labels.with_label(moved))


def _contour_edges(
    scene: Scene,
    caster: LabelCaster,
    frame: Frame,
    object_id: int,
    T_obj_world: SE3,
    options: CheckOptions,
) -> tuple[Array, Array, Array] | None:
    """Contour points (P, 3) in the mesh frame, distances (P, E) of edges in mm, strengths."""
    view = render_view(scene, caster, frame)
    contour = view.contour(object_id)
    if contour is None:
        return None
    image = scene.read_color(frame)
    profiles = read_profiles(
        smooth_image(image), contour, reach_px=options.search_px, noise=noise_level(image)
    )
    if profiles is None:
        return None
    position, strength = edge_peaks(profiles)
    best = np.argsort(-strength, axis=1, kind="stable")[:, :_EDGES]
    depth = contour.depth[profiles.index]
    at = view.T_world_cam @ view.camera.unproject(contour.points[profiles.index], depth)
    per_px = 2000 * depth / (view.camera.fx + view.camera.fy)
    mm = np.take_along_axis(position, best, axis=1) * per_px[:, None]
    return T_obj_world @ at, mm, np.take_along_axis(strength, best, axis=1)


def _places(mesh: trimesh.Trimesh, size_m: float) -> tuple[Array, Array]:
    """Vertices and faces of the mesh with triangles of about one size."""
    most = ShapeMapSettings.current().most_faces
    even = decimate_mesh(mesh, most) if len(mesh.faces) > most else mesh
    vertices, faces = trimesh.remesh.subdivide_to_size(
        np.asarray(even.vertices), np.asarray(even.faces), max_edge=_EDGE * size_m
    )
    # Corners of faces with textures of their own are at one place.
    at, place = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    return at, np.reshape(place, -1)[faces]


def _agreed(points: Array, at: Array, mm: Array, strength: Array, size_mm: float) -> Array:
    """(N,) distance at which the edges around each place agree; NaN where they do not."""
    limits = ShapeMapSettings.current()
    reach = limits.reach * size_mm
    grid = np.arange(-reach, reach + _STEP_MM, _STEP_MM)
    # An edge far away must be clearer than one at the mesh.
    prior = np.exp(-0.5 * (grid / (limits.usual * size_mm)) ** 2)
    near = cKDTree(at).query_ball_point(points, limits.around * size_mm / 1000)
    found = np.full(len(points), np.nan)
    for k, rows in enumerate(near):
        if len(rows) < limits.fewest_points:
            continue
        x, w = mm[rows], strength[rows]
        usable = np.isfinite(x)
        kernel = np.exp(-0.5 * ((grid - x[usable][:, None]) / limits.width_mm) ** 2)
        best = grid[int(np.argmax((w[usable][:, None] * kernel).sum(axis=0) * prior))]
        apart = np.abs(np.where(usable, x, np.inf) - best).min(axis=1)
        if (apart < 2 * limits.width_mm).mean() >= limits.agreement:
            found[k] = best
    return _smoothed(points, found, limits.around * size_mm / 1000)


def _smoothed(points: Array, mm: Array, radius_m: float) -> Array:
    """The median of the places around each one: single ones are edges of something else."""
    known = np.flatnonzero(np.isfinite(mm))
    if not len(known):
        return mm
    around = cKDTree(points[known]).query_ball_point(points[known], radius_m)
    smooth = np.full(len(mm), np.nan)
    smooth[known] = [float(np.median(mm[known[rows]])) for rows in around]
    return smooth


def _where(points: Array, low: Array, high: Array) -> str:
    """The side of the mesh on which places lie."""
    if not len(points):
        return "all around"
    middle = (points.mean(axis=0) - (low + high) / 2) / np.maximum((high - low) / 2, 1e-9)
    axis = int(np.argmax(np.abs(middle)))
    if abs(middle[axis]) < 0.4:
        return "all around"
    return f"at its {'+' if middle[axis] > 0 else '-'}{'xyz'[axis]} side"
