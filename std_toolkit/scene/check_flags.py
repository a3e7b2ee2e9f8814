"""Frames and objects that the last check found bad, from check/report.json.

The exporters need only this part of the report, which they read without the checks.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document
from std_toolkit.scene import document
from std_toolkit.scene.scene import Scene


@dataclass(frozen=True)
class CheckFlags:
    """Faults that the check found.

    Attributes:
        frames: fault of a frame by frame id, such as "camera pose" or "unreadable"; frames
            without a fault are absent.
        objects: fault of an object in a frame by (frame id, object id).
    """

    frames: dict[int, str] = field(default_factory=dict)
    objects: dict[tuple[int, int], str] = field(default_factory=dict)

    def of_frame(self, frame: int) -> str:
        """All faults of a frame and the objects in it; "" without any."""
        objects = [f"object {i}: {why}" for (f, i), why in self.objects.items() if f == frame]
        return "; ".join([*([self.frames[frame]] if frame in self.frames else []), *objects])


class _ObjectFrame(msgspec.Struct):
    frame: int
    fault: str = ""


class _Object(msgspec.Struct):
    object: int
    frames: list[_ObjectFrame] = []


class _Frame(msgspec.Struct):
    frame: int
    problem: str = ""
    fault: str = ""


class _Report(msgspec.Struct):
    objects: list[_Object]
    frames: list[_Frame]


def scene_fingerprint(scene: Scene) -> str:
    """Digest of the documents and meshes, on which the check of every frame depends."""
    meshes = {m.id: _digest_or_none(scene.mesh_path(m)) for m in scene.objects.models}
    return document.digest_of(
        scene.info, scene.frame_table, scene.objects, scene.poses, scene.labels, meshes
    )


def read_check_flags(scene: Scene) -> CheckFlags | None:
    """The faults in the report of the last check.

    Returns:
        None if there is no report, or labels, camera poses or meshes changed after the check.

    Raises:
        ToolkitError: the report is damaged.
    """
    path = scene.root / "check" / "report.json"
    record_path = document.record_path(scene.root, "check")
    if not path.is_file() or not record_path.is_file():
        return None
    record = read_document(record_path, document.Record)
    if record.parameters.get("scene") != scene_fingerprint(scene):
        return None
    try:
        report = msgspec.json.decode(path.read_bytes(), type=_Report)
    except (msgspec.DecodeError, OSError) as error:
        raise ToolkitError(
            f"damaged: {error}", path=path, hint="run `std-curate check` again"
        ) from error
    frames = {f.frame: f.fault or "unreadable" for f in report.frames if f.fault or f.problem}
    objects = {
        (row.frame, item.object): row.fault
        for item in report.objects
        for row in item.frames
        if row.fault
    }
    return CheckFlags(frames, dict(sorted(objects.items())))


def _digest_or_none(path: Path) -> str | None:
    return document.digest_file(path) if path.is_file() else None
