"""From what the network says to grasps."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from benchmark.grasp_methods.graspnet.config import GraspNetConfig
from benchmark.grasp_methods.graspnet.heads import Operations
from benchmark.grasp_methods.graspnet.network import GraspNetwork, Seeds
from benchmark.grasping.grasp import Grasps

_HEIGHT = 0.02  # metres, of GraspNet's fingers; it predicts none


class Decoded(NamedTuple):
    """The best grasp of every seed of one cloud.

    Attributes:
        on_object: (s,) bool, whether the seed is one of an object.
        grasps: s of them, in the order of the seeds.
    """

    on_object: Tensor
    grasps: Grasps


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
    grasps = Grasps.make(
        rotations[view, turn[:, 0].gather(1, depth)[:, 0]].double().cpu().numpy(),
        seeds.points[image].double().cpu().numpy(),
        widths=width.double().cpu().numpy(),
        depths=reach.double().numpy(),
        scores=score.double().cpu().numpy(),
        heights=_HEIGHT,
    )
    objectness = seeds.approaches.objectness[image]
    return Decoded((objectness[1] > objectness[0]).cpu(), grasps)
