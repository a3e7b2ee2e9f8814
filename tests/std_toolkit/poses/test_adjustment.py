"""Bundle adjustment of many images: an iterative solver, as exact as a direct one."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from std_toolkit.options import Refinement
from std_toolkit.poses import mapping
from std_toolkit.poses.colmap import from_rigid3d
from std_toolkit.poses.known_model import align_poses

DIRECT = 10**6


def made(images: int, points: int, track: int) -> tuple[pycolmap.Reconstruction, list]:
    """A model with noise, and its true poses T_world_cam by image id."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig = 1, 1
    options.num_frames_per_rig, options.num_points3D = images, points
    options.track_length = track
    options.num_points2D_without_point3D = 0
    options.camera_model_id = pycolmap.CameraModelId.PINHOLE
    options.camera_params = [1280.0, 1280.0, 512.0, 384.0]
    pycolmap.set_random_seed(0)
    model = pycolmap.synthesize_dataset(options)
    truth = poses_of(model)
    noise = pycolmap.SyntheticNoiseOptions()
    noise.point2D_stddev, noise.point3D_stddev = 0.7, 0.01
    noise.rig_from_world_translation_stddev = 0.002
    noise.rig_from_world_rotation_stddev = 0.05
    pycolmap.synthesize_noise(noise, model)
    return model, truth


def poses_of(model: pycolmap.Reconstruction) -> list:
    return [
        from_rigid3d(model.image(i).cam_from_world()).inverse()
        for i in sorted(model.reg_image_ids())
    ]


def position_error(model: pycolmap.Reconstruction, truth: list) -> float:
    """Root mean square of the distance to the true positions after alignment."""
    ours = poses_of(model)
    scale, T = align_poses(ours, truth)
    apart = [scale * (T.R @ a.t) + T.t - b.t for a, b in zip(ours, truth, strict=True)]
    return float(np.sqrt(np.mean(np.sum(np.square(apart), axis=1))))


@pytest.fixture
def solvers(monkeypatch) -> list[str]:
    """Names of the linear solvers that `adjust` has used."""
    used: list[str] = []

    def solve(model: pycolmap.Reconstruction, options: pycolmap.BundleAdjustmentOptions) -> None:
        config = pycolmap.BundleAdjustmentConfig()
        for i in model.reg_image_ids():
            config.add_image(i)
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        done = pycolmap.create_default_ceres_bundle_adjuster(options, config, model).solve()
        used.append(done.ceres_summary.linear_solver_type_used.name)

    monkeypatch.setattr(pycolmap, "bundle_adjustment", solve)
    return used


def adjust(model: pycolmap.Reconstruction) -> None:
    """The last adjustment of a reconstruction."""
    mapping.adjust(model, refine=Refinement.NONE, threads=1, min_angle_deg=18.0)


def test_many_images_are_adjusted_without_a_factorisation(solvers: list[str]) -> None:
    for images in (40, 160):
        adjust(made(images, 60, 16)[0])
    assert solvers == ["DENSE_SCHUR"] * 2 + ["ITERATIVE_SCHUR"] * 2


def test_the_iterative_solver_is_as_exact_as_a_direct_one(
    solvers: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, truth = made(160, 400, 40)
    direct, start = pycolmap.Reconstruction(model), position_error(model, truth)
    adjust(model)
    monkeypatch.setattr(mapping, "_DIRECT_IMAGES", DIRECT)
    adjust(direct)
    assert solvers == ["ITERATIVE_SCHUR"] * 2 + ["SPARSE_SCHUR"] * 2
    iterative, exact = position_error(model, truth), position_error(direct, truth)
    print(start, iterative, exact)
    assert exact < 0.9 * start
    assert iterative == pytest.approx(exact, rel=0.05)
    assert model.compute_mean_reprojection_error() == pytest.approx(
        direct.compute_mean_reprojection_error(), rel=0.01
    )
