"""Files of other layouts: converts depth images, instance masks and meshes to metres and ids.

Also tells whether a file or folder is a recording of ROS, without a reader of it.
"""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import check_mesh_size, mesh_diameter, mesh_extents
from std_toolkit.io import atomic, exr, images
from std_toolkit.io.tiff import TIFF_SUFFIXES, read_tiff
from std_toolkit.scene.model import CATEGORY_CLASS_IDS, Model, SymmetryModel

if TYPE_CHECKING:
    import trimesh

DEPTH_SUFFIXES = (".png", ".exr")

# RGB-D sensors measure about 0.1 to 10 m; depth outside this range has a wrong unit.
NEAREST_MEDIAN_M, FARTHEST_MEDIAN_M = 0.1, 10.0

_SATURATED = 65535

_ROS_FILES = (".mcap", ".db3", ".bag")
# librealsense writes .bag and .db3 too, with topics of its own.
_LIBREALSENSE = "/device_"


@dataclass(frozen=True)
class ForeignDepth:
    """A depth image as read.

    Attributes:
        values: (H, W) uint16 units, or float16/float32 metres; 0 = missing.
        converted: whether other encodings of missing depth became 0, so that the file cannot be
            copied.
    """

    values: NDArray[np.generic]
    converted: bool


def read_foreign_depth(path: Path, *, size: tuple[int, int]) -> ForeignDepth:
    """Depth of `size` (width, height) from a 16-bit PNG, an EXR, or a TIFF.

    NaN, infinity and negative numbers (DREDS writes -0.001), and the saturated 65535 of 16-bit
    images, mean "no measurement" and become 0. An EXR may have one channel or equal ones. A TIFF
    contains 16-bit or float units.

    Raises:
        ToolkitError: unreadable, of another size, or not a depth image.
    """
    if path.suffix.lower() == ".exr":
        check_aligned(path, exr.exr_size(path), size)
        values = _single_channel(path)
        missing = ~np.isfinite(values) | (values < 0)
        if missing.any():
            values = np.where(missing, np.zeros((), values.dtype), values)
        return ForeignDepth(values, True)
    if path.suffix.lower() in TIFF_SUFFIXES:
        stored = read_tiff(path)
        check_aligned(path, (stored.shape[1], stored.shape[0]), size)
        if stored.dtype == np.uint8:
            raise ToolkitError("depth in a TIFF must be 16-bit or float", path=path, value="uint8")
        numbers = stored.astype(np.float32)
        unknown = ~np.isfinite(numbers) | (numbers < 0) | (numbers == _SATURATED)
        return ForeignDepth(np.where(unknown, np.zeros((), stored.dtype), stored), True)
    if path.suffix.lower() != ".png":
        raise ToolkitError(
            "depth must be a 16-bit PNG, an EXR or a TIFF",
            path=path,
            hint="JPEG and 8-bit lose depth",
        )
    raw = images.read_png(path)
    check_aligned(path, (raw.shape[1], raw.shape[0]), size)
    if raw.dtype != np.uint16 or raw.ndim != 2:
        raise ToolkitError(
            "depth must be a single-channel 16-bit PNG",
            path=path,
            value=f"{raw.dtype}, {1 if raw.ndim == 2 else raw.shape[2]} channels",
            hint="a colour-mapped or 8-bit depth image has no metric values",
        )
    saturated = raw == _SATURATED
    if not saturated.any():
        return ForeignDepth(raw, False)
    return ForeignDepth(np.where(saturated, np.uint16(0), raw), True)


def check_aligned(path: Path, actual: tuple[int, int], size: tuple[int, int]) -> None:
    """Check that depth has the size of its colour image.

    Raises:
        ToolkitError: the sizes differ.
    """
    if actual != size:
        raise ToolkitError(
            f"depth is {actual[0]}x{actual[1]}, colour {size[0]}x{size[1]}: depth is not aligned",
            path=path,
            hint="record or convert depth aligned to colour (RealSense: rs.align(stream.color))",
        )


def check_unit(
    median_m: float, *, path: Path | str, depth_scale: float | None, by_flag: bool = True
) -> None:
    """Check that the median depth is plausible for a table-top recording.

    Args:
        median_m: median of all measured pixels of the recording, metres.
        depth_scale: assumed metres per unit; None for EXR.
        by_flag: whether --depth-scale can set the scale.

    Raises:
        ToolkitError: outside 10 cm to 10 m.
    """
    if NEAREST_MEDIAN_M <= median_m <= FARTHEST_MEDIAN_M:
        return
    if depth_scale is None:
        hint = "the EXR files seem not to be in metres; convert them"
    else:
        units = median_m / depth_scale
        fitting = [
            s for s in (0.001, 0.0001, 0.00025, 0.000125, 0.01, 0.0002) if 0.15 <= units * s <= 5
        ]
        named = f"; {' or '.join(f'{s:g}' for s in fitting)} would fit" if fitting else ""
        name = "--depth-scale" if by_flag else "a depth scale of"
        hint = f"{name} {depth_scale:g} (metres per unit) seems wrong{named}"
    raise ToolkitError(
        "the median depth is implausible", path=path, value=f"{median_m:.4g} m", hint=hint
    )


def _single_channel(path: Path) -> NDArray[np.floating]:
    channels = exr.read_exr(path)
    for name in ("Y", "Z", "V", "R"):
        if name in channels:
            chosen = channels[name]
            break
    else:
        if len(channels) != 1:
            raise ToolkitError(
                "the EXR file has no depth channel (Y, Z or R)", path=path, value=sorted(channels)
            )
        chosen = next(iter(channels.values()))
    if "R" in channels and any(
        not np.array_equal(channels[c], chosen, equal_nan=True) for c in "GB" if c in channels
    ):
        raise ToolkitError(
            "the EXR file is a colour image, not depth: its channels differ", path=path
        )
    if chosen.dtype not in (np.float16, np.float32):
        raise ToolkitError("depth in an EXR must be float", path=path, value=str(chosen.dtype))
    return chosen  # type: ignore[return-value]


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
        ToolkitError: its size is implausible in metres.
    """
    check_mesh_size(mesh, path=path)
    data = mesh.export(file_type=path.suffix.lower().lstrip("."))
    assert isinstance(data, bytes)  # both formats are binary
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


def _topics_of_db3(path: Path) -> str:
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as database:
            row = database.execute("SELECT name FROM topics ORDER BY name LIMIT 1").fetchone()
    except sqlite3.Error:
        return _LIBREALSENSE  # its own reader names what is damaged
    return row[0] if row else ""
