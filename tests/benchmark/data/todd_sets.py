"""Small sets in the layouts of Syn-TODD and TODD, written from their description alone.

The authors project points of their camera's frame by K, divide by z, and take W - u for the column:
boxes are filed in that frame, and images are drawn where this falls.
"""

from __future__ import annotations

import dataclasses
import json
import pickle
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from std_toolkit.io.exr import write_exr
from tests.benchmark.data.field_sets import BOXES, Box, Drawn, draw, put, put_color, with_holes

try:
    from compression import zstd  # type: ignore[import-not-found, unused-ignore]
except ImportError:
    from backports import zstd

SIZE = (160, 120)
# At a quarter of 640x480.
FILED = [613.962 / 4, 613.756 / 4, 324.447 / 4, 239.171 / 4]
DRAWN = [FILED[0], FILED[1], SIZE[0] - FILED[2], FILED[3]]
# Long names differ in their first 38 letters.
NAMES = ("Vessel_" + "a" * 40 + "_tail", "Beaker")
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
# Cameras of Blender in the world: both see the same boxes.
CAMERAS = (
    Box((1, 1, 1), (70, 0, 30), (0.5, -0.4, 1.1)).T,
    Box((1, 1, 1), (72, 3, 36), (0.58, -0.36, 1.08)).T,
)


def boxes_of(camera: int) -> list[Box]:
    """The boxes in OpenCV's frame of a camera; those of the first one are `BOXES`."""
    moved = FLIP @ np.linalg.inv(CAMERAS[camera]) @ CAMERAS[0] @ FLIP
    found = []
    for box in BOXES:
        T = moved @ box.T
        turn = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
        found.append(Box(box.sides, tuple(turn), tuple(T[:3, 3])))
    return found


def corners(box: Box) -> NDArray[np.float64]:
    """(8, 3) in the authors' frame."""
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    points = signs * np.array(box.sides) / 2
    return (points @ box.R.T + box.centre) @ FLIP[:3, :3]


def as_authors_project(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) columns and rows."""
    fx, fy, cx, cy = FILED
    uv = points @ np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]).T
    uv = uv[:, :2] / uv[:, 2:]
    return np.stack([SIZE[0] - uv[:, 0], uv[:, 1]], axis=-1)


def camera_fields(camera: int) -> dict[str, Any]:
    fx, fy, cx, cy = FILED
    x, y, z, w = Rotation.from_matrix(CAMERAS[camera][:3, :3]).as_quat()
    return {
        "camera_intrinsic": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
        "camera_extrinsic": np.linalg.inv(CAMERAS[camera]).tolist(),
        "camera_location": CAMERAS[camera][:3, 3].tolist(),
        "quaternion_WXYZ": [w, x, y, z],
        "resolution_x": SIZE[0], "resolution_y": SIZE[1], "baseline": 0.065,
    }  # fmt: skip


def write_rendered(root: Path, scene: str = "163") -> list[Drawn]:
    """Two cameras; depth has a pixel of nothing, one of infinity and one beyond 3 m."""
    top, document, every = root / scene, {}, []
    for c in range(len(CAMERAS)):
        boxes = boxes_of(c)
        drawn = draw(DRAWN, SIZE, boxes)
        every.append(drawn)
        put_color(top / f"Camera_{c}_EmptyVessel_Frame_0_RGB_L.jpg", SIZE, c)
        put_color(top / f"Camera_{c}_EmptyVessel_Frame_0_RGB_R.jpg", SIZE, c)
        depth = drawn.depth.astype(np.float32)
        depth[0, :3] = np.nan, np.inf, 7.5
        write_exr(top / f"Camera_{c}_EmptyVessel_Frame_0_Depth.exr", {"V": depth})
        fields = camera_fields(c)
        for i, (box, name) in enumerate(zip(boxes, NAMES, strict=True)):
            picture = np.zeros((*drawn.index.shape, 3), np.uint8)
            picture[drawn.index == i] = (206, 206, 206)
            picture[drawn.index == 1 - i] = (7, 0, 177)  # OpenCV writes blue, green, red
            edge = cv2.dilate((drawn.index == i).astype(np.uint8), np.ones((3, 3)))
            picture[(edge > 0) & (drawn.index < 0)] = (90, 90, 90)  # more table than object
            first = f"segmentation_Camera_{c}_{name}"
            put(top / f"{first}_visible_L.png", picture)
            put(top / f"{first}_full_L.png", np.full_like(picture, 206))
            put(top / f"{first}_Content_visible_L.png", np.full_like(picture, 206))
            uv = as_authors_project(corners(box))
            fields[f"transparent_{name}"] = {
                "3dbox": {"camera_frame": corners(box).tolist(), "image_frame": uv.tolist()},
                "2dbox_imgframe": {"x1": 0, "x2": 1, "y1": 0, "y2": 1},
                "6dpose_c_obj": (FLIP @ box.T).tolist(), "covariance": np.eye(3).tolist(),
            }  # fmt: skip
        document[f"Camera_{c}"] = fields
    (top / "BoundingBox.json").write_text(json.dumps(document))
    return every


@contextmanager
def authors_module(name: str = "dataloaders.template") -> Iterator[ModuleType]:
    """The records of the authors' program, only while something is written."""
    module = ModuleType(name)
    fields = {
        "Stereo": ("left_color", "right_color", "compressed"),
        "OBB": ("heat_map", "vertex_target", "z_centroid", "cov_matrices", "compressed"),
        "Detection": ("camera_T_object", "scale_matrix", "bbox", "object_name", "score"),
        "Panoptic": ("stereo", "depth", "segmentation", "instance_segmentation", "object_poses",
                     "boxes", "detections", "camera_params", "uid", "compressed"),
    }  # fmt: skip
    for kind, names in fields.items():
        made = dataclasses.make_dataclass(kind, names)
        made.__module__ = name
        setattr(module, kind, made)
    parent = name.partition(".")[0]
    sys.modules[parent], sys.modules[name] = ModuleType(parent), module
    try:
        yield module
    finally:
        del sys.modules[name], sys.modules[parent]


def packed(value: object) -> bytes:
    data: bytes = zstd.compress(pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL))
    return data


def write_syn_todd(
    root: Path, part: str = "test", *, mirrored: bool = False, compressed: bool = True
) -> list[Drawn]:
    """Frames 16300 and 16301, and one of another scene; `mirrored` boxes are in columns W - u."""
    top, every = root / f"synthetic_{part}_pkl", []
    top.mkdir(parents=True)
    with authors_module() as module:
        for uid, c in ((16300, 0), (16301, 1), (16446, 0)):
            boxes = boxes_of(c)
            drawn = draw(DRAWN, SIZE, boxes)
            every.append(drawn)
            detections = [module.Detection(np.eye(4), np.zeros((4, 4)), np.eye(2), "", 1.0)]
            for box, name in zip(boxes, NAMES, strict=True):
                uv = as_authors_project(corners(box))
                if mirrored:
                    uv[:, 0] = SIZE[0] - uv[:, 0]
                bbox = np.stack([uv.min(axis=0), uv.max(axis=0)])
                pose = FLIP @ box.T
                detections.append(
                    module.Detection(pose, np.zeros((4, 4)), bbox, name[:38], np.float64(1))
                )
            image = np.random.default_rng(uid).integers(0, 256, (SIZE[1], SIZE[0], 3), np.uint8)
            image = cv2.GaussianBlur(image, (0, 0), 6)
            stereo = module.Stereo(image, image, False)
            if compressed:
                jpeg = cv2.imencode(".jpg", image)[1].tobytes()
                stereo = module.Stereo(jpeg, jpeg, True)
            # The order of masks on the disk is not that of the boxes: object 0 has the id 3.
            ids = np.array([1, 3, 2])[drawn.index + 1]
            depth = np.minimum(drawn.depth, 3).astype(np.float16)
            obb = module.OBB(np.zeros(ids.shape, np.float16), np.zeros((16, 15, 20), np.float16),
                             np.zeros((15, 20)), np.zeros((15, 20, 6)), True)  # fmt: skip
            record = module.Panoptic(
                stereo, depth, np.minimum(ids, 2.0), ids, [obb], None, detections,
                camera_fields(c), uid, compressed,
            )  # fmt: skip
            (top / f"{uid}.pickle.zstd").write_bytes(packed(record))
    return every


TODD_K = [613.962 / 4, 613.756 / 4, (324.447 + 0.5) / 4 - 0.5, (239.171 + 0.5) / 4 - 0.5]


def write_todd(root: Path, part: str = "test", *, unit: float = 1.0) -> Drawn:
    """Two frames; `unit` is metres per number of the poses."""
    drawn = draw(TODD_K, SIZE)
    raw = with_holes(drawn).astype(np.float32)
    raw[0, 0] = np.nan
    for stem in ("1622410107.5037992", "1622410109.25"):
        top = root / part / stem
        put_color(top / "image.jpg", SIZE)
        write_exr(top / "depth.exr", {"R": raw, "G": raw, "B": raw})
        true = drawn.depth.astype(np.float32)
        write_exr(top / "detph_GroundTruth.exr", dict.fromkeys("RGB", true))
        ids = np.array([0, 10, 20], np.uint8)[drawn.index + 1]
        picture = np.zeros((*ids.shape, 3), np.uint8)
        picture[..., 2] = ids  # OpenCV writes blue, green, red
        put(top / "instance_segment.png", picture)
        poses = {}
        for i, box in enumerate(BOXES):
            pose = box.T[:3].copy()
            pose[:, 3] /= unit
            poses[str(i)] = {"pose": pose.tolist(), "type": "beaker"}
        (top / "pose_type.json").write_text(json.dumps(poses))
    return drawn
