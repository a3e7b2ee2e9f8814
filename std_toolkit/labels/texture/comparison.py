"""Compares the texture of a mesh with the images at a pose and at near-symmetric alternatives.

Silhouette and sensor depth of a box, a bottle or a can are nearly the same after half a turn; only
the texture differs. Each alternative is compared in the views that tell it from the pose. A texture
is confirmed only where it scores clearly above random textures of the same patches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from std_toolkit.geometry import SE3, rotation_error
from std_toolkit.labels.refine.problem import RefineObject, RefineView
from std_toolkit.labels.texture.alternatives import Alternative, NearSymmetry, near_symmetry
from std_toolkit.labels.texture.chance import OwnScore
from std_toolkit.labels.texture.scores import (
    TextureScore,
    TextureWindow,
    cut_window,
    score_view,
)
from std_toolkit.labels.texture.views import Telling, Views, frame_ranges
from std_toolkit.rendering.texture import TexturedSurface
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Frames and size (pixels) of a first look at many alternatives.
_FIRST_FRAMES, _FIRST_PX = 3, 80.0

# With more alternatives, such as all turns of a can, the best are found by a first look.
_MANY, _FOLLOWED = 6, 4

# A view in which two poses predict the same counts this much of one that tells them.
_EQUAL_VIEW = 0.1

NAN = float("nan")

TextureVerdict = Literal["fits", "turned", "undecided", "ambiguous", "other"]


@dataclass(frozen=True, kw_only=True)
class TextureSettings(Settings):
    """When a texture confirms a pose, and when another turn fits it better.

    Scores are correlations, -1..1; margins are differences of scores.
    """

    clarity: float = limit(0.5, source=NOT_RECORDED)
    """the surface in view counts as plain where its best frame is less clear (0..1)"""
    per_frame: float = limit(0.1, source=NOT_RECORDED)
    """added to scores and margins, divided by the root of the number of frames"""
    turned_score: float = limit(0.15, source=NOT_RECORDED)
    """smallest score of a turn that fits better"""
    turned_margin: float = limit(0.06, source=NOT_RECORDED)
    """smallest margin of a turn that fits better"""
    many_score: float = limit(0.1, source=NOT_RECORDED)
    """added to `turned_score` where the best of many turns is taken"""
    many_margin: float = limit(0.05, source=NOT_RECORDED)
    """added to `turned_margin` where the best of many turns is taken"""
    turned_deviations: float = limit(1.5, source=NOT_RECORDED)
    """smallest margin of a turn that fits better, in standard deviations over the frames"""
    fits_score: float = limit(
        0.15, source="wrong textures of YCB objects score up to 0.22, right ones from 0.35"
    )
    """smallest score at which the pose itself is confirmed"""
    fits_margin: float = limit(0.02, source=NOT_RECORDED)
    """smallest margin over all other turns at which the pose itself is confirmed"""
    near_turn: float = limit(np.deg2rad(45), unit="rad", source=NOT_RECORDED)
    """a nearer turn is a matter of refinement: a texture hardly changes by it"""


@dataclass(frozen=True)
class TextureComparison:
    """The pose of one object against its alternatives.

    Attributes:
        verdict: "fits": the texture agrees at the pose; "turned": it agrees clearly better after
            `turn`; "undecided": the images do not tell; "ambiguous": no texture is in view and the
            turned silhouette is the same, so that geometry cannot tell either; "other": the
            texture is clear, and neither the pose nor a turn agrees better than a random one.
            Where no texture decides, "turned" and "undecided" may be said by the contour.
        turn: T_obj_turned of the best alternative, so that `pose @ turn` is its pose; None without
            an alternative.
        text: the turn in words, such as "turned by 180 deg about z"; "" without an alternative.
        score: agreement of texture and images at the pose, -1 to 1; NaN if not measured.
        rival_score: the same at the alternative.
        frames: number of frames that were compared.
        chance: score that a random texture seldom reaches; NaN if not measured.
        telling: ids of neighbouring frames in which the alternative differs most from the pose.
        textured: whether the mesh has a texture, and shows it.
        contour_gain: log likelihood by which the contour of the turn exceeds that of the pose,
            where the contour gives the verdict; else NaN.
    """

    verdict: TextureVerdict
    turn: SE3 | None
    text: str
    score: float
    rival_score: float
    frames: int
    chance: float = NAN
    telling: tuple[int, ...] = ()
    textured: bool = True
    contour_gain: float = NAN

    @property
    def by_contour(self) -> bool:
        """Whether the contour gives the verdict."""
        return bool(np.isfinite(self.contour_gain))

    @property
    def compared(self) -> bool:
        """Whether a texture was compared, or the contour gives the verdict."""
        return self.textured or self.by_contour

    @property
    def margin(self) -> float:
        """Score minus that of the best alternative; NaN if one of them was not measured."""
        return self.score - self.rival_score

    @property
    def rival_leads(self) -> bool:
        """Whether an alternative has the higher score."""
        return self.turn is not None and (self.rival_score > self.score or self.contour_gain > 0)

    def sentence(self) -> str:
        """The finding as one sentence without a full stop."""
        if self.verdict == "turned":
            return f"{self.text} fits the {'contour' if self.by_contour else 'texture'} better"
        if self.verdict == "ambiguous":
            return f"ambiguous by geometry: the mesh has no texture, and {self.text} looks the same"
        if self.verdict == "other":
            return "the images do not show this texture: another product, or the label is elsewhere"
        if self.verdict == "undecided":
            return self._undecided()
        return "the texture fits"

    def decides(self) -> str:
        """What would decide between pose and alternative, in words; "" without an alternative."""
        if self.turn is None:
            return ""
        shown = frame_ranges(self.telling)
        what = "outline" if self.by_contour else "label"
        return f"look at the {what} in {shown}" if shown else "photograph the other side"

    def _undecided(self) -> str:
        if self.by_contour:
            return f"{self.text} fits the contour about as well: {self.decides()}"
        if self.rival_leads:
            return (
                f"{self.text} scores {self.rival_score:.2f} against {self.score:.2f}: "
                f"{self.decides()}"
            )
        if self.turn is not None and np.isfinite(self.margin):
            return (
                f"the images do not tell: the texture scores {self.score:.2f}, and "
                f"{self.rival_score:.2f} {self.text}: {self.decides()}"
            )
        if self.score >= self.chance:
            return "too little of a texture is in view to confirm it"
        if np.isfinite(self.score) and np.isfinite(self.chance):
            return (
                f"the texture is not confirmed: it scores {self.score:.2f}, and a random one up "
                f"to {self.chance:.2f}"
            )
        return "the images do not tell which turn fits the texture"


def compare_texture(
    views: Views | Sequence[RefineView],
    obj: RefineObject,
    others: Sequence[RefineObject] = (),
    *,
    surface: TexturedSurface | None = None,
    near: NearSymmetry | None = None,
    windows: Windows | None = None,
) -> TextureComparison:
    """Compare the texture of an object at its pose and at near-symmetric alternatives.

    Args:
        views: views; those are used that show the object large and from different sides, and that
            tell an alternative from the pose.
        obj: the object at the pose to judge.
        others: the other objects, which may hide it.
        surface: the mesh with its colours at full resolution; default: `obj.texture`.
        near: alternatives of its mesh, if known.
        windows: of these views and this object; those that are cut here are in it afterwards.

    Returns:
        The comparison; "undecided" if no view shows enough of the object, or if it has no
        alternatives and the texture does not agree.
    """
    surface = surface or obj.texture
    near = near or near_symmetry(obj.vertices, obj.faces, obj.symmetry)
    views = views if isinstance(views, Views) else Views.of(views)
    chosen = views.large(obj.T_world_obj @ obj.centre, obj.radius)
    in_view = [views.poses[k].inverse() @ obj.T_world_obj for k in chosen]
    if surface is not None:
        found = windows or Windows(views, obj, surface, others)
        found.add(chosen)
        if not found.cut:
            return TextureComparison("undecided", None, "", NAN, NAN, 0)
        turns = [*near.turns, *(near.mirrored(in_view) if chosen else ())]
        judged = _judge(found, turns)
        if judged is not None:
            return judged
    equal = next((a for a in near.each() if near.looks_equal(in_view, a)), None)
    if equal is None and chosen:
        mirrored = near.mirrored(in_view)
        equal = next((a for a in mirrored if near.looks_equal(in_view, a)), None)
    turn, text = (equal.turn, equal.text) if equal else (None, "")
    verdict: TextureVerdict = "ambiguous" if equal else "undecided"
    return TextureComparison(verdict, turn, text, NAN, NAN, 0, textured=False)


class Windows:
    """The parts of views that show an object, cut when they are asked for.

    Args:
        views: the views.
        obj: the object at its pose.
        surface: the mesh with its colours.
        others: objects that may hide it.

    Attributes:
        cut: windows by index of the view.
    """

    def __init__(
        self,
        views: Views,
        obj: RefineObject,
        surface: TexturedSurface,
        others: Sequence[RefineObject],
    ) -> None:
        self.views, self.obj, self.surface = views, obj, surface
        self.cut: dict[int, TextureWindow] = {}
        self._others = others
        self._tried: set[int] = set()
        self._own: dict[int, TextureScore | None] = {}

    def add(self, chosen: Sequence[int]) -> None:
        """Cut the windows of views; those without the object, or unreadable, are left out."""
        for k in chosen:
            if k in self._tried:
                continue
            self._tried.add(k)
            view = self.views.read(k)
            if view is None:
                continue
            window = cut_window(view, self.surface, self.obj.T_world_obj, self._others)
            if window is not None:
                self.cut[k] = window

    def own(self) -> dict[int, TextureScore]:
        """Scores at the pose by view, of those that show enough of the object."""
        for k in self.cut:
            if k not in self._own:
                self._own[k] = score_view(self.cut[k], self.surface, self.obj.T_world_obj)
        return {k: s for k, s in self._own.items() if s is not None}

    def turned(self, turn: SE3) -> dict[int, TextureScore | None]:
        """Scores at the turned pose by view, of those that show enough at the pose."""
        pose = self.obj.T_world_obj @ turn
        return {k: score_view(self.cut[k], self.surface, pose) for k in self.own()}


def _judge(found: Windows, turns: Sequence[Alternative]) -> TextureComparison | None:
    """The comparison in these windows; None if the surface shows no texture in them."""
    mine = found.own()
    if not mine:
        return TextureComparison("undecided", None, "", NAN, NAN, 0)
    limits = TextureSettings.current()
    if max(s.clarity for s in mine.values()) < limits.clarity:
        return None
    many = len(turns) > _MANY
    tried = _first_look([found.cut[k] for k in mine], found, turns) if many else turns
    telling = Telling(found.views, found.surface, found.obj.T_world_obj, found.obj.radius)
    for a in tried:
        found.add(telling.best(a.turn, found.cut))
    mine = found.own()
    duels = [_duel(mine, found.turned(a.turn), a, telling) for a in tried]
    own = OwnScore.of(mine, found.cut, found.surface, found.obj.T_world_obj)
    best = max(duels, key=lambda d: d.margin, default=None)
    verdict = _verdict(own, duels, best, many=many)
    if best is None:
        return TextureComparison(verdict, None, "", own.score, NAN, len(mine), own.level)
    return TextureComparison(
        verdict,
        best.rival.turn,
        best.rival.text,
        best.score,
        best.rival_score,
        len(mine),
        own.level,
        telling.frames(best.rival.turn),
    )


def _verdict(
    own: OwnScore, duels: Sequence[_Duel], best: _Duel | None, *, many: bool
) -> TextureVerdict:
    limits = TextureSettings.current()
    per_frame = limits.per_frame / np.sqrt(own.frames)
    least = max(limits.fits_score + per_frame, own.level)
    if best is not None:
        score = limits.turned_score + 1.5 * per_frame + limits.many_score * many
        margin = limits.turned_margin + per_frame + limits.many_margin * many
        margin = max(margin, limits.turned_deviations * best.margin_std)
        if best.rival_score >= score and best.margin >= margin:
            return "turned"
    if own.is_missed and all(d.rival_score < least for d in duels):
        return "other"
    far = [d for d in duels if rotation_error(d.rival.turn, SE3.identity()) > limits.near_turn]
    leads = all(d.score >= least and -d.margin >= limits.fits_margin + 0.5 * per_frame for d in far)
    if leads and own.score >= least and own.is_telling:
        return "fits"
    return "undecided"


@dataclass(frozen=True)
class _Duel:
    """The pose against one alternative.

    Attributes:
        score, rival_score: means over the frames; a frame counts by the texture that the two poses
            predict in it: one that predicts a texture where there is none is wrong as well.
        margin: `rival_score` minus `score`.
        margin_std: its standard deviation from the scatter of the frames; 0 for one or two.
        rival: the alternative.
    """

    score: float
    rival_score: float
    margin: float
    margin_std: float
    rival: Alternative


def _duel(
    mine: dict[int, TextureScore],
    other: dict[int, TextureScore | None],
    rival: Alternative,
    telling: Telling,
) -> _Duel:
    # A pose that shows nothing in a frame scores 0 there.
    theirs = {k: other.get(k) or TextureScore(0.0, 0.0, 0.0, 0.0, 0.0) for k in mine}
    weight = np.array(
        [
            (mine[k].strength + theirs[k].strength + 1e-3)
            * max(telling.difference(k, rival.turn), _EQUAL_VIEW)
            for k in mine
        ]
    )
    weight = weight / weight.sum()
    a, b = (np.array([scores[k].value for k in mine]) for scores in (mine, theirs))
    margin = float(weight @ (b - a))
    std = 0.0
    if len(mine) >= 3:
        std = float(np.sqrt((weight**2) @ ((b - a) - margin) ** 2) * np.sqrt(len(a) / (len(a) - 1)))
    return _Duel(float(weight @ a), float(weight @ b), margin, std, rival)


def _first_look(
    windows: Sequence[TextureWindow], found: Windows, turns: Sequence[Alternative]
) -> list[Alternative]:
    """The most promising of many alternatives, from small pictures of a few frames."""
    picks = np.unique(np.linspace(0, len(windows) - 1, _FIRST_FRAMES).round().astype(int))
    small = [windows[k].shrunk(_FIRST_PX) for k in picks]

    def promise(turn: Alternative) -> float:
        pose = found.obj.T_world_obj @ turn.turn
        scores = [score_view(w, found.surface, pose) for w in small]
        return sum(s.value * (s.strength + 0.1) for s in scores if s is not None)

    return sorted(turns, key=promise, reverse=True)[:_FOLLOWED]
