"""Drawing options of the views and selection of their initial frames."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from annotator.session.state import Queries
from std_toolkit.scene import Scene

Array = NDArray[np.float64]

# Default distance of a table-top scene.
_USUAL_DISTANCE_M = 0.7

# Smallest distance of the target from the image border, as a fraction of the image size.
_MARGIN = 0.08


# Side views; a short recording has fewer.
SIDE_VIEWS = 3


class Mode(StrEnum):
    """Content of the main view."""

    IMAGE = "image"
    CLOUD = "cloud"


class Style(StrEnum):
    """Drawing style of a mesh over the image."""

    SOLID = "solid"
    WIREFRAME = "wireframe"
    CONTOUR = "contour"
    TEXTURED = "textured"


# Styles that cover the image, which shines through by the opacity.
SURFACE_STYLES = (Style.SOLID, Style.TEXTURED)


class CloudSource(StrEnum):
    """Source of the points in the cloud."""

    FRAME = "frame"
    FUSED = "fused"


class Gizmo(StrEnum):
    """Handles on the selected object."""

    OFF = "off"
    MOVE = "move"
    TURN = "turn"


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Drawing options of the views.

    Attributes:
        style: textured draws a mesh without a texture or vertex colours as solid.
        opacity: of solid and textured meshes over the image, 0.1 to 1.
        blink: alternate between drawing and hiding the meshes, to compare with the image.
        hidden: do not draw meshes.
        only_selected: do not draw other objects.
        table: draw the table plane in the cloud.
        penetration: draw penetrating faces in red.
        contour_always: also draw the contour in the other styles.
        maximised: show the active view alone.
    """

    style: Style = Style.TEXTURED
    opacity: float = 0.55
    blink: bool = False
    hidden: bool = False
    only_selected: bool = False
    cloud: CloudSource = CloudSource.FRAME
    table: bool = True
    penetration: bool = True
    contour_always: bool = False
    maximised: bool = False


def choose_view_frames(scene: Scene, session: Queries) -> list[int]:
    """Return the frame of the main view, then those of the side views in recording order.

    The main view shows the first frame in which a pose can be set. Side views are selected
    greedily: each next frame is the one whose viewing direction to the objects (before the first is
    placed: to the point that the cameras face) differs most from all previous ones. Without camera
    poses they are evenly spaced over the recording. Reads no images.
    """
    ids = [f.id for f in scene.frames]
    main = session.frames[0] if session.frames else ids[0]
    if session.posed and len(session.frames) > 1:
        sides = _spread(scene, session, main, SIDE_VIEWS)
    else:
        places = np.linspace(0, len(ids) - 1, SIDE_VIEWS + 1)[1:]
        sides = [ids[round(x)] for x in places]
    others = [f for f in ids if f in set(sides) - {main}]
    return [main, *others]


def _spread(scene: Scene, session: Queries, main: int, count: int) -> list[int]:
    frames = list(session.frames)
    poses = [T for f in frames if (T := session.T_world_cam(f)) is not None]
    R = np.stack([T.R for T in poses])
    eyes = np.stack([T.t for T in poses])
    target = _middle_of_objects(session)
    if target is None:
        target = _looked_at(eyes, R[:, :, 2], frames.index(main))
    sight = eyes - target
    sight /= np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-9)
    seen = _in_view(scene, frames, R, eyes, target)
    if seen.sum() <= count:
        seen[:] = True
    start = frames.index(main)
    nearest = np.arccos(np.clip(sight @ sight[start], -1, 1))
    chosen: list[int] = []
    for _ in range(min(count, len(frames) - 1)):
        nearest[start] = -1.0
        nearest[chosen] = -1.0
        best = int(np.where(seen, nearest, -1.0).argmax())
        if nearest[best] < 0:
            break
        chosen.append(best)
        nearest = np.minimum(nearest, np.arccos(np.clip(sight @ sight[best], -1, 1)))
    return [frames[i] for i in chosen]


def _middle_of_objects(session: Queries) -> Array | None:
    placed = [T.t for o in session.state.objects if (T := session.T_world_obj(o.name)) is not None]
    return np.mean(placed, axis=0) if placed else None


def _looked_at(eyes: Array, forward: Array, main: int) -> Array:
    """Return the point nearest to all optical axes that is in front of the cameras."""
    across = np.eye(3) - forward[:, :, None] * forward[:, None, :]
    total = across.sum(axis=0)
    usual = eyes[main] + _USUAL_DISTANCE_M * forward[main]
    if np.linalg.cond(total) > 1e4:
        return usual
    point = np.linalg.solve(total, np.einsum("nij,nj->i", across, eyes))
    ahead = np.einsum("nj,nj->n", point - eyes, forward) > 0
    return point if ahead.mean() > 0.5 else usual


def _in_view(
    scene: Scene, frames: list[int], R: Array, eyes: Array, target: Array
) -> NDArray[np.bool_]:
    points = np.einsum("nji,nj->ni", R, target - eyes)
    cameras = [scene.camera(scene.frame(f)) for f in frames]
    K = np.array([[c.fx, c.fy, c.cx, c.cy, c.width, c.height] for c in cameras])
    z = np.where(points[:, 2] > 0, points[:, 2], np.nan)
    # Lens distortion moves a point by far less than the margin.
    u = (K[:, 0] * points[:, 0] / z + K[:, 2]) / K[:, 4]
    v = (K[:, 1] * points[:, 1] / z + K[:, 3]) / K[:, 5]
    inside = [(x > _MARGIN) & (x < 1 - _MARGIN) for x in (u, v)]
    return inside[0] & inside[1]
