"""The reconstruction beside poses.json: a COLMAP model and a point cloud, in the same metres."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from std_toolkit.io.atomic import atomic_path, sweep_temporaries
from std_toolkit.poses.colmap import quiet_colmap

SPARSE = Path("poses") / "sparse"
POINTS = Path("poses") / "points.ply"


def publish_model(root: Path, model: Any, work: Path) -> list[Path]:
    """Write `model` (pycolmap.Reconstruction) to the scene, each file atomically.

    The step's record, written last, tells whether all files of a model arrived.

    Args:
        root: scene folder.
        model: in the world frame, metres.
        work: an empty folder on the same file system.

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
    """Multiply all positions of the published model by `factor`; nothing where there is none."""
    import pycolmap

    if not (root / SPARSE).is_dir():
        return
    with quiet_colmap():
        model = pycolmap.Reconstruction(root / SPARSE)
        model.transform(pycolmap.Sim3d(factor, pycolmap.Rotation3d(), [0.0, 0.0, 0.0]))
    with work_folder(root) as work:
        publish_model(root, model, work)


@contextmanager
def work_folder(root: Path) -> Iterator[Path]:
    """An empty folder; what a killed run left in it and beside it is removed first."""
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
