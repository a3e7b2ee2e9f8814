"""What the tests of hostile annotations share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scene_on_disk import OBJECT_IN_WORLD, camera_pose, contents

from std_toolkit.geometry import SE3


@dataclass(frozen=True)
class Outcome:
    """What a command did."""

    status: int
    out: str
    err: str

    @property
    def error_lines(self) -> list[str]:
        return [line for line in self.err.splitlines() if line.startswith("error:")]


Annotate = Callable[..., Outcome]
Refuse = Callable[..., str]


def documents(root: Path) -> dict[str, bytes]:
    """Every file of the scene but the record of edits, which only ever grows."""
    return {k: v for k, v in contents(root).items() if not k.startswith(".std/annotate")}


def pose_in_frame(frame: int) -> SE3:
    """T_cam_obj of the box as it is labelled."""
    return camera_pose(frame).inverse() @ OBJECT_IN_WORLD


def set_pose(T: SE3 | list[Any], *, name: str = "box_1", frame: Any = 0) -> dict[str, Any]:
    """A step that puts an object somewhere."""
    numbers = T.flat() if isinstance(T, SE3) else T
    change = {"object": name, "frame": frame, "T_cam_obj": numbers}
    return {"edit": "set_poses", "changes": [change]}
