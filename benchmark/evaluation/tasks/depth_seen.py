"""What a user sees of an answer, beside its scores: the figures of `probes` on frames of a run."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data import splits
from benchmark.data.frame import DepthFrame
from benchmark.data.predictions import WithSavedDepth
from benchmark.evaluation.frames import load_each
from benchmark.evaluation.probes import ALWAYS, answer_figures, probe_color, probe_holes
from benchmark.evaluation.results import NOT_FINITE, UNREAD
from benchmark.evaluation.tasks.depth_clips import with_spread
from benchmark.methods.protocol import Restored, Restorer
from benchmark.metrics.protocols.protocol import Protocol
from benchmark.metrics.protocols.score import score_frame


def figures_seen(
    data: splits.DepthSource,
    chosen: Sequence[int],
    restorer: Restorer,
    frames: Mapping[int, DepthFrame],
    answers: Mapping[int, Restored | str],
    protocol: Protocol,
    probes: Sequence[str],
) -> dict[int, dict[str, float]]:
    """Return the figures of `benchmark.evaluation.probes` by frame.

    Args:
        data: of the run.
        chosen: indices of its frames.
        restorer: its method.
        frames, answers: some of the frames, and restored depth or error lines, by index.
        protocol: whose truth and grids count; what it aligns has no figures.
        probes: names of those that cost more runs of the method.
    """
    found: dict[int, dict[str, float]] = {}
    if protocol.align:  # what a user sees is metric
        return {index: dict.fromkeys(ALWAYS, np.nan) for index in frames}
    for index, frame in frames.items():
        # Saved depth took the place of the sensor's, which it may have harmed.
        sensor, answer = frame.depth_raw, answers[index]
        if isinstance(data, WithSavedDepth):
            sensor = data.source.load(index).depth_raw
            answer = with_spread(answer, data.answers, splits.FrameKey(frame.scene, frame.name))
        found[index] = answer_figures(restorer, frame, sensor, answer, protocol)

    def other(index: int) -> NDArray[np.uint8] | None:
        """Colour of the frame half a split away."""
        place = (chosen.index(index) + len(chosen) // 2) % len(chosen)
        return None if chosen[place] == index else data.load(chosen[place]).color

    more = []
    if "holes" in probes:
        more.append(probe_holes(restorer, frames, protocol))
    if "color" in probes:
        more.append(probe_color(restorer, frames, protocol, answers, other))
    for figures in more:
        for index, of_frame in figures.items():
            found[index] |= of_frame
    return found


def rows_unanswered(
    data: splits.DepthSource, index: int, restorer: Restorer, error: str, protocol: Protocol
) -> list[dict[str, Any]]:
    """Rows of a frame that could not be read: if only its saved depth is at fault, those of an
    empty prediction."""
    if not isinstance(data, WithSavedDepth):
        return [UNREAD]
    frame = load_each(data.source.load, [index])[0]
    if isinstance(frame, str):
        return [UNREAD]
    rows = [{NOT_FINITE: 0} | row.as_dict() for row in score_frame(None, frame, protocol)]
    if not protocol.align:
        rows[0] |= answer_figures(restorer, frame, frame.depth_raw, error, protocol)
    return rows
