"""The verdict on every label, as far as it still holds.

The check stores its judgement with the label. It holds for the pose that was measured and for the
mesh, the frames and the camera poses of that time; otherwise the label is "unknown" until the check
measures it again.
"""

from dataclasses import dataclass
from pathlib import Path

import msgspec

from std_toolkit.io.documents import digest_files, digest_of
from std_toolkit.scene.judgement import Grade, Judgement
from std_toolkit.scene.scene import Scene

# Why nothing is known of a label that has no judgement.
UNCHECKED = "the label was not checked"


@dataclass(frozen=True)
class LabelVerdict:
    """What is known of one label.

    Attributes:
        object: object id.
        name: of the object.
        grade: that of the judgement, or "unknown" if it does not hold.
        reason: one sentence.
        probability: that the pose lies within the limits; None if it is not known.
        deviation_mm, deviation_deg: standard deviation of the measured pose along its weakest
            direction; None if it is not known.
    """

    object: int
    name: str
    grade: Grade
    reason: str
    probability: float | None = None
    deviation_mm: float | None = None
    deviation_deg: float | None = None

    def line(self) -> str:
        """The verdict in one line, such as "mug: fits (97 %, ± 0.4 mm, ± 0.3 deg)"."""
        numbers = [
            f"{self.probability:.0%}".replace("%", " %") if self.probability is not None else "",
            f"± {self.deviation_mm:.1f} mm" if self.deviation_mm is not None else "",
            f"± {self.deviation_deg:.1f} deg" if self.deviation_deg is not None else "",
        ]
        known = ", ".join(n for n in numbers if n)
        text = f"{self.name}: {self.grade}" + (f" ({known})" if known else "")
        return text if self.grade == "fits" else f"{text}: {self.reason}"


def label_verdicts(scene: Scene) -> list[LabelVerdict]:
    """The verdict on every labelled object, in the order of objects.json; reads no image."""
    inputs = judgement_inputs(scene)
    found = []
    for item in scene.objects.objects:
        label = scene.labels.of(item.id)
        if label is None:
            continue
        judgement = label.judgement
        problem = _problem(scene, item.id, judgement, inputs[item.id])
        if problem or isinstance(judgement, msgspec.UnsetType):
            found.append(LabelVerdict(item.id, item.name, "unknown", problem))
            continue
        found.append(
            LabelVerdict(
                item.id,
                item.name,
                judgement.grade,
                judgement.reason,
                judgement.probability,
                judgement.deviation_mm,
                judgement.deviation_deg,
            )
        )
    return found


def judgement_inputs(scene: Scene) -> dict[int, str]:
    """Digest of mesh, frames and camera poses, by object id; the version stands for the limits.

    An image counts with its size in bytes: reading all takes long.
    """
    files = [name for f in scene.frames for name in (f.color, f.depth) if name is not None]
    sizes = [_size(scene.root / name) for name in files]
    frames = digest_of(scene.info, scene.frame_table, scene.poses, sizes)
    models = {m.id: m for m in scene.objects.models}
    meshes = digest_files(scene.root, [scene.mesh_path(m) for m in models.values()])
    return {
        item.id: digest_of(frames, item.material, model, meshes[model.mesh])
        for item in scene.objects.objects
        for model in (models[item.model],)
    }


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return -1


def _problem(
    scene: Scene, object_id: int, judgement: Judgement | msgspec.UnsetType, inputs: str
) -> str:
    """Why nothing is known of a label; "" if the judgement holds."""
    T_world_obj = scene.T_world_obj(object_id)
    if T_world_obj is None:
        return "the label is not propagated"
    if isinstance(judgement, msgspec.UnsetType):
        return UNCHECKED
    if judgement.inputs != inputs:
        return "its mesh, the frames or the camera poses changed after the check"
    if not judgement.is_current(T_world_obj, inputs):
        return "the label moved after the check"
    return ""
