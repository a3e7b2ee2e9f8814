"""Compares the print of a mesh with the images at a pose and at near-symmetric alternatives.

Silhouette and sensor depth of a box, a bottle or a can are nearly the same after half a turn; only
the print differs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from std_toolkit.geometry.se3 import SE3

PrintVerdict = Literal["fits", "turned", "undecided", "ambiguous"]


@dataclass(frozen=True)
class PrintComparison:
    """The pose of one object against its alternatives.

    Attributes:
        verdict: "fits": the print agrees at the pose; "turned": it agrees clearly better after
            `turn`; "undecided": the images do not tell; "ambiguous": the mesh has no print and
            the turned silhouette is the same, so that geometry cannot tell either.
        turn: T_obj_turned of the best alternative, so that `pose @ turn` is its pose; None without
            an alternative.
        text: the turn in words, such as "turned by 180 deg about z"; "" without an alternative.
        score: agreement of print and images at the pose, -1 to 1; NaN if not measured.
        rival_score: the same at the alternative.
        frames: number of frames that were compared.
    """

    verdict: PrintVerdict
    turn: SE3 | None
    text: str
    score: float
    rival_score: float
    frames: int

    @property
    def margin(self) -> float:
        """Score minus that of the best alternative; NaN if one of them was not measured."""
        return self.score - self.rival_score

    def sentence(self) -> str:
        """The finding as one sentence without a full stop."""
        if self.verdict == "turned":
            return f"{self.text} fits the print better"
        if self.verdict == "ambiguous":
            return f"ambiguous by geometry: the mesh has no print, and {self.text} looks the same"
        if self.verdict == "undecided":
            return "the images do not tell which turn fits the print"
        return "the print fits"
