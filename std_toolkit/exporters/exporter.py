"""Protocol of exporters, which write a scene in one layout, and the frame row they share."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import Any, Protocol

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.options import ExportOptions
from std_toolkit.plugins import Registry, configured, setting_of
from std_toolkit.rendering.ground_truth import FrameTruth
from std_toolkit.scene.check_flags import CheckFlags
from std_toolkit.scene.model import Frame
from std_toolkit.scene.scene import Scene
from std_toolkit.scene.sidecar import (
    ExportedFrame,
    ExportedModel,
    ExportedObject,
    LeftOutObject,
    Quality,
)

FAULTS_NAME = "label_faults.json"


@dataclass(frozen=True)
class Target:
    """Destination and contents of an export.

    Attributes:
        scene: scene to export.
        root: folder to write to (in the staging area while the export runs).
        frames: frames with complete ground truth, in order.
        object_ids: ids of the objects that appear in any frame, ascending.
        model_ids: models of those objects, in the order of objects.json.
        flags: faults that the last check found; None without a current report.
        dropped: reason by id of the frames that are left out because of a fault.
        quality: verdicts on the labels of the scene.
        without: reason by id of the objects that are left out of all frames.
    """

    scene: Scene
    root: Path
    options: ExportOptions
    frames: tuple[Frame, ...]
    object_ids: tuple[int, ...]
    model_ids: tuple[str, ...]
    flags: CheckFlags | None = None
    dropped: Mapping[int, str] = field(default_factory=dict)
    quality: Quality = field(
        default_factory=lambda: Quality(checked=False, failed_gates=[], labels=[])
    )
    without: Mapping[int, str] = field(default_factory=dict)

    def left_out(self, frame_id: int) -> dict[int, str]:
        """Reason by id of the objects that are left out of a frame; see `frame_maps`."""
        return {**faulty_objects(frame_id, self.flags, self.options), **self.without}

    def rank(self, object_id: int) -> int:
        """1-based position of an object among the exported ones: its id in dense layouts."""
        return self.object_ids.index(object_id) + 1

    def model_number(self, model_id: str) -> int:
        """1-based position of a model among the exported ones of the scene, or of all scenes."""
        return (self.options.model_ids or self.model_ids).index(model_id) + 1

    def object_fault(self, frame_id: int, object_id: int) -> str | None:
        """Why a label does not fit in a frame, "" if it does; None without a current check."""
        return None if self.flags is None else self.flags.objects.get((frame_id, object_id), "")


def faulty_objects(
    frame_id: int, flags: CheckFlags | None, options: ExportOptions
) -> dict[int, str]:
    """Fault by id of the objects that `drop_bad_frames` leaves out of a frame."""
    if flags is None or not options.drop_bad_frames:
        return {}
    return {i: f"check: {why}" for (f, i), why in flags.objects.items() if f == frame_id}


class FrameRow(msgspec.Struct, frozen=True, kw_only=True):
    """Contribution of a frame to the documents of the export.

    Attributes:
        outputs: files written, relative to the export.
        extra: layout-specific entries, plain JSON values.
    """

    frame: ExportedFrame
    truth: FrameTruth
    outputs: list[str]
    extra: dict[str, Any] = {}


class Exporter(Protocol):
    """Writes one layout.

    An exporter with settings of its own is a frozen dataclass: `std-curate export --set NAME=VALUE`
    sets its fields, which may be bool, int, float, str, literals, or tuples of one of them.
    """

    def check(self, target: Target) -> None:
        """Check that the layout can represent the scene.

        Raises:
            ToolkitError: it cannot.
        """
        ...

    def folder(self, target: Target) -> str:
        """Folder of the frames, relative to the export."""
        ...

    def label_camera(self, target: Target, camera: Camera) -> Camera:
        """Camera of the labels of frames with this colour camera (a pinhole)."""
        ...

    def write_models(self, target: Target) -> tuple[list[ExportedModel], list[str]]:
        """Write the meshes; returns them and all files written, relative to the export."""
        ...

    def write_frame(self, target: Target, frame: Frame) -> FrameRow:
        """Write one frame. Runs in a worker process; must write atomically."""
        ...

    def finish(
        self, target: Target, rows: list[FrameRow], models: list[ExportedModel]
    ) -> list[str]:
        """Write the documents over all frames; returns their paths, relative to the export."""
        ...

    def quaternion(self, target: Target) -> str | None:
        """Convention of quaternions in the layout's files, for the sidecar."""
        ...


EXPORTERS: Registry[Exporter] = Registry(
    "std_toolkit.exporters",
    {
        "std": "std_toolkit.exporters.std_exporter:STD",
        "bop": "std_toolkit.exporters.bop_exporter:BOP",
        "nocs": "std_toolkit.exporters.nocs_exporter:NOCS",
    },
)


def get_exporter(name: str, settings: Sequence[str] = ()) -> Exporter:
    """The exporter of a layout, with its own settings.

    Args:
        name: of the layout, of an installed plug-in, or `file.py:EXPORTER`.
        settings: `NAME=VALUE`, see `ExportOptions.settings`.

    Raises:
        ToolkitError: no such exporter or setting, or a wrong value.

    >>> get_exporter("nocs", ["depth=float"])
    Traceback (most recent call last):
    std_toolkit.errors.ToolkitError: --set: the exporter has no settings (got 'nocs')
    """
    exporter = EXPORTERS.get(name)
    if isinstance(exporter, type):  # `FILE.py:Class`
        exporter = exporter()
    if not settings:
        return exporter
    if not is_dataclass(exporter):
        raise ToolkitError("the exporter has no settings", field="--set", value=name)
    return configured(exporter, dict(map(setting_of, settings)), of="exporter")


def exported_frame(
    target: Target, frame: Frame, truth: FrameTruth, *, stem: str, mask_ids: dict[int, int]
) -> ExportedFrame:
    """The sidecar's entry of a frame.

    Args:
        stem: prefix of the layout's file names.
        mask_ids: object id to its value (or index) in the layout.
    """
    T_world_cam = target.scene.T_world_cam(frame.id)
    return ExportedFrame(
        id=frame.id,
        name=frame.name,
        stem=stem,
        camera=frame.camera,
        timestamp=frame.timestamp,
        T_world_cam=None if T_world_cam is None else T_world_cam.flat(),
        sensor_depth=frame.depth is not None,
        objects=[
            ExportedObject(
                object=row.object,
                mask_id=mask_ids[row.object],
                T_cam_obj=row.T_cam_obj,
                visible_fraction=row.visible_fraction,
                fault=target.object_fault(frame.id, row.object),
            )
            for row in truth.objects
        ],
        fault=None if target.flags is None else target.flags.frames.get(frame.id, ""),
        left_out=left_out_objects(
            target.scene, faulty_objects(frame.id, target.flags, target.options)
        ),
    )


def left_out_objects(scene: Scene, reasons: Mapping[int, str]) -> list[LeftOutObject]:
    """The sidecar's entries of objects that are left out, by their ids."""
    return [
        LeftOutObject(object=i, name=scene.objects.object(i).name, reason=why)
        for i, why in sorted(reasons.items())
    ]


def write_faults(target: Target, folder: str, rows: list[FrameRow]) -> list[str]:
    """Write label_faults.json for a layout whose own files cannot hold flags.

    Frames without a fault are absent; without a current check nothing is written.

    Args:
        folder: folder of the frames, relative to the export.
        rows: the exported frames.

    Returns:
        The path written, relative to the export.
    """
    if target.flags is None:
        return []
    content = {}
    for frame in (r.frame for r in rows):
        objects = {str(o.mask_id): o.fault for o in frame.objects if o.fault}
        if frame.fault or objects:
            content[frame.stem] = {"frame": frame.fault, "objects": objects}
    name = f"{folder}/{FAULTS_NAME}"
    text = json.dumps(content, indent=2, sort_keys=True) + "\n"
    write_bytes_atomic(target.root / name, text.encode())
    return [name]
