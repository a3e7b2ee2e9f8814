"""Ground truth of one frame: composition, occlusion, measurements, storage.

Runs in a worker process. The occlusion policy defines what hides labelled objects besides each
other:

- `models`: nothing. Correct if everything that can occlude is labelled.
- `sensor`: the sensor depth of the frame, by BOP's rule: a pixel is hidden if the sensor measures
  a surface more than delta in front of the object. Missing depth hides nothing. Distances from the
  camera are compared, not z. In front of glass and metal, sensors report false surfaces, which
  this rule treats as occluders.
- `fused`: geometry fused from the sensor depth of many frames, without depth inside the outlines
  of transparent and specular objects (see `occluders.py`); delta as above.

A hidden pixel is background in every map.
"""

import os
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from msgspec.structs import asdict

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.documents import digest_file, digest_of, write_document
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.rendering import choose, ground_truth, maps, mesh, occluders, raycast
from std_toolkit.rendering.ground_truth import (
    FrameTruth,
    ObjectTruth,
    Policy,
    info_path,
    map_paths,
)
from std_toolkit.rendering.placements import frame_inputs, frame_placements, place_meshes
from std_toolkit.rendering.renderer import PlacedMesh, Window, image_window, normalised_rays
from std_toolkit.scene.scene import Scene


@dataclass(frozen=True)
class FrameJob:
    """Parameters shared by all frames of a run. Small, because each item is sent with them.

    Attributes:
        root: scene folder.
        state: digest of the scene's documents and meshes; if it changes, workers reload the scene.
        renderer: name of the chosen renderer.
        policy: resolved occlusion policy.
        delta_m: tolerance of the policies `sensor` and `fused`.
        smooth_normals: see `render_scene_maps`.
        occluder: fused geometry (path and digest of content) for policy `fused`.
        gl: GL platform found by the main process, if the workers run on the same machine.
    """

    root: str
    state: str
    renderer: str
    policy: Policy
    delta_m: float
    smooth_normals: bool
    occluder: tuple[str, str] | None
    gl: str | None


def render_frame(frame_id: int, *, job: FrameJob, force: bool) -> Literal["done", "kept"]:
    """Render the ground truth of a frame unless it exists and is up to date.

    Raises:
        ToolkitError: an input cannot be read, or the frame has no labelled object.
    """
    if job.gl is not None:  # skips the probe in the worker
        os.environ.setdefault(choose.ANSWER_VARIABLE, job.gl)
    scene = _open_scene(job.root, job.state)
    artefact = _artefact(scene, frame_id, job)
    info = info_path(scene.root, frame_id)
    if not force and artefact.find(info, FrameTruth) is not None:
        return "kept"
    # Without this file the frame is unfinished: stale maps are not exported after a failure.
    info.unlink(missing_ok=True)
    frame = scene.frame(frame_id)
    camera = scene.camera(frame)
    placed = place_meshes(scene, frame_placements(scene, frame_id))
    if not placed:
        raise ToolkitError("no labelled object in this frame", path=scene.root, value=frame_id)
    sensor = scene.read_depth(frame)

    composition = maps.compose(choose.get_renderer(job.renderer), camera, placed, canvas=3)
    policy = _possible_policy(scene, frame_id, sensor, job)
    hidden = _hidden(scene, frame_id, composition, sensor, policy, job)
    if hidden is not None:
        composition.depth[hidden] = 0
        composition.index[hidden] = -1
        composition.face[hidden] = -1
    mask = maps.mask_of(composition.index, [p.object_id for p in placed])
    nocs, normals = maps.surface_maps(
        camera, placed, composition, smooth_normals=job.smooth_normals
    )
    rows = [_object_truth(item, composition, i, sensor) for i, item in enumerate(placed)]

    paths = map_paths(scene.root, frame_id)
    ground_truth.write_depth(paths["depth"], composition.depth)
    ground_truth.write_mask(paths["mask"], mask)
    ground_truth.write_nocs(paths["nocs"], nocs, mask)
    ground_truth.write_normals(paths["normals"], normals, mask)
    write_document(
        info,
        FrameTruth(
            **asdict(artefact.record(paths.values())),
            frame=frame_id,
            policy=policy,
            delta_m=None if policy == "models" else job.delta_m,
            renderer=job.renderer,
            smooth_normals=job.smooth_normals,
            objects=rows,
        ),
    )
    return "done"


@lru_cache(maxsize=2)
def _open_scene(root: str, state: str) -> Scene:  # noqa: ARG001 - part of the cache's key
    return Scene.open(root)


@lru_cache(maxsize=1)
def _caster() -> raycast.RaycastRenderer:
    return raycast.RaycastRenderer()


def _artefact(scene: Scene, frame_id: int, job: FrameJob) -> Artefact:
    """Everything that determines a frame's files."""
    frame = scene.frame(frame_id)
    poses = [[i, pose.flat()] for i, pose in frame_placements(scene, frame_id).items()]
    inputs = frame_inputs(scene, frame_id) | {
        "object poses": digest_of(poses),
        "sensor depth": "" if frame.depth is None else digest_file(scene.root / frame.depth),
    }
    if job.occluder is not None:
        T_world_cam = scene.T_world_cam(frame_id)
        pose = None if T_world_cam is None else T_world_cam.flat()
        inputs |= {"occluders": job.occluder[1], "camera pose": digest_of(pose)}
    names = ("renderer", "policy", "delta_m", "smooth_normals")
    options = {name: getattr(job, name) for name in names}
    return Artefact(scene.root, f"ground truth of frame {frame_id}", inputs, options)


def _possible_policy(
    scene: Scene, frame_id: int, sensor: np.ndarray | None, job: FrameJob
) -> Policy:
    """The policy that applies to this frame: `models` if the data for another one are missing."""
    lacking = {
        "sensor": sensor is None,
        "fused": job.occluder is None or scene.T_world_cam(frame_id) is None,
    }
    return "models" if lacking.get(job.policy, False) else job.policy


def _hidden(
    scene: Scene,
    frame_id: int,
    composition: maps.Composition,
    sensor: np.ndarray | None,
    policy: Policy,
    job: FrameJob,
) -> np.ndarray | None:
    """(H,W) bool: object pixels behind unlabelled geometry; None if nothing hides objects."""
    camera = scene.camera(scene.frame(frame_id))
    if policy == "sensor" and sensor is not None:
        return hidden_by_depth(composition.depth, sensor, camera, delta_m=job.delta_m)
    T_world_cam = scene.T_world_cam(frame_id)
    if policy == "fused" and job.occluder is not None and T_world_cam is not None:
        occluder = occluders.load_occluder(*job.occluder)
        if occluder is None:
            return None
        front = occluder_depth(
            _caster(), occluder, T_world_cam.inverse(), camera, where=composition.index >= 0
        )
        return hidden_by_depth(composition.depth, front, camera, delta_m=job.delta_m)
    return None


def _object_truth(
    item: PlacedMesh,
    composition: maps.Composition,
    index: int,
    sensor: np.ndarray | None,
) -> ObjectTruth:
    silhouette = composition.silhouettes[index]
    px_all, px_visible, px_valid = silhouette.px_all, 0, 0
    visible_box = None
    if silhouette.image is not None and silhouette.image_window is not None:
        height, width = composition.index.shape
        place = silhouette.image_window.slices_in(Window(0, 0, width, height))
        visible = composition.index[place] == index
        px_visible = int(np.count_nonzero(visible))
        visible_box = maps.mask_box(visible, silhouette.image_window)
        amodal = silhouette.image.depth > 0
        if sensor is not None:
            amodal &= sensor[place] > 0
        px_valid = int(np.count_nonzero(amodal))
    box = silhouette.box
    return ObjectTruth(
        object=item.object_id,
        T_cam_obj=item.T_cam_obj.matrix().ravel().tolist(),
        px_all=px_all,
        px_valid=px_valid,
        px_visible=px_visible,
        visible_fraction=px_visible / px_all if px_all else 0.0,
        bbox_amodal=None if box is None else list(box),
        bbox_visible=None if visible_box is None else list(visible_box),
    )


@lru_cache(maxsize=4)
def ray_lengths(camera: Camera) -> np.ndarray:
    """Return (H,W) float32 distance from the camera per metre of z, for every pixel."""
    x, y = normalised_rays(camera, image_window(camera))
    lengths = np.sqrt(x * x + y * y + 1).astype(np.float32)
    lengths.setflags(write=False)
    return lengths


def hidden_by_depth(
    depth: np.ndarray, scene_depth: np.ndarray, camera: Camera, *, delta_m: float
) -> np.ndarray:
    """Return where the scene depth hides the object depth.

    Args:
        depth: (H,W) z-depth of the objects, metres, 0 = none.
        scene_depth: (H,W) z-depth of the scene, metres, 0 = missing, which hides nothing.
        camera: camera of both maps.
        delta_m: tolerance of the difference of distances from the camera.

    Returns:
        (H,W) bool; False where either depth is missing.
    """
    difference = (depth - scene_depth) * ray_lengths(camera)
    return (depth > 0) & (scene_depth > 0) & (difference > np.float32(delta_m))


def occluder_depth(
    caster: raycast.RaycastRenderer,
    occluder: mesh.RenderMesh,
    T_cam_world: SE3,
    camera: Camera,
    *,
    where: np.ndarray,
) -> np.ndarray:
    """Return (H,W) float32 z-depth of the fused geometry at the pixels in `where`, 0 elsewhere."""
    depth = np.zeros(where.shape, np.float32)
    depth[where] = caster.cast_at(camera, occluder, T_cam_world, where=where)
    return depth
