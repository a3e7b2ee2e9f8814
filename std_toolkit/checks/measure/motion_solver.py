"""The motion common to the equations of several frames, with its uncertainty.

The frames are read in blocks, so that memory does not grow with their number.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.array_file import ArrayFile
from std_toolkit.checks.measure.motion import INDEPENDENT_PX, FiledEquations, MotionEquations
from std_toolkit.checks.measure.shared_errors import SharedErrors
from std_toolkit.geometry import SE3
from std_toolkit.geometry.symmetry import Symmetry
from std_toolkit.labels.refine.edges.uncertainty import disagreement
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Anti-aliasing, shading and the mesh move edges by this much even where the label is exact.
_SMALLEST_STD_PX = 0.25
_PRIOR = np.array([0.03] * 3 + [0.25] * 3)
PRIOR_SIZE = 0.1
# Widths in px of the edge's likelihood: wide ones find the motion, the last one measures it.
_WIDTHS_PX = (6.0, 4.0, 2.5, 1.5, 1.0, 0.7)
_STEPS = 3
# The widths that searches begin with: a narrow one stays at edges near the label.
_STARTS = (0, 2, 4)
_FIXED = 1e-6
# Frames in memory at a time: 4 MB.
_BLOCK_FRAMES = 256


@dataclass(frozen=True, kw_only=True)
class SignificanceSettings(Settings):
    """Which motions are significant."""

    significant_chi2: float = limit(14.16, source="chance exceeds it as rarely as three deviations")
    """chi square with three degrees of freedom"""
    smallest_gain: float = limit(
        2.0,
        source="among clutter, the edges at the label are nearly as likely",
    )
    """a motion with a smaller gain in log likelihood is not shown"""
    contributes: float = limit(2.0, unit="deviations", source=NOT_RECORDED)
    """parts of a significant motion below this are left out"""


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion with its uncertainty.

    Attributes:
        vector: (6,), see the module.
        covariance: (6, 6).
        size: size of the object relative to its mesh, minus 1; None if it was not solved.
        size_std: its standard deviation.
        residual_px: robust standard deviation of the edges around the moved contour.
        gain: log likelihood of the independent samples gained by the motion.
        errors: (M,) px of the shared errors that were solved for.
        evidence: log likelihood of what was solved for, all its values weighed by their priors,
            against the label as it is.
        stretch: (3,) the size along each axis of `solve_motion`; None if it was not solved.
        stretch_covariance: (3, 3) of it.
    """

    vector: Array
    covariance: Array
    size: float | None
    size_std: float | None
    residual_px: float
    gain: float
    errors: Array
    evidence: float
    stretch: Array | None = None
    stretch_covariance: Array | None = None

    @property
    def translation_mm(self) -> tuple[float, float]:
        """Length of the significant translation and the standard deviation along it, mm."""
        length, std = self._significant(slice(3))
        return 1000 * length, 1000 * std

    @property
    def rotation_deg(self) -> tuple[float, float]:
        """Angle of the significant rotation and the standard deviation of it, degrees."""
        length, std = self._significant(slice(3, 6))
        return float(np.rad2deg(length)), float(np.rad2deg(std))

    def _significant(self, part: slice) -> tuple[float, float]:
        """Length of the significant part, and the standard deviation along it."""
        limits = SignificanceSettings.current()
        vector = self.vector[part] if self.gain >= limits.smallest_gain else np.zeros(3)
        return _significant(vector, self.covariance[part, part])


def symmetry_motions(symmetry: Symmetry, T_world_obj: SE3, centre: Array) -> Array:
    """(N, 6) motions that do not change the appearance of the object."""
    if symmetry.is_spherical:
        return np.eye(6)[3:]
    rows = []
    for axis, offset in symmetry.continuous:
        w = T_world_obj.R @ (np.asarray(axis) / np.linalg.norm(axis))
        rows.append(np.concatenate([np.cross(w, centre - T_world_obj @ np.asarray(offset)), w]))
    return np.array(rows).reshape(-1, 6)


def solve_motion(
    equations: Sequence[MotionEquations | FiledEquations],
    free: Array | None = None,
    *,
    with_size: bool = False,
    axes: Array | None = None,
    shared: SharedErrors | None = None,
    cameras: Sequence[Array] = (),
) -> Motion | None:
    """The motion common to all frames.

    Args:
        equations: one entry per frame.
        free: (N, 6) motions that are left out, from `symmetry_motions`.
        with_size: solve for the size of the object, too.
        axes: (3, 3) columns along which the size is measured besides, each by itself.
        shared: errors that edges of all frames share; they are part of the covariance.
        cameras: (6, 6) covariance by frame of the motion that the error of its camera looks like,
            see `shared_errors.seen_error`; none: camera poses have no error.

    Returns:
        None without equations.
    """
    if not equations:
        return None
    shared = shared or SharedErrors()
    dof = 7 if with_size else 6
    deviations = [*_PRIOR, *([PRIOR_SIZE] if with_size else []), *shared.deviations]
    prior = np.diag(1 / np.array(deviations) ** 2)
    for motion in np.zeros((0, 6)) if free is None else free:
        row = np.zeros(len(prior))
        row[:6] = motion
        prior += np.outer(row, row) / _FIXED**2
    with _Rows(equations, dof, shared) as rows:
        found = _climbs(rows, prior)
        at_label, *scores = _scores(rows, prior, [np.zeros(len(prior)), *found])
        best = int(np.argmax(scores))
        xi = found[best]
        std = _deviation(rows, xi)
        information, squares = _information(rows, xi, std)
        stretched = None if axes is None else _stretched(rows, xi, std, prior, axes)
    inverse = np.linalg.inv(information + prior).astype(np.float64)
    covariance = inverse
    if len(equations) > 1:
        frames = _by_frame(equations, dof, shared, xi, std)
        moved = [A @ C @ A for (A, _), C in zip(frames, cameras, strict=False)]
        moved += [np.zeros((6, 6))] * (len(frames) - len(moved))
        expected = [(A + C, g) for (A, g), C in zip(frames, moved, strict=True)]
        covariance = inverse * disagreement(expected, least=shared.least_disagreement)
        covariance = covariance + inverse[:, :6] @ sum(moved) @ inverse[:6]
    # px per metre and per radian.
    alike = np.diag(np.repeat([shared.systematic**2 / max(s, 1e-9) for s in squares], 3))
    kept = without_free(free)
    covariance[:6, :6] += kept @ alike @ kept.T
    stretch = stretch_covariance = None
    if stretched is not None:
        stretch, alone = stretched
        # Views disagree on it as they do on the size.
        stretch_covariance = alone * (covariance[6, 6] / inverse[6, 6])
    occam = np.linalg.slogdet(prior)[1] - np.linalg.slogdet(information + prior)[1]
    gain = scores[best] - at_label
    return Motion(
        xi[:6],
        covariance[:6, :6],
        float(xi[6]) if with_size else None,
        float(np.sqrt(covariance[6, 6])) if with_size else None,
        std,
        gain,
        xi[dof:],
        float(gain + 0.5 * occam),
        stretch,
        stretch_covariance,
    )


@dataclass(frozen=True, eq=False)
class _Block:
    """Rows of some frames, see `edge_sums.add_normal_equations`; no edge is one of strength 0."""

    offsets: Array
    strengths: Array
    clutter: Array
    share: Array
    jacobian: Array

    @staticmethod
    def of(
        equations: Sequence[MotionEquations | FiledEquations], dof: int, shared: SharedErrors
    ) -> _Block:
        loaded = [e.load() for e in equations]
        jacobian = np.concatenate([e.jacobian[:, :dof] for e in loaded]).astype(np.float64)
        offsets = np.concatenate([e.offsets for e in loaded]).astype(np.float64)
        strengths = np.concatenate([e.strengths for e in loaded]).astype(np.float64)
        clutter = np.concatenate([e.clutter for e in loaded]).astype(np.float64)
        # The number of independent samples that each row stands for.
        share = np.concatenate(
            [np.full(len(e.offsets), e.length_px / INDEPENDENT_PX / len(e.offsets)) for e in loaded]
        )
        share *= shared.weights(jacobian)
        known = np.isfinite(offsets)
        return _Block(
            np.where(known, offsets, 0.0),
            np.where(known, strengths, 0.0),
            clutter,
            share,
            np.concatenate([jacobian, shared.columns(jacobian)], axis=1),
        )

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array]:
        return self.offsets, self.strengths, self.clutter, self.share, self.jacobian

    def responsibility(self, motion: Array) -> tuple[Array, Array]:
        """(P, K) probabilities of the edges after a motion, and (P,) log likelihoods."""
        width = _WIDTHS_PX[-1]
        e = self.offsets - (self.jacobian @ motion)[:, None]
        density = self.strengths * np.exp(-0.5 * (e / width) ** 2) / (np.sqrt(2 * np.pi) * width)
        total = density.sum(axis=1) + self.clutter
        return density / total[:, None], np.log(total)


class _Rows:
    """The equations of all frames; those of a long recording are in blocks in a file."""

    def __init__(
        self,
        equations: Sequence[MotionEquations | FiledEquations],
        dof: int,
        shared: SharedErrors,
    ) -> None:
        self.one: _Block | None = None
        self._file: ArrayFile | None = None
        first = equations[0]
        if len(equations) <= _BLOCK_FRAMES or isinstance(first, MotionEquations):
            self.one = _Block.of(equations, dof, shared)
            return
        # Searches read the rows twenty times: a block is one piece of the file.
        self._file = ArrayFile(first.rows.file.folder)
        self._blocks = [
            [
                self._file.put(a)
                for a in _Block.of(equations[k : k + _BLOCK_FRAMES], dof, shared).arrays
            ]
            for k in range(0, len(equations), _BLOCK_FRAMES)
        ]

    def __enter__(self) -> _Rows:
        return self

    def __exit__(self, *error: object) -> None:
        if self._file is not None:
            self._file.close()

    def blocks(self) -> Iterator[_Block]:
        if self.one is not None:
            yield self.one
            return
        for block in self._blocks:
            yield _Block(*(np.asarray(a) for a in block))


def _climbs(rows: _Rows, prior: Array) -> list[Array]:
    """The motions (D,) that searches from the label end at, one for each of `_STARTS`."""
    from std_toolkit.checks.measure.edge_sums import (  # loads numba
        add_normal_equations,
        climb,
        next_motion,
    )

    zero = np.zeros(len(prior))
    if rows.one is not None:
        widths = np.array(_WIDTHS_PX)
        return [climb(*rows.one.arrays, prior, zero, widths[k:], _STEPS) for k in _STARTS]
    # All searches in one pass over the blocks: most of the time is reading.
    motions = [zero for _ in _STARTS]
    for turn, width in enumerate(np.repeat(_WIDTHS_PX, _STEPS)):
        active = [k for k, start in enumerate(_STARTS) if turn >= _STEPS * start]
        sums = {k: (np.zeros_like(prior), np.zeros_like(zero)) for k in active}
        for block in rows.blocks():
            for k in active:
                add_normal_equations(*block.arrays, motions[k], width, *sums[k])
        for k in active:
            motions[k] = next_motion(*sums[k], prior)
    return motions


def _scores(rows: _Rows, prior: Array, motions: Sequence[Array]) -> list[float]:
    """Log posteriors of motions (D,)."""
    found = np.zeros(len(motions))
    for block in rows.blocks():
        found += [(block.share * block.responsibility(m)[1]).sum() for m in motions]
    return [float(f - 0.5 * m @ prior @ m) for f, m in zip(found, motions, strict=True)]


def _deviation(rows: _Rows, motion: Array) -> float:
    """Robust standard deviation in px of the edges around the contour after a motion."""
    squares = weights = 0.0
    for block in rows.blocks():
        e = block.offsets - (block.jacobian @ motion)[:, None]
        weight = block.share[:, None] * block.responsibility(motion)[0]
        squares += float((weight * e**2).sum())
        weights += float(weight.sum())
    # Truncation by the width makes the residual a little too small.
    return max(1.2 * float(np.sqrt(squares / max(weights, 1e-9))), _SMALLEST_STD_PX)


def _information(rows: _Rows, motion: Array, std: float) -> tuple[Array, tuple[float, float]]:
    """Information matrix (D, D), and mean squares of the jacobian per metre and per radian."""
    total: Array | float = 0.0
    metres = radians = 0.0
    count = 0
    for block in rows.blocks():
        J = block.jacobian
        weight = block.share[:, None] * block.responsibility(motion)[0]
        w = weight.sum(axis=1) / std**2
        total = total + (J * w[:, None]).T @ J
        metres += float((J[:, :3] ** 2).sum(axis=1).sum())
        radians += float((J[:, 3:6] ** 2).sum(axis=1).sum())
        count += len(J)
    return np.asarray(total), (metres / count, radians / count)


def _stretched(
    rows: _Rows, motion: Array, std: float, prior: Array, axes: Array
) -> tuple[Array, Array]:
    """Sizes along three axes (3,) and their covariance, near a motion (D,) with one size."""
    wide = np.diag(np.insert(np.diag(prior), 6, [1 / PRIOR_SIZE**2] * 2))
    wide[:6, :6] = prior[:6, :6]
    A, b = wide.copy(), -wide @ np.insert(motion, 6, [motion[6]] * 2)
    for block in rows.blocks():
        J = block.jacobian
        force, torque, size = J[:, :3], J[:, 3:6], J[:, 6:7]
        arm = (np.cross(force, torque) + force * size) / np.maximum(
            (force**2).sum(axis=1, keepdims=True), 1e-12
        )
        J3 = np.concatenate([J[:, :6], (force @ axes) * (arm @ axes), J[:, 7:]], axis=1)
        weight = block.share[:, None] * block.responsibility(motion)[0] / std**2
        e = block.offsets - (J @ motion)[:, None]
        A += (J3 * weight.sum(axis=1)[:, None]).T @ J3
        b += J3.T @ (weight * e).sum(axis=1)
    C: Array = np.linalg.inv(A).astype(np.float64)
    return motion[6] + (C @ b)[6:9], C[6:9, 6:9]


def _by_frame(
    equations: Sequence[MotionEquations | FiledEquations],
    dof: int,
    shared: SharedErrors,
    motion: Array,
    std: float,
) -> list[tuple[Array, Array]]:
    """Information (6, 6) and gradient (6,) of each frame: errors of its camera shift all edges."""
    found = []
    for entry in equations:
        block = _Block.of([entry], dof, shared)
        e = block.offsets - (block.jacobian @ motion)[:, None]
        weight = block.share[:, None] * block.responsibility(motion)[0] / std**2
        J = block.jacobian[:, :6]
        found.append(((J * weight.sum(axis=1)[:, None]).T @ J, J.T @ (weight * e).sum(axis=1)))
    return found


def without_free(free: Array | None) -> Array:
    """(6, 6) projection that takes away what a symmetry leaves open."""
    if free is None or not len(free):
        return np.eye(6)
    F = np.asarray(free, dtype=np.float64)
    return np.asarray(np.eye(6) - F.T @ np.linalg.pinv(F @ F.T) @ F)


def _significant_part(vector: Array, covariance: Array) -> Array:
    """The vector along the principal directions that contribute; zero if it is not significant."""
    limits = SignificanceSettings.current()
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    along = axes.T @ vector
    deviations = along / np.sqrt(np.maximum(values, 1e-18))
    if (deviations**2).sum() < limits.significant_chi2:
        return np.zeros(3)
    along[np.abs(deviations) < limits.contributes] = 0
    return np.asarray(axes @ along)


def _significant(vector: Array, covariance: Array) -> tuple[float, float]:
    part = _significant_part(vector, covariance)
    length = float(np.linalg.norm(part))
    if length > 0:
        unit = part / length
        return length, float(np.sqrt(unit @ covariance @ unit))
    return 0.0, float(np.sqrt(max(np.linalg.eigvalsh((covariance + covariance.T) / 2)[-1], 0)))
