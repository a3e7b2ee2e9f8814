"""What the depth images of a recording say: median, range, unit, and what means "nothing".

A few frames are read before all are written. A unit that is only guessed must give plausible
distances; one that the user or a file of the recording states is refused only where no sensor
measures.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.depth_files import (
    DepthFileSettings,
    Missing,
    frame_marks,
    lone_values,
    read_stored_depth,
)
from std_toolkit.log import logger
from std_toolkit.settings import Settings, limit

UnitOrigin = Literal["flag", "file", "format", "guess"]
"""Who states the unit: the user, a file of the recording, its format, or nobody."""
# Frames that are read, evenly spread; their pixels that are kept for the median.
_FRAMES, _PIXELS = 24, 20_000
# Units in use: millimetres, those of RealSense, TUM, L515, Kinect's raw shift, and others.
_UNITS = (0.001, 0.0001, 0.00025, 0.000125, 0.0002, 0.01, 0.1)
_R = TypeVar("_R")


@dataclass(frozen=True, kw_only=True)
class DepthSurveySettings(Settings):
    """Which median depth a unit may give."""

    nearest_m: float = limit(0.1, unit="m", source="RGB-D sensors measure from about 0.1 m")
    """a nearer median means another unit"""
    guessed_m: float = limit(
        4.0, unit="m", source="table-top recordings; units 4 to 10 times too large are in use"
    )
    """a farther median means another unit, where the unit is guessed"""
    farthest_m: float = limit(10.0, unit="m", source="the range of RGB-D sensors")
    """the same where the format of the recording has the unit"""
    possible_m: tuple[float, float] = limit(
        (0.01, 30.0), unit="m", source="no RGB-D sensor has a median outside this range"
    )
    """a median outside this range is refused for a unit that is stated, too"""


class GuessedUnit(ToolkitError):
    """The unit of depth was guessed and gives implausible distances."""


@dataclass(frozen=True, kw_only=True)
class DepthSurvey:
    """Depth of a recording, in metres.

    Attributes:
        missing: which numbers are no measurement.
        is_float: whether the images are floating-point ones.
        median_m, low_m, high_m: median, 1st and 99th percentile; None without a measurement.
        measured: fraction of the pixels with a measurement.
        marks: fraction of the pixels by number that means "nothing".
        lone: numbers at the far end that may be marks.
        origin: who states the unit.
        notes: further sentences.
        unread: why the first image cannot be read, if none can.
    """

    missing: Missing = field(default_factory=Missing)
    is_float: bool = False
    median_m: float | None = None
    low_m: float = 0.0
    high_m: float = 0.0
    measured: float = 0.0
    marks: dict[float, float] = field(default_factory=dict)
    lone: tuple[float, ...] = ()
    origin: UnitOrigin = "guess"
    notes: tuple[str, ...] = ()
    unread: ToolkitError | None = None

    def lines(self) -> list[str]:
        """The survey in sentences."""
        if self.median_m is None:
            return [f"depth: no image can be read: {self.unread}"]
        text = f"depth: median {self.median_m:.3g} m, {self.low_m:.3g} to {self.high_m:.3g} m "
        text += f"(1st to 99th percentile), {self.measured:.0%} of the pixels"
        said = {
            "flag": "stated by --depth-scale", "file": "stated by a file of the recording",
            "format": "that of the format", "guess": "guessed; --depth-scale states it",
        }[self.origin]  # fmt: skip
        number = self.missing.float_unit if self.is_float else self.missing.unit or 1.0
        lines = [f"{text}; unit {number:.6g} m a number ({said})"]
        lines += [
            f"depth: {value:.6g} means no measurement ({share:.1%} of the pixels)"
            for value, share in self.marks.items()
        ]
        return [*lines, *self.notes]

    def doubts(self) -> list[str]:
        """What only the user can decide, in sentences."""
        return [
            f"depth: {value:.6g} stands alone at the far end; if it means no measurement, give "
            f"--missing {value:.6g}"
            for value in self.lone
        ]

    def log(self, source: str = "") -> None:
        """Log both."""
        start = f"{source}: " if source else ""
        for line in self.lines():
            logger.info("%s%s", start, line)
        for line in self.doubts():
            logger.warning("%s%s", start, line)


@dataclass(frozen=True)
class DepthFile:
    """A depth image to survey.

    Attributes:
        path: the file.
        size: (width, height).
        unit: metres per number of a 16-bit image; None if it has none.
        two_bytes: see `read_foreign_depth`.
    """

    path: Path
    size: tuple[int, int]
    unit: float | None
    two_bytes: bool = False


def given_marks(text: str | None) -> tuple[float, ...]:
    """The numbers of --missing.

    Raises:
        ToolkitError: not numbers.
    """
    try:
        return tuple(float(word) for word in text.split(",")) if text else ()
    except ValueError as error:
        raise ToolkitError(
            "must be the number that means no measurement, as stored in the depth images",
            field="--missing", value=text, hint="several: --missing 65000,10000",
        ) from error  # fmt: skip


def survey_depth(
    files: Sequence[DepthFile],
    *,
    origin: UnitOrigin,
    stated: float | None = None,
    marks: tuple[float, ...] = (),
    correction: float = 1.0,
    source: Path | str | None = None,
) -> DepthSurvey:
    """Read some depth images of a recording.

    Args:
        files: all depth images in order.
        origin: who states the unit.
        stated: --depth-scale, which holds for floating-point images only if they are not in
            metres.
        marks: further numbers that mean "nothing".
        correction: factor of the depth, for the figures alone.
        source: what to name in errors; the folder of the images if None.

    Raises:
        GuessedUnit: the unit was guessed, and another is more plausible.
        ToolkitError: the unit of the format is implausible, a stated one impossible, or no image
            that can be read has a measurement.
    """
    step = max(1, len(files) // _FRAMES)
    chosen: list[tuple[DepthFile, NDArray[Any]]] = []
    unread = None
    for file in files[::step][:_FRAMES]:
        try:
            stored = read_stored_depth(file.path, size=file.size, two_bytes=file.two_bytes)
        except ToolkitError as error:  # reported with its frame
            unread = unread or error
        else:
            chosen.append((file, stored))
    if not chosen:
        return DepthSurvey(origin=origin, unread=unread)
    unit = next((f.unit for f, _ in chosen if f.unit is not None), None)
    floats = [_positive(values, marks) for _, values in chosen if values.dtype.kind == "f"]
    float_unit, notes = _float_unit(floats, stated)
    missing = Missing(marks, unit, float_unit)
    found = _marks(chosen, missing)
    missing = Missing((*marks, *(m for m in found if m not in marks)), unit, float_unit)
    metres, lone, shares, measured = _measure(chosen, missing)
    where = source if source is not None else files[0].path.parent
    if not metres.size:
        raise ToolkitError("no depth image has a measurement", path=where)
    median = _checked_median(metres * correction, missing, origin, chosen, where)
    inside = metres[metres < DepthFileSettings.current().farthest_m] * correction
    low, high = np.percentile(inside if inside.size else metres, (1, 99))
    return DepthSurvey(
        missing=missing,
        is_float=all(v.dtype.kind == "f" for _, v in chosen),
        median_m=median,
        low_m=float(low),
        high_m=float(high),
        measured=measured,
        marks=shares,
        lone=tuple(sorted(lone)),
        origin=origin,
        notes=notes,
    )


def _positive(values: NDArray[Any], marks: tuple[float, ...]) -> NDArray[Any]:
    valid = np.isfinite(values) & (values > 0)
    for mark in marks:
        valid &= values != mark
    if values.dtype == np.uint16:
        valid &= values != 65535
    return values[valid]


def _float_unit(
    floats: Sequence[NDArray[Any]], stated: float | None
) -> tuple[float, tuple[str, ...]]:
    """Metres per number of floating-point images: --depth-scale, unless they are in metres."""
    if stated is None or stated == 1 or not any(f.size for f in floats):
        return 1.0, ()
    middle = float(np.median(np.concatenate([f[:: max(1, f.size // _PIXELS)] for f in floats])))
    limits = DepthSurveySettings.current()
    as_metres = limits.nearest_m <= middle <= limits.guessed_m
    if as_metres and middle * stated < limits.nearest_m:
        return 1.0, (
            f"depth: the floating-point images are in metres (median {middle:.3g}); "
            f"--depth-scale {stated:g} is not applied to them",
        )
    return stated, ()


def _marks(chosen: Sequence[tuple[DepthFile, NDArray[Any]]], missing: Missing) -> list[float]:
    found: list[float] = []
    for _, values in chosen:
        for mark in frame_marks(_positive(values, missing.values), missing.unit_of(values)):
            if mark not in found:
                found.append(mark)
    return found


def _measure(
    chosen: Sequence[tuple[DepthFile, NDArray[Any]]], missing: Missing
) -> tuple[NDArray[np.float64], set[float], dict[float, float], float]:
    """Metres of some pixels, numbers that may be marks, shares of marks, and of measurements."""
    parts: list[NDArray[np.float64]] = []
    lone: set[float] = set()
    counts, beyond = dict.fromkeys(missing.values, 0), dict[float, int]()
    farthest = DepthFileSettings.current().farthest_m
    total = kept = 0
    for _, values in chosen:
        unit = missing.unit_of(values) or 1.0
        total += values.size
        for mark in counts:
            counts[mark] += int((values == mark).sum())
        rest = _positive(values, missing.values)
        metres = rest[:: max(1, rest.size // _PIXELS)].astype(np.float64) * unit
        near = rest.astype(np.float64) * unit < farthest
        lone.update(lone_values(rest[near], unit))
        kept += int(near.sum())
        if (far := rest[~near]).size:
            values_far, often = np.unique(far, return_counts=True)
            most = float(values_far[often.argmax()])
            beyond[most] = beyond.get(most, 0) + int(far.size)
        parts.append(metres)
    shares = {mark: n / total for mark, n in {**counts, **beyond}.items() if n}
    return np.concatenate(parts), lone, shares, kept / total


def _checked_median(
    metres: NDArray[np.float64],
    missing: Missing,
    origin: UnitOrigin,
    chosen: Sequence[tuple[DepthFile, NDArray[Any]]],
    where: Path | str,
) -> float:
    limits = DepthSurveySettings.current()
    inside = metres[metres < DepthFileSettings.current().farthest_m]
    # Where nearly all is beyond any sensor, the unit is wrong, not the pixels.
    median = float(np.median(inside if inside.size > 0.1 * metres.size else metres))
    farthest = limits.guessed_m if origin == "guess" else limits.farthest_m
    if limits.nearest_m <= median <= farthest:
        return median
    is_float = all(v.dtype.kind == "f" for _, v in chosen)
    unit = missing.float_unit if is_float else (missing.unit or 1.0)
    low, high = limits.possible_m
    if origin in ("flag", "file") and inside.size and low <= median <= high:
        return median
    if origin == "flag" and inside.size:
        raise unit_error(median, unit, where, guessed=False, is_float=is_float)
    if origin == "flag":
        fitting = " or ".join(f"{s:g}" for s in _fitting(median, unit))
        raise ToolkitError(
            "no depth image has a measurement nearer than "
            f"{DepthFileSettings.current().farthest_m:g} m",
            path=where,
            field="--depth-scale",
            value=unit,
            hint=f"{fitting} would fit" if fitting else None,
        )
    raise unit_error(median, unit, where, guessed=origin == "guess", is_float=is_float)


def _fitting(median_m: float, unit: float) -> list[float]:
    """Other units that give a plausible median."""
    return [s for s in _UNITS if 0.15 <= median_m / unit * s <= 4 and s != unit]


def unit_error(
    median_m: float, unit: float, where: Path | str, *, guessed: bool, is_float: bool
) -> ToolkitError:
    """The error of an implausible unit, with those that fit."""
    named = " or ".join(f"{s:g}" for s in _fitting(median_m, unit))
    if is_float:
        hint = "the images seem not to be in metres"
    else:
        hint = f"{unit:g} metres per unit seems wrong"
    if named:
        hint += f"; --depth-scale {named} would fit"
    if guessed:
        hint += f"; if it is right all the same: --depth-scale {unit:g}"
    kind = GuessedUnit if guessed else ToolkitError
    return kind("the median depth is implausible", path=where, value=f"{median_m:.4g} m", hint=hint)


def with_unit_asked(run: Callable[[float | None], _R]) -> _R:
    """Call `run` with None; at a terminal, ask for the unit that it could not guess, and repeat.

    Args:
        run: takes metres per number of the depth images, or None.

    Raises:
        GuessedUnit: nobody can be asked, or the answer is empty.
    """
    try:
        return run(None)
    except GuessedUnit as error:
        if not (sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()):
            raise
        sys.stderr.write(f"{error}\nmetres per number of the depth images (empty: stop): ")
        sys.stderr.flush()
        answer = sys.stdin.readline().strip()
        try:
            unit = float(answer)
        except ValueError:
            raise error from None
        return run(unit)
