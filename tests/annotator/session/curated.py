"""Scenes as `std-curate label` leaves them, and as others go on writing into them."""

from __future__ import annotations

from pathlib import Path

from std_toolkit.cli.main import main
from std_toolkit.geometry import SE3
from std_toolkit.scene import Scene

POSE = SE3.exp([0.01, 0.02, 0.6, 0.3, 0.2, 0.1])


def curate(*arguments: object) -> None:
    assert main(["--quiet", *map(str, arguments)]) == 0


def pose_file(folder: Path, pose: SE3 = POSE) -> Path:
    path = folder / "pose.txt"
    path.write_text(" ".join(map(repr, pose.flat())))
    return path


def label_more(root: Path) -> Path:
    """Three objects: one propagated, one annotated in two frames, one unlabelled."""
    for name in ("two_views", "bare"):
        curate("label", root, "--object", name, "--model", "box")
    scene = Scene.open(root)
    T_world_obj = scene.T_world_obj(1)
    assert T_world_obj is not None
    for frame in (0, 2):
        T_world_cam = scene.T_world_cam(frame)
        assert T_world_cam is not None
        path = pose_file(root.parent, T_world_cam.inverse() @ T_world_obj)
        curate("label", root, "--object", "two_views", "--frame", frame, "--pose", path,
               "--add-view")  # fmt: skip
    return root
