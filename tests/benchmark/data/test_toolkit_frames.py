"""Scenes of this toolkit, what it exports and what it simulates, as frames to score."""

from __future__ import annotations

import pickle
from pathlib import Path

import msgspec
import numpy as np
import pytest
import trimesh
from dreds_on_disk import BALLS, draw, dreds_camera, write_cleargrasp_real
from scene_on_disk import CAMERA, write_scene

from benchmark.data.frame import BACKGROUND, Instance, Material
from benchmark.data.splits import iterate, open_split
from sensors.output.dreds import dreds_scene
from sensors.output.simulated_frame import SimulatedFrame, SimulatedObject, SimulatedScene
from sensors.output.toolkit_scene import toolkit_scene
from std_toolkit.errors import ToolkitError
from std_toolkit.exporters import export_scene
from std_toolkit.geometry import SE3, Camera
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.options import ImportRequest
from std_toolkit.jobs import JobOptions
from std_toolkit.options import RenderOptions
from std_toolkit.rendering.ground_truth import read_ground_truth
from std_toolkit.rendering.render_step import render_ground_truth
from std_toolkit.scene import Scene

SERIAL = JobOptions(engine="serial", progress=False)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    """Scene `tiny` with three frames, and beside it an export of it."""
    top = tmp_path_factory.mktemp("own")
    scene = write_scene(top / "scenes/tiny")
    render_ground_truth(scene, RenderOptions(renderer="raycast", policy="models"), jobs=SERIAL)
    export_scene(scene, "std", top / "exports/std", jobs=SERIAL)
    export_scene(scene, "nocs", top / "exports/nocs", jobs=SERIAL)
    return top


def test_a_rendered_scene(rendered: Path) -> None:
    source = open_split("scenes", rendered / "scenes")
    scene = Scene.open(rendered / "scenes/tiny")
    assert [tuple(k) for k in source.keys()] == [("tiny", f"{i:06d}") for i in range(3)]  # noqa: SIM118
    for row, frame in zip(scene.frames, iterate(source), strict=True):
        truth = read_ground_truth(scene, row.id)
        np.testing.assert_array_equal(frame.color, scene.read_color(row))
        np.testing.assert_array_equal(frame.depth_raw, scene.read_depth(row))
        np.testing.assert_array_equal(frame.depth_true, truth.depth)
        np.testing.assert_array_equal(frame.mask == 1, truth.mask == 1)
        assert set(np.unique(frame.mask)) == {1, BACKGROUND}
        assert frame.camera == CAMERA
        assert frame.instances == (Instance(1, 0, Material.DIFFUSE, "other", "box"),)
    np.testing.assert_array_equal(source.load(2, nocs=True).nocs, truth.nocs)
    assert pickle.loads(pickle.dumps(source)).load(1).key == "tiny/000001"


def test_one_scene_may_be_the_root(rendered: Path) -> None:
    assert len(open_split("scenes", rendered / "scenes/tiny")) == 3


def test_ground_truth_that_is_out_of_date_is_refused(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "tiny")
    render_ground_truth(scene, RenderOptions(renderer="raycast", policy="models"), jobs=SERIAL)
    scene.save_info(msgspec.structs.replace(scene.info, depth_scale=0.0011))
    with pytest.raises(ToolkitError, match=r"older than the labels.*render"):
        open_split("scenes", tmp_path).load(0)


def test_frames_without_ground_truth_do_not_count_and_are_told(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "tiny")
    jobs = RenderOptions(renderer="raycast", policy="models")
    render_ground_truth(scene, jobs, frames=[1], jobs=SERIAL)
    source = open_split("scenes", tmp_path)
    assert [k.name for k in source.keys()] == ["000001"]  # noqa: SIM118
    (found,) = source.files()
    assert found.frames == 3
    assert found.missing == {"ground-truth depth": ["000000", "000002"]}


def test_an_export_has_its_own_camera(rendered: Path) -> None:
    scene = Scene.open(rendered / "scenes/tiny")
    source = open_split("std-export", rendered / "exports")
    assert [tuple(k) for k in source.keys()] == [("tiny", f"{i:04d}") for i in range(3)]  # noqa: SIM118
    for row, frame in zip(scene.frames, iterate(source), strict=True):
        truth = read_ground_truth(scene, row.id)
        np.testing.assert_array_equal(frame.color, scene.read_color(row))
        np.testing.assert_array_equal(frame.depth_raw, scene.read_depth(row))
        np.testing.assert_array_equal(frame.depth_true, truth.depth)
        np.testing.assert_array_equal(frame.mask != BACKGROUND, truth.mask == 1)
        # Of 4:3, for which the layout's own constants would not do.
        assert frame.camera == CAMERA
        assert frame.instances == (Instance(1, 0, Material.DIFFUSE, "other", "box"),)
    nocs = source.load(0, nocs=True).nocs
    expected = read_ground_truth(scene, 0).nocs
    assert nocs is not None
    np.testing.assert_allclose(nocs, expected, atol=0.5 / 255 + 1e-4)


def test_an_export_of_a_scene_without_depth_has_placeholders(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "scenes/tiny")
    rows = [type(f)(id=f.id, name=f.name, color=f.color) for f in scene.frames]
    bare = Scene.create(
        tmp_path / "bare/tiny", scene.info, type(scene.frame_table)(frames=rows), scene.objects
    )
    for name in ("color", "models"):
        (bare.root / name).symlink_to(scene.root / name)
    assert scene.poses is not None
    bare.save_poses(scene.poses)
    bare.save_labels(scene.labels)
    render_ground_truth(bare, RenderOptions(renderer="raycast", policy="models"), jobs=SERIAL)
    export_scene(bare, "std", tmp_path / "out", jobs=SERIAL)
    source = open_split("std-export", tmp_path / "out")
    with pytest.raises(ToolkitError, match=r"0000_depth_415\.exr: .*placeholder"):
        source.load(0)
    assert source.load(0, sensor=False).mask_of().any()
    (found,) = source.files()
    assert found.missing == {"raw depth": [f"{i:04d}_depth_415.exr" for i in range(3)]}
    (own,) = open_split("scenes", tmp_path / "bare").files()
    assert own.missing == {"raw depth": [f"{i:06d}" for i in range(3)]}


def test_a_simulated_set_has_the_cameras_of_its_records(tmp_path: Path) -> None:
    scene, frames = simulated()
    with dreds_scene(tmp_path / "set", scene, split="val") as writer:
        for frame in frames:
            writer.add(frame)
    source = open_split("dreds-catknown-val", tmp_path / "set")
    for made, frame in zip(frames, iterate(source), strict=True):
        assert frame.camera == made.label_camera
        assert frame.camera != dreds_camera((64, 48))
        np.testing.assert_array_equal(frame.depth_true, made.depth_exact)
        np.testing.assert_array_equal(frame.depth_raw, made.depth_aligned)
        np.testing.assert_array_equal(frame.mask != BACKGROUND, made.mask > 0)
        np.testing.assert_array_equal(frame.color, made.color)
        assert frame.instances == (Instance(1, 6, Material.TRANSPARENT, "mug", "ball"),)


def test_simulated_scenes_know_the_depth_of_everything(tmp_path: Path) -> None:
    scene, frames = simulated()
    with toolkit_scene(tmp_path / "scenes/00017", scene) as writer:
        for frame in frames:
            writer.add(frame)
    source = open_split("scenes", tmp_path)
    for made, frame in zip(frames, iterate(source), strict=True):
        np.testing.assert_array_equal(frame.depth_true, made.depth_exact)
        np.testing.assert_array_equal(frame.mask == 1, made.mask == 1)
        np.testing.assert_array_equal(frame.depth_raw, made.depth_aligned)
        assert frame.camera == made.label_camera
        assert frame.instances == (Instance(1, 6, Material.TRANSPARENT, "mug", "ball"),)


@pytest.mark.parametrize("kind", ["png", "exr"])
def test_the_sensors_correction_is_applied(tmp_path: Path, kind: str) -> None:
    if kind == "png":
        scene = write_scene(tmp_path / "scenes/tiny", frames=1)
    else:
        made, frames = simulated()
        with toolkit_scene(tmp_path / "scenes/00017", made) as writer:
            for frame in frames:
                writer.add(frame)
        scene = Scene.open(tmp_path / "scenes/00017")
    depth = scene.read_depth(scene.frames[0])
    assert depth is not None
    scene.save_info(msgspec.structs.replace(scene.info, depth_correction=0.98))
    render_ground_truth(scene, RenderOptions(renderer="raycast", policy="models"), jobs=SERIAL)
    loaded = open_split("scenes", tmp_path / "scenes").load(0).depth_raw
    np.testing.assert_allclose(loaded, depth * 0.98, rtol=1e-6)
    assert loaded.any()


def test_imported_captures_keep_their_own_ground_truth(tmp_path: Path) -> None:
    drawn = write_cleargrasp_real(tmp_path / "real-val", frames=2)
    request = ImportRequest(source=tmp_path / "real-val", name="captures")
    import_recording(request, tmp_path / "scenes/captures")
    for one, frame in zip(drawn, iterate(open_split("scenes", tmp_path / "scenes")), strict=True):
        np.testing.assert_array_equal(frame.depth_true, one.true)
        np.testing.assert_array_equal(frame.depth_raw, one.raw)
        np.testing.assert_array_equal(frame.mask, one.mask)
        assert frame.instances == (Instance(1, 0, Material.TRANSPARENT),)


def test_a_folder_without_scenes(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match=r"no folder holds a scene\.json"):
        open_split("scenes", tmp_path)


def simulated() -> tuple[SimulatedScene, list[SimulatedFrame]]:
    """Two frames of a ball over a table, 4:3 with labels of half the size."""
    color = Camera(128, 96, 91.0, 92.0, 61.0, 50.0)
    labels = color.resized(64, 48)
    infrared = Camera(64, 48, 46.0, 46.0, 31.0, 24.0)
    ball = BALLS[0]
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.5 / 3**0.5)
    mesh.vertices /= np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    item = SimulatedObject(
        instance_id=1,
        asset_id="ball",
        category="mug",
        class_id=6,
        material_class="transparent",
        scale_m=ball.diagonal,
        T_world_obj=SE3(np.eye(3), np.array(ball.centre)),
        mesh=mesh,
    )
    scene = SimulatedScene(
        name="00017", seed=17, sensor="d415", frames=2, objects=[item], parameters={}
    )
    frames = []
    for i in range(2):
        drawn = draw(0, [ball], labels, color.size, labels.size, seed=i)
        mask = np.where(drawn.mask == 255, 0, drawn.mask).astype(np.uint8)
        facing = np.zeros((*mask.shape, 3), np.float32)
        facing[..., 2] = -1
        frames.append(
            SimulatedFrame(
                index=i,
                color=drawn.color,
                infrared_left=np.zeros((48, 64), np.uint8),
                infrared_right=np.zeros((48, 64), np.uint8),
                depth_sensor=drawn.raw,
                depth_exact_infrared=drawn.true,
                mask_infrared=mask,
                depth_aligned=drawn.raw,
                depth_exact=drawn.true,
                mask=mask,
                nocs=np.clip(drawn.nocs, 0, 1),
                normals=facing,
                T_world_cam=SE3.identity(),
                T_world_ir=SE3.identity(),
                color_camera=color,
                infrared_camera=infrared,
            )
        )
    return scene, frames
