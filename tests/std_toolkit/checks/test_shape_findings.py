"""What the report tells of objects that differ from their meshes: size, place, smallest fault."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from sensors.synthetic import RecordingOptions, scene_from_truth
from sensors.synthetic.recording import textured_meshes
from std_toolkit.arrays import Array
from std_toolkit.checks.gates.judge import judge_scene
from std_toolkit.checks.label_check import LabelCheck
from std_toolkit.checks.measure.contours import LabelCaster
from std_toolkit.checks.measure.motion import MotionEquations
from std_toolkit.checks.measure.object_motion import moved_item
from std_toolkit.checks.measure.residuals import measure_frame
from std_toolkit.checks.measure.shape_map import map_shape
from std_toolkit.checks.measure.shared_errors import SharedErrors
from std_toolkit.checks.result import ObjectCheck, Value
from std_toolkit.checks.shapes import (
    find_shapes,
    significant_size,
    size_sentence,
    smallest_faults,
    with_shapes,
)
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene
from std_toolkit.scene.memory_scene import MemoryScene
from std_toolkit.scene.model import Material

OPTIONS = CheckOptions()
UP = np.array([0.0, 0.0, 1.0])


def an_object(*, size: float = 0.0, texture_mm: float = 0.5) -> ObjectCheck:
    """A row whose contour and texture are where the label is."""

    def at_label(key: str, mm: float, source: str) -> Value:
        covariance = np.diag([mm**2] * 3 + [(mm / 2) ** 2] * 3).ravel().tolist()
        return Value(
            key=key,
            value=0.0,
            unit="mm",
            source=source,  # type: ignore[arg-type]
            motion=[0.0] * 6,
            covariance=covariance,
        )

    return ObjectCheck(
        object=1,
        name="box",
        model="box",
        category="",
        material="diffuse",
        label="propagated",
        values=[
            at_label("motion_mm", 0.5, "contour"),
            at_label("texture_mm", texture_mm, "texture"),
            at_label("pose_mm", 0.4, "judge"),
            Value(key="size_m", value=0.2, unit="m", source="label"),
            Value(key="size_error", value=size, std=0.004, source="contour"),
        ],
    )


def test_a_size_is_told_with_its_deviation() -> None:
    assert size_sentence(an_object(size=0.0204)) == "it is 2.0 % (± 0.4) larger than its mesh"
    assert size_sentence(an_object(size=-0.03)) == "it is 3.0 % (± 0.4) smaller than its mesh"
    assert size_sentence(an_object(size=0.01)) == ""


def test_the_smallest_fault_lies_at_the_limit_and_grows_with_the_deviations() -> None:
    mm, deg = smallest_faults(an_object(), OPTIONS)
    assert mm is not None and deg is not None
    assert 2 < mm < 5 and 1 < deg < 3
    wider = CheckOptions(max_motion_mm=8.0, max_motion_deg=5.0)
    assert smallest_faults(an_object(), wider)[0] > mm + 2  # type: ignore[operator]
    unknown = an_object()
    unknown = ObjectCheck(
        **{f: getattr(unknown, f) for f in unknown.__struct_fields__ if f != "values"}, values=[]
    )
    assert smallest_faults(unknown, OPTIONS) == (None, None)


BOX = np.array(np.meshgrid([-0.08, 0.08], [-0.03, 0.03], [-0.105, 0.105])).reshape(3, -1).T
ANGLES = np.linspace(0, 2 * np.pi, 40, endpoint=False)
CAN = np.concatenate(
    [
        np.stack([0.04 * np.cos(ANGLES), 0.04 * np.sin(ANGLES), h + 0 * ANGLES], axis=1)
        for h in (-0.05, 0.05)
    ]
)
MUG = np.concatenate([CAN, [[0.075, 0, -0.02], [0.075, 0, 0.02]]])
SHAPES = {"box": BOX, "can": CAN, "mug": MUG}


def outlines(
    points: Array, seed: int, *, stretch: Array, rim_px: float = 0.0
) -> list[MotionEquations]:
    """Convex outlines of a mesh in eight frames, and the edges of a stretched object beside them.

    Args:
        points: (N, 3) of the mesh, about its centre.
        seed: of the noise, part of which is alike along 60 px.
        stretch: (3,) sizes of the object along its axes, minus 1.
        rim_px: edges lie so far outside of the whole outline.
    """
    random = np.random.default_rng(seed)
    found = []
    for azimuth in np.linspace(-0.8, 0.8, 8):
        elevation = np.deg2rad(random.uniform(30, 45))
        up = np.array([0.0, 0.0, 1.0])
        turn = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        back = np.cos(elevation) * turn + np.sin(elevation) * up
        right = np.cross(up, back) / np.linalg.norm(np.cross(up, back))
        down = np.cross(right, back)
        depth = 0.65 - points @ back
        image = 600 * np.stack([points @ right, points @ down], axis=1) / depth[:, None]
        corner = ConvexHull(image).vertices
        rows = []
        for a, b in zip(corner, np.roll(corner, -1), strict=True):
            along = image[b] - image[a]
            length = float(np.linalg.norm(along))
            normal = np.array([along[1], -along[0]]) / max(length, 1e-9)
            for part in np.arange(3.0, length, 6.0) / length:
                arm = (1 - part) * points[a] + part * points[b]
                z = 0.65 - arm @ back
                force = 600 / z * (normal[0] * right + normal[1] * down)
                force += (normal @ (600 * np.array([arm @ right, arm @ down]) / z)) / z * back
                rows.append(np.concatenate([force, np.cross(arm, force), [force @ arm]]))
                rows[-1] = np.append(rows[-1], force @ (stretch * arm))
        table = np.array(rows)
        slow = np.repeat(random.normal(0, 0.15, len(table) // 10 + 1), 10)[: len(table)]
        edges = table[:, 7] + rim_px + slow + random.normal(0, 0.3, len(table))
        offsets = np.stack([edges, random.uniform(-15, 15, len(edges))], axis=1)
        arrays = offsets, np.full_like(offsets, 0.7), np.full(len(edges), 0.1), table[:, :7]
        found.append(MotionEquations(*(a.astype(np.float32) for a in arrays), 6.0 * len(edges)))
    return found


def told_size(
    name: str, equations: list[MotionEquations], material: Material = "diffuse"
) -> tuple[float, float]:
    """The size that is claimed, 0 for none, and the standard deviation of it."""
    free = np.zeros((0, 6)) if name != "can" else np.eye(6)[5:]
    shared = SharedErrors.of_material(material, UP)
    row = moved_item(
        msgspec.structs.replace(an_object(), material=material, values=[]),
        equations,
        free,
        OPTIONS,
        axes=np.eye(3),
        shared=shared,
        cameras=(),
    )
    std = row.std("size_error")
    assert std is not None
    return significant_size(row), std


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("name", "percent"), [("box", -2), ("box", 2), ("can", 4), ("mug", -4), ("mug", 4)]
)
def test_a_wrong_scale_is_claimed(name: str, percent: int, seed: int) -> None:
    size, std = told_size(name, outlines(SHAPES[name], seed, stretch=np.full(3, percent / 100)))
    assert size != 0 and abs(size - percent / 100) < 2.5 * std


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", sorted(SHAPES))
def test_a_shade_or_another_shape_is_no_scale(name: str, seed: int) -> None:
    """The bounds hold whatever is the reason of the edges."""
    for material, stretch, rim_px in (
        ("diffuse", [0, 0, 0], 0.0),
        ("diffuse", [0, 0, 0], -0.5),
        ("raw", [0, 0, 0], -1.0),
        ("raw", [0, 0, 0], 1.0),
        ("diffuse", [0, 0, 0.03], 0.0),
        ("diffuse", [0.02, -0.02, 0], 0.0),
    ):
        seen = outlines(SHAPES[name], seed, stretch=np.array(stretch), rim_px=rim_px)
        assert told_size(name, seen, material)[0] == 0, (material, stretch, rim_px)


@pytest.fixture(scope="module")
def scene(synthetic_table: Path, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return scene_from_truth(synthetic_table, tmp_path_factory.mktemp("shapes") / "scene")


def with_mesh(
    scene: Scene, name: str, change: Callable[[Array, Array, Array], Array], *, textured: bool
) -> tuple[int, Scene]:
    """The scene with another mesh of an object; (vertices, low, high) -> vertices."""
    item = next(o for o in scene.objects.objects if o.name == name)
    mesh: trimesh.Trimesh = scene.mesh(item.model).copy()
    if textured:
        mesh = textured_meshes(RecordingOptions(frames=9, seed=1))[name].copy()
    low, high = mesh.bounds
    mesh.vertices = change(np.asarray(mesh.vertices), low, high)
    return item.id, MemoryScene(scene, meshes={item.model: mesh})


def scaled(factor: float) -> Callable[[Array, Array, Array], Array]:
    return lambda v, low, high: (low + high) / 2 + factor * (v - (low + high) / 2)


def taller(factor: float) -> Callable[[Array, Array, Array], Array]:
    """Higher on top, the foot where it was."""
    return lambda v, low, _: v * [1, 1, 0] + [0, 0, low[2]] + (v - low) * [0, 0, factor]


@pytest.mark.slow
def test_the_map_says_by_how_much_and_where(scene: Scene) -> None:
    same = {}
    for name in ("mug", "bottle", "glass"):
        i, altered = with_mesh(scene, name, scaled(1.0), textured=False)
        found = map_shape(altered, i, np.zeros(6), altered.registered_frames(), OPTIONS)
        assert found is not None
        same[name] = found
        assert abs(found.largest_mm) < 0.8, name
    # The mug is 84 mm high: its mesh is 2.5 mm too high.
    i, altered = with_mesh(scene, "mug", taller(1.03), textured=False)
    found = map_shape(altered, i, np.zeros(6), altered.registered_frames(), OPTIONS)
    assert found is not None
    assert found.largest_mm == pytest.approx(-2.5, abs=0.7)
    assert found.where == "at its +z side"
    assert found.sentence() == (
        f"it is up to {-found.largest_mm:.1f} mm smaller at its +z side than its mesh"
    )
    # The foot stayed, and what no contour shows is not invented.
    foot = found.points[:, 2] < found.points[:, 2].min() + 0.01
    known = np.isfinite(found.mm)
    assert abs(np.median(found.mm[foot & known])) < 0.6
    assert 0.1 < known.mean() < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("percent", "textured"),
    [
        pytest.param(
            percent,
            textured,
            id=f"{percent}-{'textured' if textured else 'bare'}",
            marks=[] if (percent, textured) in ((-2, False), (3, True)) else pytest.mark.long,
        )
        for percent in (-3, -2, 2, 3)
        for textured in (True, False)
    ],
)
def test_a_mesh_of_the_wrong_scale_is_told_with_its_size(
    scene: Scene, percent: int, textured: bool
) -> None:
    i, altered = with_mesh(scene, "cereal_box", scaled(1 + percent / 100), textured=textured)
    caster = LabelCaster.of_scene(altered)
    observed = [measure_frame(altered, caster, f, OPTIONS, only=[i]) for f in altered.frames]
    report = judge_scene(altered, observed, {}, OPTIONS, up=UP, only=[i])
    item = next(o for o in report.objects if o.object == i)
    size, std = significant_size(item), item.std("size_error")
    wanted = 1 / (1 + percent / 100) - 1
    assert std is not None and std < 0.006
    assert abs(size - wanted) < 2 * std
    found = find_shapes(altered, report, altered.registered_frames(), OPTIONS)[i]
    assert found.map is not None
    # The longest side is 160 mm.
    assert found.map.largest_mm == pytest.approx(80 * wanted, abs=0.8)
    told = with_shapes(report, {i: found})
    row = next(o for o in told.objects if o.object == i)
    assert row.value("shape_mm") == pytest.approx(found.map.largest_mm, abs=0.01)
    warning = next(w for w in told.warnings if "than its mesh" in w.problem)
    word = "larger" if percent < 0 else "smaller"
    assert warning.about == "cereal_box"
    assert warning.problem.startswith(f"{size_sentence(item)}, by up to ")
    assert f" {word} than its mesh" in warning.problem
    assert f"scale its mesh by {1 + size:.3f}" in warning.advice
    assert "std-scan" in warning.advice


@pytest.mark.slow
def test_a_right_mesh_has_no_such_warning(scene: Scene) -> None:
    judged = LabelCheck().judge(scene, [1, 2])
    assert all("than its mesh" not in found.judgement.reason for found in judged.values())
