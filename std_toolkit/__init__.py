"""Curation of real RGB-D recordings of specular, transparent and diffuse objects.

The names below are imported on first use: `import std_toolkit` loads none of the libraries that
the steps need.
"""

from typing import TYPE_CHECKING

from std_toolkit.plugins import install, lazy_names

if TYPE_CHECKING:
    from std_toolkit.checks.check_step import run_check
    from std_toolkit.commands import LabelCommand
    from std_toolkit.errors import ToolkitError
    from std_toolkit.exporters.export_step import export_scene
    from std_toolkit.geometry.camera import Camera
    from std_toolkit.geometry.se3 import SE3
    from std_toolkit.importers.import_step import import_recording
    from std_toolkit.importers.options import ImportRequest
    from std_toolkit.labels.entry.label import add_model, add_object, set_pose
    from std_toolkit.labels.entry.label_command import run_label_command
    from std_toolkit.labels.entry.pnp import solve_pnp
    from std_toolkit.labels.propagate import propagate_labels
    from std_toolkit.labels.refine_step import refine_labels
    from std_toolkit.options import (
        CheckOptions,
        ExportOptions,
        JobOptions,
        PoseOptions,
        PropagateOptions,
        RenderOptions,
    )
    from std_toolkit.poses.pose_gates import failed_gates
    from std_toolkit.poses.pose_step import estimate_poses
    from std_toolkit.rendering.ground_truth import read_ground_truth, rendered_frames
    from std_toolkit.rendering.render_step import render_ground_truth
    from std_toolkit.scanning.library import scan_all
    from std_toolkit.scanning.options import ScanOptions
    from std_toolkit.scanning.scan_step import scan
    from std_toolkit.scene.scene import Scene

__version__ = "0.2.0"

__all__ = [
    "SE3",
    "Camera",
    "CheckOptions",
    "ExportOptions",
    "ImportRequest",
    "JobOptions",
    "LabelCommand",
    "PoseOptions",
    "PropagateOptions",
    "RenderOptions",
    "ScanOptions",
    "Scene",
    "ToolkitError",
    "__version__",
    "add_model",
    "add_object",
    "estimate_poses",
    "export_scene",
    "failed_gates",
    "import_recording",
    "propagate_labels",
    "read_ground_truth",
    "refine_labels",
    "render_ground_truth",
    "rendered_frames",
    "run_check",
    "run_label_command",
    "scan",
    "scan_all",
    "set_pose",
    "solve_pnp",
]

# Submodule that defines each name.
_MODULES = {
    "SE3": "geometry.se3",
    "Camera": "geometry.camera",
    "CheckOptions": "options",
    "ExportOptions": "options",
    "ImportRequest": "importers.options",
    "JobOptions": "options",
    "LabelCommand": "commands",
    "PoseOptions": "options",
    "PropagateOptions": "options",
    "RenderOptions": "options",
    "ScanOptions": "scanning.options",
    "Scene": "scene.scene",
    "ToolkitError": "errors",
    "add_model": "labels.entry.label",
    "add_object": "labels.entry.label",
    "estimate_poses": "poses.pose_step",
    "export_scene": "exporters.export_step",
    "failed_gates": "poses.pose_gates",
    "import_recording": "importers.import_step",
    "propagate_labels": "labels.propagate",
    "read_ground_truth": "rendering.ground_truth",
    "refine_labels": "labels.refine_step",
    "render_ground_truth": "rendering.render_step",
    "rendered_frames": "rendering.ground_truth",
    "run_check": "checks.check_step",
    "run_label_command": "labels.entry.label_command",
    "scan": "scanning.scan_step",
    "scan_all": "scanning.library",
    "set_pose": "labels.entry.label",
    "solve_pnp": "labels.entry.pnp",
}

install()


if not TYPE_CHECKING:  # otherwise type checkers would accept misspelt names
    __getattr__ = lazy_names(__name__, _MODULES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
