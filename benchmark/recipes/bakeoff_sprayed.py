"""Truth of a recording by a second one of the same scene, sprayed matt and matched by a board.

Both recordings have camera poses in metres, each in a world of its own; a fiducial board that was
not moved lies in both. True depth of a frame is what at least three views of the sprayed scene
measured behind its pixels. Objects that have no labels are what stands above the board's plane.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.recipes.bakeoff_surroundings import BakeoffSceneSettings, Surroundings
from std_toolkit.arrays import Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, pixel_rays
from std_toolkit.geometry.se3 import SE3
from std_toolkit.poses.board_scale import Board, detect_board
from std_toolkit.scanning.board.board_photos import board_pose
from std_toolkit.scene.model import Model, Object
from std_toolkit.scene.scene import Scene
from std_toolkit.settings import Settings, limit

SPRAYED_ID = 1
# The object of all that was sprayed and has no label.
SPRAYED_MODEL = Model(
    id="sprayed", mesh="models/sprayed.ply", size_m=[1.0, 1.0, 1.0], diameter_m=1.0
)
SPRAYED = Object(id=SPRAYED_ID, name="sprayed", model="sprayed", material="transparent")


@dataclass(frozen=True, kw_only=True)
class SprayedSettings(Settings):
    """When two recordings are matched, and what an object is."""

    fewest_frames: int = limit(3, source="fewest frames of a board's scale")
    """frames of each recording that must show the board"""
    apart_mm: float = limit(5.0, unit="mm", source="half of what counts as an object")
    """the board may lie in so many places of the world, by the median over frames"""
    height_mm: float = limit(10.0, unit="mm", source="1 % of a camera's distance of 1 m")
    """what stands higher above the board's plane is an object"""
    reach_m: float = limit(0.5, unit="m", source="a board of A3 and what stands around it")
    """objects are within this distance of the board's origin, along its plane"""


@dataclass(frozen=True, eq=False)
class Sprayed:
    """The sprayed scene in the world of the other recording.

    Attributes:
        surfaces: what its views measured.
        T_world_board: the board.
    """

    surfaces: Surroundings
    T_world_board: SE3

    def depth(self, camera: Camera, T_world_cam: SE3 | None) -> Floats:
        """True depth (H, W) of a view, metres; 0 where it is not known."""
        return self.surfaces.seen_by(camera, T_world_cam)

    def objects(self, true: Floats, camera: Camera, T_world_cam: SE3) -> NDArray[np.uint8]:
        """Ids (H, W) of what stands on the board's plane: `SPRAYED_ID`, else 0."""
        limits = SprayedSettings.current()
        T = self.T_world_board.inverse() @ T_world_cam
        points = T @ (pixel_rays(camera) * true[..., None])
        # The camera looks from above, whichever way the board's z axis points.
        height = points[..., 2] * np.sign(T.t[2])
        near = np.linalg.norm(points[..., :2], axis=-1) < limits.reach_m
        stands = (true > 0) & near & (height > limits.height_mm / 1000)
        return np.where(stands, SPRAYED_ID, 0).astype(np.uint8)


def match_sprayed(scene: Scene, sprayed: Scene) -> Sprayed:
    """Bring a sprayed recording into the world of another one.

    Args:
        scene: the recording; its board.json describes the board (or that of `sprayed`).
        sprayed: of the same scene.

    Raises:
        ToolkitError: no board is described, too few frames show it, or it lies in several places.
    """
    described = [s.root / "board.json" for s in (scene, sprayed)]
    path = next((p for p in described if p.is_file()), None)
    if path is None:
        raise ToolkitError(
            "no board is described", path=described[0],
            hint="put the board.json of `std-scan board` into the scene",
        )  # fmt: skip
    board = Board.read(path)
    T_world_board, other = board_in_world(scene, board), board_in_world(sprayed, board)
    T = T_world_board @ other.inverse()
    points = Surroundings.of(sprayed).points
    if len(points) < BakeoffSceneSettings.current().agreeing:
        raise ToolkitError("too few frames with a camera pose and depth", path=sprayed.root)
    # No frame of the other recording is one of these.
    moved = {-2 - i: (T @ p).astype(np.float32) for i, p in points.items()}
    return Sprayed(Surroundings(moved), T_world_board)


def board_in_world(scene: Scene, board: Board) -> SE3:
    """Return T_world_board: the mean over frames.

    Raises:
        ToolkitError: too few frames show the board, or it lies in several places.
    """
    limits = SprayedSettings.current()
    found: list[SE3] = []
    for frame in scene.registered_frames():
        pose = board_pose(detect_board(scene.color_path(frame), board=board), scene.camera(frame))
        T = scene.T_world_cam(frame.id)
        if pose is not None and T is not None:
            found.append(T @ pose[0])
    if len(found) < limits.fewest_frames:
        raise ToolkitError(
            f"the board is seen in {len(found)} frames with a camera pose, "
            f"{limits.fewest_frames} are needed",
            path=scene.root,
        )
    places = np.array([T.t for T in found])
    middle = np.median(places, axis=0)
    apart = 1000 * float(np.median(np.linalg.norm(places - middle, axis=1)))
    if apart > limits.apart_mm:
        raise ToolkitError(
            "the board lies in several places: it was moved, or camera poses are wrong",
            path=scene.root,
            value=f"{apart:.1f} mm",
        )
    # The rotation nearest to the mean of all.
    U, _, Vt = np.linalg.svd(np.mean([T.R for T in found], axis=0))
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    return SE3(R, middle)
