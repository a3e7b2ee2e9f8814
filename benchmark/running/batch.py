"""Frames through a method and its scoring; a frame that cannot be scored is told, not fatal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame
from benchmark.data.source import DepthSource, FrameKey
from benchmark.methods.protocol import Restored, Restorer, View
from benchmark.protocols.protocol import Protocol
from benchmark.protocols.score import score_frame
from benchmark.running.parts import ERROR, FRAME, INDEX, NOT_FINITE, SCENE, UNREAD
from benchmark.running.views import view_of
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs.runner import error_of

Loaded = DepthFrame | str  # the frame, or why there is none
Keep = Callable[[FrameKey, Restored], None]


def load_frames(source: DepthSource, indices: Sequence[int], *, nocs: bool = False) -> list[Loaded]:
    """The frames of a batch; for one that cannot be read, the error as one line."""
    loaded: list[Loaded] = []
    for index in indices:
        try:
            loaded.append(source.load(index, nocs=nocs))
        except Exception as error:  # a damaged file can raise anything in the libraries below
            loaded.append(told(error))
    return loaded


def score_batch(
    indices: Sequence[int],
    keys: Sequence[FrameKey],
    loaded: Sequence[Loaded],
    restorer: Restorer,
    protocol: Protocol,
    keep: Keep | None = None,
) -> list[dict[str, Any]]:
    """The rows of a batch for the table.

    Args:
        indices: of the frames in the split.
        keys: their scenes and names.
        loaded: the frames, or why there is none.
        restorer: the method.
        protocol: how it is scored.
        keep: is given each frame's key and restored depth, to save it.

    Returns:
        For each frame the rows of the protocol. A frame that cannot be read has one row with a text
        in `error`; one at which the method failed has that text in the rows of an empty answer.
    """
    frames = {i: f for i, f in zip(indices, loaded, strict=True) if isinstance(f, DepthFrame)}
    views = {i: frame_view(f, restorer, protocol) for i, f in frames.items()}
    answers = restore_views(restorer, views)
    rows: list[dict[str, Any]] = []
    for index, key, frame in zip(indices, keys, loaded, strict=True):
        base: dict[str, Any] = {INDEX: index, SCENE: key.scene, FRAME: key.name}
        if isinstance(frame, str):
            rows.append({**base, ERROR: frame, **UNREAD})
            continue
        answer = answers[index]
        error = answer if isinstance(answer, str) else ""
        depth = None if isinstance(answer, str) else answer.depth
        base |= {ERROR: error, NOT_FINITE: _not_finite(depth)}
        rows += [base | row.as_dict() for row in score_frame(depth, frame, protocol)]
        if keep is not None and not isinstance(answer, str):
            keep(key, answer)
    return rows


def _not_finite(depth: NDArray[np.float32] | None) -> int:
    return 0 if depth is None else int(depth.size - np.isfinite(depth).sum())


def frame_view(frame: DepthFrame, restorer: Restorer, protocol: Protocol) -> View:
    """What a method sees of a frame under a protocol."""
    return view_of(
        frame,
        restorer.input_size or protocol.view_size,
        with_mask=restorer.needs_mask,
        # Where the protocol makes the views, it makes them as the released evaluation does.
        color_nearest=protocol.view_size is not None,
    )


def restore_views(restorer: Restorer, views: dict[int, View]) -> dict[int, Restored | str]:
    """Answers by index, or why there is none.

    If the batch fails as a whole, its frames are tried one by one.
    """
    if not views:
        return {}
    try:
        return dict(zip(views, _checked(restorer, list(views.values())), strict=True))
    except (KeyboardInterrupt, MemoryError):
        raise
    except Exception as error:
        if len(views) == 1:
            return {next(iter(views)): told(error)}
    found: dict[int, Restored | str] = {}
    for index, view in views.items():
        found |= restore_views(restorer, {index: view})
    return found


def _checked(restorer: Restorer, views: list[View]) -> list[Restored]:
    answers = restorer.restore(views)
    if len(answers) != len(views):
        raise ToolkitError(f"the method gave {len(answers)} answers to {len(views)} views")
    for view, answer in zip(views, answers, strict=True):
        if not isinstance(answer, Restored):
            raise ToolkitError("the method must give Restored(depth)", value=type(answer).__name__)
        if answer.depth.shape != view.depth.shape:
            raise ToolkitError(
                f"the method was given a view of {view.depth.shape}",
                field="Restored.depth",
                value=answer.depth.shape,
            )
    return answers


def told(error: Exception) -> str:
    """An error as one line."""
    return error_of(error).error or type(error).__name__
