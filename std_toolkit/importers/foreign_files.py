"""Files of other layouts: converts instance masks and meshes to ids and metres.

Also tells whether a file or folder is a recording of ROS, without a reader of it.
"""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import check_mesh_size, mesh_diameter, mesh_extents
from std_toolkit.geometry.mesh_proof import check_copy
from std_toolkit.importers.depth_files import check_aligned
from std_toolkit.io import atomic, exr, images
from std_toolkit.io.bounded_bags import LARGEST_MESSAGE_BYTES
from std_toolkit.scene.model import CATEGORY_CLASS_IDS, Model, SymmetryModel

if TYPE_CHECKING:
    import trimesh

_ROS_FILES = (".mcap", ".db3", ".bag")
# librealsense writes .bag and .db3 too, with topics of its own.
_LIBREALSENSE = "/device_"


def read_mask_source(path: Path, *, size: tuple[int, int] | None) -> np.ndarray:
    """Instance ids (H, W) uint8 or uint16 of a foreign mask.

    A PNG contains the ids, in one channel or in equal ones. An EXR of DREDS contains id/255 as
    float in channel R. The ids are rounded; the public loader truncates, which gives wrong ids
    for half floats.

    Raises:
        ToolkitError: unreadable, of another size, or not a mask.
    """
    if path.suffix.lower() == ".exr":
        if size is not None:
            check_aligned(path, exr.exr_size(path), size)
        channels = exr.read_exr(path)
        values = channels.get("R", next(iter(channels.values()))).astype(np.float64) * 255
        if not np.isfinite(values).all() or values.min() < 0 or values.max() > 255.5:
            raise ToolkitError("a mask in EXR must contain id/255 between 0 and 1", path=path)
        return np.rint(values).astype(np.uint8)
    image = images.read_png(path, size=size)
    if image.ndim == 3:
        if not (image == image[..., :1]).all():
            raise ToolkitError("a mask must have ids in one channel or in equal ones", path=path)
        image = np.ascontiguousarray(image[..., 0])
    return image


def write_mesh(path: Path, mesh: trimesh.Trimesh) -> None:
    """Write a mesh in metres; the suffix (.ply or .glb) selects the format.

    Raises:
        ToolkitError: its size is implausible in metres, or what was written is not the mesh.
    """
    check_mesh_size(mesh, path=path)
    data = mesh.export(file_type=path.suffix.lower().lstrip("."))
    assert isinstance(data, bytes)  # both formats are binary
    check_copy({path.name: data}, mesh, path)
    atomic.write_bytes_atomic(path, data)


def mesh_suffix(mesh: trimesh.Trimesh) -> str:
    """ ".glb" for a mesh with a texture, which PLY cannot store; otherwise ".ply"."""
    material = getattr(mesh.visual, "material", None)
    pictures = (getattr(material, key, None) for key in ("image", "baseColorTexture"))
    return ".glb" if any(picture is not None for picture in pictures) else ".ply"


def model_of_mesh(
    mesh: trimesh.Trimesh,
    *,
    model_id: str,
    category: str,
    symmetry: SymmetryModel | None = None,
    class_id: int | None = None,
    suffix: str = ".ply",
) -> Model:
    """The table row of a mesh in metres."""
    return Model(
        id=model_id,
        mesh=f"models/{model_id}/{model_id}{suffix}",
        category=category,
        class_id=CATEGORY_CLASS_IDS.get(category, 0) if class_id is None else class_id,
        size_m=[float(x) for x in mesh_extents(mesh)],
        diameter_m=mesh_diameter(mesh),
        symmetry=symmetry or SymmetryModel(),
    )


def natural_key(text: str) -> tuple[tuple[int, int | str], ...]:
    """Sort key that orders numbers inside names by value: 2 before 10."""
    parts = re.split(r"(\d+)", text)
    return tuple((0, int(p)) if p.isdigit() else (1, p) for p in parts if p)


def is_ros_recording(source: Path | str) -> bool:
    """Whether a file or folder is a recording of ROS, and none of librealsense."""
    source = Path(source)
    if source.is_dir():
        kinds = {path.suffix for path in source.iterdir()}
        return (source / "metadata.yaml").is_file() and bool(kinds & {".mcap", ".db3", ".zstd"})
    if not source.is_file() or source.suffix.lower() not in _ROS_FILES:
        return False
    if source.suffix.lower() == ".mcap":
        return True
    if source.suffix.lower() == ".db3":
        return not _topics_of_db3(source).startswith(_LIBREALSENSE)
    with source.open("rb") as file:
        return _LIBREALSENSE.encode() not in file.read(1 << 20)


def check_database(path: Path) -> None:
    """Check that no page is missing, which SQLite reads as zeros, and that tables are tables.

    The rows of a view are computed when they are read, without end if it says so.

    Raises:
        ToolkitError: the file is shorter than it declares, is no database, or has views.
    """
    with path.open("rb") as file:
        head = file.read(32)
    size, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
    if path.stat().st_size < (65536 if size == 1 else size) * pages or len(head) < 32:
        raise ToolkitError("the file was cut short", path=path, hint="copy or record it again")
    try:
        with closing(_database(path)) as database:
            other = database.execute(
                "SELECT name FROM sqlite_master WHERE type = 'view' OR sql LIKE 'CREATE VIRTUAL%'"
            ).fetchone()
    except (sqlite3.Error, ValueError) as error:
        raise ToolkitError(f"not a readable database: {error}", path=path) from error
    if other is not None:
        problem = "has a view or a virtual table; recordings of ROS have none"
        raise ToolkitError(problem, path=path, value=str(other[0])[:80])


def check_message_sizes(path: Path, types: Sequence[str]) -> None:
    """Check that no message of these types in a .db3 is too large; none is read.

    Raises:
        ToolkitError: one is; its topic is named.
    """
    listed = ", ".join("?" * len(types))
    try:
        with closing(_database(path)) as database:
            # The length of a blob stands before it.
            row = database.execute(
                "SELECT t.name, m.timestamp, length(m.data) FROM messages m JOIN topics t "
                f"ON m.topic_id = t.id WHERE t.type IN ({listed}) AND length(m.data) > ? LIMIT 1",
                (*types, LARGEST_MESSAGE_BYTES),
            ).fetchone()
    except sqlite3.Error as error:
        raise ToolkitError(f"not a readable recording: {error}", path=path) from error
    if row is not None:
        refuse_message(path, str(row[0]), int(row[1]), int(row[2]))


def refuse_message(path: Path, topic: str, stamp_ns: int, size: int) -> NoReturn:
    """Raise the error for a message that is larger than an image can be."""
    raise ToolkitError(
        f"a message of {size / 2**20:.0f} MB at {stamp_ns * 1e-9:.3f} s; images have at most "
        f"{LARGEST_MESSAGE_BYTES // 2**20} MB",
        path=path, field=topic[:200], hint="record smaller or compressed images",
    )  # fmt: skip


def _database(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)


def _topics_of_db3(path: Path) -> str:
    try:
        check_database(path)
    except ToolkitError as error:
        # The reader of librealsense names what is damaged; that of ROS calls this again.
        return _LIBREALSENSE if isinstance(error.__cause__, sqlite3.Error) else ""
    try:
        with closing(_database(path)) as database:
            row = database.execute("SELECT name FROM topics ORDER BY name LIMIT 1").fetchone()
    except sqlite3.Error:
        return _LIBREALSENSE
    return str(row[0]) if row else ""
