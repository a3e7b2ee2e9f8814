"""GraspNet as a planner."""

from __future__ import annotations

import math

import numpy as np
import torch

from benchmark.grasp_methods.graspnet.cloud import sampled, scene_cloud, thinned, workspace
from benchmark.grasp_methods.graspnet.config import PRESETS
from benchmark.grasp_methods.graspnet.decode import best_of_seeds
from benchmark.grasp_methods.graspnet.network import GraspNetwork
from benchmark.grasp_methods.graspnet.views import gripper_rotations
from benchmark.grasp_methods.protocol import GraspView
from benchmark.grasping.collision import filled_share, hits_plane
from benchmark.grasping.grasp import Grasps
from benchmark.grasping.gripper import get_gripper
from benchmark.grasping.nms import suppress_similar
from benchmark.methods.network import device_called
from benchmark.methods.registry import MethodOptions
from benchmark.methods.settings import configured, preset_of
from benchmark.methods.weights import load_weights, weights_for

_SEED = 0  # of the points that are looked at: the same view gives the same grasps


class GraspNet:
    """Grasps that a network finds in a cloud; settings are those of `GraspNetConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(preset_of(PRESETS, options.preset), options.settings)
        self.gripper = get_gripper(self.config.gripper)
        self.device = device_called(options.device)
        network = GraspNetwork(self.config)
        load_weights(network, weights_for("graspnet", options))
        self.network = network.to(self.device).eval().requires_grad_(False)
        turned = gripper_rotations(self.config.views, self.config.angles)
        self._rotations = torch.from_numpy(turned).to(self.device, torch.float32)

    def plan(self, view: GraspView) -> Grasps:
        """See `GraspPlanner.plan`."""
        cloud = scene_cloud(view)
        shown = cloud[workspace(view, cloud, self.config)]
        shown = shown[thinned(shown, self.config.voxel)]
        if not len(shown):
            return Grasps.empty()
        chosen = sampled(len(shown), self.config.points, np.random.default_rng(_SEED))
        points = torch.from_numpy(shown[chosen]).to(self.device)[None]
        (found,) = best_of_seeds(self.network, points, self._rotations)
        grasps = found.grasps[found.on_object.numpy()]
        widest = min(self.config.max_width, self.gripper.max_width)
        grasps = grasps.replaced(widths=np.minimum(grasps.widths, widest))
        if self.config.collision:
            grasps = self._free(grasps, view, cloud)
        kept = suppress_similar(
            grasps,
            translation=self.config.nms_distance,
            rotation=math.radians(self.config.nms_angle),
        )
        return kept.top(self.config.most)

    def _free(self, grasps: Grasps, view: GraspView, cloud: np.ndarray) -> Grasps:
        """Those whose gripper hits neither the cloud nor the table."""
        if view.T_cam_table is not None:
            grasps = grasps[~hits_plane(grasps, self.gripper, view.T_cam_table)]
        taken = filled_share(grasps, self.gripper, cloud, voxel=self.config.collision_voxel)
        return grasps[taken <= self.config.collision_share]
