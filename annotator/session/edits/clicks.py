"""Edits of clicked 2D-3D correspondences."""

from __future__ import annotations

import msgspec

from annotator.session.edits.base import Edit, EditContext
from annotator.session.state import AnnotationState, Click
from std_toolkit.errors import ToolkitError
from std_toolkit.scene.document import Count


class AddClick(Edit, frozen=True, kw_only=True, tag="add_click"):
    """One more correspondence of an object in a frame."""

    object: str
    frame: Count
    click: Click

    @property
    def title(self) -> str:
        return f"Click a point of {self.object}"

    @property
    def objects(self) -> tuple[str, ...]:
        return (self.object,)

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        clicks = state.object(self.object).clicks.get(self.frame, [])
        return _with_clicks(state, context, self.object, self.frame, [*clicks, self.click])


class ChangeClick(Edit, frozen=True, kw_only=True, tag="change_click"):
    """A correspondence is corrected, or removed where `click` is None; `index` counts from 0."""

    object: str
    frame: Count
    index: Count
    click: Click | None = None

    @property
    def title(self) -> str:
        return f"{'Correct' if self.click else 'Remove'} a point of {self.object}"

    @property
    def objects(self) -> tuple[str, ...]:
        return (self.object,)

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        clicks = list(state.object(self.object).clicks.get(self.frame, []))
        if self.index >= len(clicks):
            raise ToolkitError(
                "no such point", field="index", value=self.index, hint=f"there are {len(clicks)}"
            )
        clicks[self.index : self.index + 1] = [self.click] if self.click else []
        return _with_clicks(state, context, self.object, self.frame, clicks)


def _with_clicks(
    state: AnnotationState, context: EditContext, name: str, frame: int, clicks: list[Click]
) -> AnnotationState:
    if frame not in context.frames:
        raise ToolkitError("no such frame to click in", field="frame", value=frame)
    thing = state.object(name)
    table = {**thing.clicks, frame: clicks}
    return state.with_object(
        msgspec.structs.replace(thing, clicks={f: c for f, c in sorted(table.items()) if c})
    )
