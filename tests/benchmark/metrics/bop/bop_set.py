"""A small data set in BOP's layout, written as the format's description has it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh

from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.io.images import write_png
from std_toolkit.rendering.mesh import prepare_mesh
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import image_window

CAMERA = Camera(320, 240, 300, 300, 159.5, 119.5)
CAN, BRICK = 1, 5
MESHES = {
    CAN: trimesh.creation.cylinder(0.04, 0.12, sections=64),
    BRICK: trimesh.creation.box((0.06, 0.09, 0.15)),
}
DIAMETERS_M = {CAN: float(np.hypot(0.08, 0.12)), BRICK: float(np.linalg.norm((0.06, 0.09, 0.15)))}
HALF_TURN_Z = [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
# Image 3: a can, and two bricks of which one is hidden by the can but for a sliver. Image 4: a can.
TRUTHS = {
    3: [
        (CAN, SE3(so3_exp(np.array([1.3, 0.2, 0])), np.array([-0.02, 0, 0.6]))),
        (BRICK, SE3(so3_exp(np.array([0.5, 0.9, 0.2])), np.array([0.13, 0.03, 0.7]))),
        (BRICK, SE3(so3_exp(np.array([1.5, 0, 0])), np.array([-0.1, 0.02, 0.9]))),
    ],
    4: [(CAN, SE3(so3_exp(np.array([2.0, 0.4, 0.3])), np.array([0.05, -0.04, 0.5])))],
}
VISIBLE = {3: [1.0, 1.0, 0.06], 4: [1.0]}
TABLE_M = 1.1


def depth_of(truths: list[tuple[int, SE3]]) -> np.ndarray:
    """(H, W) metres of the objects before a wall, with a hole of missing depth."""
    depth = np.full((CAMERA.height, CAMERA.width), TABLE_M, np.float32)
    for number, T in truths:
        drawn = RaycastRenderer().draw(
            CAMERA, prepare_mesh(MESHES[number]), T, window=image_window(CAMERA)
        )
        nearer = (drawn.depth > 0) & (drawn.depth < depth)
        depth[nearer] = drawn.depth[nearer]
    depth[100:115, 140:170] = 0
    return depth


def _row(number: int, T: SE3) -> dict[str, object]:
    return {
        "obj_id": number,
        "cam_R_m2c": T.R.ravel().tolist(),
        "cam_t_m2c": (1000 * T.t).tolist(),
    }


def write_bop(root: Path) -> Path:
    folder = root / "test" / "000002"
    (folder / "depth").mkdir(parents=True)
    (root / "models").mkdir()
    K = CAMERA.K.ravel().tolist()
    for im_id, truths in TRUTHS.items():
        units = np.round(depth_of(truths) * 10_000).astype(np.uint16)
        write_png(folder / "depth" / f"{im_id:06d}.png", units)
    documents = {
        folder / "scene_camera.json": {str(i): {"cam_K": K, "depth_scale": 0.1} for i in TRUTHS},
        folder / "scene_gt.json": {str(i): [_row(*t) for t in rows] for i, rows in TRUTHS.items()},
        folder / "scene_gt_info.json": {
            str(i): [{"visib_fract": v} for v in VISIBLE[i]] for i in TRUTHS
        },
        root / "test_targets_bop19.json": [
            {"scene_id": 2, "im_id": 3, "obj_id": CAN, "inst_count": 1},
            {"scene_id": 2, "im_id": 3, "obj_id": BRICK, "inst_count": 1},
            {"scene_id": 2, "im_id": 4, "obj_id": CAN, "inst_count": 1},
        ],
        root / "models" / "models_info.json": {
            str(CAN): {
                "diameter": 1000 * DIAMETERS_M[CAN],
                "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}],
            },
            str(BRICK): {
                "diameter": 1000 * DIAMETERS_M[BRICK],
                "symmetries_discrete": [HALF_TURN_Z],
            },
        },
    }
    for path, content in documents.items():
        path.write_text(json.dumps(content))
    for number, mesh in MESHES.items():
        large = mesh.copy()
        large.apply_scale(1000)
        large.export(root / "models" / f"obj_{number:06d}.ply")
    return root
