"""From several sources of metres to one: all are reported, contradictions stop the run."""

from __future__ import annotations

from itertools import combinations

from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger
from std_toolkit.poses.scale.source import SOURCES, ScaleContext
from std_toolkit.scene.model import ScaleEstimate, ScaleReport

# By what their errors are known to be: a printed board 0.1 %, a mesh with good annotations
# 0.3-0.8 %, the depth of a consumer sensor 1-2 %. Further plug-ins come after these.
TRUST = ("board", "cad", "depth")
NO_SCALE_HINT = (
    "give the scene a source of metres: sensor depth, a board (--board FILE), or an object "
    "annotated in two or more frames (--scale none accepts the unknown unit silently)"
)


def check_source_name(scale: str) -> None:
    """Refuse a `--scale` that names nothing; cheap, so that it can come before the mapping.

    Raises:
        ToolkitError: it is neither "auto" nor "none" nor a known source nor a plug-in's path.
    """
    if scale not in ("auto", "none", *SOURCES.names()) and ":" not in scale:
        raise ToolkitError(
            "no such scale source",
            field="scale",
            value=scale,
            hint=f"one of auto, none, {', '.join(SOURCES.names())}",
        )


def resolve_scale(
    context: ScaleContext, *, scale: str, max_disagreement: float
) -> tuple[float, ScaleReport]:
    """Factor from the model's unit to metres, and the report.

    Args:
        context: the reconstruction and the scene.
        scale: "auto", "none" or the name of a source.
        max_disagreement: largest relative difference between two sources in "auto".

    Raises:
        ToolkitError: a source that fails, or sources that contradict each other while none is
            named.
    """
    if scale == "none":
        return 1.0, ScaleReport(unit="unknown", chosen="none")
    named = scale != "auto"
    check_source_name(scale)
    names = SOURCES.names() if scale in SOURCES.names() or not named else [*SOURCES.names(), scale]
    estimates: dict[str, ScaleEstimate] = {}
    for name in names:
        source = SOURCES.get(name)()
        if name != scale and not source.available(context):
            continue
        try:
            estimates[name] = source.estimate(context)
        except ToolkitError as error:
            if name == scale or not named:
                # A scene that has a source which cannot be used is a scene to look at, not one
                # to go on with quietly.
                raise ToolkitError(
                    f"scale source {name!r}: {error}",
                    hint=None if named else "mend it or name another source with --scale",
                ) from error
            logger.warning("scale source %s (not used): %s", name, error)
    if not estimates:
        logger.warning(
            "nothing tells the metres of this scene: the unit of its poses is UNKNOWN and every "
            "step that needs metres will refuse them; %s",
            NO_SCALE_HINT,
        )
        return 1.0, ScaleReport(unit="unknown", chosen="none")
    disagreement, worst = _disagreement(estimates)
    if disagreement > max_disagreement and not named:
        a, b = worst
        raise ToolkitError(
            f"scale sources differ by {100 * disagreement:.2f} % (limit "
            f"{100 * max_disagreement:.2f} %): {_line(estimates[a])}; {_line(estimates[b])}",
            hint=f"mend the wrong one or name the right one: --scale {a} or --scale {b}",
        )
    if disagreement > max_disagreement:
        logger.warning(
            "scale sources differ by %.2f %%; %s was named and is used", 100 * disagreement, scale
        )
    order = {name: i for i, name in enumerate(TRUST)}
    chosen = scale if named else min(estimates, key=lambda n: order.get(n, len(order)))
    report = ScaleReport(
        unit="metre",
        chosen=chosen,
        estimates=list(estimates.values()),
        disagreement=disagreement,
    )
    return estimates[chosen].factor, report


def _disagreement(estimates: dict[str, ScaleEstimate]) -> tuple[float, tuple[str, str]]:
    worst, pair = 0.0, ("", "")
    for a, b in combinations(estimates, 2):
        difference = abs(estimates[a].factor / estimates[b].factor - 1)
        if difference > worst:
            worst, pair = difference, (a, b)
    return worst, pair


def _line(estimate: ScaleEstimate) -> str:
    return (
        f"{estimate.source} {estimate.factor:.6g} (spread {100 * estimate.spread:.2f} %, "
        f"{estimate.note})"
    )
