"""Simple bodies on a table, for tests of the hand: no decomposition and no drop needed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from benchmark.metrics.grasp import Grasps
from benchmark.tabletop.arrange import TableObject
from benchmark.tabletop.sense import ExactCamera, Observation, _frame, camera_pose
from sensors.assets import Asset
from sensors.materials.material_draw import draw_material
from sensors.physics import PhysicalObject
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

CAMERA = Camera(212, 120, 150.0, 150.0, 105.5, 59.5)
DOWN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


def box(extents: Sequence[float], name: str = "box") -> PhysicalObject:
    """A box of these sizes (m) in its own y-up frame."""
    size = np.asarray(extents, float)
    diagonal = float(np.linalg.norm(size))
    mesh = trimesh.creation.box(extents=size / diagonal)
    corners = np.asarray(mesh.vertices)
    return PhysicalObject(Asset(name, "other", mesh), diagonal, (corners,))


def standing(thing: PhysicalObject, x: float = 0.0, y: float = 0.0) -> SE3:
    """The body on the table with its own axes along the world's."""
    low = thing.asset.vertices[:, 2].min() * thing.diagonal_m
    return SE3(np.eye(3), np.array([x, y, -low]))


def from_above(tip: Sequence[float], width: float = 0.07) -> Grasps:
    """A grasp straight down that closes along y; fingertips at `tip`."""
    return Grasps.make(DOWN[None], np.array([tip]), widths=width, depths=0.0)


def table_object(thing: PhysicalObject, number: int, kind: str = "specular") -> TableObject:
    """A body of a material class."""
    material = draw_material(np.random.default_rng(number), kind)  # type: ignore[arg-type]
    return TableObject(number, thing, material, 0.15)


class TrueCamera:
    """A camera that measures everything exactly."""

    def __init__(self) -> None:
        self._exact = ExactCamera(CAMERA, camera_pose())
        self.camera, self.T_world_cam = CAMERA, camera_pose()

    def observe(
        self,
        objects: Sequence[TableObject],
        poses: Sequence[SE3],
        attempt: int,
        *,
        color: bool,  # noqa: ARG002
    ) -> Observation:
        exact = self._exact.observe([o.body for o in objects], poses)
        image = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
        return Observation(_frame(objects, image, exact.depth, exact, CAMERA, attempt), exact)
