"""Frames and objects that the last check found bad, from check/report.json.

The exporters need only this part of the report, which they read without the checks.
"""

from dataclasses import dataclass, field

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import digest_files, digest_of
from std_toolkit.jobs.artefact import Record, read_record, record_path
from std_toolkit.scene.scene import Scene

# Input of the check's record: the documents and meshes, see `scene_fingerprint`.
SCENE_INPUT = "labels, poses and meshes"


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
    meshes = digest_files(scene.root, [scene.mesh_path(m) for m in scene.objects.models])
    return digest_of(
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
    record = read_record(record_path(scene.root, "check"), Record)
    if not path.is_file() or record is None:
        return None
    if record.inputs.get(SCENE_INPUT) != scene_fingerprint(scene):
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
