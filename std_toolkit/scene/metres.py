"""Metres or not: poses of unknown unit must never meet anything metric."""

from __future__ import annotations

from std_toolkit.errors import ToolkitError
from std_toolkit.scene.scene import Scene


def require_metres(scene: Scene) -> None:
    """Refuse poses of unknown unit; for every step that mixes poses with metric things.

    Raises:
        ToolkitError: the scene's poses come from a run without any source of metres.
    """
    poses = scene.poses
    if poses is not None and poses.scale is not None and poses.scale.unit != "metre":
        raise ToolkitError(
            "the unit of these camera poses is unknown",
            path=scene.root / "poses.json",
            field="scale.unit",
            value=poses.scale.unit,
            hint="run `std-curate poses` with a scale source (sensor depth, --board FILE, or an "
            "object annotated in two or more frames)",
        )
