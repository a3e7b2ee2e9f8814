"""MSSD and MSPD against plain loops over vertices, symmetries and angles."""

from __future__ import annotations

import numpy as np
import pytest
from bop_set import BRICK, CAMERA, CAN, MESHES

from benchmark.metrics.bop import ModelDistances, fisheye624, pinhole
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Symmetry, so3_exp
from std_toolkit.geometry.mesh import hull_vertices
from std_toolkit.geometry.symmetry import mssd as mssd_of_poses

VERTICES = {k: np.asarray(m.vertices) for k, m in MESHES.items()}
HULLS = {k: hull_vertices(m) for k, m in MESHES.items()}
ROUND = Symmetry(continuous=(((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),))
FLIP = SE3(so3_exp(np.array([np.pi, 0, 0])), np.zeros(3))
BOTH = Symmetry((tuple(FLIP.matrix().ravel()),), ROUND.continuous)


def pose(rng: np.random.Generator) -> SE3:
    """A pose in view, with a rotation that is a little off, as LM-O's are."""
    R = so3_exp(rng.normal(0, 1, 3)) + rng.normal(0, 2e-3, (3, 3))
    return SE3(R, np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.5, 0.9)]))


def near(T: SE3, rng: np.random.Generator) -> SE3:
    return SE3(T.R @ so3_exp(rng.normal(0, 0.2, 3)), T.t + rng.normal(0, 0.01, 3))


def loop(number: int, estimate: SE3, truth: SE3, transforms: list[SE3]) -> tuple[float, float]:
    """BOP's formulas one after the other."""
    X, spaces, pixels = VERTICES[number], [], []
    for S in transforms:
        a, b = estimate @ X, truth @ (S @ X)
        spaces.append(np.linalg.norm(a - b, axis=1).max())
        pixels.append(np.linalg.norm(CAMERA.project(a) - CAMERA.project(b), axis=1).max())
    return min(spaces), min(pixels)


def both(model: ModelDistances, estimate: SE3, truth: SE3) -> tuple[float, float]:
    pixels = model.mspd([estimate], [truth], pinhole(CAMERA))
    return float(model.mssd([estimate], [truth])[0, 0]), float(pixels[0, 0])


@pytest.mark.parametrize("seed", range(4))
def test_discrete_symmetries_and_rough_rotations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truths = [pose(rng) for _ in range(3)]
    estimates = [near(T, rng) for T in truths[:2]]
    symmetry = Symmetry((tuple(FLIP.matrix().ravel()),))
    model = ModelDistances(VERTICES[BRICK], HULLS[BRICK], symmetry)
    spaces, pixels = model.mssd(estimates, truths), model.mspd(estimates, truths, pinhole(CAMERA))
    for i, e in enumerate(estimates):
        for j, t in enumerate(truths):
            wanted = loop(BRICK, e, t, [SE3.identity(), FLIP])
            assert (spaces[i, j], pixels[i, j]) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_turns_sampled_and_exact(seed: int) -> None:
    """Sampled turns equal the loop; the exact minimum equals that of a fine search around it."""
    rng = np.random.default_rng(seed)
    truth = pose(rng)
    estimate = near(truth, rng)
    sampled = ModelDistances(VERTICES[CAN], HULLS[CAN], BOTH, 45)
    wanted = loop(CAN, estimate, truth, BOTH.transforms(45))
    project = pinhole(CAMERA)
    found = (
        sampled.mssd([estimate], [truth])[0, 0],
        sampled.mspd([estimate], [truth], project)[0, 0],
    )
    assert found == pytest.approx(wanted, rel=1e-12)
    exact = ModelDistances(VERTICES[CAN], HULLS[CAN], BOTH)
    space, pixel = (
        exact.mssd([estimate], [truth])[0, 0],
        exact.mspd([estimate], [truth], project)[0, 0],
    )
    fine = loop(CAN, estimate, truth, BOTH.transforms(2000))
    assert space <= fine[0] + 1e-12 and pixel <= fine[1] + 1e-9
    assert (space, pixel) == pytest.approx(fine, rel=2e-3)
    rigid = SE3(so3_exp(np.array([0.2, 0.1, 0.3])), truth.t)
    other = near(rigid, rng)
    assert exact.mssd([other], [rigid])[0, 0] == pytest.approx(
        mssd_of_poses(other, rigid, HULLS[CAN], BOTH), rel=1e-6
    )


def test_a_turn_costs_nothing() -> None:
    T = SE3(so3_exp(np.array([1.2, 0.3, 0])), np.array([0.02, 0, 0.6]))
    turned = T @ FLIP @ SE3(so3_exp(np.array([0, 0, 0.7771])), np.zeros(3))
    model = ModelDistances(VERTICES[CAN], HULLS[CAN], BOTH)
    assert model.mssd([turned], [T])[0, 0] < 1e-8
    assert model.mspd([turned], [T], pinhole(CAMERA))[0, 0] < 1e-5
    ball = ModelDistances(
        VERTICES[CAN], HULLS[CAN], Symmetry(continuous=(
            ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)), ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        ))
    )  # fmt: skip
    moved = SE3(so3_exp(np.array([0.1, 2.0, 0.4])), T.t + np.array([0, 0.003, 0.004]))
    assert ball.mssd([moved], [T])[0, 0] == pytest.approx(0.005)


def test_fisheye_against_the_formula() -> None:
    """FISHEYE624 point by point: the angle is the radius, then polynomial, tangential and prism."""
    k = [0.4, -0.5, 0.3, -0.1, 0.02, -0.002]
    p, s = (0.001, -0.002), (0.003, -0.001, 0.002, 0.0005)
    project = fisheye624((600.0, 610.0), [*k, *p, *s])
    for point in ([0.3, -0.2, 1.0], [1.0, 0.5, 0.1], [-0.4, 0.9, -0.05], [0.0, 0.0, 2.0]):
        x, y, z = point
        theta = np.arctan2(np.hypot(x, y), z)
        direction = np.array([x, y]) / max(np.hypot(x, y), 1e-30)
        u, v = direction * (theta + sum(c * theta ** (2 * i + 3) for i, c in enumerate(k)))
        r2 = u * u + v * v
        du = 2 * p[1] * u * v + p[0] * (r2 + 2 * u * u) + s[0] * r2 + s[1] * r2**2
        dv = 2 * p[0] * u * v + p[1] * (r2 + 2 * v * v) + s[2] * r2 + s[3] * r2**2
        found = project(np.array(point)[:, None])[:, 0]
        assert found == pytest.approx([600 * (u + du), 610 * (v + dv)], abs=1e-9)
    with pytest.raises(ToolkitError, match="12 coefficients"):
        fisheye624((600.0, 610.0), k)
