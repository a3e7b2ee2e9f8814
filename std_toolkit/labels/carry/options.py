"""Options of carrying poses over, without expensive imports."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from std_toolkit.errors import ToolkitError, check_options

Way = Literal["auto", "board", "features", "points"]


@dataclass(frozen=True, kw_only=True)
class CarryOptions:
    """How poses are carried over from another scene."""

    by: Way = "auto"
    """what relates the two scenes: board (a printed board that both show), features (matched in the
    images) or points (of --points); auto takes the points if given, else the board if both show
    it, else features"""
    board: Path | None = None
    """file of the board (default: board.json of one of the scenes)"""
    points: Path | None = None
    """CSV or JSON file of three or more points that both scenes show: from_frame, from_u, from_v
    and to_frame, to_u, to_v (pixels with sensor depth), or from_x, from_y, from_z and to_x, to_y,
    to_z (metres, in the worlds of the scenes)"""
    objects: tuple[str, ...] | None = None
    """names of the objects to carry over (default: all that are labelled there)"""
    overwrite: bool = False
    """replace poses that the scene has already"""

    def __post_init__(self) -> None:
        check_options(self)
        if self.by == "points" and self.points is None:
            raise ToolkitError("--by points needs --points FILE")
        if self.points is not None and self.by not in ("auto", "points"):
            raise ToolkitError(f"--points and --by {self.by} exclude each other")
        if self.board is not None and self.by not in ("auto", "board"):
            raise ToolkitError(f"--board and --by {self.by} exclude each other")
