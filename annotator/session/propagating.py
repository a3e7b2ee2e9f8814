"""Carrying the labels of a scene to all its frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from std_toolkit.log import collected_warnings
from std_toolkit.scene import Scene

if TYPE_CHECKING:
    from std_toolkit.labels.propagate import PropagateOptions


@dataclass(frozen=True)
class Carried:
    """What carrying labels did.

    Attributes:
        lines: one or more on each label, for people.
        warnings: what to look at, such as a label whose refinement did not settle.
    """

    lines: tuple[str, ...]
    warnings: tuple[str, ...]


def carry_labels(root: Path, options: PropagateOptions | None = None) -> Carried:
    """Carry the labels that are saved in a scene folder to all its frames.

    Takes up to minutes, and may run in any thread. A session that has the scene open reads it again
    afterwards; nothing may be edited in it meanwhile.

    Raises:
        ToolkitError: as `std_toolkit.labels.propagate.propagate_labels`.
    """
    from std_toolkit.labels.propagate import propagate_labels
    from std_toolkit.labels.summary import label_lines

    scene = Scene.open(root)
    with collected_warnings() as warnings:
        labels = propagate_labels(scene, options)
    lines = tuple(line.strip() for line in label_lines(scene, labels))
    return Carried(lines, tuple(warnings))
