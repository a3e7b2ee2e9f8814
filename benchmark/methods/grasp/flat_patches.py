"""A planner for a suction cup: places of the seen surface on which the cup would seal."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.methods.grasp.antipodal.antipodal import check_limits, off_middle
from benchmark.methods.grasp.antipodal.hands import obstacles_of
from benchmark.methods.grasp.antipodal.surface import surface_of, table_of
from benchmark.methods.protocol import GraspView
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.grasp.collision import Cloud
from benchmark.metrics.grasp.grasp import Grasps, suppress_similar
from benchmark.metrics.grasp.gripper import Boxes
from benchmark.metrics.grasp.suction import SuctionCup, ring_stretch
from std_toolkit.geometry.se3 import SE3
from std_toolkit.plugins import configured

Floats = NDArray[np.float64]

# Sectors of the ring, which reaches from 0.6 to 1.4 radii.
_SECTORS = 8
_INNER, _OUTER = 0.6, 1.4

# Fewest points of a plane.
_FEWEST = 12

# Points of the surface itself that may lie in the tube, of noise.
_LIFTED_M = 0.004


@dataclass(frozen=True, kw_only=True)
class FlatPatchSettings:
    """How places for the cup are looked for.

    Attributes:
        cup_radius: radius of the cup, metres.
        seed: of all that is drawn; the same view and seed give the same grasps.
        points: largest number of places that are tried.
        grasps: largest number of grasps that are given back.
        least_height, least_top, least_area: as of `antipodal`.
        steepest: largest angle between the cup's axis and straight down, degrees.
        roughest: largest standard deviation of what is seen under the lip from a smooth (quadratic)
            surface, metres: more is a step, such as beside a handle.
    """

    cup_radius: float = 0.01
    seed: int = 0
    points: int = 800
    grasps: int = 50
    least_height: float = 0.006
    least_top: float = 0.01
    least_area: float = 3e-4
    steepest: float = 75.0
    roughest: float = 0.002

    def __post_init__(self) -> None:
        check_limits(
            self,
            ("cup_radius", 0.002, 0.05),
            ("points", 10, 20_000),
            ("grasps", 1, 10_000),
            ("least_height", 0.0, 0.1),
            ("least_top", 0.0, 0.1),
            ("least_area", 0.0, 0.1),
            ("steepest", 1.0, 89.0),
            ("roughest", 1e-4, 0.1),
        )


class FlatPatches:
    """Suction on flat patches of the seen surface; nothing is learned, and no object is known.

    A place counts where the depth around it is known in every direction and has no step, and where
    the springs of the cup (`benchmark.metrics.grasp.suction`) would stretch less than they may. The
    best ones need the least stretch, are near the middle of their object, and face up.

    Args:
        options: settings as in `FlatPatchSettings`.

    Raises:
        ToolkitError: a setting that it does not have or that cannot be.
    """

    settings_type = FlatPatchSettings

    gripper_kind = "suction"

    def __init__(self, options: MethodOptions | None = None) -> None:
        given = (options or MethodOptions()).settings
        self.settings = configured(FlatPatchSettings(), given)
        self.cup = SuctionCup(radius=self.settings.cup_radius)

    def plan(self, view: GraspView) -> Grasps:
        """See `GraspPlanner`."""
        rng = np.random.default_rng(self.settings.seed)
        T_cam_table = table_of(view, rng)
        return self._plan_on_table(view, T_cam_table, rng).transformed(T_cam_table)

    def _plan_on_table(self, view: GraspView, T_cam_table: SE3, rng: np.random.Generator) -> Grasps:
        s = self.settings
        surface = surface_of(
            view, T_cam_table, least_height=s.least_height, least_top=s.least_top,
            least_area=s.least_area, count=s.points, rng=rng,
        )  # fmt: skip
        up = surface.normals[:, 2] > np.cos(np.deg2rad(s.steepest))
        places, normals, stretches = self._sealed(
            surface.points[up], surface.normals[up], surface.obstacles
        )
        if not len(places):
            return Grasps.empty()
        lever = off_middle(places, obstacles_of(surface.obstacles))
        score = 1 - stretches / self.cup.stretch - 10 * lever - 0.5 * (1 - normals[:, 2])
        grasps = Grasps.make(
            _frames(-normals), places, widths=self.cup.max_width, depths=0.0, scores=score
        )
        grasps = suppress_similar(grasps, translation=self.cup.radius)
        return grasps[~self._hits(grasps, surface.obstacles)].top(s.grasps)

    def _sealed(
        self, points: Floats, normals: Floats, seen: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Places (K, 3) on which the cup would seal, their normals, and the stretch of its springs.

        The normal is that of the plane through all that is seen under the cup.
        """
        from scipy.spatial import cKDTree

        none = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
        if not len(points) or not len(seen):
            return none
        cup = self.cup
        around = cKDTree(seen).query_ball_point(points, 1.5 * cup.radius)
        found = []
        for point, normal, near in zip(points, normals, around, strict=True):
            there = seen[near]
            # Other surfaces behind the cup's reach are not under it.
            there = there[np.abs((there - point) @ normal) < cup.height]
            if len(there) < _FEWEST:
                continue
            middle = there.mean(axis=0)
            plane = np.linalg.svd(there - middle, full_matrices=False)[2][2]
            plane = plane if plane @ normal > 0 else -plane
            at = point - ((point - middle) @ plane) * plane
            ring = self._ring(there - at, plane)
            if ring is None or (stretch := ring_stretch(-ring, cup)) > cup.stretch:
                continue
            found.append((at + ring.mean() * plane, plane, stretch))
        if not found:
            return none
        places, planes, stretches = zip(*found, strict=True)
        return np.array(places), np.array(planes), np.array(stretches)

    def _ring(self, local: Floats, normal: Floats) -> Floats | None:
        """(8,) mean height of what is seen under each part of the lip.

        None if the inner or outer half of one is empty, or if the surface has a step there, which
        a mean would hide.
        """
        R = _frames(-normal[None])[0]
        y, z = local @ R[:, 1], local @ R[:, 2]
        radius = np.hypot(y, z) / self.cup.radius
        lip = (radius > _INNER) & (radius < _OUTER)
        sector = np.floor((np.arctan2(z, y)[lip] / (2 * np.pi) % 1) * _SECTORS).astype(np.int64)
        half = 2 * sector + (radius[lip] > 1)
        if (np.bincount(half, minlength=2 * _SECTORS) == 0).any():
            return None
        height, y, z = local[lip] @ normal, y[lip], z[lip]
        smooth = np.stack([np.ones_like(y), y, z, y * y, y * z, z * z], axis=1)
        rest = height - smooth @ np.linalg.lstsq(smooth, height, rcond=None)[0]
        if float(rest.std()) > self.settings.roughest:
            return None
        total = np.bincount(sector, weights=height, minlength=_SECTORS)
        return np.asarray(total / np.bincount(sector, minlength=_SECTORS))

    def _hits(self, grasps: Grasps, seen: Floats) -> NDArray[np.bool_]:
        """(N,) grasps whose tube or box would be where something is seen, on the way too."""
        boxes = self.cup.boxes(grasps.widths, grasps.depths)
        behind = Boxes(boxes.low[:, 1:], boxes.high[:, 1:] - [_LIFTED_M, 0, 0])
        return Cloud(seen).any_inside(grasps, behind)


def _frames(approaches: Floats) -> Floats:
    """(N, 3, 3) rotations with these unit vectors (N, 3) as their x axes."""
    other = np.where(np.abs(approaches[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    y = np.cross(other, approaches)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([approaches, y, np.cross(approaches, y)], axis=2)
