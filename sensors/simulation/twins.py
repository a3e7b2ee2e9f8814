"""Material twins: a labelled scene rendered again with its own cameras and poses, once a material.

The twins of a frame have the same cameras, object poses, floor, light and noise; only the materials
of the objects differ. OUT/scenes/<twin>/<scene> are toolkit scenes with the frame ids, frame names
and labels of the source: rows of the same scene and frame are twins of each other.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import trimesh

from sensors.assets.mesh_closing import close_mesh
from sensors.materials.material_draw import DrawnMaterial, plain_look
from sensors.output.scene_record import SceneRecord
from sensors.output.simulated_frame import SimulatedFrame, SimulatedObject, SimulatedScene
from sensors.output.toolkit_scene import KeptLabels, MetricObject, read_simulation, toolkit_scene
from sensors.render.sim_scene import SimScene
from sensors.simulation.labelled_scenes import (
    LabelledFrame,
    LabelledScene,
    SceneFolder,
    find_labelled,
)
from sensors.simulation.options import SimulationOptions, TwinName
from sensors.simulation.scene_draw import dress_scene
from sensors.simulation.simulated_set import (
    SceneTimes,
    begin_set,
    check_room,
    parts_cache,
    threads_each,
)
from sensors.simulation.simulator import Simulator
from sensors.simulation.stills import Still, plane_under, stills
from sensors.simulation.turntable_objects import mesh_object
from sensors.simulation.world_builder import World, looks_of
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.mesh import nocs_frame
from std_toolkit.importers.foreign_files import mesh_suffix
from std_toolkit.jobs import JobOptions, JobReport, run_jobs
from std_toolkit.log import logger
from std_toolkit.scene.model import CATEGORY_CLASS_IDS, Labels

# Formats of meshes in scenes that need no other file.
_COPIED = (".ply", ".glb")


def simulate_twins(
    out: Path,
    source: Path,
    twins: Sequence[TwinName],
    options: SimulationOptions,
    *,
    seed: int = 0,
    scenes: int | None = None,
    renderer: str = "mitsuba",
    jobs: JobOptions | None = None,
) -> JobReport[SceneTimes]:
    """Make the missing twins of the scenes of a folder, and check the others.

    Args:
        out: top of the set.
        source: see `find_labelled`.
        twins: materials, one scene each.
        options: of the set; `views` is the largest number of frames of a scene.
        seed: of floor, light and noise, together with the name of a scene.
        scenes: largest number of scenes, the first ones.
        renderer: plug-in.
        jobs: where it runs.

    Raises:
        ToolkitError: another set exists at `out`, there is no labelled scene, or the sensor or the
            renderer cannot be used.
    """
    jobs = jobs or JobOptions()
    # The folder by name: folders move. Each scene knows its source by content.
    options = msgspec.structs.replace(options, scenes_from=source.resolve().name)
    found = find_labelled(source)[:scenes]
    begin_set(out, options, renderer)
    items = [(where, twin) for where in found for twin in twins]
    missing = [item for item in items if not twin_folder(out, *item).is_dir()]
    check_room(out, options, len(missing), ("scene",))
    if kept := len(items) - len(missing):
        logger.info("%d of %d twins are there already", kept, len(items))
    make = partial(
        _make_twin,
        out=out,
        options=options,
        seed=seed,
        renderer=renderer,
        threads=threads_each(jobs, len(missing)),
    )
    return run_jobs(
        make, items, name="twins", key=lambda item: f"{item[1]}/{item[0].name}", options=jobs
    )


def twin_folder(out: Path, where: SceneFolder, twin: TwinName) -> Path:
    """Folder of a twin; it exists exactly when the twin is complete."""
    return out / "scenes" / twin / where.name


def _make_twin(
    item: tuple[SceneFolder, TwinName],
    *,
    out: Path,
    options: SimulationOptions,
    seed: int,
    renderer: str,
    threads: int,
) -> SceneTimes:
    where, twin = item
    folder = twin_folder(out, where, twin)
    labelled = where.read(options.views)
    if folder.is_dir():
        record = read_simulation(folder)
        record.verify(folder)
        _check_source(folder, record, labelled)
        return SceneTimes(frames=0, seconds={})
    simulator = Simulator(
        options,
        renderer=renderer,
        parts_cache=parts_cache(),
        threads=threads,
        color=labelled.frames[0].camera,
    )
    staged = TwinScene(labelled, twin, options, simulator, seed)
    with toolkit_scene(folder, staged.record, kept=staged.kept) as writer:
        for frame in staged.frames():
            with simulator.stopwatch.part("write"):
                writer.add(frame)
    return SceneTimes(frames=len(labelled.frames), seconds=dict(simulator.stopwatch.seconds))


def _check_source(folder: Path, record: SceneRecord, labelled: LabelledScene) -> None:
    if record.parameters.get("twin", {}).get("source_digest") != labelled.digest:
        raise ToolkitError(
            "the labels, cameras or meshes of the source changed since the twin was made",
            path=folder,
            hint="remove the folder of the twin: the same command makes it again",
        )


class TwinScene:
    """One twin of one scene, ready to be rendered.

    Attributes:
        record: of the scene that is written.
        kept: what it keeps of its source.
    """

    def __init__(
        self,
        scene: LabelledScene,
        twin: TwinName,
        options: SimulationOptions,
        simulator: Simulator,
        seed: int,
    ) -> None:
        self._scene, self._simulator = scene, simulator
        number = int.from_bytes(hashlib.blake2b(f"{seed} {scene.name}".encode()).digest()[:4])
        self._draw, self._maps = dress_scene(
            number % 2**31,
            msgspec.structs.replace(options, views=len(scene.frames), order="arc"),
            (),
            simulator.environments,
        )
        self._stills = stills(scene)
        self._placed = [plane_under(scene, still) for still in self._stills]
        meshes = self._closed(twin)
        look = plain_look(twin, number)
        own = plain_look("original", number)
        still_open = {m for m, (_, problem, _) in meshes.items() if problem}
        self._looks: dict[int, DrawnMaterial] = {
            o.id: own if twin == "glass" and o.model in still_open else look for o in scene.objects
        }
        self._meshes = {m: mesh for m, (mesh, *_) in meshes.items()}
        self.record = self._recorded(twin, options)
        self.kept = KeptLabels(
            objects=[self._metric(item, meshes) for item in self.record.objects],
            names={f.id: f.name for f in scene.frames},
            labels=Labels(labels=list(scene.labels.labels)),
            T_cam_obj={f.id: f.T_cam_obj for f in scene.frames},
            poses=scene.poses,
        )

    def frames(self) -> Any:
        """Render the frames, in order."""
        index = 0
        for still, T_plane_own in zip(self._stills, self._placed, strict=True):
            world = self._world(still, T_plane_own, index)
            for made, frame in zip(self._simulator.frames(world), still.frames, strict=True):
                yield _as_filed(made, frame)
            index += len(still.frames)

    def _closed(self, twin: TwinName) -> dict[str, tuple[trimesh.Trimesh, str, int]]:
        """Each mesh as rendered, why it is open ("" if it is closed), and number of its caps."""
        found = {}
        for model in self._scene.models:
            down = [
                -(T_plane_own @ T).R.T[:, 2]
                for still, T_plane_own in zip(self._stills, self._placed, strict=True)
                for o in self._scene.objects
                if o.model == model and (T := still.T_own_obj.get(o.id)) is not None
            ]
            closing = close_mesh(self._scene.meshes[model], down)
            if closing.problem and twin == "glass":
                logger.warning(
                    "%s: %s is not closed (%s) and keeps its own look in the glass twin",
                    self._scene.name, model, closing.problem,
                )  # fmt: skip
            found[model] = closing.mesh, closing.problem, closing.caps
        return found

    def _recorded(self, twin: TwinName, options: SimulationOptions) -> SimulatedScene:
        scene, first = self._scene, self._stills[0]
        objects = []
        canonical: dict[str, tuple[trimesh.Trimesh, Any, float]] = {}
        for o in scene.objects:
            model = scene.models[o.model]
            if o.model not in canonical:
                mesh = self._meshes[o.model]
                centre, diagonal = nocs_frame(mesh)
                bare = trimesh.Trimesh(
                    (np.asarray(mesh.vertices) - centre) / diagonal, mesh.faces, process=False
                )
                canonical[o.model] = bare, centre, diagonal
            bare, centre, diagonal = canonical[o.model]
            T = first.T_own_obj.get(o.id)
            if T is None:  # not labelled in the first frame
                T = next(s.T_own_obj[o.id] for s in self._stills if o.id in s.T_own_obj)
            objects.append(
                SimulatedObject(
                    instance_id=o.id,
                    asset_id=o.model,
                    category=model.category,
                    class_id=CATEGORY_CLASS_IDS.get(model.category, 0),
                    material_class=self._looks[o.id].material_class,
                    scale_m=diagonal,
                    T_world_obj=SE3(T.R, T @ centre),
                    mesh=bare,
                )
            )
        return SimulatedScene(
            name=f"{scene.name}_{twin}",
            seed=self._draw.seed,
            sensor=self._simulator.sensor.name,
            baseline_m=self._simulator.sensor.baseline_m or None,
            frames=len(scene.frames),
            objects=objects,
            indices=tuple(f.id for f in scene.frames),
            parameters={
                "renderer": self._simulator.renderer_name,
                "options": msgspec.to_builtins(options),
                "draw": msgspec.to_builtins(self._draw),
                "twin": {
                    "material": twin,
                    "of": scene.name,
                    "source_digest": scene.digest,
                    "objects": {
                        str(i): msgspec.to_builtins(look) for i, look in self._looks.items()
                    },
                },
            },
        )

    def _metric(
        self, item: SimulatedObject, meshes: dict[str, tuple[trimesh.Trimesh, str, int]]
    ) -> MetricObject:
        scene = self._scene
        obj = next(o for o in scene.objects if o.id == item.instance_id)
        mesh, _, caps = meshes[obj.model]
        file = scene.files.get(obj.model)
        suffix = mesh_suffix(mesh)
        if caps or mesh is not scene.meshes[obj.model] or (file and file.suffix not in _COPIED):
            file = None
        if file is not None:
            suffix = file.suffix
        path = f"models/{obj.model}/{obj.model}{suffix}"
        model = msgspec.structs.replace(scene.models[obj.model], mesh=path)
        return MetricObject(item, obj.name, model, _one_uv(mesh), file)

    def _world(self, still: Still, T_plane_own: SE3, index: int) -> World:
        count = len(still.frames)
        part = slice(index, index + count)
        # A seed for each arrangement: its noise is its own.
        draw = msgspec.structs.replace(
            self._draw,
            seed=self._draw.seed + index,
            floors=self._draw.floors[part],
            light=self._draw.light[part],
        )
        looks = looks_of(draw, self._maps[part])
        models = {o.id: o.model for o in self._scene.objects}
        objects = [
            replace(
                mesh_object(self._meshes[models[i]], self._looks[i], T_plane_own @ T),
                instance_id=i,
            )
            for i, T in sorted(still.T_own_obj.items())
            if i in models
        ]
        scene = SimScene((looks[0].floor, *objects), looks[0].environment, looks[0].rotation_rad)
        cameras = tuple(T_plane_own @ T for T in still.T_own_cam)
        return World(draw, self.record, scene, cameras, looks)


def _one_uv(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with one texture coordinate a vertex, as files other than OBJ have."""
    from std_toolkit.geometry.obj_texture import CORNER_UV

    corners = np.asarray(mesh.face_attributes.get(CORNER_UV, ()))
    if len(corners) != len(mesh.faces):
        return mesh
    visual: Any = mesh.visual
    made = trimesh.Trimesh(
        np.asarray(mesh.vertices)[mesh.faces].reshape(-1, 3),
        np.arange(3 * len(mesh.faces)).reshape(-1, 3),
        process=False,
    )
    made.visual = trimesh.visual.TextureVisuals(uv=corners.reshape(-1, 2), material=visual.material)
    return made


def _as_filed(made: SimulatedFrame, frame: LabelledFrame) -> SimulatedFrame:
    """The frame with its id, in the world of its source."""
    T_world_cam = frame.T_world_cam or SE3.identity()
    T_cam_ir = made.T_world_cam.inverse() @ made.T_world_ir
    return replace(made, index=frame.id, T_world_cam=T_world_cam, T_world_ir=T_world_cam @ T_cam_ir)
