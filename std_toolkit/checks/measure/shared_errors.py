"""Errors in the equations of a motion that are no noise of the edges of one frame.

A mirror shows at its rim what is behind it, and at its foot the table on which it stands: edges are
faint there, and those of reflections lie beside the outline in all frames. Such errors are solved
for together with the motion. The error of a camera pose moves all edges of its frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.motion import Beside, FiledEquations, MotionEquations
from std_toolkit.geometry import SE3
from std_toolkit.scene import Scene
from std_toolkit.settings import Settings, limit

# Sine of the angle below the horizon from which an edge faces down, in part and entirely.
_DOWN = (0.2, 0.7)
# Contours that lie beside the object by chance, and the number of frames they are read in.
_CHANCE_PX = (-9.0, -6.5, 6.5, 9.0)
_CHANCE_FRAMES = 25


@dataclass(frozen=True, kw_only=True)
class SharedErrorSettings(Settings):
    """Errors of edges that all frames share, by material."""

    systematic_px: Mapping[str, float] = limit(
        {"specular": 0.5, "transparent": 0.3},
        unit="px",
        source="world seeds 400 to 519 of setting kinds: 66 % of the errors within a deviation",
    )
    """deviation of an error that looks like a motion along one axis"""
    opaque_systematic_px: float = limit(0.05, unit="px", source="the same scenes")
    """the same on other materials"""
    rim_px: Mapping[str, float] = limit(
        {"specular": 0.7, "transparent": 0.4},
        unit="px",
        source="the same scenes: edges of steel lie 0.4 px inside of the outline, of glass 0.1 px",
    )
    """deviation of edges outside or inside of the whole outline"""
    opaque_rim_px: float = limit(0.2, unit="px", source="the same scenes: 0.05 px inside")
    """the same on other materials"""
    shaded_rim_px: float = limit(
        0.7, unit="px", source="as on steel: glossy objects are declared diffuse, too"
    )
    """least deviation of edges outside or inside of the whole outline where it has a shade"""
    foot_px: Mapping[str, float] = limit(
        {"specular": 1.5},
        unit="px",
        source="the same scenes: edges of steel that face down differ by 0.7 px from others",
    )
    """the same of edges that face down, besides"""
    foot_part: Mapping[str, float] = limit(
        {"specular": 0.3},
        source="the same scenes: such edges are half as often there as others",
    )
    """weight of edges that face down"""
    least_disagreement: float = limit(
        0.5, source="where views agree as well, edges 30 px from each other are independent"
    )
    """least factor on a covariance by the disagreement of the views"""
    sized_systematic_px: float = limit(
        0.25,
        unit="px",
        source="together with the size, such an error can look like a rotation",
    )
    """least systematic part where a size is fitted, too"""


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """Errors of edges that all frames share, in pixels.

    Attributes:
        systematic: standard deviation of an error that looks like a motion along one axis.
        rim: the same of edges that lie outside or inside of the whole outline; 0 for none.
        foot: the same of edges that face down, besides; 0 for none.
        foot_part: weight of edges that face down.
        least_disagreement: least factor on a covariance by the disagreement of the views.
        up: (3,) unit vector that points up in the world.
    """

    systematic: float = 0.0
    rim: float = 0.0
    foot: float = 0.0
    foot_part: float = 1.0
    least_disagreement: float = 1.0
    up: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

    @staticmethod
    def of_material(material: str, up: Array) -> SharedErrors:
        """Those of a material; `up` points up in the world."""
        limits = SharedErrorSettings.current()
        return SharedErrors(
            systematic=limits.systematic_px.get(material, limits.opaque_systematic_px),
            rim=limits.rim_px.get(material, limits.opaque_rim_px),
            foot=limits.foot_px.get(material, 0.0),
            foot_part=limits.foot_part.get(material, 1.0),
            least_disagreement=limits.least_disagreement,
            up=up,
        )

    def with_size(self) -> SharedErrors:
        """Those where the size of the object is solved for, too."""
        least = SharedErrorSettings.current().sized_systematic_px
        return replace(self, systematic=max(self.systematic, least))

    def shaded(self) -> SharedErrors:
        """Those of an object with a shade or a shine along its whole outline."""
        return replace(self, rim=max(self.rim, SharedErrorSettings.current().shaded_rim_px))

    @property
    def deviations(self) -> list[float]:
        """Of the errors that are solved for."""
        return [x for x in (self.rim, self.foot) if x > 0]

    def facing_down(self, jacobian: NDArray[np.floating]) -> Array:
        """(P,) 0 where an edge faces up or sideways, to 1; jacobian (P, 6 or more) in px."""
        along = jacobian[:, :3] @ self.up
        sine = -along / np.maximum(np.linalg.norm(jacobian[:, :3], axis=1), 1e-12)
        return np.clip((sine - _DOWN[0]) / (_DOWN[1] - _DOWN[0]), 0.0, 1.0)

    def columns(self, jacobian: NDArray[np.floating]) -> Array:
        """(P, M) shifts of the edges by each of the errors that are solved for."""
        found = [np.ones(len(jacobian))] if self.rim > 0 else []
        found += [self.facing_down(jacobian)] if self.foot > 0 else []
        return np.array(found).reshape(-1, len(jacobian)).T

    def weights(self, jacobian: NDArray[np.floating]) -> Array:
        """(P,) weights of edges, up to 1."""
        if self.foot_part >= 1:
            return np.ones(len(jacobian))
        return 1 - (1 - self.foot_part) * self.facing_down(jacobian)

    def beside(self, errors: Array) -> Beside:
        """Where edges lie if the errors that are solved for have these sizes.

        Args:
            errors: (M,) in pixels.

        Returns:
            (P,) px beside the outline, and (P,) weights, from a jacobian.
        """
        return lambda jacobian: (self.columns(jacobian) @ errors, self.weights(jacobian))


def seen_error(covariance: Array, T_world_cam: SE3, centre: Array) -> Array:
    """(6, 6) covariance of the motion of an object that the error of a camera pose looks like.

    Args:
        covariance: (6, 6) of a right perturbation of the pose, metres and radians.
        T_world_cam: the pose.
        centre: (3,) of the object, in the world.

    Returns:
        Of a motion about the centre, see `checks.measure.motion`.
    """
    x, y, z = centre - T_world_cam.t
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R = T_world_cam.R
    moved = np.block([[R, -cross @ R], [np.zeros((3, 3)), R]])
    return np.asarray(moved @ covariance @ moved.T)


def seen_errors(scene: Scene, frames: Iterable[int], centre: Array) -> list[Array]:
    """(6, 6) covariance by frame of the motion that the error of its camera pose looks like."""
    stated = {p.frame: p.covariance for p in scene.poses.frames} if scene.poses else {}
    found = []
    for frame in frames:
        T_world_cam, covariance = scene.T_world_cam(frame), stated.get(frame)
        if T_world_cam is None or covariance is None:
            found.append(np.zeros((6, 6)))
        else:
            found.append(seen_error(np.reshape(covariance, (6, 6)), T_world_cam, centre))
    return found


def likelihood_beside(
    equations: MotionEquations,
    motion: Array,
    off: Array,
    covariance: Array,
    camera: Array,
    samples: float,
) -> float:
    """Likelihood of a sample at a motion and the most likely error of the camera.

    Args:
        equations: of one frame.
        motion: (7,).
        off: (6,) from it to the motion that the frame alone shows.
        covariance: (6, 6) of that.
        camera: (6, 6) covariance, from `seen_error`.
        samples: independent samples of the frame; an unlikely error costs their likelihood.
    """
    pull = np.linalg.solve(camera + covariance, off)
    error = camera @ pull
    cost = 0.5 * float(pull @ error) / max(samples, 1e-9)
    beside = equations.likelihood(motion + np.append(error, 0.0)) - cost
    return max(equations.likelihood(motion), beside)


def chance_likelihood(
    equations: Sequence[MotionEquations | FiledEquations], motion: Array
) -> float:
    """Likelihood of a sample of displaced contours: median over some frames."""
    chosen = np.unique(np.linspace(0, len(equations) - 1, _CHANCE_FRAMES).round().astype(int))
    found = [
        replace(e, offsets=e.offsets - np.float32(shift)).likelihood(motion)
        for e in (equations[k].load() for k in chosen)
        for shift in _CHANCE_PX
    ]
    return float(np.median(found))
