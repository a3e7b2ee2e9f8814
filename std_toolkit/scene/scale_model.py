"""Metric scale of the camera poses: estimates of several sources, fusion and contradictions.

The deviation of an estimate is relative to its factor and has two parts: the standard error of its
measurements, and the systematic error of its kind (`SOURCE_ERRORS`), which more measurements do not
reduce. Sources are fused with inverse variances as weights, and compared in units of their joint
deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import exp, hypot, log, sqrt
from typing import Literal

import msgspec

from std_toolkit.scene import document

# Systematic error by source, relative, one standard deviation:
# board    a print on paper; printers scale by up to 0.1 %
# cad      one scanned or modelled mesh, whose size is 0.3-0.5 % off the object's
# objects  the same meshes, compared by `propagate --refine-scale`
# depth    a consumer depth sensor without calibration, 1-2 %
# given    poses imported in metres from an unknown source
SOURCE_ERRORS = {"board": 0.001, "cad": 0.004, "objects": 0.004, "depth": 0.015, "given": 0.01}
OTHER_ERROR = 0.005
CALIBRATED_DEPTH_ERROR = 0.005
# The meshes of several models are wrong independently, but not below this.
SMALLEST_MESH_ERROR = 0.001

# Sources contradict each other beyond both limits.
MAX_SIGMA = 3.0
MAX_RELATIVE = 0.005

# Sources that compare the same meshes: only the most precise of them enters a fusion.
_MESH_SOURCES = ("cad", "objects")


class ScaleEstimate(document.Document, frozen=True, kw_only=True):
    """Estimate of the metric scale of a reconstruction by one source.

    Attributes:
        source: name of the plug-in: "depth", "cad", "board"; "objects" for `--refine-scale`.
        factor: metres per unit of the reconstruction before scaling.
        spread: interquartile range of the single estimates, relative to the factor.
        standard_error: standard error of the factor, relative to the factor.
        count: number of single estimates.
        note: description of the measurements.
        deviation: standard deviation of the factor, relative, with the systematic error of the
            source; null if it is to be taken from `SOURCE_ERRORS`.
    """

    source: str
    factor: document.Positive
    spread: document.NonNegative
    standard_error: document.NonNegative
    count: document.Count
    note: str = ""
    deviation: document.NonNegative | None = None

    @property
    def sigma(self) -> float:
        """Relative standard deviation: `deviation`, or from the kind of the source."""
        if self.deviation is not None:
            return self.deviation
        return hypot(self.standard_error, SOURCE_ERRORS.get(self.source, OTHER_ERROR))


class ScaleReport(document.Document, frozen=True, kw_only=True):
    """Metric scale of the camera poses.

    Attributes:
        unit: "metre", or "unknown" if no source of metric scale was used.
        chosen: most precise source that was used; "given" for poses imported in metres.
        estimates: estimates of all sources.
        disagreement: largest relative difference between two sources.
        factor: metres per unit of the reconstruction that the poses have; null in documents of
            version 0.1.0, whose poses have the factor of `chosen`.
        deviation: relative standard deviation of `factor`.
        fused: sources of which `factor` is the mean, weighted by inverse variance.
    """

    unit: Literal["metre", "unknown"]
    chosen: str
    estimates: list[ScaleEstimate] = msgspec.field(default_factory=list)
    disagreement: document.NonNegative = 0.0
    factor: document.Positive | None = None
    deviation: document.NonNegative | None = None
    fused: list[str] = msgspec.field(default_factory=list)

    @property
    def applied_factor(self) -> float:
        """Metres per unit of the reconstruction that the poses have; 1 for imported poses."""
        if self.factor is not None:
            return self.factor
        return next((e.factor for e in self.estimates if e.source == self.chosen), 1.0)

    @property
    def applied_sigma(self) -> float:
        """Relative standard deviation of the scale of the poses."""
        if self.deviation is not None:
            return self.deviation
        found = next((e.sigma for e in self.estimates if e.source == self.chosen), None)
        return SOURCE_ERRORS.get(self.chosen, OTHER_ERROR) if found is None else found

    def used(self) -> list[ScaleEstimate]:
        """The estimates of which the scale of the poses is the mean."""
        names = self.fused or [self.chosen]
        return [e for e in self.estimates if e.source in names]

    def consistent(self) -> ScaleReport:
        """The report with deviations filled in and `disagreement` computed from the estimates."""
        estimates = [msgspec.structs.replace(e, deviation=e.sigma) for e in self.estimates]
        largest = max((d.relative for d in differences(estimates)), default=0.0)
        return msgspec.structs.replace(self, estimates=estimates, disagreement=largest)


@dataclass(frozen=True)
class ScaleDifference:
    """Difference of two estimates.

    Attributes:
        a, b: the estimates.
        relative: |a / b - 1|.
        sigma: the same in units of the joint deviation.
    """

    a: ScaleEstimate
    b: ScaleEstimate
    relative: float
    sigma: float

    def __str__(self) -> str:
        return (
            f"{self.a.source} {_with_deviation(self.a)} and {self.b.source} "
            f"{_with_deviation(self.b)} differ by {100 * self.relative:.2f} %, "
            f"{self.sigma:.1f} joint standard deviations"
        )


def differences(estimates: Sequence[ScaleEstimate]) -> list[ScaleDifference]:
    """Differences of all pairs, the largest in joint deviations first."""
    found = []
    for a, b in combinations(estimates, 2):
        relative = abs(a.factor / b.factor - 1)
        joint = hypot(a.sigma, b.sigma)
        sigma = abs(log(a.factor / b.factor)) / max(joint, 1e-9)
        found.append(ScaleDifference(a, b, relative, sigma))
    return sorted(found, key=lambda d: -d.sigma)


def contradiction(
    estimates: Sequence[ScaleEstimate],
    *,
    max_relative: float = MAX_RELATIVE,
    max_sigma: float = MAX_SIGMA,
) -> ScaleDifference | None:
    """The pair of estimates that differs most beyond both limits; None if there is none."""
    beyond = (
        d for d in differences(estimates) if d.relative > max_relative and d.sigma > max_sigma
    )
    return next(beyond, None)


def fuse(estimates: Sequence[ScaleEstimate]) -> tuple[float, float]:
    """Mean of independent estimates, weighted by inverse variance.

    Of the sources that compare the same meshes only the most precise one counts.

    Args:
        estimates: at least one.

    Returns:
        The factor, and its relative standard deviation.
    """
    meshes = [e for e in estimates if e.source in _MESH_SOURCES]
    best = min(meshes, key=lambda e: e.sigma, default=None)
    kept = [e for e in estimates if e.source not in _MESH_SOURCES or e is best]
    weights = [max(e.sigma, 1e-9) ** -2 for e in kept]
    total = sum(weights)
    mean = sum(w * log(e.factor) for w, e in zip(weights, kept, strict=True)) / total
    return exp(mean), 1 / sqrt(total)


def mesh_deviation(standard_error: float, models: int) -> float:
    """Deviation of a scale from the sizes of `models` different meshes."""
    shape = max(SOURCE_ERRORS["cad"] / sqrt(max(models, 1)), SMALLEST_MESH_ERROR)
    return hypot(standard_error, shape)


def _with_deviation(estimate: ScaleEstimate) -> str:
    return f"{estimate.factor:.6g} +- {100 * estimate.sigma:.2f} %"
