"""The layout of the NOCS data sets (CAMERA and Real275) and of NOCS exports of the toolkit."""

from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.importers import foreign_files, importer, intrinsics, sidecar_recording
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.images import image_size
from std_toolkit.scene.document import check_name
from std_toolkit.scene.sidecar import SIDECAR_NAME, find_sidecar

DEPTH_SCALE = 0.001
# Cameras of the Real275 recordings and of CAMERA25, constants of the public evaluation code.
REAL275 = Camera(640, 480, 591.0125, 590.16775, 322.525, 244.11084)
CAMERA25 = Camera(640, 480, 577.5, 577.5, 319.5, 239.5)


class NocsImporter:
    """Reads one scene folder of a NOCS download, or a NOCS export."""

    def recognises(self, source: Path) -> bool:
        if not source.is_dir():
            return False
        if (source / SIDECAR_NAME).is_file():
            return find_sidecar(source, "nocs") is not None
        return any(source.glob("*_depth.png")) and any(source.glob("*_coord.png"))

    def read(self, request: ImportRequest) -> importer.Recording:
        """See `Importer`.

        Raises:
            ToolkitError: files of a frame are missing, or the intrinsics are not known.
        """
        found = find_sidecar(request.source, "nocs")
        if found is not None:
            sidecar, top = found
            folder = top / sidecar.folder
            return sidecar_recording.recording_from_sidecar(
                sidecar,
                top,
                color=lambda stem: folder / f"{stem}_color.png",
                depth=lambda stem: folder / f"{stem}_depth.png",
                depth_scale=DEPTH_SCALE,
                reference=lambda stem: _maps(folder, stem),
            )
        folder = request.source
        stems = _stems(folder)
        size = image_size(folder / f"{stems[0]}_color.png")
        if request.intrinsics is not None:
            given = intrinsics.read_intrinsics(request.intrinsics, size=size, camera=request.camera)
            camera = given.camera(size, path=request.intrinsics, off_centre=request.off_centre)
        elif size == REAL275.size:
            camera = REAL275
        else:
            raise ToolkitError(
                "only the intrinsics of Real275 (640x480) are known",
                path=folder,
                value=f"{size[0]}x{size[1]}",
                hint="give --intrinsics",
            )
        frames = tuple(_frame(folder, stem, i) for i, stem in enumerate(stems))
        return importer.Recording(
            source="import:nocs",
            cameras={"color": camera},
            frames=frames,
            depth_scale=DEPTH_SCALE,
            depth_correction=request.depth_correction,
            notes=["NOCS downloads contain no poses beside the images: objects are skipped"],
        )


def _stems(folder: Path) -> list[str]:
    if not folder.is_dir():
        raise ToolkitError("no such folder", path=folder)
    color = {p.name.removesuffix("_color.png") for p in folder.glob("*_color.png")}
    depth = {p.name.removesuffix("_depth.png") for p in folder.glob("*_depth.png")}
    if not color or color != depth:
        odd = sorted(color ^ depth, key=foreign_files.natural_key)
        raise ToolkitError(
            "no NOCS recording here, or frames that lack colour or depth",
            path=folder,
            value=odd[:5] or None,
        )
    return [
        check_name(s, path=folder, field="file name")
        for s in sorted(color, key=foreign_files.natural_key)
    ]


def _frame(folder: Path, stem: str, index: int) -> importer.SourceFrame:
    return importer.SourceFrame(
        id=index,
        name=stem,
        color=importer.SourceFile(
            source=folder / f"{stem}_color.png", target=f"color/{stem}", kind="color"
        ),
        depth=importer.SourceFile(
            source=folder / f"{stem}_depth.png",
            target=f"depth/{stem}",
            kind="depth",
            depth_scale=DEPTH_SCALE,
            two_bytes=True,
        ),
        reference=sidecar_recording.reference_files(stem, _maps(folder, stem)),
    )


def _maps(folder: Path, stem: str) -> tuple[tuple[str, Path], ...]:
    candidates = (("mask", folder / f"{stem}_mask.png"), ("nocs", folder / f"{stem}_coord.png"))
    return tuple((kind, path) for kind, path in candidates if path.is_file())


NOCS = NocsImporter()
