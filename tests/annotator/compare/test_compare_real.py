"""First guesses and refined poses of objects in real frames: two annotators of a kind."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from annotator.compare import Comparison, compare_labels
from annotator.compare.comparison_report import write_pictures
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.labels.entry.label import add_model, add_object, set_pose
from std_toolkit.scene import CameraModel, Frame, Frames, Scene, SceneInfo

pytestmark = pytest.mark.real
CAMERA = Camera(640, 480, 618.0172729492188, 618.0033569335938, 312.376953125, 232.37530517578125)


def label_frame(data: Path, root: Path, index: int, poses: str) -> dict[str, SE3]:
    """A scene of one frame, labelled with reference poses; returns them by object."""
    folder, meshes = data / "realsense_ycb_frames", data / "ycb_meshes"
    names = sorted(p.name for p in meshes.iterdir() if p.is_dir() and p.name != "051_large_clamp")
    reference = scipy.io.loadmat(str(folder / "reference_poses" / f"{index:06d}-color.png.mat"))
    for kind in ("color", "depth"):
        (root / kind).mkdir(parents=True)
        shutil.copy(folder / f"{index:06d}-{kind}.png", root / kind / "000000.png")
    frame = Frame(id=0, name="000000", color="color/000000.png", depth="depth/000000.png")
    scene = Scene.create(
        root,
        SceneInfo(name="ycb", cameras={"color": CameraModel.of(CAMERA)}, depth_scale=0.001),
        Frames(frames=[frame]),
    )
    found = {}
    for cls, pose in zip(reference["rois"][:, 1], reference[poses], strict=True):
        name = names[int(cls) - 1]
        add_model(scene, meshes / name / "textured.obj", model_id=name)
        add_object(scene, name, model=name)
        found[name] = SE3.from_quat(pose[:4], pose[4:7])
        set_pose(scene, name, 0, found[name], annotator=poses)
    return found


@pytest.fixture(scope="module")
def compared(
    test_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Comparison, dict[str, SE3], dict[str, SE3]]:
    folder = tmp_path_factory.mktemp("ycb")
    first = label_frame(test_data, folder / "first", 0, "poses")
    refined = label_frame(test_data, folder / "refined", 0, "poses_refined")
    comparison = compare_labels(Scene.open(folder / "first"), Scene.open(folder / "refined"))
    return comparison, first, refined


def test_distances_are_those_of_all_vertices(
    compared: tuple[Comparison, dict[str, SE3], dict[str, SE3]], test_data: Path
) -> None:
    comparison, first, refined = compared
    assert len(comparison.objects) == len(first) >= 5
    for row in comparison.objects:
        mesh = load_mesh(test_data / "ycb_meshes" / row.name / "textured.obj")
        vertices = np.asarray(mesh.vertices)
        apart = first[row.name] @ vertices - refined[row.name] @ vertices
        assert row.difference is not None
        assert row.difference.mssd_m == pytest.approx(np.linalg.norm(apart, axis=1).max(), rel=1e-6)
        cosine = (np.trace(first[row.name].R.T @ refined[row.name].R) - 1) / 2
        assert np.cos(row.difference.rotation_rad) == pytest.approx(cosine, abs=1e-5)


def test_first_guesses_err_along_the_viewing_ray(
    compared: tuple[Comparison, dict[str, SE3], dict[str, SE3]],
) -> None:
    comparison, _, _ = compared
    print(comparison.table.to_string())
    along = [abs(x.difference.along_ray_m) for x in comparison.objects if x.difference]
    across = [x.difference.sideways_m for x in comparison.objects if x.difference]
    assert np.median(along) > 3 * np.median(across)


def test_pictures_of_disagreements(
    compared: tuple[Comparison, dict[str, SE3], dict[str, SE3]], tmp_path: Path
) -> None:
    comparison, _, _ = compared
    paths = write_pictures(comparison, tmp_path)
    assert [p.stem for p in paths] == [x.name for x in comparison.disagreements]
