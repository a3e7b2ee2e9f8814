"""Agreement of the people of a project on the scenes that were labelled twice."""

from __future__ import annotations

import string
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Table, text_table
from std_toolkit.labels.agreement.comparison import ObjectAgreement, compare_labels
from std_toolkit.labels.agreement.options import CompareOptions
from std_toolkit.project.record import Project
from std_toolkit.project.status import SceneRow
from std_toolkit.scene.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two labels of one object by two people, modulo the symmetry of the object.

    Attributes:
        scene, object, model: which object.
        people: who labelled it: of the scene, of its second copy.
        verdict: "agree", "disagree" or "not comparable".
        translation_mm: distance between the object's centres; None if not comparable.
        turn_deg: angle between the orientations.
        mssd_mm: largest distance between corresponding surface points.
        mostly: the main difference, or why they are not comparable.
    """

    scene: str
    object: str
    model: str
    people: tuple[str, str]
    verdict: str
    translation_mm: float | None
    turn_deg: float | None
    mssd_mm: float | None
    mostly: str


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Differences of several pairs of labels: median and 95th percentile.

    Attributes:
        of: a model, "A and B" for two people, or "all".
        labels: number of pairs that were compared.
        disagree: how many of them disagree.
        translation_mm, turn_deg, mssd_mm: (median, 95 %).
    """

    of: str
    labels: int
    disagree: int
    translation_mm: tuple[float, float]
    turn_deg: tuple[float, float]
    mssd_mm: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Agreement over the scenes of a project that were labelled twice.

    Attributes:
        pairs: one per object that was labelled twice, disagreements of a scene first.
        models, people: spreads by model, and by two people.
        all: of all pairs; None without any that can be compared.
        alone: "SCENE: OBJECT" of objects that only one of the two labelled.
        problems: error by scene that could not be compared.
    """

    pairs: list[Pair]
    models: list[Spread]
    people: list[Spread]
    all: Spread | None
    alone: list[str]
    problems: dict[str, str]


def agreement(
    project: Project,
    rows: Sequence[SceneRow],
    *,
    names: bool = False,
    options: CompareOptions | None = None,
) -> Agreement:
    """Compare every scene that was labelled twice with its second copy.

    Args:
        project: the project.
        rows: its board.
        names: name the people; otherwise they are A, B, ... in the order of the project, and
            others follow.
        options: of the comparison.

    Raises:
        ToolkitError: no scene was labelled twice yet.
    """
    letters = _letters(project, rows)
    pairs: list[Pair] = []
    alone: list[str] = []
    problems: dict[str, str] = {}
    for item, row in zip(project.record.scenes, rows, strict=True):
        if row.second is None or not any(o.state != "open" for o in row.second.objects):
            continue
        try:
            first, second = (
                Scene.open(project.folder(item)),
                Scene.open(project.second(item)),
            )
            found = compare_labels(first, second, options)
        except ToolkitError as error:
            problems[row.name] = str(error)
            continue
        for one in found.objects:
            people = (one.a.label.annotator, one.b.label.annotator)
            shown = people if names else tuple(letters.get(n, "?") for n in people)
            pairs.append(_pair(row.name, one, (shown[0] or "?", shown[1] or "?")))
        alone += [f"{row.name}: {name}" for name in (*found.only_a, *found.only_b)]
    if not pairs and not problems:
        raise ToolkitError(
            "no scene was labelled twice yet",
            path=project.root,
            hint="`std-curate project run` makes the copies, `project status --for` names them",
        )
    by_people = (" and ".join(sorted(p.people)) for p in pairs)
    return Agreement(
        pairs=pairs,
        models=_spreads(pairs, (p.model for p in pairs)),
        people=_spreads(pairs, by_people),
        all=next(iter(_spreads(pairs, ("all" for _ in pairs))), None),
        alone=alone,
        problems=problems,
    )


def _letters(project: Project, rows: Sequence[SceneRow]) -> Mapping[str, str]:
    others = sorted({name for row in rows for name in row.hands} - {*project.record.people})
    people = [*project.record.people, *others]
    alphabet = string.ascii_uppercase
    return {
        name: alphabet[i % 26] + (str(i // 26 + 1) if i >= 26 else "")
        for i, name in enumerate(people)
    }


def _pair(scene: str, found: ObjectAgreement, people: tuple[str, str]) -> Pair:
    d = found.difference
    return Pair(
        scene=scene,
        object=found.name,
        model=found.a.model.id,
        people=people,
        verdict=found.verdict,
        translation_mm=None if d is None else round(1000 * d.translation_m, 4),
        turn_deg=None if d is None else round(float(np.rad2deg(d.rotation_rad)), 4),
        mssd_mm=None if d is None else round(1000 * d.mssd_m, 4),
        mostly=found.mostly,
    )


def _spreads(pairs: Sequence[Pair], keys: Iterable[str]) -> list[Spread]:
    groups: dict[str, list[Pair]] = {}
    for pair, key in zip(pairs, keys, strict=True):
        if pair.mssd_mm is not None:
            groups.setdefault(key, []).append(pair)
    return [
        Spread(
            of=key,
            labels=len(group),
            disagree=sum(p.verdict == "disagree" for p in group),
            translation_mm=_median_and_95([p.translation_mm for p in group]),
            turn_deg=_median_and_95([p.turn_deg for p in group]),
            mssd_mm=_median_and_95([p.mssd_mm for p in group]),
        )
        for key, group in sorted(groups.items())
    ]


def _median_and_95(values: Sequence[float | None]) -> tuple[float, float]:
    known = [value for value in values if value is not None]
    return round(float(np.median(known)), 4), round(float(np.percentile(known, 95)), 4)


def agreement_table(found: Agreement) -> Table:
    """Median and 95 % by model, by two people, and of all."""
    words = ("of", "labels", "disagree", "shift mm", "95 %", "turn deg", "95 %", "mssd mm", "95 %")
    spreads = [*found.models, *found.people, *([found.all] if found.all else [])]
    cells = []
    for s in spreads:
        pairs = (s.translation_mm, s.turn_deg, s.mssd_mm)
        numbers = [f"{value:.1f}" for pair in pairs for value in pair]
        cells.append([s.of, str(s.labels), str(s.disagree), *numbers])
    return text_table(words, cells, texts=1)


def agreement_lines(found: Agreement) -> list[str]:
    """A line for each disagreement, object that one person left out, and scene not compared."""
    return [
        *(
            f"{p.verdict}: {p.scene}: {p.object}: {p.mostly}"
            for p in found.pairs
            if p.verdict != "agree"
        ),
        *(f"labelled by one only: {name}" for name in found.alone),
        *(f"not compared: {name}: {why}" for name, why in found.problems.items()),
    ]
