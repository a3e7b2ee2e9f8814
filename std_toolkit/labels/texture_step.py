"""The textures of the objects of a scene against its images: for the annotator and the check."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

from std_toolkit.errors import ToolkitError
from std_toolkit.labels.refine.problem import RefineObject, RefineView
from std_toolkit.labels.refine_step import load_views
from std_toolkit.labels.texture.comparison import TextureComparison, compare_texture
from std_toolkit.labels.texture.views import Views
from std_toolkit.log import logger
from std_toolkit.scene.model import Frame
from std_toolkit.scene.scene import Scene


def scene_views(
    scene: Scene, frames: Sequence[Frame] | None = None, *, loaded: Sequence[RefineView] = ()
) -> Views:
    """Views of a scene whose images are read when they are needed, and kept.

    Args:
        frames: registered frames; default: all.
        loaded: views that are read already, with depth.
    """
    frames = scene.registered_frames() if frames is None else list(frames)
    poses = [T for f in frames if (T := scene.T_world_cam(f.id)) is not None]
    assert len(poses) == len(frames), "only registered frames can be compared"
    known: dict[int, RefineView | None] = {v.frame: v for v in loaded}

    def read(k: int) -> RefineView | None:
        frame = frames[k]
        if frame.id not in known:
            try:
                (known[frame.id],) = load_views(scene, [frame])
            except ToolkitError as error:
                logger.info("the texture is not compared in frame %d: %s", frame.id, error)
                known[frame.id] = None
        return known[frame.id]

    cameras = [scene.camera(f).without_distortion() for f in frames]
    return Views(cameras, poses, [f.id for f in frames], read)


def compare_objects(
    views: Views,
    objects: Mapping[int, RefineObject],
    chosen: Collection[int],
    *,
    cancelled: Callable[[], bool] = lambda: False,
) -> dict[int, TextureComparison]:
    """Compare the textures of objects at their poses and at near-symmetric turns.

    Args:
        views: views of the scene, in the coordinate frame of the objects.
        objects: all placed objects by id, the chosen ones with their textures; the others hide
            parts of them.
        chosen: ids of the objects to compare.
        cancelled: polled between objects; True ends the comparison.

    Returns:
        Comparisons by object id, of those that were compared.
    """
    found = {}
    for i in chosen:
        if cancelled():
            break
        others = [o for j, o in objects.items() if j != i]
        found[i] = compare_texture(views, objects[i], others)
    return found
