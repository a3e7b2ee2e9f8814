"""What is known of the objects' poses, and how long it holds.

A measurement holds for the pose that it was made of. That something speaks against a pose, such as
a turn that fits the texture better, is kept while the object stays near that pose.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from annotator.session import Session
from annotator.session.state import Judged, Placement
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, rotation_error
from std_toolkit.scene.judgement import kept_judgement
from std_toolkit.settings import Settings, limit

if TYPE_CHECKING:
    from annotator.session.residuals import FrameResidual
    from std_toolkit.checks.measure.ranking import PoseRank
    from std_toolkit.labels.texture.comparison import TextureComparison
    from std_toolkit.scene.model import Model


@dataclass(frozen=True, kw_only=True)
class FindingSettings(Settings):
    """How far an object may move from a pose that was found wrong, before that is forgotten."""

    near_mm: float = limit(5.0, unit="mm", source="a texture is aligned over such a distance")
    """largest motion of the object's centre"""
    near_share: float = limit(0.02, source="a texture is aligned over 8 % of the size")
    """the same in parts of the object's size, if that is more"""
    near_deg: float = limit(5.0, unit="deg", source="alternatives are at least 15 deg away")
    """largest turn"""


@dataclass(frozen=True)
class _Subject:
    """What a measurement of an object was made of.

    Attributes:
        name: of the object.
        poses: T_world_obj by None in a scene with metric camera poses, T_cam_obj by frame id
            otherwise.
    """

    name: str
    placements: dict[int, Placement]
    poses: dict[int | None, SE3]
    material: str
    model: Model


class Findings:
    """Measurements of the objects of a session, by name.

    Attributes:
        residuals: residuals at the present pose.
        weak_directions: sentence on the direction that the last refinement determined least.
        ranks: ranks among nearby poses.
        textures: texture comparisons at the present pose, or findings against it from nearby.
        judgements: verdicts of the judge that hold for the present poses.
        recalled: whether stored verdicts were looked for.
        unjudgeable: names of objects that cannot be judged at their pose.
        unmeasured: names of objects whose residuals were removed by their last change.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.residuals: dict[str, list[FrameResidual]] = {}
        self.weak_directions: dict[str, str] = {}
        self.ranks: dict[str, PoseRank] = {}
        self.textures: dict[str, TextureComparison] = {}
        self.judgements: dict[str, Judged] = {}
        self.recalled = False
        self.unjudgeable: set[str] = set()
        self.unmeasured: set[str] = set()
        self._subjects = self._read()
        self._compared: dict[int, tuple[TextureComparison, _Subject]] = {}

    def follow(self, *, reread: bool = False) -> None:
        """Take over a change of the session.

        Args:
            reread: whether the scene was read again, so that nothing is known any more.
        """
        before, self._subjects = self._subjects, self._read()
        self.recalled &= not reread
        self.unjudgeable.clear()
        findings = {i: self._finding(i, old) for i, old in before.items()}
        judged = {i: self.judgements.pop(old.name, None) for i, old in before.items()}
        values = {i: [m.pop(old.name, None) for m in self._by_name] for i, old in before.items()}
        unmeasured = {i for i, old in before.items() if old.name in self.unmeasured}
        for i, new in self._subjects.items():
            old, verdict = before.get(i), judged.get(i)
            if old is not None and verdict is not None and not reread and _keeps(verdict, old, new):
                self.judgements[new.name] = verdict
            if old is not None and not reread and _same(old, new):
                for known, value in zip(self._by_name, values[i], strict=True):
                    if value is not None:
                        known[new.name] = value
                continue
            unmeasured.add(i)
            found = findings.get(i)
            if found is not None and not reread and self._holds(*found, new):
                self.textures[new.name] = found[0]
                self._compared[i] = found
        self.unmeasured.clear()
        self.unmeasured |= {s.name for i, s in self._subjects.items() if i in unmeasured}
        self._pass_on()

    def keep_judgements(self, found: Mapping[str, Judged]) -> None:
        """Enter verdicts on the present poses."""
        known = {s.name for s in self._subjects.values()}
        self.judgements |= {name: judged for name, judged in found.items() if name in known}
        self._pass_on()

    def unjudged(self) -> list[str]:
        """Names of the placed objects without a verdict on the present pose."""
        placed = [s.name for s in self._subjects.values() if s.placements]
        return [name for name in placed if name not in self.judgements]

    def _pass_on(self) -> None:
        """Verdicts are saved with the labels."""
        by_name = {s.name: i for i, s in self._subjects.items()}
        self._session.judged = {by_name[n]: j for n, j in self.judgements.items() if n in by_name}

    def keep_textures(self, found: dict[str, TextureComparison]) -> None:
        """Enter comparisons that were made of the present poses."""
        for i, subject in self._subjects.items():
            if subject.name in found:
                self.textures[subject.name] = found[subject.name]
                self._compared[i] = (found[subject.name], subject)

    def uncompared(self) -> list[str]:
        """Names of the placed objects whose texture was not compared at the present pose."""
        return [s.name for i, s in self._subjects.items() if s.placements and not self._current(i)]

    def _current(self, i: int) -> bool:
        found = self._finding(i, self._subjects[i])
        return found is not None and _same(found[1], self._subjects[i])

    @property
    def _by_name(self) -> tuple[dict[str, Any], ...]:
        return (self.residuals, self.weak_directions, self.ranks, self.textures)

    def _finding(self, i: int, subject: _Subject) -> tuple[TextureComparison, _Subject] | None:
        """The comparison of an object, and what it was made of: by default what there is now."""
        texture = self.textures.get(subject.name)
        if texture is None:
            return None
        known = self._compared.get(i)
        return known if known is not None and known[0] is texture else (texture, subject)

    def _holds(self, found: TextureComparison, of: _Subject, now: _Subject) -> bool:
        """Whether a finding against a pose holds for what the object is now."""
        if not (found.verdict in ("turned", "other") or found.rival_leads):
            return False
        if not _same_thing(of, now) or not now.poses or of.poses.keys() - now.poses.keys():
            return False
        return all(self._is_near(T, now.poses[frame], now.model) for frame, T in of.poses.items())

    def _is_near(self, a: SE3, b: SE3, model: Model) -> bool:
        limits = FindingSettings.current()
        try:
            mesh = self._session.mesh(model.id)
        except ToolkitError:  # reported where the mesh itself is used
            return False
        low, high = mesh.bounds
        centre, size = (low + high) / 2, float(np.linalg.norm(high - low))
        reach = max(limits.near_mm / 1000, limits.near_share * size)
        moved = float(np.linalg.norm(a @ centre - b @ centre))
        return moved <= reach and np.rad2deg(rotation_error(a, b)) <= limits.near_deg

    def _read(self) -> dict[int, _Subject]:
        return {o.id: self._subject(o.name) for o in self._session.state.objects}

    def _subject(self, name: str) -> _Subject:
        session = self._session
        obj = session.object(name)
        poses: dict[int | None, SE3] = {f: p.pose for f, p in obj.placements.items()}
        if session.posed:
            T = session.T_world_obj(name)
            poses = {} if T is None else {None: T}
        model = session.state.model(obj.model)
        return _Subject(name, obj.placements, poses, obj.material, model)


def _keeps(judged: Judged, old: _Subject, new: _Subject) -> bool:
    """Whether a verdict holds after a change: moves within a tenth of its deviation add up."""
    if not _same_thing(old, new):
        return False
    T = new.poses.get(judged.frame)
    return not isinstance(kept_judgement(judged.judgement, T), msgspec.UnsetType)


def _same(a: _Subject, b: _Subject) -> bool:
    """Whether what is measured is the same; the name does not matter."""
    return _same_thing(a, b) and a.placements == b.placements


def _same_thing(a: _Subject, b: _Subject) -> bool:
    """Whether mesh, symmetry and material are the same."""
    return a.model == b.model and a.material == b.material
