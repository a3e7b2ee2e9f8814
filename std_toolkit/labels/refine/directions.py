"""The direction in which a pose is known least, in words."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import Symmetry
from std_toolkit.geometry.se3 import SE3, skew
from std_toolkit.labels.refine.problem import RefineView
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DirectionSettings(Settings):
    """How a weak direction is named."""

    same_deg: float = limit(25.0, unit="deg", source=NOT_RECORDED)
    """a direction within this angle of another is named by it"""


def covariance_at(covariance: NDArray[np.floating], point: NDArray[np.floating]) -> Array:
    """The 6x6 covariance of a right perturbation, with its translation taken at `point`.

    A rotation about the mesh origin moves an object that is elsewhere: translation and rotation
    are separate only about the object's centre.

    Args:
        point: (3,) in the mesh frame.
    """
    move = np.eye(6)
    move[:3, 3:] = -skew(point)
    return np.asarray(move @ covariance @ move.T, dtype=np.float64)


def weakest_direction(
    covariance: NDArray[np.floating],
    centre: NDArray[np.floating],
    radius: float,
    symmetry: Symmetry,
    *,
    T_world_obj: SE3 | None = None,
    views: Sequence[RefineView] = (),
) -> str:
    """One sentence on the direction of the largest uncertainty of the surface.

    It names the frame along whose view the direction lies, if there is one;
    `weak_direction_upright` says it relative to the table.

    Args:
        covariance: (6, 6) of a right perturbation, metres and radians.
        centre: (3,) centre of the object, mesh frame.
        radius: metres; rotations are weighted with the motion at this distance.
        symmetry: rotations about its axes are ignored, because they have no effect.
        T_world_obj, views: pose of the object and the views that determined it, for the words.
    """
    C = covariance_at(covariance, centre)
    size = np.array([1.0] * 3 + [radius] * 3)
    C = C * np.outer(size, size)
    for axis, _ in symmetry.continuous:
        free = np.concatenate([np.zeros(3), axis])
        P = np.eye(6) - np.outer(free, free)
        C = P @ C @ P
    values, vectors = np.linalg.eigh(C)
    v, std = vectors[:, -1], float(np.sqrt(max(values[-1], 0)))
    shift, turn = np.linalg.norm(v[:3]), np.linalg.norm(v[3:])
    if shift >= turn:
        direction, what = v[:3] / shift, "shift"
        amount = f"{1000 * std:.2f} mm"
    else:
        direction, what = v[3:] / turn, "turn"
        amount = f"{np.rad2deg(std / radius):.2f} deg"
    # The sign of an eigenvector is arbitrary; a fixed one keeps files reproducible.
    if direction[int(np.argmax(np.abs(direction)))] < 0:
        direction = -direction
    axis_text = ", ".join(f"{x + 0.0:.2f}" for x in np.round(direction, 2))
    words = _view_words(what, direction, centre, T_world_obj, views)
    return f"least determined: {what} {words}object axis ({axis_text}), standard deviation {amount}"


_PLAIN_WORDS = {"shift": "along ", "turn": "about "}
_WEAK = re.compile(r"(?P<what>shift|turn) (?P<words>[^(]*)object axis \((?P<axis>[^)]*)\)")


def weak_direction_upright(sentence: str, up: NDArray[np.floating]) -> str:
    """Return a sentence of `weakest_direction` in words of up and down where they fit.

    Args:
        sentence: as returned, or "".
        up: (3,) the upright direction in the object frame, unit length.
    """
    limits = DirectionSettings.current()
    found = _WEAK.search(sentence)
    if found is None:
        return sentence
    axis = np.array([float(x) for x in found["axis"].split(",")])
    along = abs(float(axis @ up)) / max(float(np.linalg.norm(axis)), 1e-9)
    words = found["words"]
    if along > np.cos(np.deg2rad(limits.same_deg)):
        words = "up or down, " if found["what"] == "shift" else "about its upright axis, "
    elif along < np.sin(np.deg2rad(limits.same_deg)) and words in _PLAIN_WORDS.values():
        words = "sideways, " if found["what"] == "shift" else "of its upright axis (tilt), "
    return sentence[: found.start("words")] + words + sentence[found.end("words") :]


def _view_words(
    what: str,
    direction: NDArray[np.floating],
    centre: NDArray[np.floating],
    T_world_obj: SE3 | None,
    views: Sequence[RefineView],
) -> str:
    """Return "along the view of frame 3, ", or "along " if the direction is along no view."""
    limits = DirectionSettings.current()
    if T_world_obj is None or not views:
        return _PLAIN_WORDS[what]
    rays = T_world_obj @ centre - np.stack([view.T_world_cam.t for view in views])
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-9)
    cosine = np.abs(rays @ (T_world_obj.R @ direction))
    best = int(np.argmax(cosine))
    if cosine[best] < np.cos(np.deg2rad(limits.same_deg)) or views[best].frame < 0:
        return _PLAIN_WORDS[what]
    frame = views[best].frame
    place = "along the view" if what == "shift" else "in the image"
    return f"{place} of frame {frame}, "
