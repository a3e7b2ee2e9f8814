"""Gates, frames and objects that the last check found bad, from check/report.json.

The exporters need only this part of the report, which they read without the checks.
"""

from dataclasses import dataclass, field

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import digest_files, digest_of
from std_toolkit.jobs.artefact import Record, read_record, record_path
from std_toolkit.scene.document import Document
from std_toolkit.scene.scene import Scene

# Input of the check's record: the documents and meshes, see `scene_fingerprint`.
SCENE_INPUT = "labels, poses and meshes"


class FailedGate(Document, frozen=True, kw_only=True):
    """A gate of the scene that failed.

    Attributes:
        key: stable name, such as "alignment".
        title: what is measured, in words.
        value, limit: in `unit`.
        rule: "at least" or "at most" the limit.
        detail: source of the value.
        advice: how to fix it.
    """

    key: str
    title: str
    value: float | None
    limit: float
    rule: str
    unit: str = ""
    detail: str = ""
    advice: str = ""

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        value = "unknown" if self.value is None else f"{self.value:.4g}{unit}"
        about = f" ({self.detail})" if self.detail else ""
        return f"{self.key}: {self.title}: {value}{about}, must be {self.rule} {self.limit:g}{unit}"


@dataclass(frozen=True)
class CheckFlags:
    """Faults that the check found.

    Attributes:
        frames: fault of a frame by frame id, such as "camera pose" or "unreadable"; frames
            without a fault are absent.
        objects: fault of an object in a frame by (frame id, object id).
        gates: the gates of the scene that failed.
        labels: keys of the gates that an object fails, by object id.
        passed: whether the check passed, with its options.
        verdict: its line.
    """

    frames: dict[int, str] = field(default_factory=dict)
    objects: dict[tuple[int, int], str] = field(default_factory=dict)
    gates: list[FailedGate] = field(default_factory=list)
    labels: dict[int, list[str]] = field(default_factory=dict)
    passed: bool = True
    verdict: str = ""


class _Finding(msgspec.Struct):
    gate: str
    verdict: str


class _ObjectFrame(msgspec.Struct):
    frame: int
    fault: str = ""


class _Object(msgspec.Struct):
    object: int
    frames: list[_ObjectFrame] = []
    gates: list[_Finding] = []


class _Frame(msgspec.Struct):
    frame: int
    problem: str = ""
    fault: str = ""


class _Gate(msgspec.Struct):
    key: str
    title: str
    value: float | None
    limit: float
    rule: str
    status: str
    scope: str = "scene"
    unit: str = ""
    detail: str = ""
    advice: str = ""


class _Report(msgspec.Struct):
    objects: list[_Object]
    frames: list[_Frame]
    gates: list[_Gate] = []
    passed: bool = True
    verdict: str = ""


def scene_fingerprint(scene: Scene) -> str:
    """Digest of the documents and meshes, on which the check of every frame depends."""
    meshes = digest_files(scene.root, [scene.mesh_path(m) for m in scene.objects.models])
    return digest_of(
        scene.info,
        scene.frame_table,
        scene.objects,
        scene.poses,
        scene.labels.without_judgements(),
        meshes,
    )


def report_is_current(scene: Scene, fingerprint: str = "") -> bool:
    """Whether the last report belongs to the current labels, camera poses and meshes.

    Reads no image. A report whose record was deleted counts as current.

    Args:
        scene: the scene.
        fingerprint: its `scene_fingerprint`, if it is known already.
    """
    record = read_record(record_path(scene.root, "check"), Record)
    if record is None:
        return True
    return record.inputs.get(SCENE_INPUT) == (fingerprint or scene_fingerprint(scene))


def read_check_flags(scene: Scene, fingerprint: str = "") -> CheckFlags | None:
    """The faults in the report of the last check.

    Args:
        scene: the scene.
        fingerprint: its `scene_fingerprint`, if it is known already.

    Returns:
        None if there is no report, or labels, camera poses or meshes changed after the check.

    Raises:
        ToolkitError: the report is damaged.
    """
    path = scene.root / "check" / "report.json"
    record = read_record(record_path(scene.root, "check"), Record)
    if not path.is_file() or record is None:
        return None
    if record.inputs.get(SCENE_INPUT) != (fingerprint or scene_fingerprint(scene)):
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
    gates = [
        FailedGate(**{f: getattr(g, f) for f in FailedGate.__struct_fields__})
        for g in report.gates
        if g.status == "fail" and g.scope == "scene"
    ]
    labels = {
        item.object: [f.gate for f in item.gates if f.verdict in ("wrong", "doubtful")]
        for item in report.objects
    }
    return CheckFlags(
        frames, dict(sorted(objects.items())), gates, labels, report.passed, report.verdict
    )
