"""What all requests share: they are resolved on a snapshot, in any thread, and give one edit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from annotator.session.edits import AnyEdit
from annotator.session.snapshot import Snapshot
from std_toolkit.errors import ToolkitError
from std_toolkit.scene.document import Document

Progress = Callable[[float], None]
Cancelled = Callable[[], bool]


@dataclass(frozen=True)
class Outcome:
    """What a request found.

    Attributes:
        edit: to be applied.
        report: sentences and numbers for people.
        warnings: what to look at.
        weak_directions: by object name: sentence on what of its pose was determined least.
    """

    edit: AnyEdit
    report: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    weak_directions: dict[str, str] = field(default_factory=dict)


class RequestCancelled(ToolkitError):
    """The request was cancelled while it was carried out; nothing has changed."""


@dataclass(frozen=True)
class Watch:
    """How a request that takes long tells of its progress and hears that it is not wanted.

    Attributes:
        progress: to be told the fraction done, 0 to 1.
        cancelled: to be asked now and then; what comes after is of no use then.
    """

    progress: Progress
    cancelled: Cancelled


class Request(Document, frozen=True, kw_only=True, tag_field="edit"):
    """Base of all requests; subclasses override `title` and `carry_out`."""

    @property
    def title(self) -> str:
        """What it does, for people."""
        raise NotImplementedError

    def resolve(
        self,
        snapshot: Snapshot,
        *,
        progress: Progress | None = None,
        cancelled: Cancelled | None = None,
    ) -> Outcome:
        """Carry it out on a snapshot; may run in any thread.

        Args:
            progress: told the fraction done, 0 to 1.
            cancelled: asked now and then; what comes after is of no use then.

        Raises:
            RequestCancelled: `cancelled` said so.
            ToolkitError: it cannot be carried out.
        """
        watch = Watch(progress or (lambda _: None), cancelled or (lambda: False))
        return self.carry_out(snapshot, watch)

    def carry_out(self, snapshot: Snapshot, watch: Watch) -> Outcome:
        """See `resolve`."""
        raise NotImplementedError
