"""Generates and packs scenes of labelled grasps."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.methods.grasp.graspnet.cloud import (
    GraspNetConfig,
    measured_pixels,
    scene_cloud,
    workspace,
)
from benchmark.methods.protocol import GraspView
from benchmark.metrics.grasp.gripper import get_gripper
from benchmark.training.grasp import pack_files, tabletop
from benchmark.training.grasp.grasp_labels import ObjectLabels, kept_labels, scene_labels
from benchmark.training.options import GraspPackOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.atomic import atomic_path, sweep_temporaries
from std_toolkit.io.documents import read_document, write_document
from std_toolkit.io.locks import hold_lock
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.jobs.artefact import begin, check_begun

# A point on an object has the grasps of the labelled point that is nearest, unless that is
# farther than so many spacings.
_REACH = 1.5
# Stream of random numbers of a frame: which of its points are kept.
_KEPT = 17


@dataclass(frozen=True)
class PackedScenes:
    """What became of the scenes.

    Attributes:
        scenes, frames: in the pack now.
        graspable: share of the known points that have a grasp, mean of the scenes.
        failed: why scenes are not, by number.
    """

    scenes: int
    frames: int
    graspable: float
    failed: dict[str, str]


def pack_grasps(
    folder: Path,
    scenes: int,
    options: GraspPackOptions | None = None,
    jobs: JobOptions | None = None,
    network: GraspNetConfig | None = None,
) -> PackedScenes:
    """Make the scenes that are not there yet; the first `scenes` are in the end.

    Args:
        folder: of the pack.
        scenes: how many.
        options: how they are made.
        jobs: where the work runs.
        network: whose views, angles, depths and workspace count; by default the published one.

    Raises:
        ToolkitError: the folder holds another pack or something else.
    """
    options = options or GraspPackOptions()
    if scenes < 1:
        raise ToolkitError("must be at least 1", field="scenes", value=scenes)
    check_begun(folder / pack_files.PACK, hint="choose another folder")
    folder.mkdir(parents=True, exist_ok=True)
    with hold_lock(folder, "lock", doing="packing into", what="folder"):
        begin_pack(folder, options, network)
        sweep_temporaries(folder)
        left = [n for n in range(scenes) if not pack_files.index_path(folder, n).exists()]
        report = run_jobs(
            partial(_make_scene, folder, options, network), left, name="pack grasps", options=jobs
        )
    made = [
        read_document(pack_files.index_path(folder, n), pack_files.SceneIndex)
        for n in range(scenes)
        if pack_files.index_path(folder, n).exists()
    ]
    frames = sum(len(index.frames) for index in made)
    graspable = float(np.mean([index.graspable for index in made])) if made else 0.0
    return PackedScenes(len(made), frames, graspable, dict(report.failed))


def begin_pack(
    folder: Path, options: GraspPackOptions, network: GraspNetConfig | None = None
) -> pack_files.GraspPackSetup:
    """Keep what decides what is in a pack, or see that it was begun with the same.

    Raises:
        ToolkitError: it was begun with something else, or the folder holds something else.
    """
    setup = _setup_of(options, network)
    begin(folder / pack_files.PACK, setup, what="this pack was", hint="choose another folder")
    return setup


def _setup_of(
    options: GraspPackOptions, network: GraspNetConfig | None
) -> pack_files.GraspPackSetup:
    network = network or GraspNetConfig()
    own = {f.name: getattr(options, f.name) for f in fields(GraspPackOptions) if f.name != "table"}
    table = asdict(options.table)
    del table["half_width_m"]
    root = table.pop("assets_root")
    return pack_files.GraspPackSetup(
        **own,
        **table,
        assets_root=None if root is None else str(root.resolve()),
        views=network.views,
        angles=network.angles,
        depths=network.depths,
    )


def _make_scene(
    folder: Path, options: GraspPackOptions, network: GraspNetConfig | None, number: int
) -> int:
    seed = options.seed + number
    objects = tabletop.draw_table(seed, options.table, parts_cache=folder / "parts")
    cameras = tabletop.draw_cameras(seed, options.frames)
    return write_scene(folder, number, objects, cameras, options, network)


def write_scene(
    folder: Path,
    number: int,
    objects: Sequence[tabletop.TableObject],
    cameras: Sequence[SE3],
    options: GraspPackOptions,
    network: GraspNetConfig | None = None,
) -> int:
    """Label and pack one scene.

    Args:
        folder: of the pack.
        number: of the scene.
        objects: of the scene; the table is z = 0.
        cameras: T_world_cam of its frames.
        options: how.
        network: as in `pack_grasps`.

    Returns:
        Its frames.
    """
    network = network or GraspNetConfig()
    setup = _setup_of(options, network)
    seed = options.seed + number
    labels = [kept_labels(folder / "objects", o, setup) for o in objects]
    clouds, numbers, points = [], [], []
    for view, T_world_cam in enumerate(cameras):
        cloud, owner = _cloud(objects, T_world_cam, setup, network, (seed, view))
        clouds.append(cloud)
        numbers.append(owner)
        points.append(_labelled_points(cloud, owner, objects, labels, T_world_cam, setup.spacing))
    owner, point = np.concatenate(numbers), np.concatenate(points)
    seen_points = [np.unique(point[(owner == o) & (point >= 0)]) for o in range(len(objects))]
    rows = scene_labels(objects, labels, seen_points, get_gripper(options.gripper))
    begins = np.cumsum([0, *(len(s) for s in seen_points)])
    row = np.full(len(point), -1, np.int32)
    for o, mine in enumerate(seen_points):
        here = (owner == o) & (point >= 0)
        row[here] = begins[o] + np.searchsorted(mine, point[here])
    pack_files.index_path(folder, number).unlink(missing_ok=True)
    place = pack_files.scene_folder(folder, number)
    place.mkdir(exist_ok=True)
    arrays: dict[str, NDArray[Any]] = {
        "points": np.concatenate(clouds),
        "object": owner.astype(np.int16),
        "row": row,
        "row_object": rows.object,
        "friction": rows.friction,
        "widths": rows.widths,
        "tolerances": rows.tolerances,
    }
    for name, array in arrays.items():
        with atomic_path(place / f"{name}.npy") as temporary:
            np.save(temporary, array)
    _write_meshes(place / "meshes.npz", objects)
    ends = np.cumsum([len(c) for c in clouds]).tolist()
    frames = [
        pack_files.PackedView(
            begin=b,
            end=e,
            T_world_cam=T.matrix().ravel().tolist(),
            digest=pack_files.digest_of_points(c),
        )
        for b, e, T, c in zip([0, *ends], ends, cameras, clouds, strict=False)
    ]
    on_objects = owner >= 0
    index = pack_files.SceneIndex(
        seed=seed,
        objects=[
            pack_files.PackedObject(
                name=o.name, surface=o.surface, T_world_obj=o.T_world_obj.matrix().ravel().tolist()
            )
            for o in objects
        ],
        frames=frames,
        rows=len(rows.friction),
        known=float((row[on_objects] >= 0).mean()) if on_objects.any() else 0.0,
        graspable=float(rows.friction.any(axis=(1, 2, 3)).mean()) if len(rows.friction) else 0.0,
    )
    write_document(pack_files.index_path(folder, number), index)
    return len(frames)


def _cloud(
    objects: Sequence[tabletop.TableObject],
    T_world_cam: SE3,
    setup: pack_files.GraspPackSetup,
    network: GraspNetConfig,
    seed: tuple[int, int],
) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    """(n, 3) points of a view that the network is shown, and (n,) whose they are, -1 table's."""
    camera = setup.camera
    look = tabletop.look_at_table(objects, camera, T_world_cam, setup.depth, seed)
    view = GraspView(
        np.zeros((*look.depth.shape, 3), np.uint8),
        look.depth,
        camera,
        look.index >= 0,
        T_world_cam.inverse().matrix(),
    )
    cloud, owner = scene_cloud(view), look.index[measured_pixels(view)]
    shown = np.flatnonzero(workspace(view, cloud, network))
    if not len(shown):
        raise ToolkitError("a view of the scene sees no object", value=seed)
    rng = np.random.default_rng([*seed, _KEPT])
    kept = np.sort(rng.permutation(shown)[: setup.points])
    return cloud[kept], owner[kept]


def _labelled_points(
    cloud: NDArray[np.float32],
    owner: NDArray[np.int16],
    objects: Sequence[tabletop.TableObject],
    labels: Sequence[ObjectLabels],
    T_world_cam: SE3,
    spacing: float,
) -> NDArray[np.int64]:
    """(n,) number of the labelled point of its object that stands for each point, -1 for none."""
    from scipy.spatial import cKDTree

    found = np.full(len(cloud), -1, np.int64)
    for o, (obj, own) in enumerate(zip(objects, labels, strict=True)):
        mine = np.flatnonzero(owner == o)
        if not len(mine):
            continue
        local = (obj.T_world_obj.inverse() @ T_world_cam) @ cloud[mine].astype(np.float64)
        apart, nearest = cKDTree(own.points).query(local)
        found[mine] = np.where(apart <= _REACH * spacing, nearest, -1)
    return found


def _write_meshes(path: Path, objects: Sequence[tabletop.TableObject]) -> None:
    arrays: dict[str, Any] = {}
    for number, obj in enumerate(objects):
        arrays[f"vertices{number}"] = np.asarray(obj.vertices, np.float32)
        arrays[f"faces{number}"] = np.asarray(obj.faces, np.int32)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)
