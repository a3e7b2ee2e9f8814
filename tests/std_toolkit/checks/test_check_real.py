"""Real frames whose reference poses were fitted to depth only: some miss the image by far."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import scipy.io

from std_toolkit.checks.check_step import run_check
from std_toolkit.checks.result import ObjectCheck
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.mesh import load_mesh, mesh_diameter, mesh_extents
from std_toolkit.jobs import JobOptions
from std_toolkit.options import CheckOptions
from std_toolkit.scene import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Label,
    Labels,
    Model,
    Object,
    ObjectTable,
    Scene,
    SceneInfo,
)

CAMERA = Camera(640, 480, 618.0172729492188, 618.0033569335938, 312.376953125, 232.37530517578125)


def check_frame(data: Path, root: Path, index: int, poses: str) -> dict[str, ObjectCheck]:
    """The rows of a frame's objects, labelled with reference poses."""
    folder, meshes = data / "realsense_ycb_frames", data / "ycb_meshes"
    names = sorted(p.name for p in meshes.iterdir() if p.is_dir() and p.name != "051_large_clamp")
    reference = scipy.io.loadmat(str(folder / "reference_poses" / f"{index:06d}-color.png.mat"))
    models, objects, labels = [], [], []
    for k, (cls, pose) in enumerate(zip(reference["rois"][:, 1], reference[poses], strict=True), 1):
        name = names[int(cls) - 1]
        shutil.copytree(meshes / name, root / "models" / name)
        mesh = load_mesh(root / "models" / name / "textured.obj")
        models.append(
            Model(
                id=name,
                mesh=f"models/{name}/textured.obj",
                size_m=[float(x) for x in mesh_extents(mesh)],
                diameter_m=mesh_diameter(mesh),
            )
        )
        objects.append(Object(id=k, name=name, model=name, material="diffuse"))
        T = SE3.from_quat(pose[:4], pose[4:7]).flat()
        labels.append(Label(object=k, frame=0, T_cam_obj=T, T_world_obj=T))
    for kind in ("color", "depth"):
        (root / kind).mkdir()
        shutil.copy(folder / f"{index:06d}-{kind}.png", root / kind / "000000.png")
    frame = Frame(id=0, name="000000", color="color/000000.png", depth="depth/000000.png")
    scene = Scene.create(
        root,
        SceneInfo(name="ycb", cameras={"color": CameraModel.of(CAMERA)}, depth_scale=0.001),
        Frames(frames=[frame]),
        ObjectTable(models=models, objects=objects),
    )
    pose0 = FramePose(frame=0, status="registered", T_world_cam=SE3.identity().flat())
    scene.save_poses(CameraPoses(frames=[pose0]))
    scene.save_labels(Labels(labels=labels))
    report = run_check(
        scene, CheckOptions(overlay_frames=0), JobOptions(engine="serial", progress=False)
    )
    assert not report.passed
    assert all(o.text("texture") != "turned" for o in report.objects)
    return {o.name: o for o in report.objects}


@pytest.mark.slow
@pytest.mark.real
def test_labels_that_fit_the_depth_but_miss_the_image_are_told(
    test_data: Path, tmp_path: Path
) -> None:
    """What a person sees in the overlays: the sugar box fits, the cracker box and wood do not."""
    rows = check_frame(test_data, tmp_path / "0", 0, "poses_refined")
    assert rows["004_sugar_box"].verdict == "fits"
    assert rows["003_cracker_box"].verdict == "wrong"
    assert abs(rows["004_sugar_box"].value("depth_mm") or 99) < 2
    assert all(abs(o.value("depth_mm") or 99) < 5 for o in rows.values())
    rows = check_frame(test_data, tmp_path / "3", 3, "poses_refined")
    # One frame does not tell how the can is turned about its axis.
    assert rows["007_tuna_fish_can"].verdict in ("fits", "unknown")
    assert rows["036_wood_block"].verdict == "wrong"
    assert {rows[n].verdict for n in ("035_power_drill", "037_scissors")} <= {"wrong", "doubtful"}


@pytest.mark.slow
@pytest.mark.real
def test_first_guesses_fail_by_depth(test_data: Path, tmp_path: Path) -> None:
    rows = check_frame(test_data, tmp_path / "0", 0, "poses")
    off = [o.name for o in rows.values() if abs(o.value("depth_mm") or 0) > 5]
    assert len(off) == 5
    assert rows["003_cracker_box"].verdict == "wrong"
