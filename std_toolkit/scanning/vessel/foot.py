"""The foot of a stemmed glass, which outlines alone leave filled to a cone.

From above, the far edge of the foot hides where the stem meets it: a foot filled up to the line of
sight has the same outline as a thin one. Glass has thin ones, so the thinnest that explains the
outlines is taken.
"""

from dataclasses import replace

import numpy as np

from std_toolkit.arrays import Mask
from std_toolkit.scanning.vessel.outline_rays import OutlineRays, TurnedProfile, ray_gaps
from std_toolkit.scanning.vessel.revolved_surface import StemSettings, stem_end

# Thicknesses of the edge that are tried.
_EDGES_M = np.arange(0.0005, 0.0041, 0.0005)

# Heights, in parts of the foot's radius, over which what it has more than the stem falls to 1/e. Of
# the first, a foot is an eighth of its radius high half way to its edge, as those of wine glasses.
_FLARES = (0.11, 0.2, 0.4)

# Percentile of the lines of sight past stem and foot that counts as the flattest.
_FLATTEST = 10


def with_foot(
    rays: OutlineRays, state: TurnedProfile, most_px: float
) -> tuple[TurnedProfile, Mask]:
    """The profile with a thin foot below a stem, and (K,) where this is not measured.

    Above the height at which the flattest lines of sight over the far edge meet the stem, outlines
    show the profile, and it stays. Below, its radius falls from the edge as an exponential. The
    profile is never widened. Without a stem it stays as it is.

    Args:
        rays: of the outlines.
        state: the fitted profile.
        most_px: distance in pixels from which a ray counts no more.
    """
    heights, hidden = state.heights, np.zeros(len(state.radii), bool)
    end = stem_end(heights, state.radii)
    if not end:
        return state, hidden
    narrowest = int(np.where(heights <= end, state.radii, np.inf).argmin())
    edge = int(state.radii[:narrowest].argmax())
    wide = float(state.radii[edge])
    low = ray_gaps(rays, state).index < narrowest
    if not low.any():
        return state, hidden
    near = OutlineRays(rays.origin[low], rays.direction[low], rays.px_per_m[low])
    d = near.direction
    fall = float(np.percentile(-d[:, 2] / np.hypot(d[:, 0], d[:, 1]), _FLATTEST))
    joint = min(heights[edge] + wide * max(fall, 0.0), heights[narrowest])
    at_joint = float(np.interp(joint, heights, state.radii))

    def footed(thick: float, flare: float) -> TurnedProfile:
        fallen = np.exp(-np.maximum(heights - thick, 0) / (flare * wide))
        thin = np.minimum(state.radii, at_joint + (wide - at_joint) * fallen)
        return replace(state, radii=np.where(heights < joint, thin, state.radii))

    def misfit(tried: TurnedProfile) -> float:
        pixels = ray_gaps(near, tried).distance * near.px_per_m
        return float(np.minimum(np.abs(pixels), most_px).mean())

    thin = [float(t) for t in _EDGES_M if t < 0.8 * joint]
    least = misfit(state)
    for flare in _FLARES if thin else ():
        found = [footed(thick, flare) for thick in thin]
        apart = [misfit(tried) for tried in found]
        best = int(np.argmin(apart))
        if apart[best] <= least + StemSettings.current().worse_px:
            return found[best], (heights > thin[best]) & (heights < joint)
    return state, hidden
