"""The verdict on every label, as far as it still holds.

The check stores its judgement with the label. It holds for the pose that was measured and for the
mesh, the frames, the camera poses and the limits of that time; otherwise the label is "unknown"
until the check measures it again. The limits of a scene are those of its last check; a label that
fits stricter ones fits them, too.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import digest_files, digest_of
from std_toolkit.io.regular import file_sizes
from std_toolkit.jobs.artefact import Record, read_record, record_path
from std_toolkit.options import CheckOptions
from std_toolkit.scene.judgement import Grade, Judgement
from std_toolkit.scene.scene import Scene
from std_toolkit.settings import changed

# Why nothing is known of a label that has no judgement.
UNCHECKED = "the label was not checked"
# Settings that decide on labels.
_GROUPS = ("checks.", "labels.")


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
        limits: of the check that differ from the defaults, by name.
    """

    object: int
    name: str
    grade: Grade
    reason: str
    probability: float | None = None
    deviation_mm: float | None = None
    deviation_deg: float | None = None
    limits: Mapping[str, float] = field(default_factory=dict)

    def line(self) -> str:
        """The verdict in one line, such as "mug: fits (97 %, ± 0.4 mm, ± 0.3 deg)"."""
        numbers = [
            f"{self.probability:.0%}".replace("%", " %") if self.probability is not None else "",
            f"± {self.deviation_mm:.1f} mm" if self.deviation_mm is not None else "",
            f"± {self.deviation_deg:.1f} deg" if self.deviation_deg is not None else "",
            _by_limits(self.limits)[2:] if self.grade == "fits" else "",
        ]
        known = ", ".join(n for n in numbers if n)
        text = f"{self.name}: {self.grade}" + (f" ({known})" if known else "")
        return text if self.grade == "fits" else f"{text}: {self.reason}"


def image_sizes(scene: Scene) -> dict[str, int]:
    """Size in bytes of the images of all frames by their path; -1 where there is none."""
    names = _images(scene)
    return dict(zip(names, file_sizes(scene.root, names), strict=True))


def _images(scene: Scene) -> list[str]:
    return [name for f in scene.frames for name in (f.color, f.depth) if name is not None]


def label_verdicts(scene: Scene, sizes: Mapping[str, int] | None = None) -> list[LabelVerdict]:
    """The verdict on every labelled object, in the order of objects.json; reads no image.

    Args:
        scene: the scene.
        sizes: its `image_sizes`, if they are known already.
    """
    if not scene.labels.labels:
        return []
    subjects, limits = _subjects(scene, sizes), _limits_of_last_check(scene)
    found = []
    for item in scene.objects.objects:
        label = scene.labels.of(item.id)
        if label is None:
            continue
        judgement = label.judgement
        problem = _problem(scene, item.id, judgement, subjects[item.id], limits)
        if problem or isinstance(judgement, msgspec.UnsetType):
            found.append(LabelVerdict(item.id, item.name, "unknown", problem))
            continue
        found.append(
            LabelVerdict(
                item.id,
                item.name,
                judgement.grade,
                judgement.reason + _by_limits(judgement.limits),
                judgement.probability,
                judgement.deviation_mm,
                judgement.deviation_deg,
                judgement.limits,
            )
        )
    return found


def judgement_inputs(scene: Scene, limits: Mapping[str, float] | None = None) -> dict[int, str]:
    """Digest of mesh, frames, camera poses and limits, by object id.

    An image counts with its size in bytes: reading all takes long.

    Args:
        scene: the scene.
        limits: that differ from the defaults, see `judgement_limits`; None: the settings in force.
    """
    limits = judgement_limits() if limits is None else limits
    return {i: digest_of(subject, dict(limits)) for i, subject in _subjects(scene).items()}


def judgement_limits(options: Mapping[str, float] | None = None) -> dict[str, float]:
    """The limits on labels that differ from the defaults, by name: of options and of settings.

    Args:
        options: those of `CheckOptions.label_limits`.
    """
    return {**(options or {}), **changed(*_GROUPS)}


def _subjects(scene: Scene, sizes: Mapping[str, int] | None = None) -> dict[int, str]:
    sizes = image_sizes(scene) if sizes is None else sizes
    frames = digest_of(
        scene.info, scene.frame_table, scene.poses, [sizes[n] for n in _images(scene)]
    )
    models = {m.id: m for m in scene.objects.models}
    meshes = digest_files(scene.root, [scene.mesh_path(m) for m in models.values()])
    return {
        item.id: digest_of(frames, item.material, model, meshes[model.mesh])
        for item in scene.objects.objects
        for model in (models[item.model],)
    }


def options_of_last_check(scene: Scene) -> CheckOptions:
    """The options of the last check of a scene; the defaults if nothing tells of one."""
    known = _last_check(scene)
    return CheckOptions() if known is None else known[0]


def _last_check(scene: Scene) -> tuple[CheckOptions, dict[str, float]] | None:
    """Options of the last check, and its settings that differ from the defaults; None if nothing
    tells of one: records may be deleted."""
    record = read_record(record_path(scene.root, "check"), Record)
    if record is None:
        return None
    names = {f.name for f in fields(CheckOptions)}
    try:
        options = CheckOptions(**{k: v for k, v in record.options.items() if k in names})
    except (ToolkitError, TypeError):  # another version wrote it
        return None
    return options, {k: v for k, v in record.options.items() if k.startswith(_GROUPS)}


def _limits_of_last_check(scene: Scene) -> dict[str, float] | None:
    """The limits on labels that differ from the defaults: of the last check; None: not known."""
    known = _last_check(scene)
    if known is None:
        return None
    return known[0].label_limits() | (changed(*_GROUPS) or known[1])


def _problem(
    scene: Scene,
    object_id: int,
    judgement: Judgement | msgspec.UnsetType,
    subject: str,
    limits: Mapping[str, float] | None,
) -> str:
    """Why nothing is known of a label; "" if the judgement holds.

    Without limits of a last check the label has those that it was judged with, which are told.
    """
    T_world_obj = scene.T_world_obj(object_id)
    if T_world_obj is None:
        return "the label is not propagated"
    if isinstance(judgement, msgspec.UnsetType):
        return UNCHECKED
    if judgement.inputs != digest_of(subject, judgement.limits):
        return "its mesh, the frames or the camera poses changed after the check"
    if not judgement.is_current(T_world_obj, judgement.inputs):
        return "the label moved after the check"
    if limits is None or limits == judgement.limits or _fits_stricter(judgement, limits):
        return ""
    return f"it was judged with other limits than the last check ({_words(judgement.limits)})"


def _by_limits(limits: Mapping[str, float]) -> str:
    return f"; limits: {_words(limits)}" if limits else ""


def _words(limits: Mapping[str, float]) -> str:
    return ", ".join(f"{k} {v:g}" for k, v in sorted(limits.items())) or "the default ones"


def _fits_stricter(judgement: Judgement, now: Mapping[str, float]) -> bool:
    """Whether a label fits, and every limit that differs allows less than it does now."""
    usual = CheckOptions()
    default: dict[str, float] = {
        f.name: getattr(usual, f.name) for f in fields(usual) if f.name.startswith("max_")
    }
    then = judgement.limits
    differing = [k for k in then.keys() | now.keys() if then.get(k) != now.get(k)]
    return judgement.grade == "fits" and all(
        k in default and then.get(k, default[k]) < now.get(k, default[k]) for k in differing
    )
