"""Questions about labels: not known to fit, carried over from another scene, propagated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from annotator.app.questions import CANCEL, Answers, Button, Choice, Field, Question, Reaction
from annotator.session.requests import CarryOver
from std_toolkit.errors import ToolkitError
from std_toolkit.options import PropagateOptions

if TYPE_CHECKING:
    from annotator.session import Session
    from std_toolkit.project.nearby import NearbyScene


# Scenes that are listed; others are named by their folder.
_MOST_SCENES = 8


def doubt_question(doubts: Sequence[tuple[str, str]], react: Reaction) -> Question:
    """Ask whether to mark objects as done whose verdict is not good: "done" or "".

    Args:
        doubts: name and reason of each object.
    """
    names = ", ".join(name for name, _ in doubts)
    return Question(
        f"{names}: not known to fit",
        react,
        text=f"{_listed(doubts)}\n\nA label marked as done counts as checked by you.",
        level="warning",
        buttons=(
            Button("", "Go back", "The object stays open."),
            Button("done", "Mark as done anyway", "You have checked it by eye."),
        ),
    )


def _listed(doubts: Sequence[tuple[str, str]]) -> str:
    return "\n".join(f"{name}: {reason}" for name, reason in doubts)


def carry_question(scenes: Sequence[NearbyScene], react: Reaction) -> Question:
    """Ask from which scene poses are carried over, and how; see `carry_request`.

    Args:
        scenes: to choose from, the best first; another folder can always be named.
    """
    known = [
        Choice(str(s.folder), f"{s.folder.name} ({s.common} of {s.labelled} objects in common)")
        for s in scenes[:_MOST_SCENES]
    ]
    return Question(
        "Carry over poses from which scene?",
        react,
        text="For a scene of the same table and objects. The two are related by what both show. "
        "The poses are unknown until they are judged in this scene.",
        fields=(
            Field(
                "scene",
                "Scene",
                kind="choice",
                value=known[0].value if known else "",
                choices=(*known, Choice("", "Another folder")),
            ),
            Field("folder", "Its folder", when=("scene", ("",))),
            Field(
                "by",
                "Related by",
                kind="choice",
                value="auto",
                choices=(
                    Choice("auto", "The board, or else features"),
                    Choice("board", "A printed board that both show"),
                    Choice("features", "Features matched in the images"),
                    Choice("points", "Three or more points of a file"),
                ),
            ),
            Field(
                "points",
                "File of points",
                when=("by", ("points",)),
                tip="CSV: from_frame, from_u, from_v, to_frame, to_u, to_v",
            ),
            Field("overwrite", "Replace poses that are here already", kind="switch", value=False),
        ),
        buttons=(Button("carry", "Carry over"), CANCEL),
    )


def carry_request(answers: Answers) -> CarryOver:
    """Return the request for the answers to `carry_question`.

    Raises:
        ToolkitError: no folder or no file of points is named.
    """
    source = answers["scene"] or answers["folder"]
    if not source:
        raise ToolkitError("name the folder of the other scene", field="folder")
    points = answers["points"] if answers["by"] == "points" else ""
    if answers["by"] == "points" and not points:
        raise ToolkitError("name the file of points", field="points")
    return CarryOver(
        source=source,
        by=answers["by"],
        points=points or None,
        overwrite=answers["overwrite"],
    )


def propagate_question(
    session: Session, doubts: Sequence[tuple[str, str]], react: Reaction
) -> Question:
    """Ask for the options of propagation; see `propagate_options`.

    Args:
        doubts: name and reason of the objects whose verdict is not good.
    """
    placed = [o for o in session.state.objects if o.placements]
    undone = [o.name for o in placed if o.status != "done"]
    objects = "1 object" if len(placed) == 1 else f"{len(placed)} objects"
    text = (
        f"The labels are saved, and the poses of {objects} are carried to "
        f"{len(session.frames)} frames through the camera poses."
    )
    if undone:
        text += f"\n\nNot marked as done yet: {', '.join(undone)}."
    if doubts:
        text += "\n\nNot confirmed:\n" + _listed(doubts)
    refining = ("refine", (True,))
    return Question(
        "Save and propagate",
        react,
        text=text,
        level="warning" if doubts else "info",
        fields=(
            Field(
                "refine",
                "Adjust each pose to several frames at once",
                kind="switch",
                value=False,
                tip="Takes minutes; the images decide, not the poses set by hand.",
            ),
            Field(
                "scale",
                "Estimate the scale of the camera poses as well",
                kind="switch",
                value=False,
                tip="Rewrites poses.json with it: for scenes whose metric scale comes from sensor "
                "depth alone.",
                when=refining,
            ),
            Field(
                "depth",
                "Use the sensor depth on raw and diffuse objects",
                kind="switch",
                value=True,
                when=refining,
            ),
            Field(
                "keyframes",
                "Adjust to",
                kind="number",
                value=10,
                least=2,
                most=200,
                unit="frames",
                when=refining,
            ),
        ),
        buttons=(
            Button("go", "Save and propagate"),
            Button("", "Cancel", "Nothing is written."),
        ),
    )


def propagate_options(answers: Answers) -> PropagateOptions:
    """Return the selected options."""
    return PropagateOptions(
        refine=answers["refine"],
        refine_scale=answers["scale"],
        use_depth=answers["depth"],
        keyframes=answers["keyframes"],
    )
