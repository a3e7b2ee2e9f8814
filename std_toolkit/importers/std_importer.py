"""The STD and DREDS layouts.

An STD or DREDS download contains images, ground-truth maps and one `_meta.txt` per frame, but no
intrinsics, camera poses or usable object poses. Intrinsics default to the constants of the
released code. Object poses are computed from ground-truth depth and NOCS maps, as the authors
advise. Camera poses are recovered by `std-curate poses`. STD exports of the toolkit have all of
this in a sidecar.
"""

from dataclasses import dataclass
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.importers import (
    foreign_files,
    importer,
    intrinsics,
    sidecar_recording,
    std_objects,
)
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.images import image_size
from std_toolkit.scene.document import check_name
from std_toolkit.scene.sidecar import find_sidecar


@dataclass(frozen=True)
class Layout:
    """File names and camera of a kind of download.

    Attributes:
        raw: suffix of the raw depth.
        ground_truth: suffixes of ground-truth depth; the first that exists is used.
        masks: suffixes of the mask.
        focal: fx and fy in pixels at `focal_size`.
    """

    name: str
    raw: str
    ground_truth: tuple[str, ...]
    masks: tuple[str, ...]
    focal: tuple[float, float]
    focal_size: tuple[int, int]


STD_LAYOUT = Layout(
    "std", "_depth_415.exr", ("_gt_depth.exr",), ("_mask.png",), (918.295, 917.544), (1280, 720)
)
DREDS_LAYOUT = Layout(
    "dreds",
    "_simDepthImage.exr",
    ("_depth_120.exr", "_depth_0.exr"),
    ("_mask.exr",),
    (446.31, 446.31),
    (640, 360),
)


class StdImporter:
    """Reads one scene folder of an STD download or export."""

    layout = STD_LAYOUT

    def recognises(self, source: Path) -> bool:
        if not source.is_dir():
            return False
        if any(source.glob(f"*{self.layout.raw}")):
            return True
        return (
            (source / "std_toolkit.json").is_file()
            and (found := find_sidecar(source, self.layout.name)) is not None
            and found[1] == source.resolve()
        )

    def read(self, request: ImportRequest) -> importer.Recording:
        """See `Importer`.

        Raises:
            ToolkitError: files of a frame are missing, or the intrinsics are not known.
        """
        found = find_sidecar(request.source, self.layout.name)
        if found is not None:
            sidecar, top = found
            folder = top / sidecar.folder
            return sidecar_recording.recording_from_sidecar(
                sidecar,
                top,
                color=lambda stem: folder / f"{stem}_color.png",
                depth=lambda stem: folder / f"{stem}{self.layout.raw}",
                depth_scale=None,
                reference=lambda stem: self._maps(folder, stem),
            )
        stems = self._stems(request.source)
        camera, resized = self._camera(request, stems[0])
        frames = tuple(
            self._frame(request.source, stem, i, resized) for i, stem in enumerate(stems)
        )
        objects = std_objects.read_objects(
            request, [f.name for f in frames], self.layout.name, self._maps, camera
        )
        return importer.Recording(
            source=f"import:{self.layout.name}",
            cameras={"color": camera},
            frames=frames,
            depth_correction=request.depth_correction,
            models=objects.models,
            objects=objects.objects,
            labels=objects.labels,
            notes=objects.notes,
        )

    def _stems(self, folder: Path) -> list[str]:
        if not folder.is_dir():
            raise ToolkitError("no such folder", path=folder)
        raw = {p.name.removesuffix(self.layout.raw) for p in folder.glob(f"*{self.layout.raw}")}
        color = {p.name.removesuffix("_color.png") for p in folder.glob("*_color.png")}
        if not raw or not color:
            what = f"*{self.layout.raw}" if not raw else "*_color.png"
            raise ToolkitError(f"no {self.layout.name} recording here: no {what}", path=folder)
        if raw != color:
            odd = sorted(raw ^ color, key=foreign_files.natural_key)
            raise ToolkitError(
                f"{len(odd)} frames lack colour or raw depth: {', '.join(odd[:5])}", path=folder
            )
        return [
            check_name(s, path=folder, field="file name")
            for s in sorted(raw, key=foreign_files.natural_key)
        ]

    def _maps(self, folder: Path, stem: str) -> tuple[tuple[str, Path], ...]:
        candidates = (
            ("depth", self.layout.ground_truth),
            ("mask", self.layout.masks),
            ("nocs", ("_coord.png",)),
        )
        found = []
        for kind, suffixes in candidates:
            paths = [p for s in suffixes if (p := folder / f"{stem}{s}").is_file()]
            found += [(kind, p) for p in paths[:1]]
        return tuple(found)

    def _camera(self, request: ImportRequest, stem: str) -> tuple[Camera, bool]:
        """The camera, and whether colour must be reduced to the size of the depth."""
        color = image_size(request.source / f"{stem}_color.png")
        depth = image_size(request.source / f"{stem}{self.layout.raw}")
        # The simulator renders colour at twice the size of everything else.
        resized = color != depth and color[0] * depth[1] == color[1] * depth[0]
        size = depth if resized else color
        if request.intrinsics is not None:
            given = intrinsics.read_intrinsics(request.intrinsics, size=size, camera=request.camera)
            camera = given.camera(size, path=request.intrinsics, off_centre=request.off_centre)
            if request.distortion is not None:
                intrinsics.parse_distortion(request.distortion)
                raise ToolkitError("images of this layout have no distortion", field="--distortion")
            return camera, resized
        width, height = self.layout.focal_size
        if size[0] * height != size[1] * width:
            raise ToolkitError(
                f"{self.layout.name} images are {width}:{height}, these are {size[0]}x{size[1]}",
                path=request.source,
                hint="give --intrinsics",
            )
        fx, fy = self.layout.focal
        known = Camera(width, height, fx, fy, width / 2 - 0.5, height / 2 - 0.5)
        return known.resized(*size), resized

    def _frame(self, folder: Path, stem: str, index: int, resized: bool) -> importer.SourceFrame:
        return importer.SourceFrame(
            id=index,
            name=stem,
            color=importer.SourceFile(
                source=folder / f"{stem}_color.png",
                target=f"color/{stem}",
                kind="color",
                resize=resized,
            ),
            depth=importer.SourceFile(
                source=folder / f"{stem}{self.layout.raw}", target=f"depth/{stem}", kind="depth"
            ),
            reference=sidecar_recording.reference_files(stem, self._maps(folder, stem)),
        )


class DredsImporter(StdImporter):
    """Reads one scene folder of a DREDS download."""

    layout = DREDS_LAYOUT


STD = StdImporter()
DREDS = DredsImporter()
