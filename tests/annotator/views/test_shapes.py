"""What is drawn of a mesh: the light one, silhouettes, sections, rays."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from vtkmodules.util.numpy_support import vtk_to_numpy

from annotator.app.placing import front_rotation
from annotator.views import meshes
from annotator.views.meshes import LIGHT_FACES, Shape, ShapeStore
from annotator.views.triangles import SECTIONS
from std_toolkit.errors import ToolkitError
from std_toolkit.scene import Model


def make_shape(mesh: trimesh.Trimesh) -> Shape:
    """A complete shape."""
    shape = meshes.make_shape(mesh)
    shape.complete()
    return shape


def bumpy(count: int = 160) -> trimesh.Trimesh:
    """A closed solid of about count * count * 2 faces."""
    mesh = trimesh.creation.uv_sphere(radius=0.06, count=[count, count])
    points = np.asarray(mesh.vertices)
    points = points * (1 + 0.1 * np.sin(80 * points[:, [1, 2, 0]]))
    return trimesh.Trimesh(points, mesh.faces, process=False)


def points_of(polydata: object) -> NDArray[np.float64]:
    return vtk_to_numpy(polydata.GetPoints().GetData()).astype(float)  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def shape() -> object:
    return make_shape(bumpy())


def test_the_full_mesh_keeps_its_faces_in_order() -> None:
    mesh = trimesh.creation.cylinder(0.03, 0.1)  # with creases, where vertices are doubled
    vertices, faces = make_shape(mesh).full.corners
    assert vertices[faces] == pytest.approx(np.asarray(mesh.vertices)[mesh.faces], abs=1e-8)


def test_the_light_mesh_is_small_and_close(shape: object) -> None:
    assert shape.full.faces > 50_000  # type: ignore[attr-defined]
    assert 0.5 * LIGHT_FACES < shape.light.faces <= LIGHT_FACES  # type: ignore[attr-defined]
    full, light = points_of(shape.full.polydata), points_of(shape.light.polydata)  # type: ignore[attr-defined]
    # In a view of 1000 px of 0.6 m a pixel is 0.6 mm; its vertices lie 0.8 mm apart.
    assert cKDTree(full).query(light)[0].max() < 1e-3
    vertices, faces = shape.light.corners  # type: ignore[attr-defined]
    dense, _ = trimesh.sample.sample_surface(
        trimesh.Trimesh(vertices, faces, process=False), 50_000, seed=0
    )
    assert cKDTree(dense).query(full)[0].max() < 2.5e-3  # of samples 1 mm apart


def test_the_light_mesh_of_separate_faces_has_no_cracks() -> None:
    """Texture seams and creases double vertices; a crack would show in the silhouette."""
    mesh = bumpy(100)
    loose = trimesh.Trimesh(
        mesh.vertices[mesh.faces].reshape(-1, 3),
        np.arange(3 * len(mesh.faces)).reshape(-1, 3),
        process=False,
    )
    shape = make_shape(loose)
    assert shape.light.faces < shape.full.faces
    _, faces = shape.light.edges
    assert (faces[:, 1] < 0).mean() < 0.002
    silhouette = shape.light.silhouette(np.array([0.0, 0.0, 0.5]))
    closed = make_shape(mesh).light.silhouette(np.array([0.0, 0.0, 0.5]))
    assert len(silhouette) < 1.5 * len(closed)


def test_a_small_mesh_is_its_own_light_mesh() -> None:
    shape = make_shape(trimesh.creation.box((0.1, 0.1, 0.1)))
    assert shape.light.faces == shape.full.faces == 12


def test_a_silhouette_is_closed(shape: object) -> None:
    ends = shape.full.silhouette(np.array([0.1, 0.3, 0.5]))  # type: ignore[attr-defined]
    _, count = np.unique(ends.reshape(-1, 3).round(9), axis=0, return_counts=True)
    assert len(ends) > 100
    # Every vertex on it is left as often as it is entered.
    assert (count % 2 == 0).all()


def test_a_box_seen_from_its_front_has_four_silhouette_edges() -> None:
    shape = make_shape(trimesh.creation.box((0.2, 0.1, 0.06)))
    ends = shape.full.silhouette(np.array([0.0, 0.0, 1.0]))
    assert len(ends) == 4
    assert np.unique(ends.reshape(-1, 3)[:, 2].round(6)) == pytest.approx([0.03])


def test_borders_belong_to_the_silhouette() -> None:
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    assert len(make_shape(sheet).full.silhouette(np.array([0.3, 0.3, 1.0]))) == 4


def test_creases_of_a_box_are_its_edges() -> None:
    ends = make_shape(trimesh.creation.box((0.2, 0.1, 0.06))).full.creases()
    assert len(ends) == 12
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert list(np.unique(lengths.round(6))) == pytest.approx([0.06, 0.1, 0.2])


def test_a_wireframe_lies_on_the_surface() -> None:
    radius = 0.05
    shape = make_shape(trimesh.creation.icosphere(4, radius))
    distance = np.linalg.norm(points_of(shape.wire), axis=1)
    assert distance.max() <= radius + 1e-6
    assert distance.min() > 0.998 * radius
    # Sections across each axis, none of them at the very ends.
    assert len(np.unique(points_of(shape.wire).round(4)[:, 0])) > 2 * SECTIONS


def test_a_ray_hits_the_front_exactly() -> None:
    shape = make_shape(trimesh.creation.box((0.2, 0.1, 0.06)))
    hit = shape.hit(np.array([0.01, 0.02, 1.0]), np.array([0.0, 0.0, -2.0]))
    assert hit is not None
    assert hit[0] == pytest.approx((1 - 0.03) / 2)
    assert hit[1] == pytest.approx([0.01, 0.02, 0.03])


@pytest.mark.parametrize(
    ("origin", "direction"),
    [([0.5, 0, 1.0], [0, 0, -1.0]), ([0, 0, 1.0], [0, 0, 1.0])],
    ids=["beside", "away"],
)
def test_a_ray_that_misses_hits_nothing(origin: list[float], direction: list[float]) -> None:
    shape = make_shape(trimesh.creation.box((0.2, 0.1, 0.06)))
    assert shape.hit(np.array(origin), np.array(direction)) is None


def a_model(size: float = 0.1, **fields: object) -> Model:
    return Model(id="a", mesh="models/a/a.ply", size_m=[size] * 3, diameter_m=size, **fields)  # type: ignore[arg-type]


class TestStore:
    def test_a_shape_is_made_once_for_all_views(self) -> None:
        asked = []
        store = ShapeStore(lambda m: asked.append(m) or bumpy(20))
        model = a_model()
        assert store.get(model) is store.get(model) is not None
        assert asked == ["a"]

    def test_another_mesh_of_the_same_id_is_another_shape(self) -> None:
        mesh = trimesh.creation.box((0.1, 0.1, 0.1))
        store = ShapeStore(lambda _: mesh)
        first = store.get(a_model())
        mesh = trimesh.creation.box((0.01, 0.01, 0.01))
        second = store.get(a_model(0.01))
        assert first is not None and second is not None
        assert second.bounds[1] == pytest.approx([0.005] * 3)
        # Turned the other way round it has the same size.
        mesh = trimesh.creation.box((0.01, 0.01, 0.01))
        assert store.get(a_model(0.01)) is not second

    def test_another_symmetry_does_not_make_it_anew(self) -> None:
        mesh = bumpy(20)
        store = ShapeStore(lambda _: mesh)
        assert store.get(a_model()) is store.get(a_model(category="mug"))

    def test_an_old_shape_is_not_shown_while_the_new_one_is_made(self) -> None:
        go, mesh = threading.Event(), bumpy(20)
        go.set()

        def read(_: str) -> trimesh.Trimesh:
            assert go.wait(10)
            return mesh

        store = ShapeStore(read, background=True)
        model = a_model()
        store.get(model)
        while store.pending:
            store.collect()
        shape = store.get(model)
        go.clear()
        mesh = bumpy(24)
        # What its document tells alike most likely is the same mesh: nothing flickers.
        assert store.get(a_model(category="mug")) is shape is not None
        assert store.get(a_model(0.2)) is None
        go.set()
        while store.pending:
            store.collect()
        store.close()

    def test_in_the_background_nobody_waits(self) -> None:
        go = threading.Event()

        def mesh(_: str) -> trimesh.Trimesh:
            assert go.wait(10)
            return bumpy(20)

        store = ShapeStore(mesh, background=True)
        model = a_model()
        assert store.get(model) is None and store.pending
        assert not store.collect()
        go.set()
        while not store.collect():
            pass
        shape = store.get(model)
        assert shape is not None and shape.light is shape.full  # it can be drawn
        while store.pending:
            store.collect()
        assert shape.wire.GetNumberOfLines() > 0
        store.close()

    def test_a_mesh_that_cannot_be_read_is_told_once(self) -> None:
        def mesh(_: str) -> trimesh.Trimesh:
            raise ToolkitError("no faces")

        store = ShapeStore(mesh)
        model = a_model()
        assert store.get(model) is None
        assert list(store.problems()) == ["a"]
        assert store.get(model) is None
        assert store.problems() == {}


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_axis_that_is_up_is_up_on_the_screen(axis: int) -> None:
    R = front_rotation(axis)
    assert np.linalg.det(R) == pytest.approx(1)
    up = R @ np.eye(3)[axis]
    assert up[0] == pytest.approx(0, abs=1e-12) and up[1] < -0.8
    assert up[2] < 0  # its upper side turned to the eye


@pytest.mark.parametrize(("axis", "front"), [(2, [0, -1, 0]), (1, [0, 0, 1])])
def test_its_front_and_its_x_side_are_seen(axis: int, front: list[int]) -> None:
    """A mug whose handle points along x shows it."""
    R = front_rotation(axis)
    assert (R @ front)[2] < -0.5
    assert (R @ [1, 0, 0])[0] > 0.5 and (R @ [1, 0, 0])[2] < 0
