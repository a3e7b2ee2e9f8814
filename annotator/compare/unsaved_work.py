"""Notes of a comparison on what annotators have not finished, unsaved edits included."""

from __future__ import annotations

from annotator.session.journal import journal_path, read_journal
from annotator.session.recovery import find_recovery
from std_toolkit.errors import ToolkitError
from std_toolkit.labels.agreement import comparison
from std_toolkit.labels.agreement.annotated_scene import AnnotatedScene, open_work
from std_toolkit.labels.agreement.options import CompareOptions
from std_toolkit.scene import Scene


def compare_labels(
    scene_a: Scene, scene_b: Scene, options: CompareOptions | None = None
) -> comparison.Comparison:
    """Compare the labels of two annotators of one recording.

    As `std_toolkit.labels.agreement.comparison.compare_labels`, with notes on unsaved edits.

    Raises:
        ToolkitError: the recordings differ, or a scene has no labels.
    """
    return comparison.compare_labels(scene_a, scene_b, options, notes_of=work_notes)


def work_notes(annotated: AnnotatedScene) -> list[str]:
    """Return sentences on the unfinished work of an annotator."""
    scene, name = annotated.scene, annotated.name
    notes = []
    path = journal_path(scene.root)
    if path.exists():
        try:
            unsaved = find_recovery(scene, read_journal(path))
        except ToolkitError as error:
            notes.append(f"{name}: {error}")
        else:
            if unsaved is not None:
                notes.append(f"{name}: {unsaved}; only what was saved counts here")
    return [*notes, *open_work(annotated)]
