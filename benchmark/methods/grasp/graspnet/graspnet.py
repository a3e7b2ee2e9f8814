"""GraspNet as a planner: grasps from the output of the network."""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from benchmark.methods.grasp.graspnet.cloud import (
    PRESETS,
    GraspNetConfig,
    gripper_rotations,
    sampled,
    scene_cloud,
    thinned,
    workspace,
)
from benchmark.methods.grasp.graspnet.graspnet_network import GraspNetwork, Operations, Seeds
from benchmark.methods.network import network_of, torch_device
from benchmark.methods.protocol import GraspView
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.grasp import collision, grasp, gripper

_SEED = 0  # of the points that are looked at: the same view gives the same grasps

_HEIGHT = 0.02  # metres, of GraspNet's fingers; it predicts none


class GraspNet:
    """Grasps that a network finds in a cloud; settings are those of `GraspNetConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    settings_type = GraspNetConfig

    def __init__(self, options: MethodOptions) -> None:
        self.config, network = network_of("graspnet", PRESETS, GraspNetwork, options)
        self.gripper = gripper.get_gripper(self.config.gripper)
        self.device = torch_device(options.device)
        self.network = network.to(self.device).eval().requires_grad_(False)
        turned = gripper_rotations(self.config.views, self.config.angles)
        self._rotations = torch.from_numpy(turned).to(self.device, torch.float32)

    def plan(self, view: GraspView) -> grasp.Grasps:
        """See `GraspPlanner.plan`."""
        cloud = scene_cloud(view)
        shown = cloud[workspace(view, cloud, self.config)]
        shown = shown[thinned(shown, self.config.voxel)]
        if not len(shown):
            return grasp.Grasps.empty()
        chosen = sampled(len(shown), self.config.points, np.random.default_rng(_SEED))
        points = torch.from_numpy(shown[chosen]).to(self.device)[None]
        (found,) = best_of_seeds(self.network, points, self._rotations)
        grasps = found.grasps[found.on_object.numpy()]
        widest = min(self.config.max_width, self.gripper.max_width)
        grasps = grasps.replaced(widths=np.minimum(grasps.widths, widest))
        if self.config.collision:
            grasps = self._free(grasps, view, cloud)
        kept = grasp.suppress_similar(
            grasps,
            translation=self.config.nms_distance,
            rotation=math.radians(self.config.nms_angle),
        )
        return kept.top(self.config.most)

    def _free(self, grasps: grasp.Grasps, view: GraspView, cloud: np.ndarray) -> grasp.Grasps:
        """Those whose gripper hits neither the cloud nor the table."""
        if view.T_cam_table is not None:
            grasps = grasps[~collision.hits_plane(grasps, self.gripper, view.T_cam_table)]
        taken = collision.filled_share(
            grasps, self.gripper, cloud, voxel=self.config.collision_voxel
        )
        return grasps[taken <= self.config.collision_share]


class Decoded(NamedTuple):
    """The best grasp of every seed of one cloud.

    Attributes:
        on_object: (s,) bool, whether the seed is one of an object.
        grasps: s of them, in the order of the seeds.
    """

    on_object: Tensor
    grasps: grasp.Grasps


@torch.inference_mode()
def best_of_seeds(network: GraspNetwork, cloud: Tensor, rotations: Tensor) -> list[Decoded]:
    """The best grasp of every seed.

    Args:
        network: in evaluation mode.
        cloud: (b, n, 3) metres.
        rotations: (v, a, 3, 3) of grippers by view and turn.
    """
    seeds = network.seeds(cloud)
    view = seeds.approaches.views.argmax(dim=2)
    operations = network.operations(cloud, seeds.points, rotations[view, 0])
    return [
        _decoded(network.config, seeds, operations, view[k], rotations, k)
        for k in range(len(cloud))
    ]


def _decoded(
    config: GraspNetConfig,
    seeds: Seeds,
    operations: Operations,
    view: Tensor,
    rotations: Tensor,
    image: int,
) -> Decoded:
    """Of one image: at each depth the likeliest turn, of the depths the one with the best score."""
    scores, turns, widths, tolerances = (part[image].float() for part in operations)
    turn = turns.argmax(dim=1, keepdim=True)  # (s, 1, d)

    def at_turn(numbers: Tensor) -> Tensor:
        return numbers.gather(1, turn)[:, 0]  # (s, d)

    depth = at_turn(scores).argmax(dim=1, keepdim=True)

    def best(numbers: Tensor) -> Tensor:
        return numbers.gather(1, depth)[:, 0]

    width = (config.width_margin * best(at_turn(widths))).clamp(0, config.max_width)
    score = best(at_turn(scores)) * best(at_turn(tolerances)) / config.max_tolerance
    reach = torch.tensor(config.depths)[depth[:, 0].cpu()]
    grasps = grasp.Grasps.make(
        rotations[view, turn[:, 0].gather(1, depth)[:, 0]].double().cpu().numpy(),
        seeds.points[image].double().cpu().numpy(),
        widths=width.double().cpu().numpy(),
        depths=reach.double().numpy(),
        scores=score.double().cpu().numpy(),
        heights=_HEIGHT,
    )
    objectness = seeds.approaches.objectness[image]
    return Decoded((objectness[1] > objectness[0]).cpu(), grasps)
