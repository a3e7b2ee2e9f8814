"""What explains the evidence on a label: its pose is off, mesh and object differ, or nothing.

Texture, contour, sensor depth and support each say where an object is, relative to its label, in
six degrees of freedom with a covariance. Where they agree, the label is judged by all together.
Where they do not, explanations are compared by their likelihood:

- "": all see the same pose, and differ by their errors only;
- "shape": the mesh has another shape than the object, whose texture tells where it is;
- "texture": the object has its texture elsewhere, as another print run; its contour tells the pose;
- "depth": the sensor errs on this surface, or its image lies beside the colour image;
- "leans": the object does not stand on the plane of the others, so that its support says nothing;
- "misled": reflections or refraction look like an outline elsewhere in all frames. A label that is
  likely right in spite of this is unknown rather than doubtful.

A label is right, or off in place, in turn, or in both: with this prior distribution its motion is a
mixture of normal distributions, from which the probability follows that it is within the limits.

Motions are vectors (6,): translation of the object's centre in mm, and rotation vector about it in
degrees, along the axes of the world.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.gates.located import (
    SHIFT,
    TURN,
    Located,
    Scatter,
    joined,
    located_by,
    log_density,
    shares_within,
)
from std_toolkit.checks.gates.reasons import differing, reason_of
from std_toolkit.checks.result import ObjectCheck, Verdict
from std_toolkit.options import CheckOptions
from std_toolkit.settings import NOT_RECORDED, Settings, limit


@dataclass(frozen=True, kw_only=True)
class JudgeSettings(Settings):
    """How evidence is weighed, and the probabilities at which a label fits or is wrong."""

    fits: float = limit(0.95, source="as usual for a test")
    """a label fits from this probability that its pose lies within the limits"""
    wrong: float = limit(0.05, source="as usual for a test")
    """a label is wrong below this probability"""
    mesh_part: float = limit(
        0.001,
        source="world seeds 400 to 519 of setting kinds: half of the meshes differ by 1 to 3 %",
    )
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
    misled_mm: float = limit(2.0, unit="mm", source="the same scenes")
    """deviation of the motion of a misled contour, besides its own"""
    misled_deg: float = limit(1.8, unit="deg", source="the same scenes")
    """the same for its rotation"""
    distinct: Mapping[str, float] = limit(
        {"specular": 0.9},
        source="world seeds 400 to 412 of setting kinds: refused faults of steel have 1.1 and more",
    )
    """a contour accuses no label at which its support is less by fewer deviations, by material: the
    edges of reflections fit as well as those of the object"""
    likely: float = limit(
        0.5, source="setting kinds, steel: right labels that seem to be off by 2 to 4 deg"
    )
    """a doubtful label is unknown from this probability if its contour may be misled, its sources
    contradict each other, or the evidence is blind"""
    depth_prior: float = limit(0.1, source="dark and glossy surfaces, and depth not aligned")
    """share of the objects on which sensor depth errs"""
    depth_mm: float = limit(5.0, unit="mm", source="residuals on such surfaces of real recordings")
    """deviation of the motion by such depth, besides its own"""
    depth_deg: float = limit(4.0, unit="deg", source=NOT_RECORDED)
    """the same for its rotation"""
    leans_prior: float = limit(0.1, source="things that lean on others, or stand on a rim")
    """share of the objects that do not stand on the plane of the others"""
    leans_mm: float = limit(12.0, unit="mm", source="half of `standing_check.reach_m`")
    """deviation of their height from it"""
    leans_deg: float = limit(6.0, unit="deg", source="half of `standing_check.level_rad`")
    """the same of their tilt"""
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
    blind: float = limit(0.2, source="a power of 0.8, as usual for a test")
    """evidence is blind by which, with more probability, a fault of twice a limit is called *fits*
    or a label in place is not"""
    noted_odds: float = limit(3.0, source=NOT_RECORDED)
    """an explanation is told where it is more likely than all others by this factor"""
    noted_mm: float = limit(2.0, unit="mm", source=NOT_RECORDED)
    """a difference between contour and texture below this is not told"""
    noted_deg: float = limit(1.0, unit="deg", source=NOT_RECORDED)
    """the same for a rotation"""


@dataclass(frozen=True, eq=False)
class Weighed:
    """The verdict on the pose of a label.

    Attributes:
        verdict: fits, doubtful, wrong, or unknown.
        probability: that the pose lies within the limits.
        within_mm, within_deg: the same for the translation and the rotation alone.
        cause: "label", "shape", "texture", "blind", "misled", "contradicted" or "".
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


def weigh(item: ObjectCheck, options: CheckOptions) -> Weighed | None:
    """The verdict on the pose of one object; None where nothing says where it is."""
    limits = JudgeSettings.current()
    sources = _sources(item)
    # A label that is not seen may lie on any surface, as a table's.
    if not any(s.name not in ("support", "depth") for s in sources):
        return None
    scatter = Scatter.of(sources[0].at)
    found = _explanations(sources, scatter)
    best = max((one for one in found if one.name != "misled"), key=lambda one: one.weight)
    total, mm, deg = _inside(found, options)
    by_name = {s.name: s for s in sources}
    apart = None
    if "contour" in by_name and "texture" in by_name:
        apart = by_name["contour"].at.motion - by_name["texture"].at.motion
    odds = best.weight / max(1 - best.weight, 1e-9)
    verdict, cause = _verdict(total, best.at, scatter, options)
    misled = any(s.explanation == "misled" for s in sources)
    apart_by = differing([(s.name, s.at) for s in sources], best.name)
    # Where a contour that may be misled contradicts the support, neither is believed alone; and
    # sources that contradict each other for no known reason accuse no label that is likely right.
    likely = verdict == "doubtful" and total >= limits.likely
    as_well = verdict in ("doubtful", "wrong") and fits_as_well(
        item, limits.distinct.get(item.material, 0.0)
    )
    if misled and (likely or (verdict == "fits" and apart_by) or as_well):
        verdict, cause = "unknown", "misled"
    elif likely and apart_by and not best.name:
        verdict, cause = "unknown", "contradicted"
    told = best.name in ("shape", "texture") and odds >= limits.noted_odds
    if verdict == "fits" and told and _is_noted(apart):
        cause = best.name
    said_by = [s.name for s in sources if not s.explanation or s.explanation != best.name]
    reason = reason_of(verdict, cause, best.at, apart, said_by) + apart_by
    return Weighed(verdict, total, mm, deg, cause, reason, best.at, apart)


def fits_as_well(item: ObjectCheck, apart: float) -> bool:
    """Whether nearly as much of the contour lies on edges at the label as where it is put: by fewer
    than `apart` deviations less."""
    there, label = item.entry("support"), item.entry("label_support")
    if there is None or label is None or there.value is None or label.value is None:
        return False
    deviation = float(np.hypot(there.std or 0.0, label.std or 0.0))
    return there.value - label.value < apart * deviation


@dataclass(frozen=True, eq=False)
class _Source:
    """Where one source puts the object, and what would explain that it is wrong.

    Attributes:
        name: "texture", "contour", "alignment", "depth" or "support".
        at: where.
        explanation: "shape", "misled", "texture" or "leans"; "" for none.
        prior: share of the objects for which it holds.
        beside: (6, 6) covariance that it adds.
        of_shape: (6, 6) covariance that another shape of the mesh adds, if that explains another
            source.
    """

    name: str
    at: Located
    explanation: str = ""
    prior: float = 0.0
    beside: Array = field(default_factory=lambda: np.zeros((6, 6)))
    of_shape: Array = field(default_factory=lambda: np.zeros((6, 6)))

    def if_holds(self, name: str) -> Located:
        """Where it puts the object if an explanation holds."""
        if name and name == self.explanation:
            return Located(self.at.motion, self.at.covariance + self.beside)
        if name == "shape":
            return Located(self.at.motion, self.at.covariance + self.of_shape)
        return self.at


def _sources(item: ObjectCheck) -> list[_Source]:
    limits = JudgeSettings.current()
    contour = located_by(item.entry("motion_mm"))
    texture = located_by(item.entry("texture_mm"))
    surface = located_by(item.entry("surface_mm"))
    standing = located_by(item.entry("standing_mm"))
    if contour is not None and item.text("confirmed") == "no":
        contour = None
    # A lone frame has neither: there, edges and depth together say where the object is.
    aligned = None if texture or contour else located_by(item.entry("aligned_mm"))
    first = texture or contour or aligned
    if first is None:
        return []
    size = 1000 * (item.value("size_m") or 0.1)
    scatter = Scatter.of(first)
    found = []
    if texture is not None:
        if contour is None:
            found.append(_Source("texture", texture))
        else:
            beside = scatter(limits.texture_part * size, limits.texture_deg)
            found.append(_Source("texture", texture, "texture", limits.texture_prior, beside))
    if contour is not None:
        mesh = scatter(limits.mesh_part * size, 0.1)
        at = Located(contour.motion, contour.covariance + mesh)
        misled = limits.misled_prior.get(item.material, 0.0)
        if texture is not None:
            beside = scatter(limits.shape_part * size, limits.shape_deg)
            found.append(_Source("contour", at, "shape", limits.shape_prior, beside))
        elif misled > 0:
            beside = scatter(limits.misled_mm, limits.misled_deg)
            found.append(_Source("contour", at, "misled", misled, beside))
        else:
            found.append(_Source("contour", at))
    if aligned is not None:
        at = Located(aligned.motion, aligned.covariance + scatter(limits.mesh_part * size, 0.1))
        found.append(_Source("alignment", at))
    if surface is not None and aligned is None:
        by_mesh = scatter(limits.mesh_part * size, 0.1)
        at = Located(
            scatter.kept @ surface.motion,
            scatter.kept @ (surface.covariance + by_mesh) @ scatter.kept,
        )
        beside = scatter(limits.depth_mm, limits.depth_deg)
        shape = scatter(limits.shape_part * size, limits.shape_deg)
        found.append(_Source("depth", at, "depth", limits.depth_prior, beside, shape))
    # Labels of one frame share the errors of its depth: that they agree on a plane says little.
    if standing is not None and aligned is None:
        at = Located(
            scatter.kept @ standing.motion, scatter.kept @ standing.covariance @ scatter.kept
        )
        beside = scatter(limits.leans_mm, limits.leans_deg)
        found.append(_Source("support", at, "leans", limits.leans_prior, beside))
    return found


@dataclass(frozen=True, eq=False)
class _Explanation:
    """Where an object is if an explanation holds, and how likely that is.

    Attributes:
        name: "", "shape", "texture", "misled", "depth" or "leans".
        weight: of the explanation and the kind of label.
        at: where the evidence puts it.
        posterior: the same with what is known of labels of this kind.
    """

    name: str
    weight: float
    at: Located
    posterior: Located


def _explanations(sources: Sequence[_Source], scatter: Scatter) -> list[_Explanation]:
    """Each explanation with each kind of label; their weights sum to 1."""
    limits = JudgeSettings.current()
    names = [""] + [s.explanation for s in sources if s.explanation]
    off = (1 - limits.right_prior) / 3
    right, wrong = (limits.right_mm, limits.right_deg), (limits.off_mm, limits.off_deg)
    labels = [
        (limits.right_prior, scatter(*right)),
        (off, scatter(wrong[0], right[1])),
        (off, scatter(right[0], wrong[1])),
        (off, scatter(*wrong)),
    ]
    found: list[tuple[float, str, Located, Array]] = []
    for name in names:
        likely, at = 0.0, None
        for s in sources:
            holds = bool(name) and s.explanation == name
            likely += float(np.log(s.prior if holds else 1 - s.prior))
            one = s.if_holds(name)
            if at is None:
                at = one
            else:
                likely += log_density(at.motion - one.motion, at.covariance + one.covariance)
                at = joined(at, one)
        assert at is not None
        for share, spread in labels:
            by_label = float(np.log(share)) + log_density(at.motion, at.covariance + spread)
            found.append((likely + by_label, name, at, spread))
    most = max(row[0] for row in found)
    total = sum(np.exp(row[0] - most) for row in found)
    return [
        _Explanation(
            name, float(np.exp(log - most) / total), at, joined(at, Located(np.zeros(6), spread))
        )
        for log, name, at, spread in found
    ]


def _inside(found: Sequence[_Explanation], options: CheckOptions) -> tuple[float, float, float]:
    """Probabilities that the motion lies within both limits, and within each."""
    sums = np.zeros(3)
    for one in found:
        if one.weight >= 1e-4:
            within = shares_within(one.posterior, options.max_motion_mm, options.max_motion_deg)
            sums += one.weight * within
    both, mm_only, deg_only = (float(min(x, 1.0)) for x in sums)
    return both, mm_only, deg_only


def _verdict(
    probability: float, at: Located, scatter: Scatter, options: CheckOptions
) -> tuple[Verdict, str]:
    verdict = graded(probability)
    if verdict != "wrong" and _is_blind(at, scatter, options):
        likely = probability >= JudgeSettings.current().likely
        return ("unknown", "blind") if likely else ("doubtful", "label")
    return verdict, "" if verdict == "fits" else "label"


def graded(probability: float) -> Verdict:
    """The verdict that a probability gives where the evidence could show a fault."""
    limits = JudgeSettings.current()
    if probability < limits.wrong:
        return "wrong"
    return "fits" if probability >= limits.fits else "doubtful"


def _is_blind(at: Located, scatter: Scatter, options: CheckOptions) -> bool:
    """Whether the evidence may well mistake labels along its weakest direction.

    A fault of twice a limit may be called *fits*, or a label in place anything else.
    """
    from scipy.special import ndtri  # scipy.stats loads for a second

    limits = JudgeSettings.current()
    for part, size in ((SHIFT, options.max_motion_mm), (TURN, options.max_motion_deg)):
        block = at.covariance[part, part]
        values, axes = np.linalg.eigh((block + block.T) / 2)
        if values[-1] < 1e-6:
            continue  # the symmetry leaves nothing to know
        direction = np.zeros(6)
        direction[part] = axes[:, -1]

        def fits(length: float, direction: Array = direction) -> bool:
            measured = Located(length * direction, at.covariance)
            weighed = _explanations([_Source("", measured)], scatter)
            return _inside(weighed, options)[0] >= limits.fits

        # Measured motions that a fault and a label in place exceed with this probability.
        deviation = float(np.sqrt(values[-1]))
        of_fault = 2 * size + float(ndtri(limits.blind)) * deviation
        in_place = -float(ndtri(limits.blind / 2)) * deviation
        if of_fault <= 0 or fits(of_fault) or not fits(in_place):
            return True
    return False


def _is_noted(apart: Array | None) -> bool:
    if apart is None:
        return False
    limits = JudgeSettings.current()
    far, turned = (float(np.linalg.norm(apart[part])) for part in (SHIFT, TURN))
    return far >= limits.noted_mm or turned >= limits.noted_deg
