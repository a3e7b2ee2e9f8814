"""A scene: one recording with its cameras, frames, objects, poses and labels."""

from std_toolkit.scene.model import (
    Annotation,
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Label,
    LabelProvenance,
    Labels,
    Model,
    Object,
    ObjectAnnotation,
    ObjectTable,
    SceneInfo,
    SymmetryModel,
)
from std_toolkit.scene.scene import Scene

__all__ = [
    "Annotation",
    "CameraModel",
    "CameraPoses",
    "Frame",
    "FramePose",
    "Frames",
    "Label",
    "LabelProvenance",
    "Labels",
    "Model",
    "Object",
    "ObjectAnnotation",
    "ObjectTable",
    "Scene",
    "SceneInfo",
    "SymmetryModel",
]
