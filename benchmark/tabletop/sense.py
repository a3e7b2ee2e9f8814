"""The camera above the table: exact views, and depth by the quick model or the simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND, DepthFrame, Instance, Material
from benchmark.tabletop.arrange import Arrangement, TableObject
from benchmark.tabletop.depth_model import degrade, draw_shares
from sensors.physics import PhysicalObject
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.rendering import maps, mesh, raycast, renderer

if TYPE_CHECKING:
    from sensors.simulation.options import QualityName
    from sensors.simulation.world_builder import World

CameraKind = Literal["quick", "simulated"]

CAMERAS: tuple[CameraKind, ...] = ("quick", "simulated")

WIDTH, HEIGHT = 640, 360

# Above the near edge of the working area, looking down at 52 degrees.
EYE, TARGET = (0.0, -0.33, 0.45), (0.0, 0.0, 0.03)

_QUALITY: QualityName = "rough"


@dataclass(frozen=True, eq=False)
class ExactView:
    """A view of the table; the maps have the camera's size.

    Attributes:
        depth: float32 metres, z-depth of the first surface, glass and table included.
        mask: uint8 index of the object, `BACKGROUND` on the table.
        behind: float32 metres, depth of the next object or the table behind the visible object;
            equal to `depth` on the table.
        normals: (h, w, 3) float32 in the camera frame, towards the camera.
    """

    depth: NDArray[np.float32]
    mask: NDArray[np.uint8]
    behind: NDArray[np.float32]
    normals: NDArray[np.float32]


class ExactCamera:
    """A fixed camera above the table, whose plane is z = 0.

    Args:
        camera: camera without distortion.
        T_world_cam: its pose; every pixel must see the plane of the table.
    """

    def __init__(self, camera: Camera, T_world_cam: SE3) -> None:
        self.camera, self.T_world_cam = camera, T_world_cam
        self._renderer = raycast.RaycastRenderer(threads=1)
        self._meshes: dict[tuple[str, float], mesh.RenderMesh] = {}
        down = camera.rays() @ T_world_cam.R[2]
        self.table = (-T_world_cam.t[2] / down).astype(np.float32)

    def observe(self, objects: Sequence[PhysicalObject], poses: Sequence[SE3]) -> ExactView:
        """Render objects at poses T_world_obj."""
        T_cam_world = self.T_world_cam.inverse()
        placed = [
            renderer.PlacedMesh(i + 1, self._mesh(o), T_cam_world @ T)
            for i, (o, T) in enumerate(zip(objects, poses, strict=True))
        ]
        up = T_cam_world.R[:, 2].astype(np.float32)
        depth, behind = self.table.copy(), self.table.copy()
        mask = np.full(depth.shape, BACKGROUND, np.uint8)
        normals = np.broadcast_to(up, (*depth.shape, 3)).copy()
        if not placed:
            return ExactView(depth, mask, behind, normals)
        seen = maps.compose(self._renderer, self.camera, placed)
        on = (seen.index >= 0) & (seen.depth < self.table)
        depth[on], mask[on] = seen.depth[on], seen.index[on].astype(np.uint8)
        normals[on] = maps.surface_maps(self.camera, placed, seen)[1][on]
        for i, outline in enumerate(seen.silhouettes):
            if outline.image is None or outline.image_window is None:
                continue
            place = outline.image_window.slices_in(renderer.image_window(self.camera))
            there = outline.image.depth
            later = (there > 0) & (mask[place] != i) & on[place] & (there < behind[place])
            np.copyto(behind[place], there, where=later)
        return ExactView(depth, mask, behind, normals)

    def _mesh(self, obj: PhysicalObject) -> mesh.RenderMesh:
        key = (obj.asset.id, obj.diagonal_m)
        if key not in self._meshes:
            self._meshes[key] = mesh.RenderMesh.from_arrays(
                obj.asset.vertices * obj.diagonal_m, obj.asset.faces
            )
        return self._meshes[key]


@dataclass(frozen=True, eq=False)
class Observation:
    """A view of the table.

    Attributes:
        frame: colour, measured and true depth, instances by index in the list of objects.
        exact: exact view with the depth behind objects, for pictures.
    """

    frame: DepthFrame
    exact: ExactView


class TableCamera(Protocol):
    """A fixed camera of a round."""

    camera: Camera
    T_world_cam: SE3

    def observe(
        self, objects: Sequence[TableObject], poses: Sequence[SE3], attempt: int, *, color: bool
    ) -> Observation:
        """Capture the table before an attempt; deterministic for objects, poses and attempt.

        Args:
            objects, poses: the remaining objects.
            attempt: seed of the noise.
            color: whether colour is used; otherwise it is a simple shading.
        """
        ...


def camera_pose() -> SE3:
    """Return T_world_cam of the camera above the table."""
    from sensors.viewpoints.views import look_at

    return look_at(EYE, TARGET)


def make_camera(
    kind: str, arrangement: Arrangement, *, parts_cache: Path | None = None
) -> TableCamera:
    """Create the camera of one round.

    Raises:
        ToolkitError: unknown kind.
    """
    if kind == "quick":
        return QuickCamera(arrangement)
    if kind == "simulated":
        return SimulatedCamera(arrangement, parts_cache=parts_cache)
    raise ToolkitError(
        "no such camera", field="--camera", value=kind, hint=f"one of {', '.join(CAMERAS)}"
    )


def materials_of(objects: Sequence[TableObject]) -> dict[int, str]:
    """Return the material class by index in the list."""
    return {k: o.material.material_class for k, o in enumerate(objects)}


def shaded(
    exact: ExactView, glass: Sequence[int] = (), camera: Camera | None = None
) -> NDArray[np.uint8]:
    """Return a plain image (h, w, 3) lit from the camera, for planners that use depth only.

    Args:
        exact: the view.
        glass: indices of objects through which the surface behind is seen, bent by their normals,
            with a bright rim and a highlight.
        camera: of the view; needed for glass.
    """
    light = np.clip(-exact.normals[..., 2], 0.1, 1.0)
    image = np.repeat(np.rint(200 * light)[..., None], 3, axis=2).astype(np.uint8)
    through = np.isin(exact.mask, list(glass))
    if camera is None or not through.any():
        return image
    # What is behind, drawn as of a surface that faces the camera as the table does.
    table = np.median(light[exact.mask == BACKGROUND]) if (exact.mask == BACKGROUND).any() else 0.7
    ground = np.where(through, 200 * table, image[..., 0]).astype(np.float32)
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float32)
    bend = _BEND_PX * (1 - light)
    shifted = cv2.remap(
        ground,
        (u + bend * exact.normals[..., 0]).astype(np.float32),
        (v + bend * exact.normals[..., 1]).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REFLECT,
    )
    slant = 1 - light
    shine = np.clip((exact.normals @ _SHINE.astype(np.float32) - 0.97) / 0.03, 0, 1)
    seen = shifted * (1 - 0.6 * slant**2) + 130 * slant**4 + 120 * shine
    tint = np.clip(seen[..., None] * _GLASS, 0, 255).astype(np.uint8)
    return np.where(through[..., None], tint, image)


# Glass in plain views: how far it bends, its tint, and where light is mirrored, camera frame.
_BEND_PX = 24.0
_GLASS = np.array([0.94, 0.98, 1.0])
_SHINE = np.array([-0.5, -0.6, -0.62]) / np.linalg.norm([-0.5, -0.6, -0.62])


class QuickCamera:
    """Exact depth degraded by the fitted model; colour by the path tracer of `sensors`.

    The fraction of an object that is measured is sampled once per round, the patches for each view.
    """

    def __init__(self, arrangement: Arrangement) -> None:
        self._scenery = Scenery(arrangement)
        self._exact = ExactCamera(self._scenery.camera, self._scenery.T_world_cam)
        self.camera, self.T_world_cam = self._exact.camera, self._exact.T_world_cam
        rng = np.random.default_rng([arrangement.seed, 10])
        self._shares = {
            o.number: draw_shares(o.material.material_class, rng) for o in arrangement.objects
        }

    def observe(
        self, objects: Sequence[TableObject], poses: Sequence[SE3], attempt: int, *, color: bool
    ) -> Observation:
        """See `TableCamera`."""
        exact = self._exact.observe([o.body for o in objects], poses)
        measured = degrade(
            exact.depth, exact.mask, exact.behind, materials_of(objects), self.camera,
            rng=np.random.default_rng([self._scenery.seed, 11, attempt]),
            shares={k: self._shares[o.number] for k, o in enumerate(objects)},
        )  # fmt: skip
        if color:
            image = self._scenery.color(objects, poses, attempt)
        else:
            kinds = materials_of(objects).items()
            glass = [k for k, kind in kinds if kind == "transparent"]
            image = shaded(exact, glass, self.camera)
        return Observation(_frame(objects, image, measured, exact, self.camera, attempt), exact)


class SimulatedCamera:
    """The depth camera of `std-sim`: infrared pair, stereo matching, path-traced colour."""

    def __init__(self, arrangement: Arrangement, *, parts_cache: Path | None = None) -> None:
        from sensors.simulation.simulator import Simulator

        self._scenery = Scenery(arrangement)
        self._exact = ExactCamera(self._scenery.camera, self._scenery.T_world_cam)
        self.camera, self.T_world_cam = self._exact.camera, self._exact.T_world_cam
        self._simulator = Simulator(self._scenery.options, parts_cache=parts_cache, threads=1)

    def observe(
        self,
        objects: Sequence[TableObject],
        poses: Sequence[SE3],
        attempt: int,
        *,
        color: bool,  # noqa: ARG002 - it comes with the simulation
    ) -> Observation:
        """See `TableCamera`."""
        exact = self._exact.observe([o.body for o in objects], poses)
        world = self._scenery.world(objects, poses, attempt)
        seen = next(iter(self._simulator.frames(world)))
        return Observation(
            _frame(objects, seen.color, seen.depth_aligned, exact, self.camera, attempt), exact
        )


class Scenery:
    """Floor and light of a round, and its objects in the format of the simulator."""

    def __init__(self, arrangement: Arrangement) -> None:
        from sensors.lighting.environment_sources import environment_source
        from sensors.lighting.light_draw import draw_floor, draw_lighting
        from sensors.simulation.options import SimulationOptions
        from sensors.specs import load_sensor

        self.seed = arrangement.seed
        self.options = SimulationOptions(
            views=1, width=WIDTH, height=HEIGHT, min_objects=1, quality=_QUALITY, split="test"
        )
        self.camera = load_sensor(self.options.sensor).color_camera(WIDTH, HEIGHT)
        self.T_world_cam = camera_pose()
        rng = np.random.default_rng([self.seed, 12])
        self._floor = draw_floor(rng, split="test")
        self._environment = environment_source(None, split="test").draw(rng)
        self._light = draw_lighting(rng, self._environment.name)
        self._renderer: Any = None

    def world(self, objects: Sequence[TableObject], poses: Sequence[SE3], attempt: int) -> World:
        """Return the remaining objects as a world of the simulator."""
        from sensors.simulation.scene_draw import ObjectDraw, SceneDraw
        from sensors.simulation.world_builder import build_world

        draw = SceneDraw(
            seed=int(np.random.default_rng([self.seed, 13, attempt]).integers(2**31)),
            objects=[
                ObjectDraw(
                    instance=k,
                    asset=o.body.asset.id,
                    category=o.body.asset.category,
                    diagonal_m=o.body.diagonal_m,
                    material=o.material,
                )
                for k, o in enumerate(objects, start=1)
            ],
            floors=[self._floor],
            light=[self._light],
        )
        world = build_world(
            "round", draw, [o.body.asset for o in objects], [self._environment], self.options,
            sensor=self.options.sensor, poses=poses,
        )  # fmt: skip
        return replace(world, T_world_cam=(self.T_world_cam,))

    def color(
        self, objects: Sequence[TableObject], poses: Sequence[SE3], attempt: int
    ) -> NDArray[np.uint8]:
        """Render colour (h, w, 3) by path tracing with few paths, denoised."""
        from sensors.render.color_image import denoise, develop
        from sensors.render.sim_renderer import SIM_RENDERERS, quality_of

        if self._renderer is None:
            self._renderer = SIM_RENDERERS.get("mitsuba")(threads=1)
        world = self.world(objects, poses, attempt)
        light = self._renderer.load(world.scene).color(
            self.camera, self.T_world_cam, ambient=self._light.color_strength,
            options=quality_of(_QUALITY).color, seed=world.draw.seed,
        )  # fmt: skip
        rng = np.random.default_rng([self.seed, 14, attempt])
        return develop(denoise(light, threads=1), rng=rng)[0]


def _frame(
    objects: Sequence[TableObject],
    color: NDArray[np.uint8],
    measured: NDArray[np.float32],
    exact: ExactView,
    camera: Camera,
    attempt: int,
) -> DepthFrame:
    kinds: Mapping[str, Material] = {m.name.lower(): m for m in Material}
    return DepthFrame(
        scene="table",
        name=f"{attempt:02d}",
        color=color,
        depth_raw=measured,
        depth_true=exact.depth,
        mask=exact.mask,
        camera=camera,
        instances=tuple(
            Instance(
                mask_id=k,
                class_id=o.body.asset.class_id,
                material=kinds[o.material.material_class],
                category=o.body.asset.category,
                model=o.body.asset.id,
            )
            for k, o in enumerate(objects)
        ),
    )
