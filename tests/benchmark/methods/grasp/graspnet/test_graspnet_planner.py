"""GraspNet as a planner: what it looks at, what it leaves out, and that it repeats itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.methods.grasp.graspnet.cloud import (
    GraspNetConfig,
    fibonacci_views,
    gripper_rotations,
    measured_pixels,
    sampled,
    scene_cloud,
    thinned,
    workspace,
)
from benchmark.methods.grasp.graspnet.graspnet_network import GraspNetwork
from benchmark.methods.protocol import GraspView
from benchmark.methods.registry import MethodOptions, make_planner
from benchmark.methods.weights import save_weights
from benchmark.metrics.grasp.collision import filled_share, hits_plane
from benchmark.metrics.grasp.gripper import GRASPNET, PANDA
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.plugins import configured

CAMERA = Camera(160, 90, 111.6, 111.6, 79.5, 44.5)
SETTINGS = {
    "points": "600",
    "level_points": "200,100,40,20",
    "level_neighbours": "8,8,8,8",
    "width": "8",
    "cylinder_points": "8",
    "margin": "0.05",
}


def a_view(**changes: object) -> GraspView:
    """A bar 8 cm high on a table that is looked at straight from above, 0.6 m away."""
    depth = np.full((90, 160), 0.6, np.float32)
    depth[35:55, 76:84] = 0.52
    view = GraspView(
        np.zeros((90, 160, 3), np.uint8),
        depth,
        CAMERA,
        depth < 0.55,
        np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.6], [0, 0, 0, 1]]),
    )
    return replace(view, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a network that was not trained, but holds every seed for one of an object, and thinks
    most of coming from the camera, closing along the image's rows, 6 cm wide."""
    torch.manual_seed(0)
    network = GraspNetwork(configured(GraspNetConfig(), SETTINGS))
    view = int(fibonacci_views(300)[:, 2].argmin())
    turn = int(np.abs(gripper_rotations(300, 12)[view, :, 0, 1]).argmax())
    head, operation = network.approach.net[1], network.operation.operation[1]
    with torch.no_grad():
        head.bias[1] += 100
        head.bias[2 + view] += 100
        operation.bias[12 + turn] += 100
        operation.bias[24:] += 0.05
    path = tmp_path_factory.mktemp("weights") / "untrained.safetensors"
    save_weights(network, path)
    return path


def a_planner(weights: Path, **settings: str):
    options = MethodOptions(weights=weights, settings={**SETTINGS, **settings})
    return make_planner("graspnet", options)


def test_the_cloud_is_what_has_depth():
    depth = a_view().depth.copy()
    depth[:3] = [[0.0], [np.nan], [-1.0]]
    view = a_view(depth=depth)
    cloud = scene_cloud(view)
    assert len(cloud) == measured_pixels(view).sum() == 87 * 160
    assert np.isfinite(cloud).all()
    assert cloud[0] == pytest.approx([0.6 * (0 - 79.5) / 111.6, 0.6 * (3 - 44.5) / 111.6, 0.6])


def test_the_workspace_is_a_box_around_the_objects():
    config = GraspNetConfig(margin=0.05)
    for view in (a_view(), a_view(mask=None), a_view(T_cam_table=None)):
        cloud = scene_cloud(view)
        shown = workspace(view, cloud, config)
        bar = cloud[:, 2] < 0.55
        assert shown[bar].mean() > 0.95
        # The bar is 3.7 cm x 9.3 cm.
        middle = cloud[shown]
        assert np.abs(middle[:, 0]).max() < 0.037 / 2 + 0.06
        assert np.abs(middle[:, 1]).max() < 0.093 / 2 + 0.06
        assert 0.01 < shown.mean() < 0.3
    nobody = a_view(mask=None, T_cam_table=None)
    assert workspace(nobody, scene_cloud(nobody), config).all()


def test_one_wrong_depth_does_not_stretch_the_workspace():
    depth = a_view().depth.copy()
    depth[2, 2] = 0.4  # floats in the air far off
    view = a_view(depth=depth, mask=None)
    cloud = scene_cloud(view)
    shown = workspace(view, cloud, GraspNetConfig(margin=0.05))
    assert np.abs(cloud[shown][:, 0]).max() < 0.2


def test_points_are_thinned_and_drawn_without_loss():
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 0.1, (2000, 3))
    kept = points[thinned(points, 0.01)]
    cubes = np.floor(kept / 0.01)
    assert len(np.unique(cubes, axis=0)) == len(kept)
    assert len(kept) == len(np.unique(np.floor(points / 0.01), axis=0))
    assert np.array_equal(thinned(points, 0), np.arange(2000))
    few, many = sampled(50, 80, rng), sampled(100, 80, rng)
    assert len(few) == len(many) == 80
    assert set(few) == set(range(50))
    assert len(set(many)) == 80


def test_grasps_repeat_fit_the_hand_and_hit_nothing(weights):
    planner, view = a_planner(weights), a_view()
    grasps, again = planner.plan(view), planner.plan(view)
    assert np.array_equal(grasps.to_array(), again.to_array())
    free = a_planner(weights, collision="false").plan(view)
    assert 0 < len(grasps) <= 50
    assert (np.diff(grasps.scores) <= 0).all()
    assert grasps.widths.max() <= PANDA.max_width
    cloud = scene_cloud(view)
    assert filled_share(grasps, PANDA, cloud).max() <= 0.01
    assert view.T_cam_table is not None
    assert not hits_plane(grasps, PANDA, view.T_cam_table).any()
    # Those on the table at the foot of the bar are left out.
    assert hits_plane(free, PANDA, view.T_cam_table).any()
    tips = np.stack([[CAMERA.project(t)] for t in grasps.tips])[:, 0]
    assert ((tips[:, 0] > 70) & (tips[:, 0] < 90)).all()
    apart = np.linalg.norm(grasps.translations[:, None] - grasps.translations, axis=2)
    trace = np.einsum("aij,bij->ab", grasps.rotations, grasps.rotations)
    alike = (apart < 0.03) & (trace > 1 + 2 * np.cos(np.radians(30)))
    assert (alike == np.eye(len(grasps), dtype=bool)).all()


def test_another_gripper_may_be_asked_for(weights):
    grasps = a_planner(weights, gripper="graspnet", most="5").plan(a_view())
    assert len(grasps) <= 5
    assert grasps.widths.max() <= GRASPNET.max_width
    with pytest.raises(ToolkitError):
        a_planner(weights, gripper="claw")


def test_where_nothing_is_seen_there_is_nothing_to_grasp(weights):
    planner = a_planner(weights)
    assert len(planner.plan(a_view(depth=np.zeros((90, 160), np.float32)))) == 0
    assert len(planner.plan(a_view(mask=np.zeros((90, 160), bool)))) == 0
    table = np.full((90, 160), 0.6, np.float32)
    assert len(planner.plan(a_view(depth=table, mask=None))) == 0


def test_weights_of_another_network_and_none_at_all_are_told(weights):
    with pytest.raises(ToolkitError, match="another network"):
        a_planner(weights, width="16")
    with pytest.raises(ToolkitError, match="no weights for graspnet"):
        make_planner("graspnet", MethodOptions())
    with pytest.raises(ToolkitError) as told:
        a_planner(weights, level_points="900,100,40,20")
    assert told.value.field == "level_points"
