"""Frames in which an object lies elsewhere than in the other frames of the recording.

A motion is measured against the motion and size that all frames have in common: an error of label
or mesh, the same in every frame, is no motion. The evidence is the gain in log likelihood of the
edges, summed over neighbouring frames. A run of frames is accepted if the gain exceeds what chance
reaches, the object is seen there about as well as elsewhere, and the displacement the limit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.motion import FiledEquations, MotionEquations
from std_toolkit.checks.measure.motion_solver import solve_motion
from std_toolkit.checks.measure.residuals import ObjectObservation
from std_toolkit.checks.measure.shared_errors import chance_likelihood, likelihood_beside
from std_toolkit.checks.measure.wide_search import SearchedView
from std_toolkit.settings import Settings, limit

Equations = MotionEquations | FiledEquations

# Frames of a run that are searched, and hypotheses of each that are tried in the others.
_SEARCHED, _HYPOTHESES = 4, 5
# The common motion and the frames without it are found in turn.
_ROUNDS = 3


@dataclass(frozen=True, kw_only=True)
class FrameMotionSettings(Settings):
    """Which motions of single frames are faults."""

    sample_px: float = limit(
        20.0, unit="px", source="errors that differ from frame to frame are correlated over this"
    )
    """length of a contour that counts as one sample"""
    smallest_gain: float = limit(6.0, unit="nats", source="set on seeds 1, 2, 11 and 111")
    """gain in log likelihood of a run of frames, besides the logarithm of the number of frames"""
    unfit_gain: float = limit(1.2, unit="nats", source="set on seeds 1, 2, 11 and 111")
    """the same where the label does not fit: that is evidence by itself"""
    per_frame: float = limit(
        0.5, unit="nats", source="longer runs are as many more, and have edges in common"
    )
    """further gain for each frame of a run"""
    clear: float = limit(0.85, source="an object that lies 2.5 px elsewhere keeps a half")
    """a frame with this part of the usual likelihood has no motion of its own"""
    seed_gain: float = limit(4.0, unit="nats", source="below it no frame begins a run")
    """gain of a frame alone from which a run is tried"""
    drop: float = limit(10.0, unit="nats", source="as certain as the run itself")
    """a run ends where it lost this much"""
    seen: float = limit(0.6, source="set on seeds 1, 2, 11 and 111")
    """likelihood at the new place as a part of that usual for the object"""
    witness: float = limit(
        0.32, unit="nats", source="a flat dish of glass with 0.31 has no usual contour"
    )
    """usual likelihood of a sample above chance from which an object tells of frames"""
    unfit: float = limit(0.4, source="set on seeds 1, 2, 11 and 111")
    """a label does not fit in a frame below this part of its usual likelihood"""
    weakest: float = limit(0.75, source="reflections make frames differ; set on seed 11")
    """nor above this part of the tenth percentile of the other frames; where an object is seen in
    several frames elsewhere, as much is enough"""
    single: float = limit(1.5, source="a right frame of the real recording lies 4.9 mm off")
    """limits of the displacement that a single frame must exceed"""
    returned: float = limit(
        2.5, source="two right frames of the real recording lie 8.3 mm off; bumps of 15 mm count"
    )
    """the same for frames between others that agree: an object seldom returns to its place"""
    place_px: float = limit(20.0, unit="px", source="places this far apart are independent")
    """a far place is one of many: the needed gain grows with the places as near"""
    fewest_fits: float = limit(0.3, source="a label that fits in few frames is wrong itself")
    """share of the frames in which the label of a witness fits"""
    deviations: float = limit(3.0, unit="deviations", source="chance of one in a thousand")
    """displacement over its standard deviation"""
    shift_px: float = limit(2.5, unit="px", source="lenses and rolling shutters move less")
    """smallest displacement in the image"""


@dataclass(frozen=True, eq=False)
class Displaced:
    """Neighbouring frames in which an object lies elsewhere.

    Attributes:
        frames: ids of the frames.
        before, after: ids of the nearest other frames that show the object; None at an end.
        motion: (6,) from the common motion, see `checks.measure.motion`.
        covariance: (6, 6) of it.
        mm: displacement across the view, millimetres.
        gain, margin: log likelihood gained, and the part of it above what a run needs.
    """

    frames: tuple[int, ...]
    before: int | None
    after: int | None
    motion: Array
    covariance: Array
    mm: float
    gain: float
    margin: float = np.inf


@dataclass(frozen=True)
class _Frame:
    frame: int
    equations: Equations
    pixel_m: float
    samples: float
    camera: Array


class ObjectFrames:
    """The frames of one object: those in which it lies elsewhere, and those that do not show it.

    Args:
        observed: frame ids in order, with the object in each.
        free: (N, 6) motions that do not change its appearance, from `symmetry_motions`.
        smallest_mm: smallest displacement across the view that is a fault.
        cameras: (6, 6) by entry of `observed`, from `seen_errors`; none: they have no error.

    Attributes:
        tells: whether its label fits in so many frames that the others say something.
        fits: ids of the frames in which its label fits as in most others.
        unfit: ids of the frames in which it is not where its label is, nor near.
        part: (frames,) likelihood in parts of the usual; none of less than three frames.
        displaced: runs of frames in which it lies elsewhere.
    """

    def __init__(
        self,
        observed: Sequence[tuple[int, ObjectObservation]],
        free: Array,
        *,
        smallest_mm: float,
        cameras: Sequence[Array] = (),
    ) -> None:
        limits = FrameMotionSettings.current()
        cameras = cameras or [np.zeros((6, 6))] * len(observed)
        self.frames = [
            _Frame(f, o.motion, o.metres_per_px or 0.0, o.motion.length_px / limits.sample_px, C)
            for (f, o), C in zip(observed, cameras, strict=True)
            if o.motion is not None
        ]
        self.free, self.smallest_mm = free, smallest_mm
        self.tells, self.part, self.fits = False, np.array([]), frozenset[int]()
        self.unfit: tuple[int, ...] = ()
        self.displaced: list[Displaced] = []
        if len(self.frames) < 3:
            return
        left = np.ones(len(self.frames), bool)
        for _ in range(_ROUNDS):
            self.displaced = []
            if not self._set_common(left):
                return
            self.displaced = self._near_runs()
            taken = {f for d in self.displaced for f in d.frames}
            rest = np.array([f.frame not in taken for f in self.frames])
            # Frames in which the object lies elsewhere pull at the motion that the others share.
            if rest.sum() < 3 or (rest == left).all():
                break
            left = rest
        self._sort()

    def _set_common(self, left: NDArray[np.bool_]) -> bool:
        """Measure the common motion in some frames, and how well all frames agree with it."""
        limits = FrameMotionSettings.current()
        shared = [f for f, taken in zip(self.frames, left, strict=True) if taken]
        common = solve_motion([f.equations for f in shared], self.free, with_size=True)
        assert common is not None and common.size is not None
        self.zero = np.append(common.vector, common.size)
        self.per_sample = np.array([_expected(f, self.zero, self.free) for f in self.frames])
        self.chance = chance_likelihood([f.equations for f in shared], self.zero)
        known = np.sort(self.per_sample[left])
        self.usual = float(np.median(known[len(known) // 2 :])) - self.chance
        self.part = (self.per_sample - self.chance) / max(self.usual, 1e-9)
        self.tells = self.usual >= limits.witness and bool(
            (self.part >= limits.seen).mean() >= limits.fewest_fits
        )
        likely = self.part[self.part >= limits.unfit]
        self.weakest = limits.weakest * float(np.percentile(likely, 10) if len(likely) else 0.0)
        return self.tells

    def _sort(self) -> None:
        limits = FrameMotionSettings.current()
        taken = {f for d in self.displaced for f in d.frames}
        rest = [
            (f.frame, p)
            for f, p in zip(self.frames, self.part, strict=True)
            if f.frame not in taken
        ]
        self.fits = frozenset(f for f, p in rest if p >= limits.seen)
        self.unfit = tuple(f for f, p in rest if p < min(limits.unfit, self.weakest))

    def leave_out(self, frames: Iterable[int]) -> None:
        """Forget what frames say whose camera pose is wrong."""
        left = set(frames)
        self.unfit = tuple(f for f in self.unfit if f not in left)
        self.displaced = [
            replace(d, frames=kept)
            for d in self.displaced
            if (kept := tuple(f for f in d.frames if f not in left))
        ]

    def shift_mm(self, frame: int, motion: Array) -> float:
        """Displacement across the view in mm of a motion (6,) from the common one, in a frame."""
        k = next(k for k, f in enumerate(self.frames) if f.frame == frame)
        return self._shift(k, self.zero + np.append(motion, 0.0))[0]

    # Runs of frames with a motion within the reach of the label's profiles.

    def _near_runs(self) -> list[Displaced]:
        limits = FrameMotionSettings.current()
        seeds = []
        for k in map(int, np.flatnonzero(self.part < limits.clear)):
            frame = self.frames[k]
            alone = solve_motion([frame.equations], self.free)
            assert alone is not None
            motion = np.append(alone.vector, self.zero[6])
            gain = self._gain(k, motion)
            if gain >= limits.seed_gain and self._shift(k, motion)[1] >= limits.shift_px:
                seeds.append((gain, k, motion))
        left = np.ones(len(self.frames), bool)
        found = []
        for _, k, motion in sorted(seeds, key=lambda s: -s[0]):
            if left[k] and (run := self._grow(k, motion, left)) is not None:
                first, last, displaced = run
                left[first : last + 1] = False
                found.append(displaced)
        return sorted(found, key=lambda d: d.frames)

    def _gain(self, k: int, motion: Array, equations: Equations | None = None) -> float:
        """Log likelihood of frame k gained by a motion (7,)."""
        found = (equations or self.frames[k].equations).load().likelihood(motion)
        return self.frames[k].samples * (found - float(self.per_sample[k]))

    def _shift(self, k: int, motion: Array) -> tuple[float, float]:
        """Displacement in mm across the view, and in px, against the common motion."""
        along = self.frames[k].equations.load().jacobian @ (motion - self.zero)
        # Along the normals of a round contour half of the square of a shift is seen.
        px = float(np.sqrt(2 * (along**2).mean()))
        return 1000 * self.frames[k].pixel_m * px, px

    def _climb(self, equations: Sequence[Equations], start: Array) -> tuple[Array, Array]:
        """Motion (7,) and covariance (6, 6) from a start (7,), whose size it keeps."""
        solved = solve_motion([e.load().after(start) for e in equations], self.free)
        assert solved is not None
        return start + np.append(solved.vector, 0.0), solved.covariance

    def _extent(self, k: int, motion: Array, left: NDArray[np.bool_]) -> tuple[int, int, float]:
        """First and last frame of the run around a frame with the largest gain, and the gain."""
        limits = FrameMotionSettings.current()
        ends, total = [k, k], self._gain(k, motion)
        for side, step in ((0, -1), (1, 1)):
            here, best = 0.0, 0.0
            j = k + step
            while 0 <= j < len(self.frames) and left[j] and here > best - limits.drop:
                here += self._gain(j, motion) - limits.per_frame
                if here > best:
                    best, ends[side] = here, j
                j += step
            total += best
        return ends[0], ends[1], total

    def _grow(
        self, k: int, motion: Array, left: NDArray[np.bool_]
    ) -> tuple[int, int, Displaced] | None:
        first, last, gain = self._extent(k, motion, left)
        for _ in range(2):
            better, covariance = self._climb(
                [f.equations for f in self.frames[first : last + 1]], motion
            )
            again = self._extent(k, better, left)
            if again[2] < gain:
                break
            motion, (first, last, gain) = better, again
        inside = list(range(first, last + 1))
        found = self._accepted(
            inside, [self.frames[j].equations for j in inside], motion, covariance
        )
        return None if found is None else (first, last, found)

    def _accepted(
        self, inside: list[int], equations: Sequence[Equations], motion: Array, covariance: Array
    ) -> Displaced | None:
        """The run if it is significant, seen as usual and large enough."""
        limits = FrameMotionSettings.current()
        gain = sum(self._gain(j, motion, e) for j, e in zip(inside, equations, strict=True))
        samples = [self.frames[j].samples for j in inside]
        found = np.average([e.load().likelihood(motion) for e in equations], weights=samples)
        seen = (float(found) - self.chance) / self.usual
        shifts = np.array([self._shift(j, motion) for j in inside])
        mm, px = np.median(shifts, axis=0)
        middle = self.frames[inside[len(inside) // 2]]
        J = middle.equations.load().jacobian[:, :6].astype(np.float64)
        variance = np.einsum("pi,ij,pj->p", J, covariance, J).mean()
        std_mm = 1000 * middle.pixel_m * float(np.sqrt(2 * variance))
        lost = bool((self.part[inside] < min(limits.unfit, self.weakest)).all())
        needed = limits.unfit_gain if lost else limits.smallest_gain
        needed += float(np.log(len(self.frames)) + np.log1p((px / limits.place_px) ** 2))
        needed += limits.per_frame * len(inside)
        alone = len(inside) == 1
        if gain < needed or seen < (limits.seen if alone else min(limits.seen, self.weakest)):
            return None
        ids = [f.frame for f in self.frames]
        before = ids[inside[0] - 1] if inside[0] > 0 else None
        after = next(iter(ids[inside[-1] + 1 :]), None)
        returned = before is not None and after is not None
        least = limits.returned if returned else limits.single if alone else 1.0
        if mm < self.smallest_mm * least or px < limits.shift_px or mm < limits.deviations * std_mm:
            return None
        return Displaced(
            tuple(ids[j] for j in inside),
            before,
            after,
            (motion - self.zero)[:6],
            covariance,
            float(mm),
            gain,
            gain - needed,
        )

    # Runs of frames in which the object is not near its label.

    def search(self, view: Callable[[int], SearchedView | None], most: int) -> None:
        """Look for the object in the frames that do not show it near its label.

        Args:
            view: of a frame id; None if its image cannot be read.
            most: largest number of runs of frames that are searched.
        """
        number = {f.frame: k for k, f in enumerate(self.frames)}
        runs: list[list[int]] = []
        for k in sorted(number[f] for f in self.unfit):
            if runs and k == runs[-1][-1] + 1:
                runs[-1].append(k)
            else:
                runs.append([k])
        for run in runs[:most]:
            found = self._search_run(run, view)
            if found is not None:
                self.displaced.append(found)
        self.displaced.sort(key=lambda d: d.frames)
        self._sort()

    def _search_run(
        self, run: list[int], view: Callable[[int], SearchedView | None]
    ) -> Displaced | None:
        chosen = np.unique(np.linspace(0, len(run) - 1, _SEARCHED).round().astype(int))
        views = {run[c]: v for c in chosen if (v := view(self.frames[run[c]].frame)) is not None}
        best: tuple[float, Array] | None = None
        for k in views:
            for motion in self._places(k, views[k]):
                gain = 0.0
                for j, other in views.items():
                    e = other.equations(motion[:6])
                    if e is not None:
                        gain += self._gain(j, motion, e)
                if best is None or gain > best[0]:
                    best = gain, motion
        if best is None:
            return None
        motion = best[1]
        measured = {j: e for j, v in views.items() if (e := v.equations(motion[:6])) is not None}
        if not measured:
            return None
        motion, covariance = self._climb(list(measured.values()), motion)
        found = self._accepted(list(measured), list(measured.values()), motion, covariance)
        if found is None:
            return None
        ids = [f.frame for f in self.frames]
        after = next(iter(ids[run[-1] + 1 :]), None)
        return replace(found, frames=tuple(ids[j] for j in run), after=after)

    def _places(self, k: int, view: SearchedView) -> list[Array]:
        """The most likely motions (7,) of the object in a frame."""
        found = []
        for place in view.places():
            if (e := view.equations(place)) is None:
                continue
            motion, _ = self._climb([e], np.append(place, self.zero[6]))
            again = view.equations(motion[:6])
            if again is not None:
                found.append((self._gain(k, motion, again), motion))
        return [m for _, m in sorted(found, key=lambda pair: -pair[0])[:_HYPOTHESES]]


def _expected(frame: _Frame, zero: Array, free: Array) -> float:
    """Likelihood at the common motion and the most likely error of the frame's camera."""
    e = frame.equations.load()
    alone = solve_motion([e], free) if frame.camera.any() else None
    if alone is None:
        return e.likelihood(zero)
    off = alone.vector - zero[:6]
    return likelihood_beside(e, zero, off, alone.covariance, frame.camera, frame.samples)
