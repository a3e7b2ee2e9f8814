"""What all edits share: each turns one state into the next. One format serves journal and script.

An edit is applied in its resolved form, which holds all it needs as numbers, so that replaying a
journal gives the same state bit for bit, whatever became of meshes and camera poses since. What
needs images or a solver is a request (`annotator.session.requests`), whose outcome is an edit.
"""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotator.session.state import AnnotationState
from std_toolkit.geometry import SE3
from std_toolkit.scene.document import Document


@dataclass(frozen=True)
class EditContext:
    """What an edit may ask of the session it is applied in.

    Attributes:
        frames: ids of all frames in which a pose can be set.
        pose: T_cam_obj of an object in a frame, from the state given; None if it has none there.
        centre: (3,) centre of a model's bounding box, mesh frame, metres: what turns turn about.
        shared: one pose holds for all frames (the scene has metric camera poses).
        annotator: who edits.
        time: when, UTC, ISO 8601.
        reserved: object ids that no new object may take: they stand in the scene's files, or belong
            to another object in a state that undo leads to.
    """

    frames: Container[int]
    pose: Callable[[AnnotationState, str, int], SE3 | None]
    centre: Callable[[str], NDArray[np.float64]]
    shared: bool
    annotator: str
    time: str
    reserved: Callable[[], Container[int]] = tuple


class Edit(Document, frozen=True, kw_only=True, tag_field="edit"):
    """Base of all edits; `apply` never changes the state it is given."""

    @property
    def title(self) -> str:
        """What it does, for the undo menu."""
        raise NotImplementedError

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the objects that it touches; empty where it concerns the scene as a whole."""
        return ()

    def resolved(self, state: AnnotationState, context: EditContext) -> Edit:
        """The same edit with everything it asks of the context written out as numbers.

        Raises:
            ToolkitError: as `apply`.
        """
        del state, context
        return self

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        """The next state.

        Raises:
            ToolkitError: unknown object, model or frame, or a value out of range.
        """
        raise NotImplementedError
