"""Surfaces of known material at a known distance, measured by the simulated depth camera.

Random scenes mix distance, slope and occlusion with the effect of a material. Here a board of tiles
faces the camera, or vessels of one size class stand on a floor in front of it. `perf/realism.py`
prints the statistics; a test checks their bounds.

`measurable_pixels` selects pixels visible to both infrared cameras and away from depth steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from sensors.assets import draw_diagonal, open_source
from sensors.depth_models.stereo import with_noise
from sensors.lighting.environment_sources import StudioSource
from sensors.lighting.light_draw import PROJECTOR_POWER, draw_floor, draw_lighting
from sensors.materials.material_draw import DrawnMaterial, draw_material
from sensors.materials.material_library import MaterialClass, load_library
from sensors.pattern import make_pattern
from sensors.render import infrared_image, sim_renderer, sim_scene
from sensors.specs import SensorSpec, load_sensor
from sensors.stereo import disparity_to_depth, make_matcher
from std_toolkit.geometry import SE3, Camera

SENSOR = load_sensor("d415")
CAMERA = SENSOR.infrared_camera(640, 360)
DISTANCE_M = 0.6

TILT_DEG = 10.0

VESSELS = ("bottle", "bowl", "mug")

_COLUMNS, _SPACING_M = 3, (0.24, 0.22)

_ELEVATION_DEG = 50.0

# Half the local matcher's window: costs summed over 9 pixels, each with a radius of 3.
WINDOW_PX = 7
# Difference in disparity between two surfaces within a window.
STEP_PX = 1.5
_OCCLUDED_PX = 1.0


@dataclass(frozen=True, eq=False)
class TrialScene:
    """A scene and the pose of the left infrared camera.

    Attributes:
        materials: of the instances 1, 2, ...
    """

    scene: sim_scene.SimScene
    T_world_ir: SE3
    materials: tuple[DrawnMaterial, ...]


@dataclass(frozen=True, eq=False)
class TrialView:
    """Measurement of a trial scene.

    Attributes:
        left, right: (h, w) uint8 infrared.
        depth, exact: (h, w) float32 metres in the left camera, 0 = none.
        mask: (h, w) uint8 instances, 0 = floor.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    depth: NDArray[np.float32]
    exact: NDArray[np.float32]
    mask: NDArray[np.uint8]


def tiles(camera: Camera, seed: int, *, material_class: MaterialClass = "diffuse") -> TrialScene:
    """A slightly tilted board that fills the view at 0.6 m, with one tile per material.

    Args:
        camera: left infrared camera.
        seed: of tilt, colours and jitter.
    """
    rng = np.random.default_rng([seed, 0])
    names = [m.name for m in load_library().of_class(material_class)]
    columns = int(np.ceil(np.sqrt(len(names) * camera.width / camera.height)))
    rows = int(np.ceil(len(names) / columns))
    # A quarter larger than the view, so that no corner of a tilted board is visible.
    size = 1.25 * DISTANCE_M * np.array([camera.width / camera.fx, camera.height / camera.fy])
    w, h = size / (columns, rows)
    square = sim_scene.SurfaceMesh(
        np.array([[-w, -h, 0], [w, -h, 0], [w, h, 0], [-w, h, 0]]) / 2,
        np.array([[0, 1, 2], [0, 2, 3]]),
    )
    order = rng.permutation(columns * rows)
    materials = [draw_material(rng, material_class, name=name) for name in names]
    objects = []
    for place in range(columns * rows):
        # With more places than materials, the sequence of materials repeats.
        index = int(order[place]) % len(names)
        at = (np.array([place % columns, place // columns]) + 0.5) * (w, h) - size / 2
        pose = SE3(np.eye(3), np.array([*at, 0.0]))
        objects.append(
            sim_scene.SceneObject(place + 1, square, pose, materials[index], color=_own_color(rng))
        )
    tilt = np.deg2rad(rng.uniform(-TILT_DEG, TILT_DEG, 2))
    T_board_cam = SE3.exp([0, 0, 0, *tilt, 0]) @ _above(DISTANCE_M)
    placed = tuple(item.material for item in objects)
    return TrialScene(
        sim_scene.SimScene(tuple(objects), StudioSource().draw(rng)), T_board_cam, placed
    )


def vessels(
    materials: Sequence[tuple[MaterialClass, str, str]],
    seed: int,
    *,
    floor: str | None = None,
    lying: bool = False,
    distance_m: float = DISTANCE_M,
    elevation_deg: float = _ELEVATION_DEG,
) -> TrialScene:
    """Vessels in two rows on a floor.

    Args:
        materials: class and name of each vessel's material, and its category.
        seed: of shapes, sizes, floor and jitter.
        floor: name of the floor's material; None: a random one.
        lying: on their sides instead of upright.
        distance_m: of the camera from their middle.
        elevation_deg: of the camera.
    """
    rng = np.random.default_rng([seed, 1])
    source = open_source("procedural")
    h = 3.0
    ground = sim_scene.SurfaceMesh(
        np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    drawn = draw_floor(rng).material if floor is None else draw_material(rng, "diffuse", name=floor)
    drawn = msgspec.structs.replace(drawn, own_share=0)
    objects = [sim_scene.SceneObject(0, ground, SE3.identity(), drawn)]
    # Assets have y up, the world z.
    turn = np.eye(3) if lying else np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    up = 2 if lying else 1
    rows = int(np.ceil(len(materials) / _COLUMNS))
    for i, (material_class, name, category) in enumerate(materials):
        asset = source.sample(rng, category)
        vertices = asset.vertices * draw_diagonal(rng, asset)
        place = np.array([i % _COLUMNS, i // _COLUMNS]) - (np.array([_COLUMNS, rows]) - 1) / 2
        at = np.array([*(place * _SPACING_M), -float(vertices[:, up].min())])
        objects.append(
            sim_scene.SceneObject(
                i + 1,
                sim_scene.SurfaceMesh(vertices, asset.faces),
                SE3(turn, at),
                draw_material(rng, material_class, name=name),
                color=_own_color(rng),
            )
        )
    away = SE3.exp([0, 0, 0, np.deg2rad(90 - elevation_deg), 0, 0]) @ _above(distance_m)
    T_world_ir = SE3(np.eye(3), np.array([0, 0, 0.05])) @ away
    scene = sim_scene.SimScene(
        tuple(objects), StudioSource().draw(rng), float(rng.uniform(0, 2 * np.pi))
    )
    return TrialScene(scene, T_world_ir, tuple(item.material for item in objects[1:]))


def render_view(
    trial: TrialScene,
    spec: SensorSpec,
    camera: Camera,
    renderer: sim_renderer.SimRenderer,
    *,
    options: sim_renderer.RenderOptions,
    seed: int,
) -> TrialView:
    """Render the pair, match it, and cast the exact depth.

    Args:
        spec: sensor with a projector.
        camera: its left infrared camera, or one for a crop of its image.
        seed: of pattern, light and noise.

    Raises:
        ToolkitError: the sensor has no projector.
    """
    pattern = make_pattern(spec, seed=seed)
    assert spec.projector is not None  # its pattern would have been refused
    rng = np.random.default_rng([seed, 2])
    light = draw_lighting(rng, trial.scene.environment.name)
    T = trial.T_world_ir
    projector = sim_scene.Projector(
        pattern.image,
        pattern.fov_x_deg,
        T @ spec.projector.T_ir_projector,
        power=PROJECTOR_POWER * light.projector_factor,
    )
    loaded = renderer.load(trial.scene)
    T_left_right = SE3(np.eye(3), np.array([spec.baseline_m, 0.0, 0.0]))
    pair = [
        loaded.infrared(
            camera,
            eye,
            projector,
            ambient=light.infrared_strength,
            options=options,
            seed=2 * seed + i,
        )
        for i, eye in enumerate((T, T @ T_left_right))
    ]
    whole = spec.infrared_camera(640, 360)
    response = infrared_image.InfraredResponse(
        blur_px=infrared_image.BLUR_SHARE * whole.width * camera.fx / whole.fx
    )
    left, right, _ = infrared_image.expose_pair(*pair, rng=rng, response=response)
    low, high = spec.disparity_range(whole.width, whole.height)
    matcher = make_matcher("local", min_disparity=low, max_disparity=high)
    depth = disparity_to_depth(
        with_noise(matcher.match(left, right), rng),
        focal_px=camera.fx,
        baseline_m=spec.baseline_m,
        range_m=(spec.depth.range_m[0], spec.depth.range_m[1]),
    )
    maps = sim_scene.TruthCaster(trial.scene).maps(camera, T)
    return TrialView(left, right, depth, maps.depth, maps.mask)


def _own_color(rng: np.random.Generator) -> tuple[float, float, float]:
    r, g, b = (float(x) for x in rng.uniform(0.05, 0.8, 3))
    return r, g, b


def _above(height_m: float) -> SE3:
    return SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, height_m]))


def small_holes(missing: NDArray[np.bool_], *, largest: int = 80) -> NDArray[np.bool_]:
    """Pixels of holes smaller than `largest` pixels.

    Real D4xx cameras have 0.2 to 0.7 % of all pixels of 640x360 in such holes.

    Args:
        missing: (h, w) bool, pixels without a measurement.
    """
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(
        missing.astype(np.uint8), connectivity=4
    )
    small = statistics[:, cv2.CC_STAT_AREA] < largest
    small[0] = False  # the measured pixels
    return np.asarray(small[labels])


def measurable_pixels(
    exact: NDArray[np.floating], *, focal_px: float, baseline_m: float
) -> NDArray[np.bool_]:
    """Pixels whose whole window is on one surface that both cameras see.

    Args:
        exact: (h, w) true z-depth in the left camera, metres, 0 = none.

    Returns:
        (h, w) bool. False at the left edge that the right camera does not see, in the shadows
        beside near objects, and at their borders.
    """
    known = exact > 0
    disparity = np.zeros(exact.shape, np.float32)
    np.divide(focal_px * baseline_m, exact, out=disparity, where=known, casting="unsafe")
    column = np.arange(exact.shape[1], dtype=np.float32)
    in_right = column - disparity
    # A nearer object further right projects to the same column, or left of it, in the right image.
    nearest = np.minimum.accumulate(in_right[:, ::-1], axis=1)[:, ::-1]
    hidden = known & (in_right - nearest > _OCCLUDED_PX)
    window = np.ones((2 * WINDOW_PX + 1, 2 * WINDOW_PX + 1), np.uint8)
    small = np.ones((3, 3), np.uint8)
    # Over three pixels even a steep slope changes little, but a step by its whole height.
    step = cv2.dilate(disparity, small) - cv2.erode(disparity, small) > STEP_PX
    mixed = cv2.dilate((step | hidden).astype(np.uint8), window) > 0
    return np.asarray(known & (in_right >= WINDOW_PX) & ~mixed)
