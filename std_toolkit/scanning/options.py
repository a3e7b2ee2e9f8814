"""Options of `std-scan`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError, check_options
from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.door import Writes
from std_toolkit.options import KnownCameras
from std_toolkit.scene.document import check_name

# Work of an earlier version lies in .scan.
MODEL_FOLDER = Writes("results", (".scan",))

# Groups of limits that decide a scan.
LIMITS = ("scanning.", "poses.")


@dataclass(frozen=True, kw_only=True)
class ScanOptions:
    """Make a metric, watertight, textured mesh of an object from photos.

    The object stands on the printed board; 40 to 60 photos around it, from two heights, show most
    of the board. Poses and metres come from the board. The output folder receives OBJ, MTL, PNG,
    GLB and PLY in metres, and report.html. A run that was interrupted resumes with the same
    command. See docs/scanning.md.
    """

    photos: Path = field(metadata={"option": ""})
    """folder of the photos; or a video, of which about 60 sharp frames are taken; or an RGB-D scene
    of std-curate import, whose sensor depth helps on plain surfaces"""
    flipped: Path | None = field(default=None, metadata={"option": ""})
    """folder or video of the same object turned over on the same board"""
    out: Path = field(metadata={"option": "out", "writes": MODEL_FOLDER})
    """folder for the model; its name is the name of the model"""
    board: Path | None = None
    """description of the printed board on which the object stands (JSON)"""
    intrinsics: str | None = None
    """intrinsics file, or fx,fy,cx,cy in pixels (default: calibrated from the board)"""
    masks: Path | None = None
    """folder of your own masks, PNG named as the photos; photos without one are segmented. With two
    folders of photos, those of each are in a subfolder of its name"""
    pick: str | None = None
    """[FOLDER/]PHOTO:x,y a pixel of the object, where several stand on the board"""
    box: str | None = None
    """[FOLDER/]PHOTO:x0,y0,x1,y1 a box around the object, where several stand on the board"""
    all_objects: bool = field(default=False, metadata={"option": "all"})
    """scan every object that stands on the board, one folder in the output folder for each, with
    an overview and library.json; for std-annotate --meshes"""
    names: tuple[str, ...] = ()
    """with --all, names of the objects, largest first, as the error without --pick and
    candidates.jpg number them (default: object_1, object_2, ...)"""
    revolve: bool = False
    """fit a surface of revolution to the outlines: for unsprayed vessels of glass or metal, without
    handles"""
    wall_mm: Annotated[float, msgspec.Meta(gt=0, le=100)] | None = None
    """thickness in millimetres of the wall and base of a vessel that is open at the top, such as a
    mug or a bowl: its hollow, where plain walls show no depth, is the outside moved inwards. With
    --revolve, of the wall alone (default: no hollow but what photos show; with --revolve, as its
    rim shows)"""
    base_mm: Annotated[float, msgspec.Meta(gt=0, le=1000)] | None = None
    """with --revolve: thickness in millimetres of the base of the vessel at its middle, from the
    table to the floor of its inside (default: a guess)"""
    inside_depth_mm: Annotated[float, msgspec.Meta(gt=0, le=1000)] | None = None
    """with --revolve: depth of the inside in millimetres, measured with a ruler from the rim to the
    floor, instead of --base-mm"""
    category: str = "other"
    """category of the object, which turns its frame: the handle of a "mug" is on the side of +x"""
    faces: Annotated[int, msgspec.Meta(ge=100, le=2_000_000)] = 20_000
    """number of faces of the mesh"""
    texture: Annotated[int, msgspec.Meta(ge=64, le=8192)] = 2048
    """width and height of the texture in pixels"""
    voxels: Annotated[int, msgspec.Meta(ge=20, le=1000)] = 220
    """number of voxels along the longest side of the object"""
    neighbours: Annotated[int, msgspec.Meta(ge=2, le=20)] = 6
    """number of photos that each photo is compared with for depth"""
    depth: str = "patchmatch"
    """engine of the depth maps: patchmatch; colmap, the stereo of your COLMAP with CUDA; an
    installed plug-in, or file.py:NAME"""
    max_features: Annotated[int, msgspec.Meta(ge=100, le=1_000_000)] = 4000
    """SIFT features per photo"""
    image_size: Annotated[int, msgspec.Meta(ge=320, le=65_535)] = 1600
    """longer side to which larger photos are reduced, pixels"""
    preview: bool = True
    """write preview.ply, a coarse mesh by the board alone, before the long stages; it is removed
    when the model is there"""
    known: KnownCameras = field(default_factory=KnownCameras)
    jobs: JobOptions = field(default_factory=JobOptions)

    def __post_init__(self) -> None:
        check_options(self)
        check_name(self.category, field="--category")
        if self.wall_mm is not None and self.known.cameras is not None:
            raise ToolkitError(
                "needs the board, which tells what is upright", field="--wall-mm",
                value=self.wall_mm, hint="leave it out with --cameras",
            )  # fmt: skip
        inside = {"--base-mm": self.base_mm, "--inside-depth-mm": self.inside_depth_mm}
        for option, stated in inside.items():
            if stated is not None and not self.revolve:
                raise ToolkitError(
                    "is of a vessel scanned with --revolve", field=option, value=stated,
                    hint="add --revolve, or leave it out",
                )  # fmt: skip
        for option, given in (("--pick", self.pick), ("--box", self.box)):
            if given is not None and self.board is None:
                raise ToolkitError(
                    "chooses one of several objects on the board", field=option, value=given,
                    hint="give --board FILE, or masks with --masks",
                )  # fmt: skip
        self._check_all()
        if self.flipped is None:
            return
        if self.photos.resolve() == self.flipped.resolve():
            raise ToolkitError(
                "the second folder is the first", value=self.flipped,
                hint="give the photos of the object turned over",
            )  # fmt: skip
        alone = {"--revolve": self.revolve, "--cameras": self.known.cameras is not None}
        for option, is_given in alone.items():
            if is_given:
                raise ToolkitError(
                    "takes one folder of photos", field=option,
                    hint="leave the second folder out",
                )  # fmt: skip

    def _check_all(self) -> None:
        """Refuse options that belong to one object with those of all objects, and the reverse.

        Raises:
            ToolkitError: names the option.
        """
        if not self.all_objects:
            if self.names:
                raise ToolkitError(
                    "names the objects of --all", field="--names", value=" ".join(self.names),
                    hint="add --all; the name of one model is that of its folder --out",
                )  # fmt: skip
            return
        single = {
            "--pick": self.pick is not None, "--box": self.box is not None,
            "--masks": self.masks is not None, "--revolve": self.revolve,
            "--wall-mm": self.wall_mm is not None, "--category": self.category != "other",
        }  # fmt: skip
        given = [option for option, is_given in single.items() if is_given]
        if given:
            raise ToolkitError(
                f"contradicts {given[0]}, which is of one object", field="--all",
                hint=f"leave --all out, or scan all first and that object again with {given[0]}",
            )  # fmt: skip
        if self.flipped is not None or self.known.cameras is not None:
            other = "a second folder" if self.flipped is not None else "--cameras"
            raise ToolkitError(
                f"contradicts {other}", field="--all",
                hint="the objects are found on one board in one folder of photos",
            )  # fmt: skip
        for name in self.names:
            check_name(name, field="--names")
        if len({name.lower() for name in self.names}) < len(self.names):
            raise ToolkitError(
                "one name is given twice", field="--names", value=" ".join(self.names)
            )

    @property
    def wall_m(self) -> float | None:
        """Thickness of the wall in metres, if known."""
        return None if self.wall_mm is None else self.wall_mm / 1000

    def labels(self) -> tuple[str, str]:
        """Names of both folders of photos, different ones."""
        assert self.flipped is not None
        first, second = self.photos.resolve(), self.flipped.resolve()
        if first.name != second.name:
            return first.name, second.name
        return f"{first.parent.name}/{first.name}", f"{second.parent.name}/{second.name}"


@dataclass(frozen=True, kw_only=True)
class BoardCommand:
    """Make the board that the object stands on: a PDF to print at 100 %, and its description."""

    out: Path = field(metadata={"option": "out", "writes": Writes("file", suffix=".pdf")})
    """PDF file; the description has the same name with the suffix .json"""
    paper: Literal["a4", "a3", "letter"] = "a4"
    """size of the sheet; letter: 8.5 x 11 inches"""
    middle: Literal["white", "grey", "pattern"] = "white"
    """what is printed where the object stands: grey for white objects, whose outline white paper
    hides; a pattern of greys for glass"""
    first_id: int | None = None
    """id of the first tag (default: 0, 60, 120 for a4, a3, letter); boards of one size that are
    used side by side need different ids"""
