"""What changed under the results of a run since they were made, and must be made again."""

from dataclasses import dataclass
from typing import Any

import pandas as pd

from benchmark.data.identity import (
    COLUMNS,
    INDEX,
    Digests,
    changed_content,
    content_table,
    data_digest,
    tell_changes,
)
from benchmark.evaluation.known_data import CONTENT_FILE, DATA_FILE, DataRecord
from benchmark.evaluation.results import check_columns, drop_frames, read_table
from benchmark.evaluation.task_run import TaskRun
from std_toolkit.io.atomic import atomic_path
from std_toolkit.io.documents import read_document, write_document
from std_toolkit.log import logger

CACHE = ".digests.json"


def renew(run: TaskRun[Any, Any], data: Any) -> "Renewal":
    """Compare what a run reads with what its results were made of.

    Args:
        run: whose folder may hold results.
        data: of the run.

    Returns:
        What to do; the names of what changed are logged.

    Raises:
        ToolkitError: the table of content of the run is damaged.
    """
    content = content_table(run.inputs(data), Digests(run.out / CACHE))
    path = run.folder / CONTENT_FILE
    if not path.exists():
        return Renewal(content, None)
    then = read_table(path)
    check_columns(then, COLUMNS, path)
    changed = changed_content(then, content)
    if len(changed):
        logger.warning(
            "%s: the data changed since it was scored: %s", run.title, tell_changes(changed)
        )
    return Renewal(content, changed)


@dataclass(frozen=True, eq=False)
class Renewal:
    """What a run reads now.

    Attributes:
        content: see `benchmark.data.identity.content_table`; empty for tasks that read no data.
        changed: rows that changed since the results were made; None if these do not say.
    """

    content: pd.DataFrame
    changed: pd.DataFrame | None

    def apply(self, run: TaskRun[Any, Any], data: Any, table: pd.DataFrame) -> pd.DataFrame:
        """Drop the rows of frames that changed, and write what the run knows of its data.

        Args:
            run: whose folder is locked.
            data: of the run.
            table: rows of earlier work.

        Returns:
            The rows that are right.
        """
        if self.content.empty:
            return table
        if self.changed is None:
            stale = set(table[INDEX].tolist())
            if stale:
                logger.warning(
                    "%s: these results do not say what data they are of (an earlier version made "
                    "them): scored again", run.title,
                )  # fmt: skip
        else:
            stale = set(self.changed[INDEX].tolist())
            if stale:
                logger.warning("%s: %d frames are scored again", run.title, len(stale))
        if stale:
            # First: whoever is killed here begins with the same frames.
            table = drop_frames(run.folder, run.table_name, table, stale)
            for name in run.derived:
                (run.folder / name).unlink(missing_ok=True)
        if self.changed is None or stale:
            with atomic_path(run.folder / CONTENT_FILE) as temporary:
                self.content.to_parquet(temporary, index=False, write_page_checksum=True)
        record = DataRecord(
            digest=data_digest(self.content),
            frames=run.frames_there(data),
            provenance=run.provenance(data),
        )
        path = run.folder / DATA_FILE
        if not path.exists() or read_document(path, DataRecord) != record:
            write_document(path, record)
        return table
