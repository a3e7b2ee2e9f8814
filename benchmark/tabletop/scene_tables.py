"""Labelled scenes as tables: their objects, at their poses and with their materials.

The plane of the table is found as for labelling. Labels overlap or float by some millimetres; the
objects come to rest from their labelled poses.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.data.toolkit_scenes import scene_folders
from benchmark.tabletop.arrange import MASS_KG, TABLE_HALF_M, Arrangement, TableObject
from sensors.assets.mesh_file import read_asset
from sensors.materials.material_draw import draw_material
from sensors.physics import PhysicalObject, convex_parts, settle_from
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import nocs_frame
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.documents import digest_file
from std_toolkit.labels.support.plane import TablePlane
from std_toolkit.labels.support.table import search_table
from std_toolkit.log import logger
from std_toolkit.scene.scene import Scene
from std_toolkit.settings import NOT_RECORDED, Settings, limit

_DOCUMENTS = ("scene.json", "frames.json", "objects.json", "poses.json", "labels.json")


@dataclass(frozen=True, kw_only=True)
class SceneTableSettings(Settings):
    """Labelled objects that stand on a table."""

    fell_m: float = limit(0.03, unit="m", source=NOT_RECORDED)
    """an object that moves further until it is at rest stood on something without a label"""


@dataclass(frozen=True)
class SceneTables:
    """Tables of the labelled scenes of a folder, one for each.

    Attributes:
        folders: folders of the scenes.
    """

    folders: tuple[Path, ...]

    def __len__(self) -> int:
        return len(self.folders)

    def digest(self) -> str:
        """Return a hash of the documents and the meshes of all scenes."""
        found = hashlib.sha256()
        for folder in self.folders:
            scene = Scene.open(folder)
            meshes = [scene.mesh_path(model) for model in scene.objects.models]
            for path in (*(folder / name for name in _DOCUMENTS), *meshes):
                if path.is_file():
                    name = path.relative_to(folder).as_posix()
                    found.update(f"{folder.name}/{name} {digest_file(path)}\n".encode())
        return found.hexdigest()

    def arrange(self, index: int, seed: int, *, parts_cache: Path | None = None) -> Arrangement:
        """Return the table of scene `index`.

        The middle of the objects is at the origin. The x axis is that of the image of the first
        frame with a pose, so that the table is seen as in this frame.

        Args:
            index: index of the scene.
            seed: of the masses and of what the materials' classes leave open.
            parts_cache: cache folder of convex parts.

        Raises:
            ToolkitError: no labelled object, no table, objects beyond its edge, or objects that do
                not come to rest.
        """
        scene = Scene.open(self.folders[index])
        rng = np.random.default_rng([seed, 20])
        objects: list[TableObject] = []
        in_world: list[SE3] = []
        centres: list[NDArray[np.float64]] = []
        for obj in scene.objects.objects:
            T_world_obj = scene.T_world_obj(obj.id)
            if T_world_obj is None:
                logger.warning("%s: %s has no pose and is left out", scene.root, obj.name)
                continue
            model = scene.objects.model(obj.model)
            asset = read_asset(
                scene.mesh_path(model), asset_id=model.id, category=model.category, unit="m"
            )
            assert asset.diagonal_m is not None
            body = PhysicalObject(asset, asset.diagonal_m, convex_parts(asset, parts_cache))
            material = draw_material(rng, obj.material, textured=asset.texture is not None)
            mass = float(rng.uniform(*MASS_KG))
            objects.append(TableObject(len(objects), body, material, mass))
            in_world.append(T_world_obj)
            centres.append(nocs_frame(scene.mesh(obj.model))[0])
        if not objects:
            raise ToolkitError(
                "no object of the scene has a pose in the world",
                path=scene.root,
                hint="label the objects, then `std-curate propagate`",
            )
        found = search_table(scene)
        if found.table is None:
            raise ToolkitError(found.reason, path=scene.root)
        T_table_world = _table_frame(scene, found.table, np.array([T.t for T in in_world]))
        start = [
            T_table_world @ SE3(T.R, T @ centre)
            for T, centre in zip(in_world, centres, strict=True)
        ]
        _check_on_table(scene, objects, start)
        poses = settle_from([o.body for o in objects], start)
        for o, a, b in zip(objects, start, poses, strict=True):
            if (moved := float(np.linalg.norm(a.t - b.t))) > SceneTableSettings.current().fell_m:
                logger.warning(
                    "%s: %s moved by %.0f mm until it was at rest",
                    scene.root,
                    o.label,
                    1000 * moved,
                )
        return Arrangement(seed, tuple(objects), tuple(poses))


def open_scene_tables(top: Path) -> SceneTables:
    """Find the scenes at and below a folder.

    Raises:
        ToolkitError: there is none.
    """
    folders = scene_folders(top)
    if not folders:
        raise ToolkitError("no scene here: no folder holds a scene.json", path=top)
    return SceneTables(tuple(folders))


def _table_frame(scene: Scene, table: TablePlane, centres: NDArray[np.float64]) -> SE3:
    """T_table_world: z up, the middle of the objects at the origin, x to the right of the image."""
    up = table.plane.normal
    middle = table.plane.project((centres.min(axis=0) + centres.max(axis=0)) / 2)
    T_world_cam = scene.T_world_cam(scene.registered_frames()[0].id)
    assert T_world_cam is not None
    # Of a camera that is turned by 90 degrees, the image's x axis is upright.
    level = T_world_cam.R - np.outer(up, up @ T_world_cam.R)
    axis = level[:, 0] if np.linalg.norm(level[:, 0]) > 0.5 else level[:, 1]
    x = axis / np.linalg.norm(axis)
    return SE3(np.stack([x, np.cross(up, x), up]), np.zeros(3)) @ SE3(np.eye(3), -middle)


def _check_on_table(scene: Scene, objects: list[TableObject], poses: list[SE3]) -> None:
    for o, T in zip(objects, poses, strict=True):
        if (beside := float(np.abs(T.t[:2]).max())) > TABLE_HALF_M:
            raise ToolkitError(
                f"the {o.label} is {beside:.2f} m from the middle of the objects, beyond the "
                f"table's edge ({TABLE_HALF_M} m)",
                path=scene.root,
            )
        low = min(float((T @ (part * o.body.diagonal_m))[:, 2].min()) for part in o.body.parts)
        if low < -SceneTableSettings.current().fell_m:
            raise ToolkitError(
                f"the {o.label} is {-1000 * low:.0f} mm below the table",
                path=scene.root,
                hint="check its label and the plane with `std-curate check`",
            )
