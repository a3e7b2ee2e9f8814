"""The verdict on a pose in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.gates.located import SHIFT, TURN, Located, disagree
from std_toolkit.checks.result import Verdict

_EXPLAINED = {
    "": "nothing explains it",
    "shape": "the mesh has another shape",
    "texture": "the texture sits elsewhere on the object",
    "misled": "reflections mislead its contour",
    "depth": "its sensor depth errs",
    "leans": "it does not stand on the plane of the others",
}


def differing(sources: Sequence[tuple[str, Located]], name: str) -> str:
    """The first two sources that disagree, and what explains it best.

    Args:
        sources: names, and where they put the object.
        name: of the explanation.
    """
    for k, (first, a) in enumerate(sources):
        for second, b in sources[k + 1 :]:
            if disagree(a, b):
                far = a.motion - b.motion
                mm, deg = (float(np.linalg.norm(far[part])) for part in (SHIFT, TURN))
                return (
                    f"; {first} and {second} disagree by {mm:.1f} mm and {deg:.1f} deg: "
                    f"{_EXPLAINED[name]}"
                )
    return ""


def reason_of(
    verdict: Verdict, cause: str, at: Located, apart: Array | None, said_by: Sequence[str]
) -> str:
    """Where the evidence puts the object, in words.

    Args:
        verdict, cause: see `hypotheses.Weighed`.
        at: where the object is by the best explanation.
        apart: motion (6,) from the texture to the contour; None without both.
        said_by: names of the sources that say so.
    """
    (mm, mm_std), (deg, deg_std) = at.mm, at.deg
    several = len(said_by) > 1
    who = " and ".join([", ".join(said_by[:-1]), said_by[-1]]) if several else f"its {said_by[0]}"
    beside = ""
    if apart is not None:
        far, turn = float(np.linalg.norm(apart[SHIFT])), float(np.linalg.norm(apart[TURN]))
        beside = f"{far:.1f} mm and {turn:.1f} deg"
    if cause == "shape":
        return (
            "the mesh has another shape than the object: its texture fits the label, its contour "
            f"lies {beside} beside"
        )
    if cause == "texture":
        return (
            "the object has its texture elsewhere than the mesh (another print run?): its contour "
            f"fits the label, its texture lies {beside} beside"
        )
    if cause == "misled":
        return (
            f"its contour puts it {mm:.1f} mm (± {at.along(SHIFT):.1f}) and {deg:.1f} deg "
            f"(± {at.along(TURN):.1f}) from its label, and reflections may mislead it"
        )
    if cause == "blind":
        return (
            f"its images determine it only to ± {mm_std:.1f} mm and ± {deg_std:.1f} deg along the "
            "weakest direction"
        )
    if verdict == "fits":
        word = "confirm" if several else "confirms"
        return f"{who} {word} it to ± {mm_std:.1f} mm and ± {deg_std:.1f} deg"
    word = "put" if several else "puts"
    return (
        f"{who} {word} it {mm:.1f} mm (± {at.along(SHIFT):.1f}) and {deg:.1f} deg "
        f"(± {at.along(TURN):.1f}) from its label"
    )
