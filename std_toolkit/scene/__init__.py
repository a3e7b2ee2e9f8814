"""A scene: one recording with its cameras, frames, objects, poses and labels."""

from std_toolkit.scene.model import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Label,
    Labels,
    Model,
    Object,
    ObjectTable,
    SceneInfo,
    SymmetryModel,
)
from std_toolkit.scene.scene import Scene

__all__ = [
    "CameraModel",
    "CameraPoses",
    "Frame",
    "FramePose",
    "Frames",
    "Label",
    "Labels",
    "Model",
    "Object",
    "ObjectTable",
    "Scene",
    "SceneInfo",
    "SymmetryModel",
]
