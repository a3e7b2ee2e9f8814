"""Whether the sizes of the labelled objects change the scale of the camera poses, and by how much.

`propagate --refine-scale` measures the scale with the objects. The result is fused with the sources
that the poses have; a more precise source is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isclose

import msgspec

from std_toolkit.scene.scale_model import (
    ScaleEstimate,
    ScaleReport,
    contradiction,
    fuse,
    mesh_deviation,
)

SOURCE = "objects"


@dataclass(frozen=True)
class MeasuredScale:
    """Scale of the camera poses from the sizes of the labelled objects.

    Attributes:
        factor: on the current camera positions.
        standard_error: of the factor, relative.
        objects, models: number of objects, and of their different meshes.
        settled: whether the estimation converged.
    """

    factor: float
    standard_error: float
    objects: int
    models: int
    settled: bool


@dataclass(frozen=True)
class ScaleDecision:
    """Outcome of a comparison of measured and present scale.

    Attributes:
        factor: on the current camera positions; 1 keeps them.
        report: scale report of the poses after that.
        sentence: what was decided and why.
        kept: whether the measured scale was not used.
    """

    factor: float
    report: ScaleReport
    sentence: str
    kept: bool


def decide_scale(report: ScaleReport | None, measured: MeasuredScale) -> ScaleDecision:
    """Fuse a measured scale with the present one, unless that is more precise.

    Args:
        report: scale report of the poses; None for poses imported in metres.
        measured: scale from the objects.

    Returns:
        Keeps the scale if the measurement did not settle, is less precise than the present
        sources, or contradicts them.
    """
    before = report or ScaleReport(unit="metre", chosen="given", factor=1.0)
    now = before.applied_factor
    if not measured.settled:
        text = "the scale from the sizes of the objects did not settle and is not applied"
        return ScaleDecision(1.0, before.consistent(), text, kept=True)
    estimate = ScaleEstimate(
        source=SOURCE,
        factor=now * measured.factor,
        spread=measured.standard_error,
        standard_error=measured.standard_error,
        count=measured.objects,
        note="sizes of the labelled objects, by `propagate --refine-scale`",
        deviation=mesh_deviation(measured.standard_error, measured.models),
    )
    # An earlier result of this step saw the same objects and counts no longer.
    earlier = [e for e in before.estimates if e.source != SOURCE]
    others = [e for e in before.used() if e.source != SOURCE] or earlier or [_present(before)]
    factor, sigma = fuse(others)
    best = min(others, key=lambda e: e.sigma)
    listed = [*(earlier or others), estimate]
    kept = msgspec.structs.replace(
        before,
        chosen=best.source,
        estimates=listed,
        factor=factor,
        deviation=sigma,
        fused=[e.source for e in others],
    ).consistent()
    measured_text = (
        f"the sizes of the objects give {estimate.factor / now:.4f} +- {estimate.sigma:.4f} of "
        "the present scale"
    )
    # To the scale without an earlier result of this step; 1 unless there was one.
    back = 1.0 if isclose(factor, now, rel_tol=1e-9) else factor / now
    wrong = contradiction([*others, estimate])
    if wrong is not None:
        text = f"{measured_text}; not applied: {wrong}; check the sizes of the meshes"
        return ScaleDecision(back, kept, text, kept=True)
    if estimate.sigma >= sigma:
        text = (
            f"{measured_text}; metres from {best.source} are kept, which are more precise "
            f"(deviation {100 * sigma:.2f} %)"
        )
        return ScaleDecision(back, kept, text, kept=True)
    fused, deviation = fuse([*others, estimate])
    applied = msgspec.structs.replace(
        kept,
        chosen=SOURCE,
        factor=fused,
        deviation=deviation,
        fused=[e.source for e in _counted([*others, estimate])],
    )
    text = (
        f"{measured_text}; applied as {fused / now:.4f}, the weighted mean with "
        f"{', '.join(e.source for e in others)}"
    )
    return ScaleDecision(fused / now, applied, text, kept=False)


def _present(report: ScaleReport) -> ScaleEstimate:
    """The scale of the poses as an estimate, where none is listed, as for imported poses."""
    return ScaleEstimate(
        source=report.chosen if report.chosen != SOURCE else "given",
        factor=report.applied_factor,
        spread=0.0,
        standard_error=0.0,
        count=0,
        deviation=report.applied_sigma,
    )


def _counted(estimates: list[ScaleEstimate]) -> list[ScaleEstimate]:
    """Without the annotated sizes (`cad`), which are less precise than the refined ones."""
    return [e for e in estimates if e.source != "cad"]
