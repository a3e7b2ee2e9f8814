"""A scene whose labels, objects or camera poses differ from those on disk."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from std_toolkit.scene.model import CameraPoses, Labels, ObjectTable
from std_toolkit.scene.scene import Scene

if TYPE_CHECKING:
    import trimesh


class MemoryScene(Scene):
    """A scene with documents of its own, and the images of another one; nothing is written.

    Args:
        scene: the scene on disk.
        labels, poses, objects: replace those of the scene.
        meshes: by model id, in metres, for models that are not on disk or are read already.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        labels: Labels | None = None,
        poses: CameraPoses | None = None,
        objects: ObjectTable | None = None,
        meshes: Mapping[str, trimesh.Trimesh] | None = None,
    ) -> None:
        super().__init__(scene.root, scene.info, scene.frame_table, objects or scene.objects)
        self.__dict__["labels"] = scene.labels if labels is None else labels
        self.__dict__["poses"] = poses or scene.poses
        self._meshes = {**scene._meshes, **(meshes or {})}
