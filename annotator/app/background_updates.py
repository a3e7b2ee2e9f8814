"""Automatic background computations: table, penetrations, residuals, verdicts, image prefetch.

They run in the second thread of the runner and never delay computations that the user started.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from annotator.app import operations, pose_checks
from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.tasks import Task
from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from std_toolkit.labels.support.penetration import Penetration
    from std_toolkit.labels.support.plane import TablePlane, TableSearch

# A burst of key presses triggers one computation.
PENETRATION_DELAY_S = 0.3
RESIDUAL_DELAY_S = 0.8
TABLE_DELAY_S = 1.0
JUDGE_DELAY_S = 1.5
_KEYS = (
    "Table",
    "Penetration",
    "Residuals",
    operations.OTHER_RESIDUALS,
    pose_checks.RANKS,
    pose_checks.JUDGE,
)
# Number of images prefetched on each side of the one in the main view.
FRAMES_AHEAD = 4


class BackgroundUpdates:
    """Updates `table`, `penetrations` and `findings` of a controller after its events."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._cameras = controller.session.cameras
        self._unsubscribe = controller.subscribe(self._on_event)
        self._read_ahead()
        controller.start_aside("Libraries", _import_heavy, lambda _: None)
        self._begin(table_delay=0.2)

    def close(self) -> None:
        self._unsubscribe()
        self._controller.cancel_aside(*_KEYS)

    def _on_event(self, event: Event) -> None:
        c = self._controller
        if event.kind == "preview" and c.dragging is not None:
            # Dragging needs the CPU; the end of the drag requests all updates again.
            c.cancel_aside(*_KEYS)
        elif event.kind == "edited" and c.session.cameras is not self._cameras:
            # The previous table is invalid in the new world frame.
            self._cameras = c.session.cameras
            self._set_table(None)
            self._begin()
        elif event.kind in ("preview", "edited"):
            self._begin()
        elif event.kind == "selected" and c.selected is not None and c.selected not in c.residuals:
            operations.measure_residuals(c, delay=RESIDUAL_DELAY_S)
        elif event.kind == "frames":
            self._read_ahead()
            operations.measure_residuals(c, delay=RESIDUAL_DELAY_S)
            if not c.session.posed:
                self._search_table(TABLE_DELAY_S)
                self._find_penetrations()

    def _begin(self, *, table_delay: float = TABLE_DELAY_S) -> None:
        """Request everything that the last edit may have changed."""
        self._find_penetrations()
        operations.measure_residuals(self._controller, delay=RESIDUAL_DELAY_S)
        pose_checks.judge_aside(self._controller, delay=JUDGE_DELAY_S)
        table = self._controller.table
        if table is None or table.source == "objects":
            self._search_table(table_delay)

    def _read_ahead(self) -> None:
        c = self._controller
        ids = [f.id for f in c.session.scene.frames]
        at = ids.index(c.frame)
        near = [
            i for k in range(1, FRAMES_AHEAD + 1) for i in (at + k, at - k) if 0 <= i < len(ids)
        ]
        c.images.prefetch([*c.view_frames[1:], *(ids[i] for i in near)])

    # --- table -----------------------------------------------------------------------------------

    def _search_table(self, delay: float) -> None:
        c = self._controller
        snapshot, camera_frame = c.session.snapshot(), _common_camera(c)

        def work(_: Task) -> TableSearch:
            from annotator.session.requests.pose_requests import placed_objects
            from std_toolkit.labels.support.plane import TableSearch
            from std_toolkit.labels.support.table import search_table

            objects = placed_objects(snapshot, camera_frame)
            try:
                return search_table(snapshot.scene, objects=objects, camera_frame=camera_frame)
            except ToolkitError as error:
                # Reported when the user requests the table.
                return TableSearch(None, str(error))

        def finish(found: TableSearch) -> None:
            c.table_problem = found.reason
            self._set_table(found.table)

        c.start_aside("Table", work, finish, delay=delay)

    def _set_table(self, table: TablePlane | None) -> None:
        c = self._controller
        if table is not c.table:
            c.table = table
            c.emit(Event("table"))
            self._find_penetrations()

    # --- penetration -----------------------------------------------------------------------------

    def _find_penetrations(self) -> None:
        c = self._controller
        snapshot, camera_frame, table = c.session.snapshot(), _common_camera(c), c.table

        def work(_: Task) -> tuple[Penetration, ...]:
            from annotator.session.requests.pose_requests import placed_objects
            from std_toolkit.labels.support.penetration import find_penetrations

            objects = placed_objects(snapshot, camera_frame)
            plane = None if table is None or table.quality != "good" else table.plane
            # An error of the table plane is not a penetration.
            tolerance = 0.0005 if plane is None else max(0.0005, table.uncertainty_m)  # type: ignore[union-attr]
            found = find_penetrations(objects, plane=plane, tolerance_m=tolerance)
            return tuple(p for p in found if p.sure)

        def finish(found: tuple[Penetration, ...]) -> None:
            if found or c.penetrations:
                c.penetrations, c.penetrations_frame = found, camera_frame
                c.emit(Event("penetration"))

        c.start_aside("Penetration", work, finish, delay=PENETRATION_DELAY_S)


def _import_heavy(_: Task) -> None:
    """Import modules of the computations early; importing them on a key press delays the views."""
    for name in (
        "annotator.session.requests",
        "annotator.session.residuals",
        "std_toolkit.checks.measure.ranking",
        "std_toolkit.labels.support.table",
        "std_toolkit.labels.auto_refine",
        "annotator.session.judging",
        "std_toolkit.checks.label_check",
    ):
        import_module(name)


def _common_camera(c: Controller) -> int | None:
    """Return None for the world frame, or the frame whose camera replaces it if there is none."""
    return None if c.session.posed else c.frame
