"""What `std-curate carry` takes, without expensive imports."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from std_toolkit.errors import ToolkitError, check_options
from std_toolkit.jobs.door import Writes

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


@dataclass(frozen=True, kw_only=True)
class CarryCommand:
    """Carry the poses of the objects over from a scene of the same table and objects.

    The two scenes are related by a printed board, by matched features, or by three or more points.
    Objects that SCENE lacks are added with their meshes. The poses are labels without a verdict:
    run propagate --refine and check.
    """

    scene: Path = field(metadata={"writes": Writes("scene")})
    """folder of the scene that receives the poses"""
    source: Path = field(metadata={"option": "from"})
    """folder of the labelled scene"""
    options: CarryOptions = field(default_factory=CarryOptions)
    annotator: str = ""
    """name of who carries the poses over"""
