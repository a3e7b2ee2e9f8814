"""Packed scenes, and what the training step makes of them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmark.methods.grasp.graspnet.cloud import fibonacci_views, gripper_rotations
from benchmark.methods.grasp.graspnet.graspnet_network import GraspNetwork
from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import PANDA
from benchmark.training.grasp.grasp_step import (
    GraspNetLoss,
    answers_and_truth,
    begin_of_turns,
    drawn_points,
    grasp_step,
    known_of,
    score_of_friction,
    soften_normalisation,
)
from benchmark.training.grasp.pack_grasps import begin_pack
from benchmark.training.grasp.packed_grasps import PackedGrasps
from benchmark.training.grasp.tabletop import TableObject, draw_cameras, look_at_table
from benchmark.training.step import StepInfo, model_input
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import so3_exp
from tests.benchmark.training.grasp.grasp_scene import OPTIONS, TINY, table_objects
from tests.benchmark.training.grasp.true_friction import true_friction


@pytest.fixture(scope="module")
def frames(grasp_pack) -> PackedGrasps:
    return PackedGrasps([grasp_pack], TINY)


def a_network() -> GraspNetwork:
    torch.manual_seed(0)
    return GraspNetwork(TINY)


def distances(thing: TableObject, points: np.ndarray) -> np.ndarray:
    """(n,) metres from the object's surface."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(thing.vertices.astype(np.float32)),
        o3d.core.Tensor.from_numpy(thing.faces.astype(np.uint32)),
    )
    return scene.compute_distance(o3d.core.Tensor.from_numpy(points.astype(np.float32))).numpy()


def test_other_points_are_drawn_every_time_but_the_same_for_validation(frames):
    batch, network = frames[[0, 1]], a_network()
    assert batch["cloud"].shape == (2, 1500, 3)
    drawn = [drawn_points(network.train(), batch) for _ in range(2)]
    assert not torch.equal(*drawn)
    assert all(len(row.unique()) == TINY.points for one in drawn for row in one)
    kept = [drawn_points(network.eval(), batch) for _ in range(2)]
    assert torch.equal(*kept)


def test_a_batch_is_its_frames_one_after_the_other(frames):
    both, parts = frames[[0, 1]], [frames[[0]], frames[[1]]]
    for name in ("cloud", "object"):
        assert torch.equal(both[name], torch.cat([part[name] for part in parts]))
    rows = [len(part["friction"]) for part in parts]
    assert len(both["friction"]) == sum(rows)
    for k, begin in enumerate((0, rows[0])):
        row = parts[k]["row"][0]
        assert torch.equal(both["row"][k], torch.where(row < 0, -1, row + begin))
        own = slice(begin, begin + rows[k])
        assert torch.equal(both["widths"][own], parts[k]["widths"])
        assert torch.equal(both["row_object"][own], parts[k]["row_object"] + 3 * k)
    assert torch.equal(both["turned"][3:], parts[1]["turned"])


def test_points_lie_on_the_objects_that_they_are_said_to_be_of(frames):
    batch = frames[[1]]
    seeds = batch["cloud"][0].double().numpy()
    found = 0
    for number, (thing, T) in enumerate(zip(table_objects(), frames.poses(1), strict=True)):
        mine = (batch["object"][0] == number).numpy()
        local = T.inverse() @ seeds[mine]
        assert distances(thing, local).max() < 1e-4
        found += int(mine.sum())
    table = (batch["object"][0] < 0).numpy()
    height = (frames.T_world_cam(1) @ seeds[table])[:, 2]
    assert np.abs(height).max() < 1e-4
    assert found > 10
    # Every point on an object is near a point with labels: depth is exact.
    assert torch.equal(batch["object"] >= 0, batch["row"] >= 0)


def test_what_is_known_of_views_is_what_a_loop_finds(frames):
    batch = frames[[0]]
    known = known_of(batch, batch["row"], TINY.views)
    directions = fibonacci_views(TINY.views)
    row = batch["row"][0]
    for s in torch.nonzero(row >= 0)[::25, 0].tolist():
        r = int(row[s])
        R = batch["turned"][batch["row_object"][r]].double().numpy()
        for j in (0, 17, 59):
            own = int(np.argmax((directions @ R.T) @ directions[j]))
            codes = batch["friction"][r, own].numpy()
            best = codes[codes > 0].min(initial=255)
            expected = 0.0 if best == 255 else score_of_friction(0.2 * best)
            assert known.views[0, s, j].item() == pytest.approx(expected, abs=1e-6)
    assert (known.views[0][row < 0] == 0).all()


def test_turns_begin_where_the_cameras_do_and_name_the_same_grasps():
    rng = np.random.default_rng(0)
    rotations = torch.from_numpy(gripper_rotations(60, 6))
    for _ in range(20):
        R = torch.from_numpy(so3_exp(rng.normal(size=3)))
        j = int(rng.integers(60))
        closeness = (R @ rotations[:, 0, :, 0].T).T @ rotations[j, 0, :, 0]
        own = R @ rotations[int(closeness.argmax()), 0]
        begun, order = begin_of_turns(own, rotations[j, 0], 6)
        assert torch.allclose(begun[:, 0], own[:, 0])
        # No other step of 30 degrees would be nearer.
        angle = torch.atan2(
            (begun.T @ rotations[j, 0])[2, 1], (begun.T @ rotations[j, 0])[1, 1]
        ).abs()
        assert angle <= np.pi / 12 + 1e-9
        for place, turn in enumerate(order.tolist()):
            about = torch.from_numpy(so3_exp([np.pi / 6 * place, 0, 0]))
            same = own @ torch.from_numpy(so3_exp([np.pi / 6 * turn, 0, 0]))
            swapped = same * torch.tensor([1.0, -1, -1])
            now = begun @ about
            assert torch.allclose(now, same) or torch.allclose(now, swapped)


def test_what_the_step_wants_holds_in_the_scene(frames):
    """The best turn and depth of the chosen views, as grasps: all frames and orders are right."""
    network = a_network().train()
    asked = []

    def remember(cloud, points, rotations):
        asked.append((points, rotations))
        return GraspNetwork.operations(network, cloud, points, rotations)

    network.operations = remember  # type: ignore[method-assign]
    good, count = 0.0, 0
    for index in (0, 1):
        batch = frames[[index]]
        # The network asks for the best view of each seed.
        index_of = drawn_points(network.eval(), batch)
        cloud = batch["cloud"].gather(1, index_of[..., None].expand(-1, -1, 3))
        with torch.no_grad():
            chosen = index_of.gather(1, GraspNetwork.seeds(network, cloud).chosen)
        wanted = known_of(batch, batch["row"].gather(1, chosen), TINY.views).views
        network.approach.register_forward_hook(
            lambda module, given, said, w=wanted: said._replace(views=w)  # noqa: ARG005
        )
        _, _, target = answers_and_truth(network, batch)
        points, rotations = asked[-1]
        best, flat = target.scores[0].flatten(1).max(dim=1)
        kept = best > 0
        turn, depth = flat // 2, flat % 2
        about = np.stack([so3_exp([np.pi / 6 * k, 0, 0]) for k in turn.tolist()])
        grasps = Grasps.make(
            (rotations[0].double().numpy() @ about)[kept],
            points[0].double().numpy()[kept],
            widths=target.widths[0].flatten(1).gather(1, flat[:, None])[:, 0].numpy()[kept],
            depths=np.array(TINY.depths)[depth.numpy()][kept],
        )
        world = grasps.transformed(frames.T_world_cam(index))
        good += (true_friction(frames.objects(index), world, PANDA) > 0).sum()
        count += int(kept.sum())
        # Views that the seeds' best view has a grasp of are those with one.
        assert torch.equal(wanted[0].amax(1) > 0, kept)
    # Labels are of the nearest of points 15 mm apart: some grasps just miss.
    assert count > 15
    assert good / count > 0.65


def test_a_step_has_a_loss_of_all_parts_and_learns_everywhere(frames):
    network = a_network().train()
    found = grasp_step(network, GraspNetLoss(), model_input(frames[[0, 1]]), StepInfo("", 0, 10))
    assert set(found.parts) == {"objectness", "views", "score", "turn", "width", "tolerance"}
    assert found.total.isfinite()
    found.total.backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in network.parameters())


@pytest.mark.slow
def test_two_views_are_learned_by_heart(frames):
    network, loss, seen = a_network().train(), GraspNetLoss(), model_input(frames[[0, 1]])
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    parts = []
    for step in range(160):
        torch.manual_seed(7)  # the same points in every step
        found = grasp_step(network, loss, seen, StepInfo("", step, 160))
        optimizer.zero_grad()
        found.total.backward()
        optimizer.step()
        parts.append({name: float(part) for name, part in found.parts.items()})
    # Of three beginnings, 0.003, 0.10, 0.48, 0.33, 0.04 and 0.02 of the first were left at most.
    left = {name: parts[-1][name] / parts[0][name] for name in parts[0]}
    most = {"objectness": 0.02, "views": 0.2, "turn": 0.7, "score": 0.6, "width": 0.2}
    assert all(left[name] < share for name, share in most.items()), left
    assert left["tolerance"] < 0.1, left


def test_a_frame_of_nothing_but_table_trains_objectness_alone(frames):
    batch = dict(frames[[0]])
    batch["row"] = torch.full_like(batch["row"], -1)
    batch["object"] = torch.full_like(batch["object"], -1)
    for name in ("friction", "widths", "tolerances", "row_object"):
        batch[name] = batch[name][:0]
    found = grasp_step(a_network().train(), GraspNetLoss(), model_input(batch), StepInfo())
    assert found.parts["objectness"] > 0
    assert sum(float(v) for n, v in found.parts.items() if n != "objectness") == 0


def test_momentum_of_normalisation_falls_by_halves():
    network = a_network()
    seen = []
    for step in (0, 99, 100, 899):
        soften_normalisation(network, StepInfo("", 100 * step, 90_000))
        seen.append({m.momentum for m in network.modules() if hasattr(m, "momentum")})
    assert seen == [{0.5}, {0.5}, {0.25}, {0.5**9}]
    soften_normalisation(network, StepInfo("", 199, 200))
    assert {m.momentum for m in network.modules() if hasattr(m, "momentum")} == {0.1}


def test_a_pack_goes_on_only_with_the_same(grasp_pack, tmp_path):
    assert begin_pack(grasp_pack, OPTIONS, TINY).spacing == OPTIONS.spacing
    with pytest.raises(ToolkitError, match=r"begun with 0\.015") as told:
        begin_pack(grasp_pack, replace(OPTIONS, spacing=0.01), TINY)
    assert told.value.field == "spacing"
    with pytest.raises(ToolkitError, match="no folder of packed grasps"):
        PackedGrasps([tmp_path], TINY)
    with pytest.raises(ToolkitError) as told:
        PackedGrasps([grasp_pack], replace(TINY, views=300))
    assert told.value.field == "views"


def test_a_cut_off_file_is_told(grasp_pack, tmp_path):
    import shutil

    copy = tmp_path / "pack"
    shutil.copytree(grasp_pack, copy)
    path = copy / "scene-00000" / "friction.npy"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ToolkitError, match="cannot be read"):
        PackedGrasps([copy], TINY)[[0]]


def test_frames_have_names_digests_and_the_depth_that_they_were_made_of(frames, grasp_pack):
    assert len(frames) == 2
    assert frames.key(0) != frames.key(1)
    assert frames.scene(0) == frames.scene(1)
    assert frames.frames[0].digest != frames.frames[1].digest
    look = look_at_table(
        table_objects(), frames.packs[0].camera, draw_cameras(0, 2)[1], "exact", (0, 1)
    )
    assert np.allclose(frames.look(1).depth, look.depth, atol=1e-5)
    index = json.loads((grasp_pack / "scene-00000.json").read_text())
    assert index["known"] == 1.0
    assert 0.3 < index["graspable"] <= 1


def test_a_sensor_misses_glass_and_its_seeds_do_not_count():
    objects = [replace(o, surface="transparent") for o in table_objects()]
    camera = OPTIONS.size
    from benchmark.training.grasp.pack_files import GraspPackSetup

    setup = GraspPackSetup(
        seed=0, assets="", assets_root=None, split="all", objects=(1, 1), sizes=(1, 1), frames=1,
        size=camera, depth="sensor", points=1, gripper="panda", spacing=0.01, views=1, angles=1,
        depths=(0.01,),
    )  # fmt: skip
    T = draw_cameras(0, 1)[0]
    exact = look_at_table(objects, setup.camera, T, "exact")
    seen = look_at_table(objects, setup.camera, T, "sensor", (0, 0))
    assert np.array_equal(exact.index, seen.index)
    glass = exact.index >= 0
    right = np.abs(seen.depth - exact.depth) < 0.01
    assert right[glass].mean() < 0.3
    assert right[~glass].mean() > 0.6
