"""Ray-cast scenes of an object seen from around: the truth, and made-up answers of a method."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from benchmark.restoring.visual_hull import PosedView
from sensors.synthetic import shapes
from sensors.synthetic.raycast_world import World
from sensors.synthetic.recording import UPRIGHT
from sensors.viewpoints.views import look_at
from std_toolkit.geometry import SE3, Camera
from std_toolkit.scene import CameraModel, Scene, SceneInfo
from tests.scene_on_disk import camera_poses, write_frames

SHAPES = {
    "bottle": lambda: shapes.bottle(0.035, 0.15),
    "bowl": lambda: shapes.bowl(0.068, 0.055),
    "box": lambda: shapes.box(0.08, 0.08, 0.05),
}


@dataclass(frozen=True, eq=False)
class Seen:
    """A view with its truth: depth (H, W) metres, and pixels of glass or metal."""

    view: PosedView
    true: np.ndarray
    glass: np.ndarray

    def but(self, **changes) -> Seen:
        return replace(self, view=replace(self.view, **changes))


def seen_from_around(
    shape: str,
    *,
    views: int = 16,
    size: tuple[int, int] = (160, 120),
    error: float = 0.02,
    bias: float = 0.0,
    arc: float = 360.0,
    spread: float | None = None,
    lens: tuple[float, ...] = (),
    seed: int = 0,
) -> list[Seen]:
    """Views of a glass or metal object and an opaque box on a table, with true masks.

    The answers on the object are off by smooth noise of `error` metres and by `bias`; their spread
    says so, unless it is given.
    """
    rng = np.random.default_rng(seed)
    material = "specular" if shape == "bowl" else "transparent"
    made = [shapes.Shape("it", "other", material, SHAPES[shape](), shapes.TURN)]
    made.append(shapes.Shape("box", "other", "diffuse", SHAPES["box"](), shapes.TURN))
    heights = [s.mesh.extents[1] / 2 for s in made]
    poses = [SE3(UPRIGHT, np.array([x, 0.0, h])) for x, h in zip((0, -0.16), heights, strict=True)]
    world = World(made, poses, seed=0)
    w, h = size
    camera = Camera(w, h, w * 0.95, w * 0.95, (w - 1) / 2, (h - 1) / 2, lens)
    found = []
    for index in range(views):
        turn = np.deg2rad(arc * index / max(views - (arc < 360), 1) - 90 - arc / 2 * (arc < 360))
        up = np.deg2rad(35 + 12 * np.sin(3 * turn))
        eye = 0.55 * np.array([np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)])
        T_world_cam = look_at(eye + np.array([0, 0, 0.05]), [-0.03, 0, 0.06])
        rays = camera.rays().reshape(-1, 3) @ T_world_cam.R.T
        hits = world.cast(np.broadcast_to(T_world_cam.t, rays.shape), rays)
        true = np.where(np.isfinite(hits.t), hits.t, 0).reshape(h, w).astype(np.float32)
        glass = (hits.entity == 2).reshape(h, w)
        noise = cv2.GaussianBlur(rng.normal(size=(h, w)), (0, 0), w / 40)
        off = bias + error * noise / noise.std()
        depth = np.where(glass, true + off, true).astype(np.float32)
        said = float(np.hypot(error, bias)) if spread is None else spread
        maps = (
            np.where(glass, said, 0.003).astype(np.float32),
            glass.astype(np.float32) * 0.9 + 0.03,
        )
        view = PosedView(f"{index:06d}", camera, T_world_cam, depth, maps[0], maps[1], ~glass)
        found.append(Seen(view, true, glass))
    return found


def errors(depths: list[np.ndarray], scene: list[Seen]) -> np.ndarray:
    """Errors in metres at all pixels of glass or metal of all views."""
    return np.concatenate([(d - s.true)[s.glass] for d, s in zip(depths, scene, strict=True)])


METHODS = '''
from pathlib import Path
import numpy as np
from benchmark.methods.protocol import Restored

class Told:
    """Reads its answers, by the number of the frame in the first pixel of the colour image."""
    input_size, needs_mask = None, False

    def __init__(self, options):
        self.answers = np.load(Path(__file__).with_name("answers.npz"))

    def restore(self, views):
        found = []
        for view in views:
            depth, spread, clear = self.answers["maps"][int(view.color[0, 0, 0])]
            trust = (clear < 0.5).astype(np.float32)
            found.append(Restored(depth, trust, spread, clear))
        return found

class Mute(Told):
    """Does not say how far off it is."""

    def restore(self, views):
        return [Restored(found.depth, None, None, found.clear) for found in super().restore(views)]
'''


def write_scene(root: Path, scene: list[Seen], *, posed: bool = True) -> Path:
    """A scene of std-curate whose sensor sees nothing on glass, with `root/methods.py`."""
    images, depths = [], []
    for index, seen in enumerate(scene):
        image = np.full((*seen.true.shape, 3), 90, np.uint8)
        image[seen.glass] = 200
        image[0, 0] = index
        images.append(image)
        depths.append(np.where(seen.glass, 0, seen.true))
    camera = CameraModel.of(scene[0].view.camera)
    info = SceneInfo(name="seen", cameras={"color": camera}, depth_scale=0.001)
    made = Scene.create(root / "scene", info, write_frames(root / "scene", images, depths))
    if posed:
        made.save_poses(camera_poses([seen.view.T_world_cam for seen in scene]))
    maps = [np.stack([s.view.depth, s.view.spread, s.view.clear]) for s in scene]
    np.savez(root / "answers.npz", maps=np.asarray(maps, np.float32))
    (root / "methods.py").write_text(METHODS)
    return made.root
