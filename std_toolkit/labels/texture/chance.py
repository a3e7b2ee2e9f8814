"""The score of a texture against the level of chance: random textures of the same patches.

An alignment of a few pixels makes any texture agree a little with any image, a few large patches
more than fine letters. What a score is worth therefore depends on the object and the view.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from std_toolkit.geometry import SE3
from std_toolkit.labels.texture.scores import TextureScore, TextureWindow, chance_scores
from std_toolkit.rendering.texture import TexturedSurface
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Random textures in all, and views in which they are compared.
_RANDOM, _RANDOM_VIEWS = 10, 2

# From the median absolute deviation to the standard deviation of a normal distribution.
_MAD = 1.4826


@dataclass(frozen=True, kw_only=True)
class ChanceSettings(Settings):
    """When a texture scores above chance, and when it is missed."""

    deviations: float = limit(
        3.0, source="2 of 99 textures of other YCB objects reach it; the right ones do"
    )
    """a confirmed texture scores above random ones by this many of their standard deviations"""
    deviation: float = limit(0.03, source=NOT_RECORDED)
    """smallest standard deviation of random textures"""
    covered: float = limit(
        0.2, source="0.09 and 0.08 on a drill and scissors, whose scores are chance"
    )
    """smallest compared part of the visible surface that tells whether a texture is there"""
    strength: float = limit(0.2, source="wrong textures of 0.12 to 0.16 score up to 0.43")
    """smallest mean strength of a texture that is confirmed"""
    missed_deviations: float = limit(
        1.5, source="51 of 60 strong textures of other YCB objects score less"
    )
    """a texture whose score is above random ones by less is not in the images"""
    missed_strength: float = limit(
        0.6, source="0.42 and 0.37 for a mug and a bowl with highlights in their textures"
    )
    """smallest mean strength of a texture that must be found where it is"""
    missed_frames: int = limit(2, source="one image may be blurred, or the object hidden")
    """smallest number of frames in which a texture is missed"""


@dataclass(frozen=True)
class OwnScore:
    """The texture at the pose itself, against random textures.

    Attributes:
        score: mean over the frames, weighted by the strength of the texture.
        level: score that a random texture seldom reaches.
        is_telling: whether enough of the surface was compared, and its texture is strong enough.
        frames: number of frames.
        is_missed: whether a strong texture scores like a random one.
    """

    score: float
    level: float
    is_telling: bool
    frames: int
    is_missed: bool

    @classmethod
    def of(
        cls,
        mine: Mapping[int, TextureScore],
        windows: Mapping[int, TextureWindow],
        surface: TexturedSurface,
        pose: SE3,
    ) -> OwnScore:
        """Compare the scores at a pose, T_world_obj, with those of random textures.

        Args:
            mine: scores by view.
            windows: windows by view.
        """
        limits = ChanceSettings.current()
        strength = np.array([s.strength + 1e-3 for s in mine.values()])
        weight = strength / strength.sum()
        score, covered = (
            float(weight @ np.array([getattr(s, key) for s in mine.values()]))
            for key in ("value", "covered")
        )
        mean = float(weight @ strength)
        middle, deviation = _chance(mine, windows, surface, pose)
        missed = (
            score < middle + limits.missed_deviations * deviation
            and mean >= limits.missed_strength
            and covered >= limits.covered
            and len(mine) >= limits.missed_frames
        )
        level = middle + limits.deviations * deviation
        telling = covered >= limits.covered and mean >= limits.strength
        return cls(score, level, telling, len(mine), missed)


def _chance(
    mine: Mapping[int, TextureScore],
    windows: Mapping[int, TextureWindow],
    surface: TexturedSurface,
    pose: SE3,
) -> tuple[float, float]:
    """Median and standard deviation of the scores of random textures."""
    limits = ChanceSettings.current()
    strongest = sorted(mine, key=lambda k: mine[k].strength, reverse=True)[:_RANDOM_VIEWS]
    count = -(-_RANDOM // len(strongest))
    scores = [chance_scores(windows[k], surface, pose, count=count) for k in strongest]
    middle = float(np.mean([np.median(x) for x in scores]))
    apart = np.abs(np.concatenate([np.asarray(x) - np.median(x) for x in scores]))
    deviation = max(_MAD * float(np.median(apart)), limits.deviation)
    # More frames do not lower it: neighbours show the same side, and are wrong together.
    return middle, deviation
