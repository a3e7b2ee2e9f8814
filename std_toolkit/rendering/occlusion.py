"""What hides labelled objects besides each other.

- `models`: nothing. Right when everything that can occlude is labelled.
- `sensor`: the frame's sensor depth, by BOP's rule: a pixel is hidden where the sensor reads more
  than delta in front of the object; a missing reading hides nothing. Distances from the camera
  are compared, not z. In front of glass and metal sensors invent surfaces, which this rule takes
  for occluders.
- `fused`: geometry fused from the sensor depth of many frames, in which readings inside the
  outlines of transparent and specular objects play no part (see `fused.py`); delta as above.

A hidden pixel is background in every map.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.rendering.ground_truth import Policy
from std_toolkit.rendering.mesh import RenderMesh
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.windows import image_window, normalised_rays
from std_toolkit.scene.model import DIFFUSE_MATERIALS
from std_toolkit.scene.scene import Scene

if TYPE_CHECKING:
    from std_toolkit.geometry.camera import Camera
    from std_toolkit.geometry.se3 import SE3

DEFAULT_DELTA_M = 0.015
"""BOP's tolerance for real sensors."""

FEWEST_FRAMES_TO_FUSE = 8


def resolve_policy(scene: Scene, wished: Literal["auto"] | Policy) -> Policy:
    """The policy to use; `auto` takes the best one that the scene's data allows.

    `auto` is `fused` with sensor depth in at least 8 registered frames, `sensor` with fewer if no
    labelled object is transparent or specular, and else `models`.

    Raises:
        ToolkitError: the policy needs sensor depth or camera poses that the scene lacks.
    """
    with_depth = [f for f in scene.frames if f.depth is not None]
    registered = [f for f in with_depth if scene.T_world_cam(f.id) is not None]
    if wished == "auto":
        materials = {scene.objects.object(x.object).material for x in scene.labels.labels}
        if len(registered) >= FEWEST_FRAMES_TO_FUSE:
            return "fused"
        return "sensor" if with_depth and materials <= {*DIFFUSE_MATERIALS} else "models"
    if wished == "sensor" and not with_depth:
        raise ToolkitError(
            "policy sensor needs sensor depth, which this scene has none of",
            path=scene.root,
            field="policy",
            hint="use --policy models",
        )
    if wished == "fused" and not registered:
        raise ToolkitError(
            "policy fused needs sensor depth in frames with camera poses",
            path=scene.root,
            field="policy",
            hint="use --policy models or sensor",
        )
    return wished


def ray_lengths(camera: Camera) -> np.ndarray:
    """(H,W) float32 distance from the camera per metre of z, for every pixel."""
    return _ray_lengths(camera)


@lru_cache(maxsize=4)
def _ray_lengths(camera: Camera) -> np.ndarray:
    x, y = normalised_rays(camera, image_window(camera))
    lengths = np.sqrt(x * x + y * y + 1).astype(np.float32)
    lengths.setflags(write=False)
    return lengths


def hidden_by_depth(
    depth: np.ndarray, scene_depth: np.ndarray, camera: Camera, *, delta_m: float
) -> np.ndarray:
    """Where a scene depth hides an object depth.

    Args:
        depth: (H,W) z-depth of the objects, 0 = none.
        scene_depth: (H,W) z-depth of the scene, 0 = missing, which hides nothing.
        camera: both maps' camera.
        delta_m: tolerance on the difference of distances.

    Returns:
        (H,W) bool, true only where both depths are there.
    """
    difference = (depth - scene_depth) * ray_lengths(camera)
    return (depth > 0) & (scene_depth > 0) & (difference > np.float32(delta_m))


def occluder_depth(
    caster: RaycastRenderer,
    occluder: RenderMesh,
    T_cam_world: SE3,
    camera: Camera,
    *,
    where: np.ndarray,
) -> np.ndarray:
    """(H,W) float32 z-depth of the fused geometry at the pixels in `where`, 0 elsewhere."""
    depth = np.zeros(where.shape, np.float32)
    depth[where] = caster.cast_at(camera, occluder, T_cam_world, where=where)
    return depth
