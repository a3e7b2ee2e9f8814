"""BOP data sets: true poses, cameras, depth, models and targets."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.bop_metadata import TARGET_VISIBLE
from std_toolkit.geometry import SE3, Camera, Symmetry
from std_toolkit.geometry.mesh import hull_vertices, load_mesh, mesh_diameter
from std_toolkit.importers import bop_documents, bop_objects, foreign_files
from std_toolkit.io.documents import read_document
from std_toolkit.io.images import image_size
from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh

_ID = Annotated[int, msgspec.Meta(ge=0, le=999_999)]


class BopTarget(msgspec.Struct, frozen=True, kw_only=True):
    """An entry of test_targets_bop19.json: number of instances of an object in an image."""

    scene_id: _ID
    im_id: _ID
    obj_id: _ID
    inst_count: Annotated[int, msgspec.Meta(ge=1)]


class _Visibility(msgspec.Struct, frozen=True, kw_only=True):
    visib_fract: float


@dataclass(frozen=True, eq=False)
class BopModel:
    """A model in the frame of its BOP file, metres.

    Attributes:
        mesh: for rendering.
        vertices: (V, 3) all of them.
        hull: (K, 3) those of the hull.
        diameter_m: largest distance between two of them.
        symmetry: of the model.
    """

    mesh: RenderMesh
    vertices: NDArray[np.float64]
    hull: NDArray[np.float64]
    diameter_m: float
    symmetry: Symmetry


@dataclass(frozen=True, eq=False)
class BopImage:
    """An image's camera and depth, metres."""

    camera: Camera
    depth: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class BopDataset:
    """A split of a data set, opened.

    Attributes:
        root: of the data set.
        split: such as "test".
        targets: what is to be found.
        scenes: their documents by number.
        visible: visible shares by scene and image, in the order of scene_gt.json.
    """

    root: Path
    split: str
    targets: tuple[BopTarget, ...]
    scenes: dict[int, bop_documents.BopScene]
    visible: dict[int, dict[int, list[float]]]

    def truths(self, target: BopTarget) -> tuple[list[SE3], NDArray[np.bool_]]:
        """All true poses of a target's object in its image, and which are to be found.

        These are as many as the target says, the most visible ones.

        Raises:
            ToolkitError: fewer poses than the target says.
        """
        rows = self.scenes[target.scene_id].gt.get(target.im_id, [])
        index = [i for i, row in enumerate(rows) if row.obj_id == target.obj_id]
        if len(index) < target.inst_count:
            raise ToolkitError(
                "fewer true poses than the targets say",
                path=self.folder(target.scene_id) / "scene_gt.json",
                field=f"{target.im_id}, obj_id {target.obj_id}",
                value=len(index),
            )
        shares = self.visible[target.scene_id][target.im_id]
        order = sorted(range(len(index)), key=lambda k: -shares[index[k]])
        valid = np.zeros(len(index), dtype=bool)
        valid[order[: target.inst_count]] = True
        return [rows[i].T_cam_obj for i in index], valid

    def folder(self, scene_id: int) -> Path:
        """Of a scene."""
        return self.root / self.split / f"{scene_id:06d}"

    def image(self, scene_id: int, im_id: int) -> BopImage:
        """Camera and depth of an image.

        Raises:
            ToolkitError: no such image, or no readable depth of it.
        """
        path = self.folder(scene_id) / "depth" / f"{im_id:06d}.png"
        row = self.scenes[scene_id].cameras.get(im_id)
        if row is None or not path.is_file():
            raise ToolkitError("VSD needs the image's depth", path=path)
        size = image_size(path)
        depth = foreign_files.read_foreign_depth(path, size=size).values.astype(np.float32)
        fx, fy, cx, cy = row.intrinsics
        return BopImage(Camera(*size, fx, fy, cx, cy), depth * np.float32(row.depth_scale_m))

    def model(self, obj_id: int) -> BopModel:
        """A model, from models_eval/ where there is one, else models/.

        Raises:
            ToolkitError: the model is missing or damaged.
        """
        folder = next(
            (f for f in (self.root / "models_eval", self.root / "models") if f.is_dir()), None
        )
        if folder is None:
            raise ToolkitError("the data set's models are missing", path=self.root / "models")
        mesh = load_mesh(folder / f"obj_{obj_id:06d}.ply", unit="mm")
        info_path = folder / "models_info.json"
        infos = (
            read_document(info_path, dict[str, bop_documents.ModelInfo])
            if info_path.is_file()
            else {}
        )
        info = infos.get(str(obj_id))
        with bop_documents.named(info_path, str(obj_id)):
            symmetry = bop_objects.symmetry_of(info, np.zeros(3)).symmetry()
        given = None if info is None else info.diameter
        return BopModel(
            prepare_mesh(mesh),
            np.asarray(mesh.vertices, dtype=np.float64),
            hull_vertices(mesh),
            mesh_diameter(mesh) if given is None else given * bop_documents.MM,
            symmetry,
        )


def open_bop(root: Path | str, split: str = "test") -> BopDataset:
    """Open a split of a data set in BOP's layout.

    Args:
        root: of the data set.
        split: folder of the scenes.

    Returns:
        The data set. Targets are those of test_targets_bop19.json where it is there, else all
        instances of which a tenth is visible.

    Raises:
        ToolkitError: documents are missing, break the format, or do not belong together.

    >>> open_bop("/nowhere")
    Traceback (most recent call last):
    std_toolkit.errors.ToolkitError: /nowhere/test: no scenes of a BOP data set here
    """
    root = Path(root)
    folders = sorted(p.parent for p in (root / split).glob("*/scene_gt.json"))
    folders = [f for f in folders if f.name.isdigit()]
    if not folders:
        raise ToolkitError("no scenes of a BOP data set here", path=root / split)
    scenes = {int(f.name): bop_documents.read_bop_scene(f) for f in folders}
    visible = {number: _visibility(scene) for number, scene in scenes.items()}
    path = root / "test_targets_bop19.json"
    if split == "test" and path.is_file():
        targets = read_document(path, list[BopTarget])
        for target in targets:
            if target.scene_id not in scenes:
                raise ToolkitError("no such scene", path=path, value=target.scene_id)
    else:
        targets = _all_visible(scenes, visible)
    return BopDataset(root, split, tuple(targets), scenes, visible)


def _visibility(scene: bop_documents.BopScene) -> dict[int, list[float]]:
    path = scene.folder / "scene_gt_info.json"
    infos = read_document(path, dict[str, list[_Visibility]])
    shares = {int(k): [row.visib_fract for row in rows] for k, rows in infos.items()}
    for im_id, rows in scene.gt.items():
        if len(shares.get(im_id, [])) != len(rows):
            raise ToolkitError("does not match scene_gt.json", path=path, field=str(im_id))
    return shares


def _all_visible(
    scenes: dict[int, bop_documents.BopScene], visible: dict[int, dict[int, list[float]]]
) -> list[BopTarget]:
    counts: dict[tuple[int, int, int], int] = defaultdict(int)
    for number, scene in scenes.items():
        for im_id, rows in scene.gt.items():
            for row, share in zip(rows, visible[number][im_id], strict=True):
                if share >= TARGET_VISIBLE:
                    counts[number, im_id, row.obj_id] += 1
    return [
        BopTarget(scene_id=s, im_id=i, obj_id=o, inst_count=n)
        for (s, i, o), n in sorted(counts.items())
    ]
