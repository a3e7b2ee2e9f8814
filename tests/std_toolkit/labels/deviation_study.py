"""Refines synthetic objects and compares their errors with the reported deviations.

Used by the tests and by perf/label_deviation.py.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import numpy as np
import trimesh
from numpy.typing import NDArray

from sensors.synthetic.recording import RecordingOptions, make_recording, textured_meshes
from sensors.synthetic.truth import scene_from_truth
from std_toolkit.geometry import SE3
from std_toolkit.geometry.mesh import hull_vertices, mesh_bounds
from std_toolkit.geometry.symmetry import Symmetry, fixed_point, nearest_variant
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.jobs import JobOptions
from std_toolkit.labels.auto_refine import refine_objects
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.labels.refine.directions import covariance_at
from std_toolkit.options import PropagateOptions
from std_toolkit.scene import Scene
from std_toolkit.scene.model import Label, Labels, SymmetryModel

FRAMES = 9
START_M, START_DEG = 0.015, 8.0
# Standard deviations of the faults.
MESH_SIZE, TEXTURE_M, CAMERA_M, CAMERA_RAD = 0.003, 0.0004, 0.0007, 0.0007
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """One refined object.

    Attributes:
        z: errors in units of the reported deviations, one per direction (5 or 6).
        mm, deg: error of the centre and of the rotation, symmetry aware.
        textured: whether the mesh has a texture.
        std_mm, std_deg: reported deviations along the weakest directions.
    """

    seed: int
    name: str
    material: str
    frames: int
    depth: bool
    mesh_fault: bool
    camera_fault: bool
    textured: bool
    z: list[float]
    mm: float
    deg: float
    std_mm: float
    std_deg: float


def recorded_study(
    recording: Path, scene_root: Path, seed: int, *, propagated: bool = False
) -> list[Row]:
    """Record six objects and study them; in two of five recordings opaque meshes have a texture."""
    options = RecordingOptions(frames=FRAMES, seed=seed)
    make_recording(recording, options, jobs=JobOptions(progress=False))
    textured = options if seed % 5 < 2 and not propagated else None
    return study(recording, scene_root, seed, textured=textured, propagated=propagated)


def study(
    recording: Path,
    scene_root: Path,
    seed: int,
    *,
    textured: RecordingOptions | None = None,
    propagated: bool = False,
) -> list[Row]:
    """Refine every object of a recording from one start each; rows in the order of their ids.

    Args:
        recording: folder of the recording.
        scene_root: folder of the scene to make.
        seed: of the faults and starts; selects the kinds of faults, too.
        textured: options of the recording, to give opaque meshes their textures; None leaves them
            plain. A mesh with a texture has no symmetry.
        propagated: annotate the starts in the first frame, propagate them with `refine` and read
            labels.json; else refine them at once. For plain meshes.
    """
    rng = np.random.default_rng([seed, 77])
    depth, mesh_fault, camera_fault = bool(seed % 4 < 2), seed % 2 == 1, seed % 3 == 2
    scene = scene_from_truth(recording, scene_root)
    truth = {x.object: SE3.from_matrix(x.T_world_obj) for x in scene.labels.labels}
    if not depth:
        table = scene.frame_table
        frames = [msgspec.structs.replace(f, depth=None) for f in table.frames]
        table = msgspec.structs.replace(table, frames=frames)
        write_bytes_atomic(scene.root / "frames.json", msgspec.json.encode(table))
    if camera_fault:
        _shake(scene, rng)
    meshes = {m.id: scene.mesh(m.id).copy() for m in scene.objects.models}
    if textured is not None:
        textures = textured_meshes(textured)
        meshes |= {name: mesh.copy() for name, mesh in textures.items()}
        models = [
            msgspec.structs.replace(m, symmetry=SymmetryModel()) if m.id in textures else m
            for m in scene.objects.models
        ]
        scene.save_objects(msgspec.structs.replace(scene.objects, models=models))
    scene = Scene.open(scene.root)
    if mesh_fault:
        for mesh in meshes.values():
            centre = mesh_bounds(mesh).mean(axis=0)
            mesh.vertices = centre + (mesh.vertices - centre) * rng.normal(1, MESH_SIZE, 3)
            if textured is not None and mesh.visual.kind == "texture":
                _shift_texture(mesh, rng)
    start = {
        i: _moved(T, mesh_bounds(meshes[scene.objects.object(i).model]).mean(axis=0), rng)
        for i, T in truth.items()
    }
    count = int(rng.choice([3, 4, 6, 9]))
    chosen = [int(i) for i in np.linspace(0, FRAMES - 1, count).round()]
    if propagated:
        found = _propagated(scene, start, meshes, count)
    else:
        outcome = refine_objects(scene, start, frames=chosen, mesh=meshes.__getitem__)
        found = {i: (x.pose, x.covariance) for i, x in outcome.objects.items()}
    rows = []
    for i, (pose, covariance) in sorted(found.items()):
        item = scene.objects.object(i)
        model = scene.objects.model(item.model)
        symmetry = model.symmetry.symmetry()
        found_error = pose_error(pose, covariance, truth[i], meshes[model.id], symmetry)
        rows.append(
            Row(
                seed,
                item.name,
                item.material,
                count,
                depth,
                mesh_fault,
                camera_fault,
                textured is not None and model.id in textures,
                **asdict(found_error),
            )
        )
    return rows


@dataclass(frozen=True)
class PoseError:
    """Error of a pose and its reported deviations; see `Row`."""

    z: list[float]
    mm: float
    deg: float
    std_mm: float
    std_deg: float


def pose_error(
    pose: SE3, covariance: Array, truth: SE3, mesh: trimesh.Trimesh, symmetry: Symmetry
) -> PoseError:
    """Compare the error of a pose, symmetry aware, with its covariance.

    Args:
        pose, truth: T_world_obj.
        covariance: (6, 6) of a right perturbation of `pose`, metres and radians.
        mesh: that the pose is of.
        symmetry: of the mesh.
    """
    centre = fixed_point(symmetry, mesh_bounds(mesh).mean(axis=0))
    true = nearest_variant(truth, pose, hull_vertices(mesh), symmetry)
    error = (pose.inverse() @ true).log()
    at = SE3(np.eye(3), centre)
    error = (at.inverse() @ SE3.exp(error) @ at).log()
    C = covariance_at(covariance, centre)
    radius = 0.5 * float(np.linalg.norm(mesh.extents))
    size = np.array([1.0] * 3 + [radius] * 3)
    axes = [np.asarray(a) for a, _ in symmetry.continuous]
    if symmetry.is_spherical:
        axes = list(np.eye(3))
    z = whitened(error * size, C * np.outer(size, size), axes)
    turn = error[3:] - sum((a * (a @ error[3:]) for a in axes), np.zeros(3))
    std = [float(np.sqrt(np.linalg.eigvalsh(C[k, k])[-1])) for k in (np.s_[:3], np.s_[3:])]
    return PoseError(
        [float(x) for x in z],
        1000 * float(np.linalg.norm(error[:3])),
        float(np.rad2deg(np.linalg.norm(turn))),
        1000 * std[0],
        float(np.rad2deg(std[1])),
    )


def _propagated(
    scene: Scene, start: dict[int, SE3], meshes: dict[str, trimesh.Trimesh], keyframes: int
) -> dict[int, tuple[SE3, Array]]:
    """Poses and covariances in labels.json after `propagate --refine`, by object."""
    for model in scene.objects.models:
        meshes[model.id].export(scene.root / model.mesh)
    T_world_cam = scene.T_world_cam(0)
    assert T_world_cam is not None
    labels = [
        Label(object=i, frame=0, T_cam_obj=(T_world_cam.inverse() @ T).flat(), method="gui")
        for i, T in start.items()
    ]
    scene.save_labels(Labels(labels=labels))
    propagate_labels(Scene.open(scene.root), PropagateOptions(refine=True, keyframes=keyframes))
    found = {}
    for label in Scene.open(scene.root).labels.labels:
        assert label.T_world_obj is not None and label.covariance is not None
        found[label.object] = (
            SE3.from_matrix(label.T_world_obj),
            np.reshape(label.covariance, (6, 6)),
        )
    return found


def whitened(error: Array, covariance: Array, axes: list[Array]) -> Array:
    """The error in units of its deviation along the principal axes of the covariance.

    Args:
        error: (6,) translation and rotation, in comparable units.
        covariance: (6, 6).
        axes: rotations that have no effect; they are left out.
    """
    keep = np.eye(6)
    for axis in axes:
        free = np.concatenate([np.zeros(3), axis])
        keep = keep - np.outer(free, free)
    basis = np.linalg.svd(keep)[0][:, : 6 - len(axes)]
    values, vectors = np.linalg.eigh(basis.T @ covariance @ basis)
    return np.asarray(vectors.T @ (basis.T @ error) / np.sqrt(values))


def _moved(T: SE3, centre: Array, rng: np.random.Generator) -> SE3:
    shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    at = SE3(np.eye(3), centre)
    turn = SE3.exp([0, 0, 0, *(np.deg2rad(START_DEG) * axis)])
    return SE3(np.eye(3), START_M * shift) @ T @ at @ turn @ at.inverse()


def _shift_texture(mesh: trimesh.Trimesh, rng: np.random.Generator) -> None:
    """Move the texture of each of six sides along the surface, as photos blended on a scan lie."""
    uv = mesh.visual.uv
    # `textured_mesh` has three by two tiles, each as wide as the largest extent.
    middle = np.repeat(uv.reshape(-1, 3, 2).mean(axis=1), 3, axis=0)
    side = np.minimum(middle * [3, 2], [2.99, 1.99]).astype(int) @ [2, 1]
    shift = rng.normal(0, TEXTURE_M / mesh.extents.max(), (6, 2)) / [3, 2]
    mesh.visual.uv = uv + shift[side]


def _shake(scene: Scene, rng: np.random.Generator) -> None:
    """Camera poses with errors of the deviations that they state."""
    deviations = np.array([CAMERA_M] * 3 + [CAMERA_RAD] * 3)
    poses = scene.poses
    assert poses is not None
    frames = [
        msgspec.structs.replace(
            f,
            T_world_cam=(
                SE3.from_matrix(f.T_world_cam) @ SE3.exp(rng.normal(0, deviations))
            ).flat(),
            covariance=[float(x) for x in np.diag(deviations**2).ravel()],
        )
        for f in poses.frames
        if f.T_world_cam is not None
    ]
    scene.save_poses(msgspec.structs.replace(poses, frames=frames))


def shares(rows: list[Row]) -> tuple[float, float, float]:
    """Shares of the directions within one and two deviations, and the robust scale of z."""
    z = np.abs(np.concatenate([r.z for r in rows]))
    return float((z <= 1).mean()), float((z <= 2).mean()), float(np.median(z) / 0.6745)
