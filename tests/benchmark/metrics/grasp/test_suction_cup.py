"""Where a suction cup seals, and what it holds: spheres, cylinders, steps, forces."""

import math

import numpy as np
import pytest
import trimesh

from benchmark.metrics.grasp.suction import SuctionCup, ring_stretch, seal_at
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.se3 import SE3, so3_exp

CUP = SuctionCup()
DOWN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


def _seal(*meshes, tip=(0.0, 0.0, 0.0), R=DOWN, cup=CUP):
    caster = RayCaster(threads=1)
    for mesh in meshes:
        caster.add(mesh.vertices, mesh.faces)
    return seal_at(caster, SE3(R, np.array(tip, float)), cup)


def _slab(width=0.2, x=0.0, top=0.0):
    box = trimesh.creation.box((width, 0.2, 0.02))
    box.apply_translation([x, 0, top - 0.01])
    return box


def test_a_plane_needs_no_stretch():
    found = _seal(_slab())
    assert found.mesh == 0 and found.stretch < 1e-5 and found.is_tight(CUP)


@pytest.mark.parametrize("radius", [0.012, 0.02, 0.04])
def test_a_sphere_bends_the_cone_alike(radius):
    """All of the ring is on one height of a sphere: no spring changes its length."""
    ball = trimesh.creation.icosphere(5, radius)
    assert _seal(ball, tip=(0, 0, radius)).stretch < 0.01


def test_a_cylinder_stretches_as_its_sagitta_says():
    radius = 0.031
    pipe = trimesh.creation.cylinder(radius, 0.2, sections=720)
    pipe.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 2, [0, 1, 0]))
    found = _seal(pipe, tip=(0, 0, radius))
    angles = 2 * np.pi * np.arange(16) / 16
    along = radius - np.sqrt(radius**2 - (CUP.radius * np.cos(angles)) ** 2)
    assert found.stretch == pytest.approx(ring_stretch(along, CUP), abs=2e-3)
    cone = math.hypot(CUP.radius, CUP.height + along.max() - along.mean())
    assert found.stretch == pytest.approx(cone / math.hypot(0.01, 0.01) - 1, abs=3e-3)
    assert found.is_tight(CUP)
    narrow = trimesh.creation.cylinder(0.0105, 0.2, sections=720)
    narrow.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 2, [0, 1, 0]))
    assert not _seal(narrow, tip=(0, 0, 0.0105)).is_tight(CUP)


def test_a_tilted_cup_seals_up_to_eleven_degrees():
    for degrees, tight in ((8, True), (16, False)):
        tilted = DOWN @ so3_exp([0, np.deg2rad(degrees), 0])
        assert _seal(_slab(), R=tilted).is_tight(CUP) is tight


def test_edges_steps_and_gaps_leak():
    assert not _seal(_slab(0.1, x=0.045)).is_tight(CUP)  # over the edge: the lip is in the air
    step = trimesh.util.concatenate([_slab(0.1, x=-0.05), _slab(0.1, x=0.05, top=0.004)])
    assert not _seal(step).is_tight(CUP)
    # Two objects beside each other are not one surface.
    assert _seal(_slab(0.1, x=-0.05), _slab(0.1, x=0.05)).mesh == -1
    assert _seal(_slab(), tip=(0, 0, 0.05)).mesh == -1


def test_forces_and_torques_have_limits():
    vacuum = math.pi * 0.01**2 * 60e3
    none = np.zeros(3)
    assert CUP.suction == pytest.approx(vacuum)
    assert CUP.holds([-0.99 * vacuum, 0, 0], none)
    assert not CUP.holds([-1.01 * vacuum, 0, 0], none)
    # Shear is friction of what is left of the vacuum.
    assert CUP.holds([-0.5 * vacuum, 0, 0.24 * vacuum], none)
    assert not CUP.holds([-0.5 * vacuum, 0, 0.26 * vacuum], none)
    peel = math.pi * 0.01 * 15.6
    assert CUP.holds(none, [0, 0.99 * peel, 0]) and not CUP.holds(none, [0, 0, 1.01 * peel])
    twist = 0.01 * 0.5 * vacuum
    assert CUP.holds(none, [0.99 * twist, 0, 0]) and not CUP.holds(none, [1.01 * twist, 0, 0])


def test_boxes_follow_the_tip_and_sizes_are_checked():
    boxes = CUP.boxes([0.02], [0.03])
    assert boxes.high[0, 0, 0] == pytest.approx(0.03)
    assert boxes.low[0, 0].tolist() == pytest.approx([0.02, -0.01, -0.01])
    assert SuctionCup(radius=0.0125).name == "suction-12.5mm"
    with pytest.raises(ToolkitError, match="2 to 50 mm"):
        SuctionCup(radius=0.1)
