"""Whose labels of an object count when several annotators are merged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

from annotator.agreement.agreement import CompareOptions, ObjectAgreement
from annotator.agreement.labelled import AnnotatedScene, LabelledObject
from std_toolkit.errors import ToolkitError


@dataclass(frozen=True, kw_only=True)
class MergeOptions:
    """What becomes of objects on which annotators do not agree.

    Attributes:
        threshold_mm: labels agree if their MSSD is at most this.
        as_annotated: merge the poses as set by hand, before any refinement over several frames.
        prefer: annotator ("A", "B", ...) whose label is taken where there is no agreement.
        take: annotator by object name, whose label is taken whatever the others say.
        single: take labels that only one annotator made.
        majority: of three or more, more than half that agree pairwise outvote the others.
    """

    threshold_mm: float = 5.0
    as_annotated: bool = False
    prefer: str | None = None
    take: Mapping[str, str] = field(default_factory=dict)
    single: bool = False
    majority: bool = False

    def compare(self) -> CompareOptions:
        return CompareOptions(threshold_mm=self.threshold_mm, as_annotated=self.as_annotated)


def chosen_labels(
    group: Sequence[LabelledObject], pairs: Sequence[ObjectAgreement], options: MergeOptions
) -> tuple[Sequence[LabelledObject], str]:
    """The labels that count, and why; none where a person has to decide."""
    by_owner = {x.owner.name: x for x in group}
    wanted = options.take.get(group[0].name)
    if wanted is not None:
        return [by_owner[wanted]], f"taken from {wanted}, as asked"
    apart = [p for p in pairs if p.verdict != "agree"]
    if len(group) > 1 and not apart:
        return group, ""
    why = "; ".join(_why(p) for p in apart)
    if len(group) == 1:
        why = f"labelled by {group[0].owner.name} only"
        if options.single:
            return group, why
    elif options.majority:
        agreed = _majority(group, apart)
        if agreed:
            outvoted = [x.owner.name for x in group if x not in agreed]
            return agreed, f"outvoted: {', '.join(outvoted)} ({why})"
    if options.prefer in by_owner:
        return [by_owner[options.prefer]], f"taken from {options.prefer}, preferred ({why})"
    return [], why


def _why(pair: ObjectAgreement) -> str:
    names = f"{pair.a.owner.name} and {pair.b.owner.name}"
    if pair.difference is None:
        return f"{names}: {pair.mostly}"
    return f"{names} are {1000 * pair.worst_m:.1f} mm apart, {pair.mostly}"


def _majority(
    group: Sequence[LabelledObject], apart: Sequence[ObjectAgreement]
) -> Sequence[LabelledObject]:
    """The largest set of labels that agree pairwise, if it is more than half and the only one."""
    foes = {frozenset((p.a.owner.name, p.b.owner.name)) for p in apart}
    for size in range(len(group) - 1, len(group) // 2, -1):
        found = [
            members
            for members in combinations(group, size)
            if not any(
                frozenset((x.owner.name, y.owner.name)) in foes for x, y in combinations(members, 2)
            )
        ]
        if found:
            return found[0] if len(found) == 1 else ()
    return ()


def check_names(options: MergeOptions, annotators: Sequence[AnnotatedScene]) -> None:
    """Raises ToolkitError for an option that names an annotator that there is not."""
    known = [a.name for a in annotators]
    asked = {"--prefer": options.prefer, **{f"--take {k}": v for k, v in options.take.items()}}
    for field_name, name in asked.items():
        if name is not None and name not in known:
            raise ToolkitError(
                "no such annotator",
                field=field_name,
                value=name,
                hint=f"{known[0]} to {known[-1]}, in the order of the folders",
            )


def check_taken(options: MergeOptions, groups: Sequence[Sequence[LabelledObject]]) -> None:
    """Raises ToolkitError for `take` of an object that is not there or that nobody labelled."""
    by_name = {g[0].name: g for g in groups}
    for name, owner in options.take.items():
        if name not in by_name:
            raise ToolkitError(
                "no such labelled object",
                field="--take",
                value=name,
                hint=f"known: {', '.join(sorted(by_name))}",
            )
        have = [x.owner.name for x in by_name[name]]
        if owner not in have:
            raise ToolkitError(
                f"{owner} did not label it",
                field="--take",
                value=name,
                hint=f"labelled by {', '.join(have)}",
            )
