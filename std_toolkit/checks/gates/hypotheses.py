"""What explains the evidence on a label: its pose is off, mesh and object differ, or nothing.

Contour and texture each say where an object is, relative to its label, in six degrees of freedom
with a covariance. Where they agree, the label is judged by both together. Where they do not, three
explanations are compared by their likelihood:

- "": both see the same pose, and differ by their errors only;
- "shape": the object has another shape than the mesh, which moves its contour; its texture tells
  where it is;
- "texture": the object has its texture elsewhere than the mesh, as packaging of another print run;
  its contour tells where it is.

A contour alone may be misled: reflections and refraction look like an outline that lies elsewhere
in all frames. A label that is likely right in spite of it is unknown rather than doubtful.

A label is right, or off in place, in turn, or in both: a prior distribution of its motion. With it
the motion is known as a mixture of normal distributions, from which the probability follows that
the label lies within the limits.

Motions are vectors (6,): translation of the object's centre in mm, and rotation vector about it in
degrees, along the axes of the world.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.result import ObjectCheck, Value, Verdict
from std_toolkit.options import CheckOptions
from std_toolkit.settings import NOT_RECORDED, Settings, limit

_SAMPLES = 4000
# Covariances are filed with six digits.
_ROUNDING = 1e-5
_SHIFT, _TURN = slice(3), slice(3, 6)


@dataclass(frozen=True, kw_only=True)
class JudgeSettings(Settings):
    """How evidence is weighed, and the probabilities at which a label fits or is wrong."""

    fits: float = limit(0.95, source="as usual for a test")
    """a label fits from this probability that its pose lies within the limits"""
    wrong: float = limit(0.05, source="as usual for a test")
    """a label is wrong below this probability"""
    deviation_factor: Mapping[str, float] = limit(
        {"specular": 1.0, "transparent": 1.0},
        source=NOT_RECORDED,
    )
    """factor on the deviations of a contour's motion, by material"""
    opaque_factor: float = limit(1.0, source=NOT_RECORDED)
    """the same for other materials"""
    mesh_part: float = limit(0.003, source="scanned meshes and measured ones")
    """deviation of the place of a contour by the mesh, in parts of the object's size"""
    shape_part: float = limit(0.02, source="boxes that bulge, bottles of other production runs")
    """the same where the object has another shape"""
    shape_deg: float = limit(1.5, unit="deg", source=NOT_RECORDED)
    """rotation by which another shape moves a contour, standard deviation"""
    texture_part: float = limit(0.03, source="a bottle whose label sits 7 mm elsewhere")
    """deviation of a texture that sits elsewhere, in parts of the object's size"""
    texture_deg: float = limit(2.0, unit="deg", source="the same bottle: 2.7 deg")
    """rotation of a texture that sits elsewhere, standard deviation"""
    shape_prior: float = limit(0.10, source=NOT_RECORDED)
    """share of the objects that have another shape than their mesh"""
    texture_prior: float = limit(0.05, source=NOT_RECORDED)
    """share of the objects that have their texture elsewhere"""
    misled_prior: Mapping[str, float] = limit(
        {"specular": 0.05, "transparent": 0.05},
        source="world seeds 400 to 519 of setting kinds: one in ten is more than 3 deviations off",
    )
    """share of the contours that are misled, by material; of others none is"""
    misled_mm: float = limit(3.0, unit="mm", source="the same scenes")
    """deviation of the motion of a misled contour, besides its own"""
    misled_deg: float = limit(2.5, unit="deg", source="the same scenes")
    """the same for its rotation"""
    misled: float = limit(
        0.5, source="the same scenes: right labels that seem to be off by 2 to 4 deg"
    )
    """a doubtful label whose contour may be misled is unknown from this probability"""
    right_mm: float = limit(1.5, unit="mm", source="refined labels")
    """deviation of right labels"""
    right_deg: float = limit(0.8, unit="deg", source="refined labels")
    """the same for their rotation"""
    off_mm: float = limit(5.0, unit="mm", source="faults up to 15 mm long")
    """deviation of wrong labels along each axis"""
    off_deg: float = limit(3.3, unit="deg", source="faults up to 10 degrees")
    """the same for their rotation"""
    right_prior: float = limit(0.5, source="half of the labels may be wrong")
    """share of the labels that are right; the others are off in place, turn, or both"""
    blind: float = limit(0.5, source="such a fault would look right rather than wrong")
    """evidence is blind that leaves a label with a fault of twice a limit more probability"""
    noted_odds: float = limit(3.0, source=NOT_RECORDED)
    """an explanation is told where it is more likely than all others by this factor"""
    noted_mm: float = limit(2.0, unit="mm", source=NOT_RECORDED)
    """a difference between contour and texture below this is not told"""
    noted_deg: float = limit(1.0, unit="deg", source=NOT_RECORDED)
    """the same for a rotation"""


@dataclass(frozen=True, eq=False)
class Located:
    """Where the evidence puts an object.

    Attributes:
        motion: (6,) most likely motion from the label.
        covariance: (6, 6) of it.
    """

    motion: Array
    covariance: Array

    @property
    def mm(self) -> tuple[float, float]:
        """Length of the translation, and the largest standard deviation of one."""
        return self._part(_SHIFT)

    @property
    def deg(self) -> tuple[float, float]:
        """The same of the rotation."""
        return self._part(_TURN)

    def _part(self, part: slice) -> tuple[float, float]:
        block = self.covariance[part, part]
        largest = float(np.linalg.eigvalsh((block + block.T) / 2)[-1])
        return float(np.linalg.norm(self.motion[part])), float(np.sqrt(max(largest, 0.0)))

    def along(self, part: slice) -> float:
        """Standard deviation along the motion; the largest one without a motion."""
        length, largest = self._part(part)
        if length < 1e-9:
            return largest
        unit = self.motion[part] / length
        return float(np.sqrt(max(float(unit @ self.covariance[part, part] @ unit), 0.0)))


@dataclass(frozen=True, eq=False)
class Weighed:
    """The verdict on the pose of a label.

    Attributes:
        verdict: fits, doubtful, wrong, or unknown.
        probability: that the pose lies within the limits.
        within_mm, within_deg: the same for the translation and the rotation alone.
        cause: "label", "shape", "texture", "blind", "misled" or "".
        reason: in words.
        located: where the object is by the best explanation.
        apart: motion (6,) from the texture to the contour; None without both.
    """

    verdict: Verdict
    probability: float
    within_mm: float
    within_deg: float
    cause: str
    reason: str
    located: Located
    apart: Array | None = None


def source(value: Value | None) -> Located | None:
    """The motion of a value of the report; None if it has none."""
    if value is None or value.motion is None or value.covariance is None:
        return None
    filed = np.reshape(value.covariance, (6, 6))
    # Filed numbers are rounded: what a symmetry leaves open has no variance, or less.
    values, axes = np.linalg.eigh((filed + filed.T) / 2)
    least = _ROUNDING * max(float(values[-1]), 0.0)
    values = np.where(values > least, values, 0.0)
    return Located(np.array(value.motion), (axes * values) @ axes.T)


def weigh(item: ObjectCheck, options: CheckOptions) -> Weighed | None:
    """The verdict on the pose of one object; None where nothing says where it is."""
    limits = JudgeSettings.current()
    contour = source(item.entry("motion_mm"))
    texture = source(item.entry("texture_mm"))
    size = 1000 * (item.value("size_m") or 0.1)
    if contour is not None and item.text("confirmed") == "no":
        contour = None
    if contour is None and texture is None:
        return None
    scatter = _Scatter.of(contour or texture)
    if contour is not None:
        factor = limits.deviation_factor.get(item.material, limits.opaque_factor)
        mesh = scatter(limits.mesh_part * size, 0.1)
        contour = Located(contour.motion, contour.covariance * factor**2 + mesh)
    misled = limits.misled_prior.get(item.material, 0.0) if texture is None else 0.0
    found = list(_explanations(contour, texture, size, scatter, misled))
    best = max((one for one in found if one.name != "misled"), key=lambda one: one.weight)
    total, mm, deg = _inside(found, options)
    apart = None if contour is None or texture is None else contour.motion - texture.motion
    odds = best.weight / max(sum(one.weight for one in found) - best.weight, 1e-300)
    verdict, cause = _verdict(total, best.at, scatter, options)
    if verdict == "doubtful" and misled > 0 and total >= limits.misled:
        verdict, cause = "unknown", "misled"
    if verdict == "fits" and best.name and odds >= limits.noted_odds and _is_noted(apart):
        cause = best.name
    reason = _reason(verdict, cause, best.at, apart, _sources(contour, texture, best.name))
    return Weighed(verdict, total, mm, deg, cause, reason, best.at, apart)


@dataclass(frozen=True, eq=False)
class _Scatter:
    """Covariances of errors in all directions that the symmetry of an object does not undo."""

    kept: Array

    @staticmethod
    def of(located: Located | None) -> _Scatter:
        assert located is not None
        values, axes = np.linalg.eigh((located.covariance + located.covariance.T) / 2)
        least = _ROUNDING * max(float(values[-1]), 1e-12)
        known = axes[:, values > least]
        return _Scatter(known @ known.T)

    def __call__(self, mm: float, deg: float) -> Array:
        return self.kept @ np.diag(np.array([mm] * 3 + [deg] * 3) ** 2) @ self.kept


@dataclass(frozen=True, eq=False)
class _Explanation:
    """Where an object is if an explanation holds, and how likely that is.

    Attributes:
        name: "", "shape", "texture" or "misled".
        weight: of the explanation and the kind of label.
        at: where the evidence puts it.
        posterior: the same with what is known of labels of this kind.
    """

    name: str
    weight: float
    at: Located
    posterior: Located


def _explanations(
    contour: Located | None,
    texture: Located | None,
    size: float,
    scatter: _Scatter,
    misled: float = 0.0,
) -> Iterable[_Explanation]:
    """Each explanation with each kind of label; `misled`: share of such contours."""
    limits = JudgeSettings.current()
    nothing = np.zeros((6, 6))
    shape = scatter(limits.shape_part * size, limits.shape_deg)
    elsewhere = scatter(limits.texture_part * size, limits.texture_deg)
    options = [
        ("", 1 - limits.shape_prior - limits.texture_prior, nothing, nothing),
        ("shape", limits.shape_prior, shape, nothing),
        ("texture", limits.texture_prior, nothing, elsewhere),
    ]
    off = (1 - limits.right_prior) / 3
    right, wrong = (limits.right_mm, limits.right_deg), (limits.off_mm, limits.off_deg)
    labels = [
        (limits.right_prior, scatter(*right)),
        (off, scatter(wrong[0], right[1])),
        (off, scatter(right[0], wrong[1])),
        (off, scatter(*wrong)),
    ]
    if contour is None or texture is None:
        beside = scatter(limits.misled_mm, limits.misled_deg)
        options = [("", 1 - misled, nothing, nothing)]
        options += [("misled", misled, beside, nothing)] if misled > 0 else []
    for name, prior, of_contour, of_texture in options:
        if contour is not None and texture is not None:
            c, t = contour.covariance + of_contour, texture.covariance + of_texture
            at = _joined(Located(contour.motion, c), Located(texture.motion, t))
            prior *= _density(contour.motion - texture.motion, c + t)
        else:
            at = contour if contour is not None else texture  # type: ignore[assignment]
            at = Located(at.motion, at.covariance + of_contour)
        for share, spread in labels:
            weight = prior * share * _density(at.motion, at.covariance + spread)
            yield _Explanation(
                name, max(weight, 1e-300), at, _joined(at, Located(np.zeros(6), spread))
            )


def _density(x: Array, covariance: Array) -> float:
    """Normal density, up to a constant."""
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    values = np.maximum(values, 1e-6)
    return float(np.exp(-0.5 * ((axes.T @ x) ** 2 / values + np.log(values)).sum()))


def _joined(a: Located, b: Located) -> Located:
    """Two measurements weighted by their inverse covariances."""
    A, B = (np.linalg.inv(s.covariance + 1e-8 * np.eye(6)) for s in (a, b))
    covariance = np.linalg.inv(A + B)
    covariance = (covariance + covariance.T) / 2
    return Located(covariance @ (A @ a.motion + B @ b.motion), covariance)


@cache
def _normal_samples() -> Array:
    half = np.random.default_rng(0).normal(size=(_SAMPLES // 2, 6))
    return np.concatenate([half, -half])


def _inside(found: Sequence[_Explanation], options: CheckOptions) -> tuple[float, float, float]:
    """Probabilities that the motion lies within both limits, and within each."""
    total = sum(one.weight for one in found)
    sums = np.zeros(3)
    for one in found:
        if one.weight < 1e-4 * total:
            continue
        at = one.posterior
        values, axes = np.linalg.eigh((at.covariance + at.covariance.T) / 2)
        motions = at.motion + _normal_samples() @ (axes * np.sqrt(np.maximum(values, 0))).T
        far, turned = (np.linalg.norm(motions[:, part], axis=1) for part in (_SHIFT, _TURN))
        mm, deg = far <= options.max_motion_mm, turned <= options.max_motion_deg
        sums += one.weight / total * np.array([(mm & deg).mean(), mm.mean(), deg.mean()])
    both, mm_only, deg_only = (float(min(x, 1.0)) for x in sums)
    return both, mm_only, deg_only


def _verdict(
    probability: float, at: Located, scatter: _Scatter, options: CheckOptions
) -> tuple[Verdict, str]:
    verdict = graded(probability)
    if verdict != "wrong" and _is_blind(at, scatter, options):
        blind = probability >= JudgeSettings.current().blind
        return ("unknown", "blind") if blind else ("doubtful", "label")
    return verdict, "" if verdict == "fits" else "label"


def graded(probability: float) -> Verdict:
    """The verdict that a probability gives where the evidence could show a fault."""
    limits = JudgeSettings.current()
    if probability < limits.wrong:
        return "wrong"
    return "fits" if probability >= limits.fits else "doubtful"


def _is_blind(at: Located, scatter: _Scatter, options: CheckOptions) -> bool:
    """Whether a fault of twice a limit along the weakest direction would look right."""
    limits = JudgeSettings.current()
    for part, size in ((_SHIFT, options.max_motion_mm), (_TURN, options.max_motion_deg)):
        block = at.covariance[part, part]
        values, axes = np.linalg.eigh((block + block.T) / 2)
        if values[-1] < 1e-6:
            continue  # the symmetry leaves nothing to know
        motion = np.zeros(6)
        motion[part] = 2 * size * axes[:, -1]
        faulty = Located(motion, at.covariance)
        if _inside(list(_explanations(faulty, None, 0.0, scatter)), options)[0] > limits.blind:
            return True
    return False


def _is_noted(apart: Array | None) -> bool:
    if apart is None:
        return False
    limits = JudgeSettings.current()
    far, turned = (float(np.linalg.norm(apart[part])) for part in (_SHIFT, _TURN))
    return far >= limits.noted_mm or turned >= limits.noted_deg


def _sources(contour: Located | None, texture: Located | None, name: str) -> str:
    if contour is None or name == "shape":
        return "its texture"
    if texture is None or name == "texture":
        return "its contour"
    return "texture and contour"


def _reason(verdict: Verdict, cause: str, at: Located, apart: Array | None, said_by: str) -> str:
    (mm, mm_std), (deg, deg_std) = at.mm, at.deg
    beside = ""
    if apart is not None:
        far, turn = float(np.linalg.norm(apart[_SHIFT])), float(np.linalg.norm(apart[_TURN]))
        beside = f"{far:.1f} mm and {turn:.1f} deg"
    if cause == "shape":
        return (
            "the mesh has another shape than the object: its texture fits the label, its contour "
            f"lies {beside} beside"
        )
    if cause == "texture":
        return (
            "the object has its texture elsewhere than the mesh (another print run?): its contour "
            f"fits the label, its texture lies {beside} beside"
        )
    if cause == "misled":
        return (
            f"its contour puts it {mm:.1f} mm (± {at.along(_SHIFT):.1f}) and {deg:.1f} deg "
            f"(± {at.along(_TURN):.1f}) from its label, and reflections may mislead it"
        )
    if cause == "blind":
        return (
            f"its images determine it only to ± {mm_std:.1f} mm and ± {deg_std:.1f} deg along the "
            "weakest direction"
        )
    if verdict == "fits":
        word = "confirm" if " and " in said_by else "confirms"
        return f"{said_by} {word} it to ± {mm_std:.1f} mm and ± {deg_std:.1f} deg"
    plural = "put" if " and " in said_by else "puts"
    return (
        f"{said_by} {plural} it {mm:.1f} mm (± {at.along(_SHIFT):.1f}) and {deg:.1f} deg "
        f"(± {at.along(_TURN):.1f}) from its label"
    )
