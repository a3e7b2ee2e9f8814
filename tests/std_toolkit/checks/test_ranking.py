"""The rank of a pose among nearby poses, on drawn boxes and bottles in clutter."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from std_toolkit.checks.measure.ranking import PoseRank, rank_objects
from std_toolkit.geometry import SE3, Camera, Symmetry, so3_exp

CAMERA = Camera(480, 360, 420.0, 420.0, 239.5, 179.5)
ROUND = Symmetry(continuous=(((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),))


@dataclass
class DrawnScene:
    """Images by frame id, in the place of a scene."""

    images: list[NDArray[np.uint8]]

    def frame(self, id: int) -> Any:
        return SimpleNamespace(id=id)

    def camera(self, _: Any) -> Camera:
        return CAMERA

    def read_color(self, frame: Any) -> NDArray[np.uint8]:
        return self.images[frame.id]


def box() -> trimesh.Trimesh:
    return trimesh.creation.box((0.06, 0.14, 0.2))


def bottle() -> trimesh.Trimesh:
    outline = [[0, -0.1], [0.035, -0.1], [0.035, 0.04], [0.012, 0.07], [0.012, 0.1], [0, 0.1]]
    return trimesh.creation.revolve(np.array(outline), sections=40)


def draw(mesh: trimesh.Trimesh, poses: list[SE3], seed: int) -> DrawnScene:
    """Flat shaded faces, far ones first, over rectangles and lines."""
    random = np.random.default_rng(seed)
    images = []
    for T in poses:
        image = np.full((CAMERA.height, CAMERA.width, 3), random.uniform(90, 160), np.uint8)
        for _ in range(40):
            p = random.integers(0, CAMERA.size, size=(2, 2))
            q = p[0] + random.integers(-60, 60, size=2)
            colour = random.uniform(60, 200, 3).tolist()
            cv2.rectangle(image, p[0].tolist(), q.tolist(), colour, -1)
            cv2.line(image, p[0].tolist(), p[1].tolist(), colour, 2)
        corners = (T @ np.asarray(mesh.vertices))[mesh.faces]
        normals = np.asarray(mesh.face_normals) @ T.R.T
        uv = CAMERA.project(corners.reshape(-1, 3)).reshape(-1, 3, 2)
        for k in np.argsort(-corners[..., 2].mean(axis=1)):
            if normals[k] @ corners[k, 0] < 0:
                light = 140 + 100 * float(normals[k] @ [0.5, -0.6, -0.6])
                points = np.rint(uv[k] * 16).astype(np.int32)
                cv2.fillConvexPoly(image, points, [light, light, 0.6 * light], cv2.LINE_AA, 4)
        noisy = image + random.normal(0, 3, image.shape)
        images.append(np.clip(cv2.GaussianBlur(noisy, (0, 0), 0.7), 0, 255).astype(np.uint8))
    return DrawnScene(images)


def around(count: int) -> list[SE3]:
    """T_cam_obj of an upright object from several sides, looking down by 30 deg."""
    poses = []
    for angle in np.linspace(0.3, 2.5, count):
        R = so3_exp([np.deg2rad(-120), 0, 0]) @ so3_exp([0, 0, angle])
        poses.append(SE3(R, np.array([0.04 * np.sin(3 * angle), 0.01, 0.6])))
    return poses


def rank(
    scene: DrawnScene,
    mesh: trimesh.Trimesh,
    poses: list[SE3],
    change: SE3,
    symmetry: Symmetry = Symmetry(),  # noqa: B008
) -> PoseRank:
    found = rank_objects(
        scene,  # type: ignore[arg-type]
        {1: lambda k: poses[k] @ change},
        {1: mesh},
        {1: symmetry},
        range(len(poses)),
    )
    return found[1]


@pytest.mark.slow
@pytest.mark.parametrize("shape, seed", [("box", 1), ("bottle", 2)])
def test_only_the_true_pose_is_good(shape: str, seed: int) -> None:
    mesh, symmetry = (box(), Symmetry()) if shape == "box" else (bottle(), ROUND)
    poses = around(3)
    scene = draw(mesh, poses, seed)
    small = SE3(so3_exp([0.01, -0.01, 0.01]), np.array([0.001, -0.001, 0.001]))
    found = rank(scene, mesh, poses, small, symmetry)
    assert found.good, found
    assert found.sentence().startswith(f"better than {found.beaten} of 200 nearby poses")
    axes = range(3) if shape == "box" else range(2)
    for axis in axes:
        angle = (20, -50, -20)[axis]
        turn = SE3(so3_exp(np.eye(3)[axis] * np.deg2rad(angle)), np.zeros(3))
        assert not rank(scene, mesh, poses, turn, symmetry).good, (axis, angle)
    assert not rank(scene, mesh, poses, SE3(np.eye(3), np.array([0.02, 0, 0])), symmetry).good


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("shape", ["box", "bottle"])
@pytest.mark.parametrize("seed", range(10, 18))
def test_no_pose_20_to_50_deg_off_is_good(shape: str, seed: int) -> None:
    mesh, symmetry = (box(), Symmetry()) if shape == "box" else (bottle(), ROUND)
    poses, random = around(4), np.random.default_rng(seed)
    scene = draw(mesh, poses, seed)
    assert rank(scene, mesh, poses, SE3.identity(), symmetry).good
    for axis in np.eye(3)[: 3 if shape == "box" else 2]:
        for degrees in (20, -20, 35, -35, 50, -50):
            shift = random.uniform(-0.01, 0.01, 3)
            turn = SE3(so3_exp(axis * np.deg2rad(degrees)), shift)
            assert not rank(scene, mesh, poses, turn, symmetry).good, (axis, degrees, shift)


def test_turns_about_a_symmetry_axis_are_no_perturbations() -> None:
    mesh, poses = bottle(), around(2)
    scene = draw(mesh, poses, 3)
    spun = SE3(so3_exp([0, 0, 0.8]), np.zeros(3))
    straight, turned = (rank(scene, mesh, poses, c, ROUND) for c in (SE3.identity(), spun))
    assert straight.nearby == turned.nearby == 200
    assert abs(straight.beaten - turned.beaten) <= 4
    assert straight.rival < 0


def test_an_object_outside_all_images_is_not_ranked() -> None:
    poses = [SE3(np.eye(3), np.array([5.0, 0, 0.6]))]
    found = rank(draw(box(), poses, 4), box(), poses, SE3.identity())
    assert not found.good
    assert "visible in no frame" in found.sentence()
