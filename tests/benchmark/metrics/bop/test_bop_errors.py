"""VSD and MSPD in cases that can be worked out."""

from __future__ import annotations

import numpy as np
import pytest
from bop_set import BRICK, CAMERA, CAN, MESHES

from benchmark.metrics.bop import mspd, see, vsd
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Symmetry, so3_exp
from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import image_window

# A square of 0.2 m that faces the camera.
CORNERS = np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]])
SQUARE = RenderMesh.from_arrays(CORNERS, np.array([[0, 1, 2], [0, 2, 3]]))
DRAW = RaycastRenderer()


def at(x: float, y: float, z: float) -> SE3:
    return SE3(np.eye(3), np.array([x, y, z]))


def depth_of(T: SE3) -> np.ndarray:
    everything = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    surface = see(DRAW, CAMERA, SQUARE, T, everything)
    assert surface.window is not None
    rows, columns = np.nonzero(surface.distance)
    everything[rows + surface.window.y, columns + surface.window.x] = T.t[2]
    return everything


def test_a_square_moved_sideways() -> None:
    """60 pixels wide, moved by 20: 40 columns of 80 in common, and there they agree."""
    true, off = at(0, 0, 1), at(20 / 300, 0, 1)
    depth = depth_of(true)
    seen = see(DRAW, CAMERA, SQUARE, true, depth), see(DRAW, CAMERA, SQUARE, off, depth)
    assert seen[0].visible.sum() == 60 * 60
    # The wall behind does not hide the moved square.
    assert vsd(seen[1], seen[0], 0.28) == pytest.approx(np.full(10, 0.5))
    assert (vsd(seen[0], seen[0], 0.28) == 0).all()


def test_a_square_moved_away() -> None:
    """What is hidden at the estimate's pose counts where it is visible at the true one."""
    true, off = at(0, 0, 1), at(0, 0, 1.03)
    depth = depth_of(true)
    a, b = see(DRAW, CAMERA, SQUARE, true, depth), see(DRAW, CAMERA, SQUARE, off, depth)
    assert not b.visible.any()  # 3 cm behind what was measured
    error = vsd(b, a, 0.2, taus=(0.1, 0.2))
    inner = (b.distance > 0).sum() / 3600
    # 3 cm (a little more along slanted rays) of 20: not within a tenth, within a fifth.
    assert error == pytest.approx([1, 1 - inner])


def test_missing_depth_counts_as_visible() -> None:
    true = at(0, 0, 1)
    depth = np.zeros((CAMERA.height, CAMERA.width), np.float32)
    assert see(DRAW, CAMERA, SQUARE, true, depth).visible.sum() == 3600
    depth[:] = 0.9  # something before it
    hidden = see(DRAW, CAMERA, SQUARE, true, depth)
    assert not hidden.visible.any()
    assert (vsd(hidden, hidden, 0.2) == 1).all()


@pytest.mark.parametrize("seed", range(4))
def test_vsd_is_that_of_whole_images(seed: int) -> None:
    """The definition, pixel by pixel over the image, on rendered bricks behind an occluder."""
    rng = np.random.default_rng(seed)
    mesh, window = prepare_mesh(MESHES[BRICK]), image_window(CAMERA)
    true = SE3(so3_exp(rng.normal(0, 1, 3)), np.array([0.02, -0.01, 0.6]))
    off = SE3(true.R @ so3_exp(rng.normal(0, 0.2, 3)), true.t + rng.normal(0, 0.01, 3))
    depth = np.where(DRAW.draw(CAMERA, mesh, true, window=window).depth > 0, 0.55, 1.1)
    depth[:, 170:] = 0.4  # something in front
    depth[100:115, 120:150] = 0  # and no reading
    along = np.linalg.norm(CAMERA.rays(), axis=2)
    drawn = [DRAW.draw(CAMERA, mesh, T, window=window).depth * along for T in (off, true)]
    seen = [d > 0 for d in drawn]
    measured = depth * along
    visible = [
        s & ((measured == 0) | (d - measured <= 0.015)) for d, s in zip(drawn, seen, strict=True)
    ]
    visible[0] |= visible[1] & seen[0]
    either, both = visible[0] | visible[1], visible[0] & visible[1]
    assert 0 < both.sum() < either.sum()
    taus = 0.05 * np.arange(1, 11)
    apart = np.abs(drawn[0] - drawn[1]) / 0.18
    wanted = [((apart >= tau) & both | either & ~both).sum() / either.sum() for tau in taus]
    found = vsd(*(see(DRAW, CAMERA, mesh, T, depth) for T in (off, true)), 0.18)
    assert found == pytest.approx(wanted, abs=1e-12)


def test_out_of_the_image() -> None:
    depth = np.zeros((CAMERA.height, CAMERA.width), np.float32)
    outside = see(DRAW, CAMERA, SQUARE, at(5, 0, 1), depth)
    assert outside.window is None
    assert (vsd(outside, see(DRAW, CAMERA, SQUARE, at(0, 0, 1), depth), 0.2) == 1).all()
    with pytest.raises(ToolkitError, match="camera's size"):
        see(DRAW, CAMERA, SQUARE, at(0, 0, 1), depth.T)
    with pytest.raises(ToolkitError, match="diameter_m"):
        vsd(outside, outside, 0)


def test_projection_distance_against_a_plain_loop() -> None:
    vertices = np.asarray(MESHES[BRICK].vertices)
    true = SE3(so3_exp(np.array([0.4, 0.7, 0.1])), np.array([0.05, 0.02, 0.6]))
    off = SE3(so3_exp(np.array([0.45, 0.6, 0.2])), np.array([0.06, 0.02, 0.63]))
    half = SE3(so3_exp(np.array([0, 0, np.pi])), np.zeros(3))
    symmetry = Symmetry(discrete=(tuple(half.matrix().ravel()),))
    best = np.inf
    for S in (SE3.identity(), half):
        worst = 0.0
        for v in vertices:
            a, b = CAMERA.project(off @ v), CAMERA.project(true @ (S @ v))
            worst = max(worst, float(np.linalg.norm(a - b)))
        best = min(best, worst)
    assert mspd(off, true, vertices, CAMERA, symmetry) == pytest.approx(best, abs=1e-9)
    assert mspd(off @ half, true, vertices, CAMERA, symmetry) == pytest.approx(best, abs=1e-9)
    assert mspd(off @ half, true, vertices, CAMERA) > 2 * best


def test_turns_of_a_can() -> None:
    vertices = np.asarray(prepare_mesh(MESHES[CAN]).vertices)
    round_ = Symmetry(continuous=(((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),))
    true = SE3(so3_exp(np.array([1.2, 0, 0])), np.array([0, 0, 0.6]))
    turned = true @ SE3(so3_exp(np.array([0, 0, 0.777])), np.zeros(3))
    # At most half a step of 2 pi / 315 on 4 cm at 54 cm and 300 pixels: 0.22 pixels.
    assert mspd(turned, true, vertices, CAMERA, round_) < 0.23
    assert mspd(turned, true, vertices, CAMERA) > 10


def test_behind_the_camera() -> None:
    assert mspd(at(0, 0, -1), at(0, 0, 1), CORNERS, CAMERA) == np.inf
    assert mspd(at(0, 0, 1), at(0, 0, -1), CORNERS, CAMERA) == np.inf
    with pytest.raises(ToolkitError, match="vertices"):
        mspd(at(0, 0, 1), at(0, 0, 1), CORNERS[0], CAMERA)


def test_distances_are_along_the_rays() -> None:
    """A square at z = 1 m is farther away towards its corners: z times the length of the ray."""
    true = at(0.3, 0.2, 1)
    surface = see(DRAW, CAMERA, SQUARE, true, np.zeros((CAMERA.height, CAMERA.width), np.float32))
    assert surface.window is not None
    x0, y0 = surface.window.x, surface.window.y
    rays = CAMERA.rays()[y0 : surface.window.y1, x0 : surface.window.x1]
    hit = surface.distance > 0
    assert hit.any()
    np.testing.assert_allclose(surface.distance[hit], np.linalg.norm(rays, axis=2)[hit], rtol=1e-6)
