"""Small sets in the layouts of the field's data sets, written from their description alone.

Boxes with three different sides and a turn, in front of a wall, drawn by a pinhole camera of this
file: depth, masks, poses and meshes agree. Nothing here uses the constants of the readers.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.spatial.transform import Rotation

WALL_M = 1.25


@dataclass(frozen=True)
class Box:
    """A box: sides in metres, and where it stands in the camera's frame."""

    sides: tuple[float, float, float]
    turn: tuple[float, float, float]
    centre: tuple[float, float, float]

    @property
    def R(self) -> NDArray[np.float64]:
        return Rotation.from_euler("xyz", self.turn, degrees=True).as_matrix()

    @property
    def T(self) -> NDArray[np.float64]:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.R, self.centre
        return T

    def save(self, path: Path, unit: float = 1.0) -> None:
        """Its mesh in its own frame; `unit` is metres per number."""
        path.parent.mkdir(parents=True, exist_ok=True)
        trimesh.creation.box(np.array(self.sides) / unit).export(path)


BOXES = (
    Box((0.10, 0.22, 0.05), (20, 35, 10), (-0.16, 0.02, 0.80)),
    Box((0.18, 0.07, 0.12), (-30, 15, 50), (0.14, -0.05, 0.90)),
)


@dataclass(frozen=True)
class Drawn:
    """What was drawn: metres of the wall and the boxes, and the index of the box or -1."""

    depth: NDArray[np.float64]
    index: NDArray[np.int64]

    @property
    def objects(self) -> NDArray[np.bool_]:
        return self.index >= 0


def draw(K: Sequence[float], size: tuple[int, int], boxes: Sequence[Box] = BOXES) -> Drawn:
    """Cut the ray of each pixel with the slabs of each box.

    Args:
        K: fx, fy, cx, cy.
        size: (width, height).
    """
    fx, fy, cx, cy = K
    u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.shape)], axis=-1)
    depth = np.full(u.shape, WALL_M)
    index = np.full(u.shape, -1)
    for i, box in enumerate(boxes):
        begin, along = -box.R.T @ np.array(box.centre), rays @ box.R
        with np.errstate(divide="ignore"):
            ends = (np.array([-0.5, 0.5])[:, None] * box.sides - begin)[:, None, None] / along
        enter, leave = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
        hit = (enter <= leave) & (enter > 0) & (enter < depth)
        depth[hit], index[hit] = enter[hit], i
    return Drawn(depth, index)


def with_holes(drawn: Drawn) -> NDArray[np.float64]:
    """What a sensor measures: the wall, but nothing on the right half of the first box, and the
    second one 2 cm too far."""
    raw = drawn.depth.copy()
    raw[drawn.index == 1] += 0.02
    columns = np.flatnonzero((drawn.index == 0).any(axis=0))
    right = np.arange(raw.shape[1]) > columns.mean()
    raw[(drawn.index == 0) & right] = 0
    return raw


def put(path: Path, image: NDArray[Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def put_depth(path: Path, metres: NDArray[np.float64], unit: float) -> None:
    put(path, np.rint(metres / unit).astype(np.uint16))


def put_color(path: Path, size: tuple[int, int], seed: int = 0) -> None:
    put(path, np.random.default_rng(seed).integers(0, 256, (size[1], size[0], 3), np.uint8))


# HAMMER at a quarter of 1088x832: the K of the description, divided by four with pixel centres.
HAMMER_SIZE = (272, 208)
HAMMER_K = [706.755 / 4, 707.513 / 4, (545.633 + 0.5) / 4 - 0.5, (389.930 + 0.5) / 4 - 0.5]


def write_hammer(root: Path, *, inner: str = "polarization", frames: int = 2) -> Drawn:
    """All nine test sequences, one of them without objects, and one of scene 3."""
    drawn = draw(HAMMER_K, HAMMER_SIZE)
    names = [f"scene{s}_traj{t}" for s in (12, 13, 14) for t in ("1_1", "2_1", "2_2")]
    for name in (*names, "scene12_traj1_naked_1", "scene3_traj1_1"):
        top = root / name / inner if inner else root / name
        for i in range(frames):
            put_color(top / f"rgb/{i:06d}.png", HAMMER_SIZE, i)
            put_depth(top / f"_gt/{i:06d}.png", drawn.depth, 0.001)
            put_depth(top / f"depth_d435/{i:06d}.png", with_holes(drawn), 0.001)
            put_depth(top / f"depth_l515/{i:06d}.png", drawn.depth + 0.01, 0.001)
            put_depth(top / f"depth_tof/{i:06d}.png", drawn.depth + 0.03, 0.001)
            (top / "_pose").mkdir(exist_ok=True)
            np.savetxt(top / f"_pose/{i:06d}.txt", np.eye(4))
    return drawn


CLEARPOSE_SIZE = (160, 120)
CLEARPOSE_K = [150.3, 150.3, 83.4, 61.7]
# A transparent object, and an opaque one of YCB.
CLEARPOSE_LABELS = (17, 64)


def write_clearpose(
    root: Path, scenes: Sequence[str] = ("set1/scene1", "set2/scene3", "set8/scene5"),
    *, field: str = "intrinsic_matrix", boxes: Sequence[Box] = BOXES,
) -> Drawn:  # fmt: skip
    """Scenes with two frames each: true depth is the sensor off the objects."""
    drawn = draw(CLEARPOSE_K, CLEARPOSE_SIZE, boxes)
    raw = with_holes(drawn) if len(boxes) > 1 else drawn.depth
    fx, fy, cx, cy = CLEARPOSE_K
    labels = np.array([0, *CLEARPOSE_LABELS], np.uint8)[drawn.index + 1]
    poses = np.stack([box.T[:3] for box in boxes], axis=-1)
    row = {
        "cls_indexes": np.array(CLEARPOSE_LABELS[: len(boxes)])[:, None],
        "factor_depth": 1000,
        field: np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
        "poses": poses,
        "rotation_translation_matrix": np.eye(4)[:3],
    }
    for scene in scenes:
        top = root / scene
        for stem in ("000000", "000005"):
            put_color(top / f"{stem}-color.png", CLEARPOSE_SIZE)
            put_depth(top / f"{stem}-depth.png", raw, 0.001)
            put_depth(top / f"{stem}-depth_true.png",
                      np.where(drawn.objects, drawn.depth, raw), 0.001)  # fmt: skip
            put(top / f"{stem}-label.png", labels)
        savemat(top / "metadata.mat", {"000000": row, "000005": row})
    return drawn


TRANSCG_SIZE = (320, 180)
TRANSCG_K = {1: [231.8, 231.8, 162.6, 87.2], 2: [225.6, 225.7, 162.5, 91.1]}
# L515 from D435: beside it, a little turned.
TRANSCG_SHIFT = Box((1, 1, 1), (0, 4, 0), (0.03, -0.01, 0.005)).T


def write_transcg(root: Path, *, samples: int | None = None) -> dict[int, Drawn]:
    """Three scenes of 240 perspectives, of which few are valid."""
    valid = {1: [0, 7, 215], 2: [7, 30]}
    moved = [
        Box(b.sides, tuple(Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)),
            tuple(T[:3, 3]))
        for b in BOXES
        for T in [TRANSCG_SHIFT @ b.T]
    ]  # fmt: skip
    drawn = {1: draw(TRANSCG_K[1], TRANSCG_SIZE), 2: draw(TRANSCG_K[2], TRANSCG_SIZE, moved)}
    intrinsics = root / "camera_intrinsics"
    intrinsics.mkdir(parents=True)
    for camera, name in ((1, "1-camIntrinsics-D435"), (2, "2-camIntrinsics-L515")):
        fx, fy, cx, cy = TRANSCG_K[camera]
        np.save(intrinsics / f"{name}.npy", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]))
    np.save(root / "T_camera2_camera1.npy", TRANSCG_SHIFT)
    each = sum(map(len, valid.values()))
    (root / "metadata.json").write_text(json.dumps({
        "total_scenes": 3, "perspective_num": 240, "train": [1, 3], "test": [2],
        "train_samples": 2 * each, "test_samples": each if samples is None else samples,
    }))  # fmt: skip
    for scene in (1, 2, 3):
        top = root / f"scene{scene}"
        for camera, unit in ((1, 1 / 1000), (2, 1 / 4000)):
            for p in valid[camera]:
                one, at = drawn[camera], top / str(p)
                raw = with_holes(one)
                put_color(at / f"rgb{camera}.png", TRANSCG_SIZE)
                put_depth(at / f"depth{camera}.png", raw, unit)
                pasted = np.where(one.objects, one.depth, raw)
                put_depth(at / f"depth{camera}-gt.png", pasted, unit)
                put(at / f"depth{camera}-gt-mask.png", one.objects.astype(np.uint8))
                (at / "corrected_pose").mkdir(exist_ok=True)
                for k, box in enumerate(BOXES):
                    np.save(at / f"corrected_pose/{k}.npy", box.T)
        (top / "metadata.json").write_text(json.dumps({
            "type": "cluttered", "split": "test", "model_list": [3, 5],
            "D435_valid_perspective_list": valid[1], "D435_valid_perspective_num": 3,
            "L515_valid_perspective_list": valid[2], "L515_valid_perspective_num": 2,
        }))  # fmt: skip
    return drawn


BOP_SIZE, BOP_K = (160, 120), [140.0, 141.0, 81.5, 60.25]


def write_bop_sensors(root: Path, sensor: str, *, gray: bool = False, first: int = 4) -> Drawn:
    """A scene of val with two objects, depth in tenths of a millimetre; id 0 may exist."""
    drawn = draw(BOP_K, BOP_SIZE)
    top, fx, fy, cx, cy = root / "val" / "000000", *BOP_K
    gt = [
        {"obj_id": first + i, "cam_R_m2c": box.R.ravel().tolist(),
         "cam_t_m2c": (1000 * np.array(box.centre)).tolist()}
        for i, box in enumerate(BOXES)
    ]  # fmt: skip
    camera = {"cam_K": [fx, 0, cx, 0, fy, cy, 0, 0, 1], "depth_scale": 0.1}
    put_color(top / f"{'gray' if gray else 'rgb'}_{sensor}/000000.png", BOP_SIZE)
    put_depth(top / f"depth_{sensor}/000000.png", with_holes(drawn), 0.0001)
    for i, box in enumerate(BOXES):
        put(top / f"mask_visib_{sensor}/000000_{i:06d}.png", 255 * (drawn.index == i).astype("u1"))
        box.save(root / f"models/obj_{first + i:06d}.ply", unit=0.001)
    (top / f"scene_gt_{sensor}.json").write_text(json.dumps({"0": gt}))
    (top / f"scene_camera_{sensor}.json").write_text(json.dumps({"0": camera}))
    return drawn


def write_pace(root: Path, part: str, unit: float, channels: int) -> Drawn:
    """A scene of a part: no sensor's name; `depth_scale` 1, whatever the unit of depth is."""
    drawn = draw(BOP_K, BOP_SIZE)
    top, fx, fy, cx, cy = root / part / "000000", *BOP_K
    gt = [
        {"obj_id": number, "cam_R_m2c": box.R.ravel().tolist(),
         "cam_t_m2c": (1000 * np.array(box.centre)).tolist()}
        for number, box in zip((7, 545), BOXES, strict=True)
    ]  # fmt: skip
    camera = {"cam_K": [fx, 0, cx, 0, fy, cy, 0, 0, 1], "depth_scale": 1.0}
    put_color(top / "rgb/000000.png", BOP_SIZE)
    put_depth(top / "depth/000000.png", with_holes(drawn), unit)
    for i, (row, box) in enumerate(zip(gt, BOXES, strict=True)):
        mask = 255 * (drawn.index == i).astype("u1")
        put(top / f"mask_visib/000000_{i:06d}.png", np.dstack([mask] * channels))
        box.save(root / f"models/obj_{row['obj_id']:06d}.ply", unit=0.001)
    (top / "scene_gt.json").write_text(json.dumps({"0": gt}))
    (top / "scene_camera.json").write_text(json.dumps({"0": camera}))
    return drawn


HOUSECAT_SIZE, HOUSECAT_K = (274, 213), [188.0, 188.0, 136.5, 106.0]


def write_housecat(root: Path, scene: str = "test_scene1", protocol: int = 4) -> Drawn:
    """A frame with a glass (id 1) and a fork (id 2); ids in the red channel."""
    drawn = draw(HOUSECAT_K, HOUSECAT_SIZE)
    top, fx, fy, cx, cy = root / scene, *HOUSECAT_K
    put_color(top / "rgb/000000.png", HOUSECAT_SIZE)
    put_depth(top / "depth/000000.png", with_holes(drawn), 0.001)
    instance = np.zeros((*drawn.index.shape, 3), np.uint8)
    instance[..., 2] = drawn.index + 1  # OpenCV writes blue, green, red
    put(top / "instance/000000.png", instance)
    np.savetxt(top / "intrinsics.txt", [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    (top / "meta.txt").write_text("1 8 glass-new_3\n2 7 cutlery-fork_1\n")
    labels = {
        "instance_ids": [1, 2],
        "class_ids": np.array([8, 7]),
        "bboxes": np.zeros((2, 4)),
        "rotations": np.stack([b.R for b in BOXES]).astype(np.float32),
        "translations": np.array([b.centre for b in BOXES]),
        "gt_scales": np.array([b.sides for b in BOXES]),
    }
    (top / "labels").mkdir()
    with (top / "labels/000000_label.pkl").open("wb") as file:
        pickle.dump(labels, file, protocol=protocol)
    for box, name in zip(BOXES, ("glass/glass-new_3", "cutlery/cutlery-fork_1"), strict=True):
        box.save(root / f"obj_models_small_size_final/{name}.obj")
    return drawn


ROBI_SIZE = (320, 256)
ROBI_K = [1083.097 / 4, 1083.097 / 4, (379.327 + 0.5) / 4 - 0.5, (509.437 + 0.5) / 4 - 0.5]


def write_robi(root: Path, truth: str) -> Drawn:
    """Three views of the Ensenso, two of them with true depth; numbers of 1/32 mm."""
    drawn = draw(ROBI_K, ROBI_SIZE)
    top, unit = root / "Zigzag" / "Scene_1", 0.001 / 32
    for view in (70, 71, 72):
        put_depth(top / f"Ensenso/Depth/DEPTH_view_{view}.png", with_holes(drawn), unit)
        grey = np.full((ROBI_SIZE[1], ROBI_SIZE[0]), view, np.uint8)
        put(top / f"Ensenso/Stereo/LEFT_view_{view}.bmp", grey)
        for side in ("LEFT", "RIGHT"):
            put(top / f"Ensenso/StereoPattern/{side}_view_{view}.bmp", grey)
        if view > 70:
            put_depth(top / truth / f"DEPTH_view_{view}.png", drawn.depth, unit)
    return drawn


NOCS_SIZE = (640, 480)
NOCS_K = {"Real": [591.0125, 590.16775, 322.525, 244.11084], "CAMERA": [577.5, 577.5, 319.5, 239.5]}
# Ids of the two objects; their names, or synset and model.
NOCS_IDS, NOCS_BACK = (2, 5), 1
NOCS_NAMES = {"Real": ("mug_a_norm", "laptop_b_norm"), "CAMERA": ("0379/m1", "0364/l1")}


def stepped(box: Box) -> tuple[Box, Box]:
    """A box and a step on its y side, which has no plane of symmetry."""
    sides = np.array(box.sides)
    centre = np.array(box.centre) + box.R @ (sides * (0.1, 0.75, 0.2))
    return box, Box(tuple(sides * (0.4, 0.5, 0.6)), box.turn, tuple(centre))


@dataclass(frozen=True)
class NocsDrawn:
    """Depth in metres, index of the object or -1, normalised coordinates, and similarities."""

    depth: NDArray[np.float64]
    index: NDArray[np.int64]
    coordinates: NDArray[np.float64]
    RTs: NDArray[np.float64]
    sides: NDArray[np.float64]


def write_nocs(root: Path, data: str, part: str, *, pickled: bool, channels: int = 1) -> NocsDrawn:
    """A frame with a mug and a laptop, an object of class 0, and a listed one that is not seen.

    Real meshes are in metres; synthetic ones have another size, and z the other way round.
    """
    size, (fx, fy, cx, cy) = NOCS_SIZE, NOCS_K[data]
    found = draw(NOCS_K[data], size, [part for box in BOXES for part in stepped(box)])
    index = np.where(found.index < 0, -1, found.index // 2)
    u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    points = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.shape)], -1) * found.depth[..., None]
    coordinates, RTs, all_sides = np.zeros(points.shape), [], []
    synthetic = data == "CAMERA"
    models = root / "obj_models"
    for i, box in enumerate(BOXES):
        sides = np.array(box.sides) * (1, 1.5, 1)
        middle = np.array(box.centre) + box.R @ (np.array(box.sides) * (0, 0.25, 0))
        diagonal = np.linalg.norm(sides)
        coordinates[index == i] = ((points - middle) @ box.R / diagonal + 0.5)[index == i]
        RT = np.eye(4)
        RT[:3, :3], RT[:3, 3] = diagonal * box.R, middle
        RTs.append(RT)
        all_sides.append(sides / diagonal)
        meshes = []
        for one in stepped(box):
            mesh = trimesh.creation.box(one.sides)
            mesh.apply_translation(box.R.T @ (np.array(one.centre) - middle))
            meshes.append(mesh)
        mesh = trimesh.util.concatenate(meshes)
        if synthetic:
            mesh.vertices = mesh.vertices * (1, 1, -1) / diagonal
            mesh.invert()
        name = NOCS_NAMES[data][i]
        path = models / (f"{part}/{name}/model.obj" if synthetic else f"real_{part}/{name}.obj")
        path.parent.mkdir(parents=True, exist_ok=True)
        mesh.export(path)
    scene = "00000" if synthetic else "scene_1"
    top = root / data / part / scene
    put_color(top / "0000_color.png", size)
    raw = np.rint(1000 * found.depth).astype(np.uint16)
    columns = np.flatnonzero((index == 0).any(axis=0))
    raw[(index == 0) & (np.arange(size[0]) > columns.mean())] = 0
    if channels == 3:  # OpenCV writes blue, green, red
        raw[raw == 0] = 32001
        raw = np.dstack([np.full_like(raw, 7), raw // 256, raw % 256]).astype(np.uint8)
    put(top / "0000_depth.png", raw)
    ids = np.array([255, *NOCS_IDS], np.uint8)[index + 1]
    ids[:20, :20] = NOCS_BACK
    put(top / "0000_mask.png", np.dstack([np.zeros_like(ids), np.zeros_like(ids), ids]))
    filed = np.where(index[..., None] >= 0, coordinates * (1, 1, -1) + (0, 0, 1), 1)
    put(top / "0000_coord.png", np.rint(255 * filed).astype(np.uint8)[..., ::-1])
    named = [name.replace("/", " ") for name in NOCS_NAMES[data]]
    unseen = "9 4 can_c_norm" if not synthetic else "9 4 0294 c1"
    (top / "0000_meta.txt").write_text(
        f"5 5 {named[1]}\n{unseen}\n{NOCS_BACK} 0 {named[0]}\n2 6 {named[0]}\n"
    )
    if pickled:
        folder = "val" if synthetic else "real_test"
        path = root / "gts" / folder / f"results_{folder}_{scene}_0000.pkl"
        path.parent.mkdir(parents=True)
        labels = {"gt_RTs": np.stack(RTs), "handle_visibility": np.array([0, 1])}
        path.write_bytes(pickle.dumps(labels))
    return NocsDrawn(found.depth, index, coordinates, np.stack(RTs), np.stack(all_sides))
