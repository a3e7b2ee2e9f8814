"""Frames of boxes with a colour on every side, drawn by intersecting rays: truth without error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from benchmark.data.frame import BACKGROUND, Instance, Material
from benchmark.methods.pose.priors.prior_file import Priors, save_priors
from benchmark.methods.protocol import PoseAnswer, PoseView
from std_toolkit.geometry.camera import Camera

WIDTH, HEIGHT, FOCAL = 96, 72, 90.0
CAMERA = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)
CAR, MUG = 5, 6
SIDES = {CAR: (0.8, 0.36, 0.48), MUG: (0.48, 0.64, 0.6)}  # both with a diagonal of 1
_COLORS = np.array(
    [[220, 40, 40], [40, 220, 40], [40, 40, 220], [220, 220, 40], [40, 220, 220], [220, 40, 220]]
)


@dataclass(frozen=True)
class Box:
    class_id: int
    RT: np.ndarray  # the diagonal in metres inside

    @property
    def half(self) -> np.ndarray:
        return np.array(SIDES[self.class_id]) / 2


def boxes_of(seed: int) -> list[Box]:
    """Two boxes side by side, each turned in its own way."""
    rng = np.random.default_rng(seed)
    found = []
    for class_id, x in ((CAR, -0.13), (MUG, 0.13)):
        Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
        Q = Q * np.sign(np.diag(R))
        Q[:, 0] *= np.sign(np.linalg.det(Q))
        RT = np.eye(4)
        RT[:3, :3] = Q * rng.uniform(0.18, 0.24)
        RT[:3, 3] = (x, rng.uniform(-0.03, 0.03), rng.uniform(0.55, 0.65))
        found.append(Box(class_id, RT))
    return found


def view_of_boxes(boxes: list[Box]) -> PoseView:
    """The boxes, numbered from 1, before nothing."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack(
        [(u - CAMERA.cx) / FOCAL, (v - CAMERA.cy) / FOCAL, np.ones((HEIGHT, WIDTH))], axis=-1
    )
    depth = np.full((HEIGHT, WIDTH), np.inf)
    color = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    mask = np.full((HEIGHT, WIDTH), BACKGROUND, np.uint8)
    nocs = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    for number, box in enumerate(boxes, start=1):
        inverse = np.linalg.inv(box.RT)
        origin, direction = inverse[:3, 3], rays @ inverse[:3, :3].T
        with np.errstate(divide="ignore"):
            a = (-box.half - origin) / direction
            b = (box.half - origin) / direction
        near = np.minimum(a, b).max(axis=-1)
        hit = (near < np.maximum(a, b).min(axis=-1)) & (near > 0) & (near < depth)
        place = origin + direction * near[..., None]
        axis = (np.abs(place) / box.half).argmax(axis=-1)
        side = 2 * axis + (np.take_along_axis(place, axis[..., None], -1)[..., 0] > 0)
        depth[hit], mask[hit] = near[hit], number
        nocs[hit], color[hit] = place[hit] + 0.5, _COLORS[side[hit]]
    depth = np.where(np.isfinite(depth), depth, 0).astype(np.float32)
    instances = tuple(
        Instance(number, box.class_id, Material.DIFFUSE)
        for number, box in enumerate(boxes, start=1)
    )
    return PoseView(color, depth, depth, CAMERA, PoseAnswer(mask, instances, nocs))


def batch_of(views: list[PoseView]) -> dict[str, torch.Tensor]:
    """What `PackedFrames` gives of such frames."""
    classes = np.full((len(views), 256), BACKGROUND, np.uint8)
    for row, view in zip(classes, views, strict=True):
        for instance in view.truth.instances:
            row[instance.mask_id] = instance.class_id
    arrays = {
        "color": np.stack([v.color for v in views]),
        "raw": np.stack([v.depth for v in views]),
        "true": np.stack([v.depth for v in views]),
        "mask": np.stack([v.truth.mask for v in views]),
        "materials": np.where(classes == BACKGROUND, BACKGROUND, 1).astype(np.uint8),
        "nocs": np.rint(255 * np.stack([v.truth.nocs for v in views])).astype(np.uint8),
        "classes": classes,
        "K": np.stack([v.camera.K for v in views]).astype(np.float32),
        "index": np.arange(len(views)),
    }
    return {name: torch.from_numpy(array) for name, array in arrays.items()}


def write_priors(path, points: int = 64, seed: int = 0):
    """Priors of all seven classes: points on a box a little unlike each of those above."""
    from benchmark.metrics.pose.pose_protocol import DREDS_CLASSES

    rng = np.random.default_rng(seed)
    found = {}
    for class_id, name in enumerate(DREDS_CLASSES[1:], start=1):
        half = np.array(SIDES.get(class_id, (0.6, 0.6, 0.53))) / 2 * (1.1, 0.9, 1.0)
        p = rng.uniform(-1, 1, (points, 3))
        axis = rng.integers(3, size=points)
        p[np.arange(points), axis] = np.sign(p[np.arange(points), axis])
        found[name] = (p * half).astype(np.float32)
    save_priors(path, Priors(found, {"how": "by hand"}))
    return path
