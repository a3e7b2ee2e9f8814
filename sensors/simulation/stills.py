"""Arrangements of labelled objects, and the plane under them.

The objects rest on the plane under them. Where labels disagree with it by millimetres it is lowered
to the lowest point of any object: a floor must hide no labelled surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensors.simulation.labelled_scenes import LabelledFrame, LabelledScene
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.labels.support.neighbours import Cameras, common_support
from std_toolkit.labels.support.solid import PlacedObject
from std_toolkit.log import logger
from std_toolkit.settings import NOT_RECORDED, Settings, limit


@dataclass(frozen=True, kw_only=True)
class TwinSettings(Settings):
    """Labelled objects on a plane."""

    floats_m: float = limit(0.015, unit="m", source=NOT_RECORDED)
    """an object this far above the plane is named"""


@dataclass(frozen=True, eq=False)
class Still:
    """Frames in which all objects rest at the same place.

    Attributes:
        T_own_cam: of the frames, in the frame of `T_own_obj`: the world, or one frame's camera.
    """

    frames: list[LabelledFrame]
    T_own_cam: list[SE3]
    T_own_obj: dict[int, SE3]


def stills(scene: LabelledScene) -> list[Still]:
    """The frames of a scene by arrangement: one for static objects, else one for each frame."""
    if scene.static:
        cameras = [f.T_world_cam for f in scene.frames if f.T_world_cam is not None]
        first = scene.frames[0]
        # One pose in the world for all frames: that of the label.
        world = {
            i: SE3.from_matrix(label.T_world_obj)
            for i in first.T_cam_obj
            if (label := scene.labels.of(i)) is not None and label.T_world_obj is not None
        }
        return [Still(scene.frames, cameras, world)]
    return [Still([f], [SE3.identity()], f.T_cam_obj) for f in scene.frames]


def plane_under(scene: LabelledScene, still: Still) -> SE3:
    """T_plane_own: z up, the plane under the objects at z = 0, their middle above the origin.

    Raises:
        ToolkitError: the cameras see no object from above.
    """
    names = {o.id: (o.name, o.model) for o in scene.objects}
    objects = [
        PlacedObject(names[i][0], scene.meshes[names[i][1]], T)
        for i, T in still.T_own_obj.items()
        if i in names
    ]
    found = common_support(objects, Cameras.of(still.T_own_cam))
    if found is None:
        raise ToolkitError(
            "the cameras see no object from above: no plane under the objects",
            field=f"{scene.name}, frame {still.frames[0].name}",
        )
    up = found.normal
    heights = {o.name: float((o.T_frame_obj @ o.solid.hull @ up).min()) for o in objects}
    level = min(heights.values())
    limits = TwinSettings.current()
    for name, low in heights.items():
        if low - level > limits.floats_m:
            logger.warning(
                "%s, frame %s: %s is %.0f mm above the plane, which is under the lowest object",
                scene.name, still.frames[0].name, name, 1000 * (low - level),
            )  # fmt: skip
    middles = np.array([T.t for T in still.T_own_obj.values()])
    middle = (middles.min(axis=0) + middles.max(axis=0)) / 2
    origin = middle - up * (up @ middle - level)
    R_cam = still.T_own_cam[0].R
    flat = R_cam - np.outer(up, up @ R_cam)
    axis = flat[:, 0] if np.linalg.norm(flat[:, 0]) > 0.5 else flat[:, 1]
    x = axis / np.linalg.norm(axis)
    R = np.stack([x, np.cross(up, x), up])
    return SE3(R, -R @ origin)
