"""Training and validation of GraspNet."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from benchmark.methods.grasp.graspnet import cloud, graspnet, graspnet_network
from benchmark.metrics.grasp import ap, force_closure, grasp
from benchmark.training import catalogue, config, step, validation
from benchmark.training.grasp.grasp_step import GraspNetLoss, grasp_step
from benchmark.training.grasp.packed_grasps import PackedGrasps
from std_toolkit.geometry.camera import Camera

_DRAWN = 12  # grasps of a frame in the gallery


class GraspValidator(validation.Validator):
    """Validation: the loss, and GraspNet's average precision of the best grasps of each frame.

    No grasp is left out because it collides: what a planner does with the cloud is not the
    network's merit. The sums are frames, their losses, and the precision at each friction.
    """

    frames: Any

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._objects: dict[tuple[int, int], list[ap.JudgedObject]] = {}

    def zeros(self, network: nn.Module) -> np.ndarray:  # noqa: ARG002
        return np.zeros(2 + len(force_closure.FRICTIONS))

    def add(
        self, total: np.ndarray, network: nn.Module, batch: step.Batch, context: validation.Context
    ) -> None:
        count = len(batch["index"])
        with context():
            lost = grasp_step(network, self.loss, step.model_input(batch), step.StepInfo())
            found = _best(network, batch["cloud"])
        total[:2] += count, count * float(lost.total)
        for index, grasps in zip(batch["index"].tolist(), found, strict=True):
            total[2:] += ap.precision_at(self.judged(index, grasps).friction).mean(axis=0)

    def judged(self, index: int, grasps: grasp.Grasps) -> ap.Judged:
        """Grasps of a frame, judged as GraspNet does."""
        frame = self.frames.frames[index]
        place = frame.pack, frame.number
        if place not in self._objects:
            self._objects[place] = [
                ap.JudgedObject.of_mesh(o.vertices, o.faces) for o in self.frames.objects(index)
            ]
        table = self.frames.T_world_cam(index).inverse()
        return ap.judge_grasps(grasps, self._objects[place], self.frames.poses(index), table)

    def scores(self, states: np.ndarray) -> dict[str, float]:
        frames = states[0]
        means = states[1:] / frames if frames else np.full(len(states) - 1, math.nan)
        by_friction = dict(zip(force_closure.FRICTIONS, means[1:].tolist(), strict=True))
        return {
            "loss": float(means[0]),
            "ap": float(means[1:].mean()),
            "ap08": by_friction[0.8],
            "ap04": by_friction[0.4],
        }

    def main_score(self, scores: dict[str, float]) -> tuple[str, float]:
        value = 1 - scores["ap"]
        return "1 - AP", math.inf if math.isnan(value) else value

    def pictures(
        self, network: nn.Module, shown: Sequence[int], batch: step.Batch
    ) -> Sequence[np.ndarray]:
        """Depth with the best grasps: green those that hold, red the others."""
        pictures = []
        for index, grasps in zip(shown, _best(network, batch["cloud"]), strict=True):
            judged = self.judged(index, grasps)
            best, good = judged.grasps[:_DRAWN], judged.friction[:_DRAWN] > 0
            camera = self.frames.packs[self.frames.frames[index].pack].camera
            pictures.append(picture(self.frames.look(index).depth, camera, best, good))
        return pictures


def picture(
    depth: NDArray[np.float32], camera: Camera, grasps: grasp.Grasps, good: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """(h, w, 3) depth with opened jaws drawn on it."""
    known = depth > 0
    near, far = np.percentile(depth[known], (1, 99)) if known.any() else (0.0, 1.0)
    shade = np.clip(255 - 200 * (depth - near) / max(far - near, 1e-6), 0, 255)
    image = np.repeat(np.where(known, shade, 0).astype(np.uint8)[..., None], 3, axis=2)
    for k in range(len(grasps) - 1, -1, -1):
        half, tip = grasps.widths[k] / 2, grasps.depths[k]
        corners = [(tip, -half), (-0.02, -half), (-0.02, 0), (-0.06, 0), (-0.02, 0)]
        corners += [(-0.02, half), (tip, half)]
        local = np.array([(x, y, 0.0) for x, y in corners])
        pixels = camera.project(local @ grasps.rotations[k].T + grasps.translations[k])
        if np.isfinite(pixels).all():
            color = (60, 200, 60) if good[k] else (220, 60, 60)
            line = np.rint(pixels).astype(np.int32)[:, None]
            cv2.polylines(image, [line], False, color, 1, cv2.LINE_AA)
    return image


def _best(network: nn.Module, clouds: torch.Tensor) -> list[grasp.Grasps]:
    """The grasps of the seeds on objects, of each cloud."""
    assert isinstance(network, graspnet_network.GraspNetwork)
    turned = cloud.gripper_rotations(network.config.views, network.config.angles)
    rotations = torch.from_numpy(turned).to(clouds.device, torch.float32)
    found = graspnet.best_of_seeds(network, clouds[:, : network.config.points], rotations)
    return [f.grasps[f.on_object.numpy()] for f in found]


GRASPNET_TRAINING = catalogue.Trainable(
    presets=cloud.PRESETS,
    network=graspnet_network.GraspNetwork,
    loss=GraspNetLoss(),
    frames=PackedGrasps,
    images=False,
    step=grasp_step,
    validator=GraspValidator,
    optimization=replace(
        config.ADAM,
        learning_rate=1e-3,
        batch_size=2,
        epochs=18,
        milestones=(8 / 18, 12 / 18, 16 / 18),
        factor=0.1,
    ),
)
