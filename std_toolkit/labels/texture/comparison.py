"""Compares the texture of a mesh with the images at a pose and at near-symmetric alternatives.

Silhouette and sensor depth of a box, a bottle or a can are nearly the same after half a turn; only
the texture differs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from std_toolkit.geometry import SE3, rotation_error
from std_toolkit.labels.refine.problem import RefineObject, RefineView, large_views
from std_toolkit.labels.texture.alternatives import Alternative, NearSymmetry
from std_toolkit.labels.texture.scores import (
    TextureScore,
    TextureViewSettings,
    TextureWindow,
    cut_window,
    score_view,
)
from std_toolkit.rendering.texture import TexturedSurface
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Frames that are compared, and frames and size (pixels) of a first look at many alternatives.
FRAMES, _FIRST_FRAMES, _FIRST_PX = 8, 3, 80.0

# With more alternatives, such as all turns of a can, the best are found by a first look.
_MANY, _FOLLOWED = 6, 4


TextureVerdict = Literal["fits", "turned", "undecided", "ambiguous"]


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
    fits_score: float = limit(0.1, source=NOT_RECORDED)
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
            `turn`; "undecided": the images do not tell; "ambiguous": the mesh has no texture and
            the turned silhouette is the same, so that geometry cannot tell either.
        turn: T_obj_turned of the best alternative, so that `pose @ turn` is its pose; None without
            an alternative.
        text: the turn in words, such as "turned by 180 deg about z"; "" without an alternative.
        score: agreement of texture and images at the pose, -1 to 1; NaN if not measured.
        rival_score: the same at the alternative.
        frames: number of frames that were compared.
    """

    verdict: TextureVerdict
    turn: SE3 | None
    text: str
    score: float
    rival_score: float
    frames: int

    @property
    def margin(self) -> float:
        """Score minus that of the best alternative; NaN if one of them was not measured."""
        return self.score - self.rival_score

    def sentence(self) -> str:
        """The finding as one sentence without a full stop."""
        if self.verdict == "turned":
            return f"{self.text} fits the texture better"
        if self.verdict == "ambiguous":
            return f"ambiguous by geometry: the mesh has no texture, and {self.text} looks the same"
        if self.verdict == "undecided":
            return "the images do not tell which turn fits the texture"
        return "the texture fits"


def compare_texture(
    views: Sequence[RefineView],
    obj: RefineObject,
    others: Sequence[RefineObject] = (),
    *,
    surface: TexturedSurface | None = None,
    near: NearSymmetry | None = None,
) -> TextureComparison:
    """Compare the texture of an object at its pose and at near-symmetric alternatives.

    Args:
        views: images; those that show the object large and from different sides are used.
        obj: the object at the pose to judge.
        others: the other objects, which may hide it.
        surface: the mesh with its colours at full resolution; default: `obj.texture`.
        near: alternatives of its mesh, if known.

    Returns:
        The comparison; "undecided" if no view shows enough of the object, or if it has no
        alternatives and the texture does not agree.
    """
    surface = surface or obj.texture
    near = near or NearSymmetry(obj.vertices, obj.faces, obj.symmetry)
    centre = obj.T_world_obj @ obj.centre
    chosen = large_views(
        [v.camera for v in views],
        [v.T_world_cam for v in views],
        centre,
        obj.radius,
        count=FRAMES,
        smallest_px=TextureViewSettings.current().smallest_px,
    )
    views = [views[k] for k in chosen]
    in_view = [v.T_world_cam.inverse() @ obj.T_world_obj for v in views]
    if surface is not None:
        windows = [
            w for v in views if (w := cut_window(v, surface, obj.T_world_obj, others)) is not None
        ]
        if not windows:
            return _unmeasured("undecided", None)
        turns = [*near.turns, *(near.mirrored(in_view) if views else ())]
        judged = _judge(windows, obj, surface, turns)
        if judged is not None:
            return judged
    equal = next((a for a in near.each() if near.looks_equal(in_view, a)), None)
    if equal is None and views:
        mirrored = near.mirrored(in_view)
        equal = next((a for a in mirrored if near.looks_equal(in_view, a)), None)
    return _unmeasured("ambiguous" if equal else "undecided", equal)


def _unmeasured(verdict: TextureVerdict, rival: Alternative | None) -> TextureComparison:
    turn, text = (rival.turn, rival.text) if rival else (None, "")
    return TextureComparison(verdict, turn, text, float("nan"), float("nan"), 0)


def _judge(
    windows: Sequence[TextureWindow],
    obj: RefineObject,
    surface: TexturedSurface,
    turns: Sequence[Alternative],
) -> TextureComparison | None:
    """The comparison in these windows; None if the surface shows no texture in them."""
    pose = obj.T_world_obj
    own = [score_view(w, surface, pose) for w in windows]
    kept = [k for k, s in enumerate(own) if s is not None]
    windows = [windows[k] for k in kept]
    mine = [s for s in own if s is not None]
    if not mine:
        return TextureComparison("undecided", None, "", float("nan"), float("nan"), 0)
    limits = TextureSettings.current()
    if max(s.clarity for s in mine) < limits.clarity:
        return None
    many = len(turns) > _MANY
    tried = _first_look(windows, surface, obj, turns) if many else turns
    duels = [
        _duel(mine, [score_view(w, surface, pose @ a.turn) for w in windows], a) for a in tried
    ]
    per_frame = limits.per_frame / np.sqrt(len(windows))
    if not duels:
        weight = np.array([s.strength + 1e-3 for s in mine])
        score = float(weight @ np.array([s.value for s in mine]) / weight.sum())
        alone: TextureVerdict = "fits" if score >= limits.fits_score + per_frame else "undecided"
        return TextureComparison(alone, None, "", score, float("nan"), len(windows))
    best = max(duels, key=lambda d: d.margin)
    far = [d for d in duels if rotation_error(d.rival.turn, SE3.identity()) > limits.near_turn]
    verdict: TextureVerdict = "undecided"
    score = limits.turned_score + 1.5 * per_frame + limits.many_score * many
    margin = limits.turned_margin + per_frame + limits.many_margin * many
    if best.rival_score >= score and best.margin >= max(
        margin, limits.turned_deviations * best.margin_std
    ):
        verdict = "turned"
    elif all(
        d.score >= limits.fits_score + per_frame
        and -d.margin >= limits.fits_margin + 0.5 * per_frame
        for d in far
    ):
        verdict = "fits"
    return TextureComparison(
        verdict, best.rival.turn, best.rival.text, best.score, best.rival_score, len(windows)
    )


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
    mine: Sequence[TextureScore], other: Sequence[TextureScore | None], rival: Alternative
) -> _Duel:
    # A pose that shows nothing in a frame scores 0 there.
    theirs = [s or TextureScore(0.0, 0.0, 0.0, 0.0) for s in other]
    weight = np.array([a.strength + b.strength + 1e-3 for a, b in zip(mine, theirs, strict=True)])
    weight = weight / weight.sum()
    a, b = (np.array([s.value for s in scores]) for scores in (mine, theirs))
    margin = float(weight @ (b - a))
    std = 0.0
    if len(mine) >= 3:
        std = float(np.sqrt((weight**2) @ ((b - a) - margin) ** 2) * np.sqrt(len(a) / (len(a) - 1)))
    return _Duel(float(weight @ a), float(weight @ b), margin, std, rival)


def _first_look(
    windows: Sequence[TextureWindow],
    surface: TexturedSurface,
    obj: RefineObject,
    turns: Sequence[Alternative],
) -> list[Alternative]:
    """The most promising of many alternatives, from small pictures of a few frames."""
    picks = np.unique(np.linspace(0, len(windows) - 1, _FIRST_FRAMES).round().astype(int))
    small = [windows[k].shrunk(_FIRST_PX) for k in picks]

    def promise(turn: Alternative) -> float:
        found = [score_view(w, surface, obj.T_world_obj @ turn.turn) for w in small]
        return sum(s.value * (s.strength + 0.1) for s in found if s is not None)

    return sorted(turns, key=promise, reverse=True)[:_FOLLOWED]
