"""Sets in BOP's form, written in milliseconds: labels, cameras and models, without images."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh

from std_toolkit.geometry import SE3


def write_bop(root: Path, rows: dict[int, list[tuple[int, SE3]]], *, camera: bool = False) -> Path:
    """A set in BOP's form without images: boxes 1 and 2."""
    scene = root / "test" / "000001"
    scene.mkdir(parents=True)
    (root / "models").mkdir()
    for number in (1, 2):
        mesh = trimesh.creation.box((60, 40, 100))
        mesh.export(root / "models" / f"obj_{number:06d}.ply")
    gt, cameras = {}, {}
    for image, placed in rows.items():
        gt[str(image)] = [
            {"obj_id": n, "cam_R_m2c": T.R.ravel().tolist(), "cam_t_m2c": (1000 * T.t).tolist()}
            for n, T in placed
        ]
        row: dict[str, object] = {"cam_K": [500, 0, 320, 0, 500, 240, 0, 0, 1]}
        if camera:
            row |= {"cam_R_w2c": np.eye(3).ravel().tolist(), "cam_t_w2c": [10.0 * image, 0, 0]}
        cameras[str(image)] = row
    (scene / "scene_gt.json").write_text(json.dumps(gt))
    (scene / "scene_camera.json").write_text(json.dumps(cameras))
    return root
