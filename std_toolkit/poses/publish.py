"""Publication of the reconstruction as COLMAP model and points, and change of its scale."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from std_toolkit.io.atomic import atomic_path, sweep_temporaries
from std_toolkit.io.colmap_files import check_colmap_model
from std_toolkit.io.documents import digest_files, write_document
from std_toolkit.jobs.artefact import Record, changed_files, read_record, record_path
from std_toolkit.poses.colmap import quiet_colmap
from std_toolkit.scene.model import FramePose, ScaleReport, pose_from_list
from std_toolkit.scene.scene import Scene

SPARSE = Path("poses") / "sparse"

POINTS = Path("poses") / "points.ply"


def publish_model(root: Path, model: Any, work: Path) -> list[Path]:
    """Write `model` (pycolmap.Reconstruction) to the scene, each file atomically.

    The caller writes the record of the step last; the record shows whether the files are complete.

    Args:
        root: scene folder.
        model: model in the world frame, metres.
        work: empty folder on the same file system.

    Returns:
        The written files.
    """
    fresh = work / "sparse"
    fresh.mkdir()
    with quiet_colmap():
        model.write(fresh)
        model.export_PLY(work / "points.ply")
    outputs = [_move(path, root / SPARSE / path.name) for path in sorted(fresh.iterdir())]
    outputs.append(_move(work / "points.ply", root / POINTS))
    return outputs


def rescale_model(root: Path, factor: float) -> None:
    """Multiply all positions of the published model, if any, by `factor`."""
    import pycolmap

    if not (root / SPARSE).is_dir():
        return
    with quiet_colmap():
        check_colmap_model(root / SPARSE)
        model = pycolmap.Reconstruction(root / SPARSE)
        model.transform(pycolmap.Sim3d(factor, pycolmap.Rotation3d(), [0.0, 0.0, 0.0]))
    with work_folder(root) as work:
        publish_model(root, model, work)


@contextmanager
def work_folder(root: Path) -> Iterator[Path]:
    """Create an empty folder and remove it afterwards.

    Remains of a killed run are removed first, here and in the folders of the pose step.
    """
    work = root / ".std" / "work" / "poses"
    shutil.rmtree(work, ignore_errors=True)
    for folder in (root / ".std" / "poses", root / "poses"):
        if folder.is_dir():
            sweep_temporaries(folder)
    work.mkdir(parents=True)
    try:
        yield work
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _move(source: Path, target: Path) -> Path:
    with atomic_path(target) as temporary:
        source.replace(temporary)
    return target


@contextmanager
def rescaled_poses(scene: Scene, factor: float, report: ScaleReport) -> Iterator[None]:
    """Multiply all camera positions and the reconstruction by `factor`; the caller holds the lock.

    `report` replaces the scale report of poses.json. The caller saves the labels in the new scale
    inside the block. If the block ends without an error, the record of the step
    that wrote the poses is updated, so that a pipeline treats them as fresh. After a run that was
    killed before that, the record does not match and the poses are recovered again.
    """
    intact = _intact_records(scene.root)
    poses = scene.poses
    assert poses is not None
    frames = poses.frames
    if factor != 1:
        rescale_model(scene.root, factor)
        frames = [_rescaled(f, factor) for f in frames]
    scene.save_poses(msgspec.structs.replace(poses, frames=frames, scale=report))
    yield
    for path, record in intact:
        outputs = digest_files(scene.root, [scene.root / name for name in record.outputs])
        write_document(path, msgspec.structs.replace(record, outputs=outputs))


def _intact_records(root: Path) -> list[tuple[Path, Record]]:
    """Records of the steps that wrote poses.json and whose outputs have not changed since."""
    found = []
    for path in sorted(record_path(root, "x").parent.glob("*.json")):
        record = read_record(path, Record)
        if record is None or "poses.json" not in record.outputs:
            continue
        if not changed_files(root, record.outputs):
            found.append((path, record))
    return found


def _rescaled(frame: FramePose, factor: float) -> FramePose:
    if frame.T_world_cam is None:
        return frame
    T = pose_from_list(frame.T_world_cam)
    pose = T.flat()
    for i in range(3):
        pose[4 * i + 3] *= factor
    covariance = None
    if frame.covariance is not None:
        size = [factor] * 3 + [1.0] * 3
        covariance = [
            frame.covariance[6 * i + j] * size[i] * size[j] for i in range(6) for j in range(6)
        ]
    return msgspec.structs.replace(frame, T_world_cam=pose, covariance=covariance)
