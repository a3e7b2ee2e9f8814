"""The antipodal planner on rendered tables: what it grasps can be grasped."""

import numpy as np
import pytest
import trimesh

from benchmark.methods.grasp.antipodal.antipodal import Antipodal
from benchmark.methods.grasp.antipodal.contact_pairs import (
    Pairs,
    antipodal_pairs,
    best_spread,
    round_pairs,
)
from benchmark.methods.grasp.antipodal.hands import unknown_share
from benchmark.methods.grasp.antipodal.surface import find_table
from benchmark.methods.protocol import GraspView
from benchmark.methods.registry import MethodOptions, grasp_planners, make_planner
from benchmark.metrics.grasp.collision import hits_mesh, hits_plane
from benchmark.metrics.grasp.force_closure import GraspedMesh, needed_friction
from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import PANDA
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

CAMERA = Camera(480, 270, 335.0, 335.0, 239.5, 134.5)


def slanted(distance: float = 0.6) -> SE3:
    """T_world_cam of a camera that looks at the origin from 50 degrees above the table."""
    eye = distance * np.array([0, -np.cos(np.radians(50)), np.sin(np.radians(50))])
    z = -eye / np.linalg.norm(eye)
    x = np.array([1.0, 0, 0])
    return SE3(np.stack([x, np.cross(z, x), z], axis=1), eye)


def upright(mesh: trimesh.Trimesh, x: float, y: float) -> trimesh.Trimesh:
    """The mesh on the table, z = 0, at a place."""
    mesh.apply_translation([x, y, -mesh.bounds[0, 2]])
    return mesh


def view_of(meshes: list[trimesh.Trimesh], *, masked: bool = True, told: bool = True) -> GraspView:
    """What the camera truly sees."""
    import open3d as o3d

    table = trimesh.creation.box((1.4, 1.4, 0.1))
    table.apply_translation([0, 0, -0.05])
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    for mesh in [*meshes, table]:
        scene.add_triangles(
            o3d.core.Tensor.from_numpy(mesh.vertices.astype(np.float32)),
            o3d.core.Tensor.from_numpy(mesh.faces.astype(np.uint32)),
        )
    T = slanted()
    directions = CAMERA.rays() @ T.R.T
    rays = np.concatenate([np.broadcast_to(T.t, directions.shape), directions], axis=-1)
    hits = scene.cast_rays(o3d.core.Tensor.from_numpy(rays.astype(np.float32)), nthreads=1)
    depth = hits["t_hit"].numpy()
    depth[~np.isfinite(depth)] = 0
    on_object = hits["geometry_ids"].numpy() < len(meshes)
    return GraspView(
        np.zeros((270, 480, 3), np.uint8),
        depth,
        CAMERA,
        on_object if masked else None,
        T.inverse().matrix() if told else None,
    )


def good(grasps: Grasps, meshes: list[trimesh.Trimesh]) -> np.ndarray:
    """(N,) which grasps, in the camera's frame, hit nothing and hold with friction 0.5.

    The fingers are 18 mm long at their tips; what they touch first is the widest place there.
    """
    world = grasps.transformed(slanted())
    free = ~hits_plane(world, PANDA, np.eye(4))
    least = np.full(len(world), np.inf)
    for mesh in meshes:
        free &= ~hits_mesh(world, PANDA, mesh.vertices, mesh.faces)
        grasped = GraspedMesh(mesh.vertices, mesh.faces)
        widest = np.zeros(len(world))
        need = np.full(len(world), np.inf)
        for back in (0.002, 0.006, 0.01, 0.014, 0.018):
            contacts = grasped.contacts_of(
                world.tips - back * world.approaches, world.closings, world.widths
            )
            width = np.linalg.norm(contacts.points[:, 1] - contacts.points[:, 0], axis=1)
            first = contacts.found & (width > widest + 1e-5)
            widest = np.where(first, width, widest)
            need = np.where(first, needed_friction(contacts), need)
        least = np.minimum(least, need)
    return np.asarray(free & (least < 0.5))


def cup() -> trimesh.Trimesh:
    wall = trimesh.creation.annulus(0.051, 0.055, 0.06, sections=96)
    floor = trimesh.creation.cylinder(0.055, 0.004, sections=96)
    floor.apply_translation([0, 0, -0.03])
    return trimesh.util.concatenate([wall, floor])


SHAPES = {
    "box": lambda: trimesh.creation.box((0.05, 0.09, 0.07)),
    "ball": lambda: trimesh.creation.icosphere(4, 0.032),
    "can": lambda: trimesh.creation.cylinder(0.03, 0.1, sections=96),
    "lying can": lambda: trimesh.creation.cylinder(
        0.028, 0.13, sections=96, transform=trimesh.transformations.rotation_matrix(
            np.pi / 2, [0.3, 1, 0]
        )
    ),
    "cup that is too wide": cup,
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
def test_an_object_alone_is_grasped(name: str) -> None:
    mesh = upright(SHAPES[name](), 0.03, -0.02)
    grasps = Antipodal().plan(view_of([mesh]))
    held = good(grasps, [mesh])
    assert held[0]
    assert held.mean() > 0.5


@pytest.mark.slow
def test_a_crowded_table_has_good_grasps_of_everything() -> None:
    places = [(-0.15, 0.0), (0.0, 0.1), (0.14, 0.08), (0.02, -0.1), (-0.14, 0.16)]
    meshes = [upright(make(), *p) for make, p in zip(SHAPES.values(), places, strict=True)]
    grasps = Antipodal().plan(view_of(meshes, masked=False))
    held = good(grasps, meshes)
    assert held[0] and held.mean() > 0.6
    tips = grasps.transformed(slanted()).tips
    middles = np.array([m.bounds.mean(axis=0) for m in meshes])
    nearest = np.linalg.norm(tips[:, None, :2] - middles[None, :, :2], axis=2).argmin(axis=1)
    assert set(nearest[held].tolist()) == set(range(5))


@pytest.mark.slow
def test_the_same_view_gives_the_same_grasps() -> None:
    view = view_of([upright(SHAPES["can"](), 0, 0), upright(SHAPES["ball"](), 0.12, 0)])
    first, again = (Antipodal().plan(view).to_array() for _ in range(2))
    assert np.array_equal(first, again)
    assert (np.diff(first[:, 0]) <= 0).all()
    other = Antipodal(MethodOptions(settings={"seed": "7"})).plan(view)
    assert not np.array_equal(other.to_array(), first)


@pytest.mark.slow
def test_a_table_that_nobody_told_of_is_found() -> None:
    mesh = upright(SHAPES["can"](), 0, 0)
    view = view_of([mesh], masked=False, told=False)
    T_cam_table = find_table(view.depth, CAMERA, rng=np.random.default_rng(0))
    normal = slanted().R @ T_cam_table.R[:, 2]
    assert np.allclose(normal, [0, 0, 1], atol=1e-3)
    assert abs((slanted() @ T_cam_table.t)[2]) < 1e-3
    grasps = Antipodal().plan(view)
    assert good(grasps, [mesh])[0]


def test_an_empty_table_has_nothing_to_grasp() -> None:
    assert len(Antipodal().plan(view_of([]))) == 0
    blind = view_of([])
    nothing = GraspView(
        blind.color, np.zeros_like(blind.depth), CAMERA, None, slanted().inverse().matrix()
    )
    assert len(Antipodal().plan(nothing)) == 0
    with pytest.raises(ToolkitError, match="table"):
        Antipodal().plan(GraspView(blind.color, np.zeros_like(blind.depth), CAMERA))


@pytest.mark.slow
def test_what_is_too_wide_and_solid_is_left() -> None:
    mesh = upright(trimesh.creation.box((0.12, 0.13, 0.1)), 0, 0)
    assert not good(Antipodal().plan(view_of([mesh])), [mesh]).any()


def test_a_circle_is_found_from_a_part_of_it() -> None:
    # The near half of an upright cylinder, of which the outermost 20 degrees are not seen.
    angles = np.radians(np.linspace(-160, -20, 15))
    heights = np.linspace(0.02, 0.08, 4)
    a, h = np.meshgrid(angles, heights)
    normals = np.stack([np.cos(a), np.sin(a), np.zeros_like(a)], axis=-1).reshape(-1, 3)
    points = 0.03 * normals + np.stack([0 * h, 0 * h, h], axis=-1).reshape(-1, 3)
    pairs = round_pairs(points, normals, widest=0.08)
    assert len(pairs) > 20
    assert np.allclose(pairs.middles[:, :2], 0, atol=1e-9)
    assert np.allclose(pairs.widths, 0.06)
    assert np.allclose(pairs.closings[:, 2], 0, atol=0.9)
    assert not len(round_pairs(points, normals, widest=0.05))


def test_faces_of_a_box_are_pairs_and_corners_are_not() -> None:
    y, z = np.meshgrid(np.linspace(-0.02, 0.02, 5), np.linspace(0, 0.04, 5))
    flat = np.stack([0 * y, y, z], axis=-1).reshape(-1, 3)
    aside = np.array([0.025, 0, 0])
    left, right = flat - aside, flat + aside
    out = np.tile([1.0, 0, 0], (25, 1))
    points, normals = np.concatenate([left, right]), np.concatenate([-out, out])
    pairs = antipodal_pairs(points, normals, widest=0.08, cone=np.cos(np.arctan(0.5)))
    assert len(pairs) > 25
    assert (pairs.widths >= 0.05).all() and (pairs.quality >= 0).all()
    assert pairs.quality.max() == pytest.approx(1)
    assert np.allclose(pairs.middles[:, 0], 0)
    # Turned inwards they are the sides of a gap, which no finger can press apart.
    assert not len(antipodal_pairs(points, -normals, widest=0.08, cone=0.9))
    # Neighbouring faces of a corner look apart by 90 degrees only.
    up = np.tile([0, 0, 1.0], (25, 1))
    assert not len(antipodal_pairs(points, np.concatenate([-out, up]), widest=0.08, cone=0.9))


def test_the_best_pairs_are_spread() -> None:
    # Nine good pairs in one place, three poor ones elsewhere.
    middles = np.concatenate([np.zeros((9, 3)), [[0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0]]])
    pairs = Pairs(middles, np.tile([1.0, 0, 0], (12, 1)), np.full(12, 0.05), np.ones(12))
    score = np.concatenate([np.linspace(1, 0.9, 9), [0.1, 0.2, 0.3]])
    chosen = best_spread(pairs, 4, score)
    assert sorted(chosen.middles[:, 0].tolist()) == [0, 0.1, 0.2, 0.3]


@pytest.mark.slow
def test_planners_are_known_by_name() -> None:
    assert "antipodal" in grasp_planners.names()
    planner = make_planner("antipodal", MethodOptions(settings={"grasps": "3"}))
    assert len(planner.plan(view_of([upright(SHAPES["can"](), 0, 0)]))) <= 3
    for settings, told in (
        ({"gripper": "hand"}, "panda"),
        ({"friction": "nan"}, "between"),
        ({"speed": "1"}, "no such setting"),
    ):
        with pytest.raises(ToolkitError, match=told):
            make_planner("antipodal", MethodOptions(settings=settings))
    with pytest.raises(ToolkitError, match="cannot be made"):
        make_planner("builtins:dict", None)


def test_low_bumps_and_specks_are_no_objects() -> None:
    """8 mm is more than `least_height`, but no object; a tall stick covers too few pixels."""
    bump = upright(trimesh.creation.box((0.06, 0.06, 0.008)), 0.1, 0.0)
    stick = upright(trimesh.creation.box((0.004, 0.004, 0.03)), -0.1, 0.0)
    view = view_of([bump, stick], masked=False)
    assert len(Antipodal().plan(view)) == 0
    tall = upright(trimesh.creation.box((0.05, 0.05, 0.05)), 0.0, 0.1)
    grasps = Antipodal().plan(view_of([bump, stick, tall], masked=False))
    tips = grasps.transformed(slanted()).tips
    assert len(grasps) and (np.linalg.norm(tips[:, :2] - [0.0, 0.1], axis=1) < 0.06).all()


def test_pixels_without_depth_are_unknown() -> None:
    down = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    grasp = Grasps.make(down[None], [[0, 0, 0.05]], widths=0.06, depths=0.02)
    seen = grasp.transformed(slanted().inverse())
    depth = np.full((270, 480), 0.6, np.float32)
    assert unknown_share(seen, PANDA, depth, CAMERA).tolist() == [0.0]
    assert unknown_share(seen, PANDA, 0 * depth, CAMERA).tolist() == [1.0]
    # The fingers are left and right of the middle: one of the two is behind the hole.
    depth[:, :240] = 0
    across = grasp.replaced(rotations=(down @ turned(90))[None]).transformed(slanted().inverse())
    assert unknown_share(across, PANDA, depth, CAMERA)[0] == pytest.approx(0.5, abs=0.05)
    assert len(unknown_share(Grasps.empty(), PANDA, depth, CAMERA)) == 0


def turned(degrees: float) -> np.ndarray:
    """A turn about the approach."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
