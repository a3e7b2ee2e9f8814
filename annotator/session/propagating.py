"""Carrying the labels of a scene to all its frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from std_toolkit.scene import Scene

if TYPE_CHECKING:
    from std_toolkit.labels.propagate import PropagateOptions


def carry_labels(root: Path, options: PropagateOptions | None = None) -> tuple[str, ...]:
    """Carry the labels that are saved in a scene folder to all its frames.

    Takes up to minutes, and may run in any thread. A session that has the scene open reads it again
    afterwards; nothing may be edited in it meanwhile.

    Returns:
        A line on each label, for people.

    Raises:
        ToolkitError: as `std_toolkit.labels.propagate.propagate_labels`.
    """
    from std_toolkit.labels.propagate import propagate_labels
    from std_toolkit.labels.summary import label_lines

    scene = Scene.open(root)
    return tuple(line.strip() for line in label_lines(scene, propagate_labels(scene, options)))
