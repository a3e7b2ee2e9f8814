"""Which turns of a mesh look the same, asked so that nobody needs to know a syntax."""

from __future__ import annotations

from annotator.desk.wording import symmetry_text
from annotator.web.question import (
    CANCEL,
    Answers,
    Field,
    Question,
    Reaction,
    button,
    whole_number,
)
from std_toolkit.scene import Model

_AXES = ("x", "y", "z")
_CHOICES = (
    ("No turn looks the same", "none"),
    *((f"Any turn about {axis} (bottle, can, bowl)", f"axis:{axis}") for axis in _AXES),
    ("Half turns about x, y and z (box)", "box"),
    *((f"Equal turns about {axis}", f"fold:{axis}") for axis in _AXES),
)


def symmetry_question(model: Model, react: Reaction) -> Question:
    """Ask for the symmetry of a mesh; see `symmetry_words`."""
    folds = [Field(f"count_{axis}", "How many turns make a full one", kind="number", value=2,
                   when=("symmetry", f"fold:{axis}")) for axis in _AXES]  # fmt: skip
    return Question(
        f"Symmetry of {model.id}",
        react,
        text="Refining and comparing treat turns that look the same as equal. Axes are the mesh's "
        "own, through the middle of its bounding box: the handles along the object's axes (A) "
        "show them.",
        fields=[
            Field(
                "symmetry",
                "Symmetry",
                kind="choice",
                choices=((f"As it is: {symmetry_text(model.symmetry)}", "keep"), *_CHOICES),
                value="keep",
            ),
            *folds,
        ],
        buttons=[button("set", "Set"), CANCEL],
    )


def symmetry_words(answers: Answers) -> list[str] | None:
    """What was chosen, as `parse_symmetry` reads it; None if it stays as it is."""
    chosen = str(answers.get("symmetry", "keep"))
    if chosen not in [value for _, value in _CHOICES]:
        return None
    if chosen == "box":
        return [f"fold:{axis}:2" for axis in _AXES]
    if chosen.startswith("fold:"):
        return [f"{chosen}:{whole_number(answers, f'count_{chosen[-1]}')}"]
    return [chosen]
