"""Views of tables as toolkit scenes, for programs of the user that restore their depth.

Later views of a table depend on the grasps before them. The name of a view therefore contains a
hash of its sensor depth: depth that was made for another state of the table is never taken for it.
"""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmark.data.frame import DepthFrame
from benchmark.data.predictions import read_prediction
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io import exr, images
from std_toolkit.io.documents import write_document
from std_toolkit.io.locks import hold_lock
from std_toolkit.scene.model import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    SceneInfo,
)
from std_toolkit.scene.scene import Scene

SOURCE = "table-clearing"


def named_view(frame: DepthFrame, scene: str) -> DepthFrame:
    """Return a view with the name of its table, and with a name of its own.

    The latter is the number of the attempt and a hash of the sensor depth.
    """
    depth = np.ascontiguousarray(frame.depth_raw, "<f4")
    digest = hashlib.blake2b(depth.tobytes(), digest_size=4).hexdigest()
    return replace(frame, scene=scene, name=f"{frame.name}-{digest}")


def save_view(folder: Path, frame: DepthFrame, T_world_cam: SE3) -> None:
    """Add a view to the scene `folder / frame.scene`, unless it is there.

    Colour is `color/NAME.png`, sensor depth `depth/NAME.exr` (metres, 0 where not measured); the
    scene has the intrinsics and the camera pose, z up and the table at z = 0. Ground truth is not
    written.

    Raises:
        ToolkitError: the folder has another scene, or cannot be written.
    """
    root, name = folder / frame.scene, frame.name
    root.mkdir(parents=True, exist_ok=True)
    with hold_lock(root, "lock", doing="writing to", wait=True, images=True):
        there = _frames(root, frame)
        if any(f.name == name for f in there):
            return
        color, depth = f"color/{name}.png", f"depth/{name}.exr"
        images.write_color(root / color, frame.color)
        exr.write_exr(root / depth, {"Y": frame.depth_raw}, compression="zip")
        added = Frame(id=len(there), name=name, color=color, depth=depth)
        frames = Frames(frames=[*there, added])
        if there:
            write_document(root / "frames.json", frames)
            scene = Scene.open(root)
        else:
            cameras = {"color": CameraModel.of(frame.camera)}
            info = SceneInfo(name=frame.scene, cameras=cameras, source=SOURCE)
            scene = Scene.create(root, info, frames)
        placed = [
            FramePose(frame=f.id, status="registered", T_world_cam=T_world_cam.flat())
            for f in frames.frames
        ]
        scene.save_poses(CameraPoses(frames=placed, source=SOURCE))


def _frames(root: Path, frame: DepthFrame) -> list[Frame]:
    """Frames of the scene that the view belongs to; none if there is no scene."""
    if not (root / "scene.json").is_file():
        return []
    scene = Scene.open(root)
    if scene.info.source != SOURCE or scene.info.cameras["color"].camera() != frame.camera:
        raise ToolkitError(
            "a scene of another camera is here", path=root, hint="choose another --save-views"
        )
    return scene.frames


def check_saved_depth(path: Path, folder: Path, frame: DepthFrame) -> None:
    """Check saved depth of a view before it is read.

    Args:
        path: file of the depth of this name.
        folder: folder of all saved depth.
        frame: the view, as `named_view` returns it.

    Raises:
        ToolkitError: no depth of this view, or of another size.
    """
    if not path.is_file():
        attempt = frame.name.partition("-")[0]
        others = sorted((folder / frame.scene).rglob(f"{attempt}-*.exr"))
        raise ToolkitError(
            "the saved depth is of another state of the table"
            if others
            else "no saved depth of this view",
            path=path,
            hint="restore the views of --save-views under their names, and run the command again",
        )
    height, width = read_prediction(path).shape
    if (width, height) != frame.camera.size:
        raise ToolkitError(
            "saved depth has another size than the view",
            path=path,
            value=f"{width}x{height}",
            hint="{}x{} is expected".format(*frame.camera.size),
        )
