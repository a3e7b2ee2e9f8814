"""Poses at which an object looks nearly the same but for its texture, found from its mesh.

Half and quarter turns about the axes of the mesh whose turned surface nearly coincides with it,
steps of a turn for surfaces of revolution, and turns that only mirror the silhouette in the views
at hand. Symmetries that the model declares are no alternatives.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, product

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Symmetry, rotation_error, so3_exp
from std_toolkit.geometry.turned_surface import (
    SAME_AXIS,
    Basis,
    align_turn,
    axes_to_try,
    axis_name,
    spread_points,
    turn_about,
)
from std_toolkit.labels.refine.object_surface import ObjectSurface, surface_of
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Points on the surface that are compared, and steps of the alignment of the turned surface.
_POINTS, _STEPS = 600, 8


# Turns nearer to one another are the same; of nearer ones both fail if one does.
_SAME_TURN, _EQUAL_TURN = np.deg2rad(10), np.deg2rad(0.1)

# Turns that are tried about the axis of a surface of revolution.
_ROUND_STEP_DEG = 20


_SILHOUETTE_PX = 64

# Meshes whose alternatives are kept.
_KEPT = 16


@dataclass(frozen=True, kw_only=True)
class AlternativeSettings(Settings):
    """Which turned poses look nearly the same."""

    distance: float = limit(0.05, source="a handle is more, the back of a bottle less")
    """largest distance of 95 % of the turned surface, in parts of the diagonal of the bounding
    box"""
    shift: float = limit(0.08, source=NOT_RECORDED)
    """largest shift of its centre, in parts of the diagonal"""
    hopeless: float = limit(0.15, source=NOT_RECORDED)
    """a turned surface that is further away before its alignment is another shape"""
    exact: float = limit(0.01, source="not even a perfect outline tells such a turn")
    """distance below which a turn counts as exact"""
    far: float = limit(
        np.deg2rad(15),
        unit="rad",
        source="smaller turns are a matter of refinement",
    )
    """smallest turn of an alternative"""
    mirrored: float = limit(np.deg2rad(60), unit="rad", source=NOT_RECORDED)
    """smallest turn that only mirrors the silhouette"""
    mirrored_iou: float = limit(0.94, source=NOT_RECORDED)
    """smallest overlap of the silhouettes of such a turn"""
    equal_iou: float = limit(0.97, source=NOT_RECORDED)
    """silhouettes that overlap by more are equal but for the pixels of their rims"""
    similar_iou: float = limit(0.6, source="the half turn of a bracket of two arms has 0.65 to 0.9")
    """smallest mean overlap of the silhouettes of a turn after which most of a body may fit"""


@dataclass(frozen=True, eq=False)
class Alternative:
    """A turn after which an object looks nearly the same.

    Attributes:
        turn: T_obj_turned; the alternative to `pose` is `pose @ turn`.
        text: the turn in words, such as "turned by 180 deg about z".
        distance: 95th percentile of the distance between the turned surface and the surface, in
            parts of the bounding box's diagonal; NaN if only silhouettes agree.
    """

    turn: SE3
    text: str
    distance: float

    @property
    def exact(self) -> bool:
        """Whether the turned surface is the surface, as far as an image can show."""
        return self.distance <= AlternativeSettings.current().exact


class NearSymmetry:
    """Near-symmetric alternatives of one mesh.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) triangles.
        symmetry: symmetries that the model declares.

    Alternatives are searched when they are asked for: the first often suffices.
    """

    def __init__(
        self, vertices: Array, faces: NDArray[np.integer], symmetry: Symmetry | None = None
    ) -> None:
        self._surface = surface_of(vertices, faces)  # type: ignore[arg-type]
        self._symmetry = symmetry or Symmetry()
        self._same = _SameTurn(self._symmetry)
        self._points = spread_points(vertices, faces, _POINTS)[0]
        self._size = 2 * self._surface.radius
        self._bases = axes_to_try(self._points)
        self._searching = threading.Lock()
        self._turns: list[Alternative] = []
        self._rest = self._find()

    @property
    def turns(self) -> tuple[Alternative, ...]:
        """Alternatives whose turned surface nearly coincides with the surface."""
        return tuple(self.each())

    def each(self) -> Iterator[Alternative]:
        """`turns` one after the other; those not looked at are not searched."""
        for k in count():
            with self._searching:
                if k == len(self._turns):
                    found = next(self._rest, None)
                    if found is None:
                        return
                    self._turns.append(found)
                found = self._turns[k]
            yield found

    def mirrored(self, poses: Sequence[SE3]) -> list[Alternative]:
        """Turns at least 60 deg away whose silhouette is nearly the same in all given views.

        A box seen from one side, or a plate, has more of them than its shape has.

        Args:
            poses: T_cam_obj of the views.
        """
        limits = AlternativeSettings.current()
        known = [a.turn for a in self.turns]
        found: list[Alternative] = []
        views = _Views(self._surface, poses)
        for rotation, text in _cube_turns(self._bases):
            turn = turn_about(self._surface.centre, rotation)
            if rotation_error(turn, SE3.identity(), self._symmetry) < limits.mirrored:
                continue
            if self._same.any(turn, [*known, *(a.turn for a in found)]):
                continue
            if views.same_silhouettes(turn, limits.mirrored_iou):
                found.append(Alternative(turn, text, float("nan")))
        return found

    def similar(self, poses: Sequence[SE3]) -> list[Alternative]:
        """Turns of a cube after which most of the silhouette is the same, but not all of it.

        Those that overlap most come first.

        Args:
            poses: T_cam_obj of the views.
        """
        limits = AlternativeSettings.current()
        views = _Views(self._surface, poses)
        tried: list[SE3] = []
        found: list[tuple[float, Alternative]] = []
        for rotation, text in _cube_turns(self._bases):
            turn = turn_about(self._surface.centre, rotation)
            if rotation_error(turn, SE3.identity(), self._symmetry) < limits.far:
                continue
            if self._same.any(turn, tried):
                continue
            tried.append(turn)
            shared = views.overlaps(turn)
            mean = float(np.mean(shared)) if shared else 0.0
            if mean >= limits.similar_iou and min(shared) < limits.equal_iou:
                found.append((mean, Alternative(turn, text, float("nan"))))
        return [a for _, a in sorted(found, key=lambda one: -one[0])]

    def looks_equal(self, poses: Sequence[SE3], alternative: Alternative) -> bool:
        """Whether silhouettes cannot tell the alternative in any of the views.

        Args:
            poses: T_cam_obj of the views; without any, the shape decides.
        """
        limits = AlternativeSettings.current()
        if not poses:
            return alternative.exact
        return _Views(self._surface, poses).same_silhouettes(alternative.turn, limits.equal_iou)

    def _find(self) -> Iterator[Alternative]:
        limits = AlternativeSettings.current()
        found: list[SE3] = []
        failed: list[SE3] = []
        tried = [*_cube_turns(self._bases)]
        axis = self._round_axis()
        if axis is not None:
            tried += _round_turns(*axis)
        for rotation, text in tried:
            turn = turn_about(self._surface.centre, rotation)
            if rotation_error(turn, SE3.identity(), self._symmetry) < limits.far:
                continue
            # Half of the turns of a cube are others in other words; upside-down turns of a bottle
            # differ by its symmetry only.
            if self._same.any(turn, found) or self._same.any(turn, failed, within=_EQUAL_TURN):
                continue
            aligned, distance = self._aligned(turn)
            if distance <= limits.distance:
                found.append(aligned)
                yield Alternative(aligned, text, distance)
            else:
                failed.append(turn)

    def _round_axis(self) -> tuple[Array, str] | None:
        """The axis about which the mesh is a surface of revolution, if there is one."""
        limits = AlternativeSettings.current()
        for basis, names in self._bases:
            for k in range(3):
                turns = [turn_about(self._surface.centre, so3_exp(basis[k] * np.deg2rad(a)))
                         for a in (20, 37, 45, 90)]  # fmt: skip
                # Most axes fail at the first angle.
                if all(self._aligned(t, steps=0)[1] <= 0.6 * limits.distance for t in turns):
                    return basis[k], names[k]
        return None

    def _aligned(self, turn: SE3, *, steps: int = _STEPS) -> tuple[SE3, float]:
        """The turn moved so that the surfaces coincide best, and their distance then."""
        limits = AlternativeSettings.current()
        start, limit = turn, limits.shift * self._size
        few = turn @ self._points[::5]
        rough = np.linalg.norm(self._surface.closest(few)[0] - few, axis=1)
        if np.percentile(rough, 90) > limits.hopeless * self._size:
            return turn, float("inf")
        turn = align_turn(
            turn,
            self._points,
            self._surface.closest,
            centre=self._surface.centre,
            radius=self._surface.radius,
            steps=steps,
        )
        moved = np.linalg.norm(turn @ self._surface.centre - start @ self._surface.centre)
        turned = rotation_error(turn, start)
        if moved > limit or turned > SAME_AXIS:
            return start, float("inf")
        there, back = turn @ self._points, turn.inverse() @ self._points
        gaps = np.concatenate(
            [np.linalg.norm(self._surface.closest(p)[0] - p, axis=1) for p in (there, back)]
        )
        return turn, float(np.percentile(gaps, 95)) / self._size


_known: OrderedDict[tuple[bytes, Symmetry], NearSymmetry] = OrderedDict()


def near_symmetry(
    vertices: Array, faces: NDArray[np.integer], symmetry: Symmetry | None = None
) -> NearSymmetry:
    """The alternatives of a mesh, kept for the meshes that were used last; see `NearSymmetry`."""
    digest = hashlib.sha256(np.asarray(vertices).tobytes()).digest()
    digest += hashlib.sha256(np.asarray(faces).tobytes()).digest()
    key = digest, symmetry or Symmetry()
    found = _known.get(key)
    if found is None:
        found = _known[key] = NearSymmetry(vertices, faces, symmetry)
        while len(_known) > _KEPT:
            _known.popitem(last=False)
    return found


class _SameTurn:
    """Whether a turn is near known ones, over the declared symmetries."""

    def __init__(self, symmetry: Symmetry) -> None:
        self._spherical = symmetry.is_spherical
        self._discrete = np.stack([S.R for S in symmetry.discrete_transforms()])
        axes = [np.asarray(axis) / np.linalg.norm(axis) for axis, _ in symmetry.continuous]
        self._axes = np.reshape(axes, (-1, 3))

    def any(self, turn: SE3, known: Sequence[SE3], *, within: float = _SAME_TURN) -> bool:
        """True if one of them is nearer than an angle, radians."""
        if self._spherical or not known:
            return bool(known)
        R = np.stack([k.R for k in known])[:, None] @ self._discrete
        # Cosines of the angles of R^T turn, and between the axes of revolution.
        whole = ((R * turn.R).sum(axis=(2, 3)) - 1) / 2
        about = ((R @ self._axes.T) * (turn.R @ self._axes.T)).sum(axis=2)
        return bool(max(whole.max(), about.max(initial=-1.0)) > np.cos(within))


class _Views:
    """Silhouettes of an object at its pose in several views, each drawn when it is needed."""

    def __init__(self, surface: ObjectSurface, poses: Sequence[SE3]) -> None:
        self._surface, self._poses = surface, poses
        self._masks: list[NDArray[np.bool_]] = []

    def same_silhouettes(self, turn: SE3, least: float) -> bool:
        """Whether masks before and after a turn overlap by `least` (IoU) in every view."""
        return all(self._overlap(k, turn) >= least for k in range(len(self._poses)))

    def overlaps(self, turn: SE3) -> list[float]:
        """Overlaps (IoU) of the masks before and after a turn, by view."""
        return [self._overlap(k, turn) for k in range(len(self._poses))]

    def _overlap(self, k: int, turn: SE3) -> float:
        while k >= len(self._masks):
            self._masks.append(_silhouette(self._surface, self._poses[len(self._masks)]))
        before, after = self._masks[k], _silhouette(self._surface, self._poses[k] @ turn)
        return int((before & after).sum()) / max(int((before | after).sum()), 1)


def _cube_turns(bases: Sequence[Basis]) -> list[tuple[Array, str]]:
    """Half turns, quarter turns, then the other turns of a cube, with their words."""
    found = []
    for basis, names in bases:
        for degrees in (180, 90, 270):
            for k in (2, 1, 0):
                text = f"turned by {degrees} deg about {names[k]}"
                found.append((so3_exp(basis[k] * np.deg2rad(degrees)), text))
    for basis, names in bases:
        for i, j in product(range(3), repeat=2):
            for a, b in product((90, 270), (90, 180, 270)):
                if i != j:
                    R = so3_exp(basis[i] * np.deg2rad(a)) @ so3_exp(basis[j] * np.deg2rad(b))
                    text = f"turned by {b} deg about {names[j]}, then {a} deg about {names[i]}"
                    found.append((R, text))
    return found


def _round_turns(axis: Array, name: str) -> list[tuple[Array, str]]:
    """Steps of a full turn, upright and upside down."""
    across = np.eye(3)[int(np.argmin(np.abs(axis)))]
    across = across - (across @ axis) * axis
    across /= np.linalg.norm(across)
    found = []
    for degrees in range(_ROUND_STEP_DEG, 360, _ROUND_STEP_DEG):
        R = so3_exp(axis * np.deg2rad(degrees))
        found.append((R, f"turned by {degrees} deg about {name}"))
    over = so3_exp(across * np.pi)
    for degrees in range(0, 360, _ROUND_STEP_DEG):
        text = f"turned by 180 deg about {axis_name(across)}"
        if degrees:
            text += f", then {degrees} deg about {name}"
        found.append((so3_exp(axis * np.deg2rad(degrees)) @ over, text))
    return found


def _silhouette(surface: ObjectSurface, T_cam_obj: SE3) -> NDArray[np.bool_]:
    """(n, n) pixels that show the object, in a window around its centre as large as the object."""
    centre = T_cam_obj @ surface.centre
    half = surface.radius / max(float(np.linalg.norm(centre)), 1e-6)
    grid = np.linspace(-1.1, 1.1, _SILHOUETTE_PX) * half
    # Rays about the direction of the centre, so that a pose beside the image axis is the same.
    forward = centre / np.linalg.norm(centre)
    right = np.cross(np.array([0.0, 1.0, 0.0]), forward)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    x, y = np.meshgrid(grid, grid)
    rays = forward + x[..., None] * right + y[..., None] * down
    hits = surface.cast(rays.reshape(-1, 3), T_cam_obj)
    return np.asarray(np.isfinite(hits.depth).reshape(x.shape))
