"""Real captures of the ClearGrasp data set.

Every capture exists twice: with transparent objects, and with opaque replicas in the same pose.
The transparent capture becomes the scene's colour and sensor depth. Colour and depth of the
replicas, the mask and the normals are kept in `reference/`.
"""

from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.importers import foreign_files, importer, intrinsics
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.images import COLOR_SUFFIXES, image_size
from std_toolkit.scene.document import check_name

_COLOR = "-transparent-rgb-img"
_DEPTH = "-transparent-depth-img.exr"
_INTRINSICS = "camera_intrinsics.yaml"


class ClearGraspImporter:
    """Reads one folder of captures, such as `real-val`."""

    def recognises(self, source: Path) -> bool:
        return source.is_dir() and any(source.glob(f"*{_DEPTH}"))

    def read(self, request: ImportRequest) -> importer.Recording:
        """See `Importer`.

        Raises:
            ToolkitError: a capture lacks colour or depth, or the intrinsics are missing.
        """
        folder = request.source
        if not folder.is_dir():
            raise ToolkitError("no such folder", path=folder)
        color = {
            p.stem.removesuffix(_COLOR): p
            for p in folder.glob(f"*{_COLOR}.*")
            if p.suffix.lower() in COLOR_SUFFIXES
        }
        depth = {p.name.removesuffix(_DEPTH): p for p in folder.glob(f"*{_DEPTH}")}
        if not depth or set(color) != set(depth):
            odd = sorted(set(color) ^ set(depth), key=foreign_files.natural_key)
            raise ToolkitError(
                "no ClearGrasp captures here, or captures that lack colour or depth",
                path=folder,
                value=odd[:5] or None,
                hint="give the folder with the *-transparent-depth-img.exr, such as real-val",
            )
        keys = sorted(color, key=foreign_files.natural_key)
        given = request.intrinsics or str(_intrinsics_file(folder))
        size = image_size(color[keys[0]])
        camera = intrinsics.read_intrinsics(given, size=size).camera(
            size, path=given, off_centre=request.off_centre
        )
        return importer.Recording(
            source="import:cleargrasp",
            cameras={"color": camera},
            frames=tuple(
                _frame(folder, check_name(k, path=folder), i, color[k], depth[k])
                for i, k in enumerate(keys)
            ),
            depth_correction=request.depth_correction,
        )


def _intrinsics_file(folder: Path) -> Path:
    for place in (folder, *list(folder.resolve().parents)[:3]):
        if (place / _INTRINSICS).is_file():
            return place / _INTRINSICS
    raise ToolkitError(f"{_INTRINSICS} not found", path=folder, hint="give --intrinsics")


def _frame(folder: Path, key: str, index: int, color: Path, depth: Path) -> importer.SourceFrame:
    twins: tuple[tuple[str, importer.FileKind, str], ...] = (
        ("color", "color", "-opaque-rgb-img.jpg"),
        ("color", "color", "-opaque-rgb-img.png"),
        ("depth", "depth", "-opaque-depth-img.exr"),
        ("mask", "mask", "-mask.png"),
        ("normals", "map", "-normals.exr"),
    )
    reference = tuple(
        importer.SourceFile(
            source=folder / f"{key}{suffix}",
            target=f"reference/{place}/{key}",
            kind=kind,
            binary=kind == "mask",
        )
        for place, kind, suffix in twins
        if (folder / f"{key}{suffix}").is_file()
    )
    return importer.SourceFrame(
        id=index,
        name=key,
        color=importer.SourceFile(source=color, target=f"color/{key}", kind="color"),
        depth=importer.SourceFile(source=depth, target=f"depth/{key}", kind="depth"),
        reference=reference,
    )


CLEARGRASP = ClearGraspImporter()
