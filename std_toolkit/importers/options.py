"""Options of an import: which images to read and how, and the request that an importer gets."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.options import KnownCameras, Material


@dataclass(frozen=True, kw_only=True)
class ImageOptions:
    """Options for reading colour and depth images."""

    color: str | None = None
    """folder or quoted glob pattern of the colour images, or their topic in a recording of ROS"""
    depth: str | None = None
    """folder or quoted glob pattern of the depth images, aligned to colour, or their topic"""
    depth_scale: float | None = None
    """metres per number of the depth images (default: that of the format or of the intrinsics
    file; for separate images 0.001 of 16-bit ones, 1 of EXR)"""
    missing: str | None = None
    """number in the depth images that means no measurement, beside 0, NaN, infinity and those that
    are recognised; several with commas"""
    depth_correction: float = 1.0
    """factor applied to all depth, from a calibration"""
    intrinsics: str | None = None
    """intrinsics file, a folder with one for each image, or fx,fy,cx,cy in pixels (default: those
    of the format)"""
    camera: str | None = None
    """camera of an intrinsics file with several, by its name in the file, such as cam0"""
    distortion: str | None = None
    """OpenCV coefficients k1,k2,p1,p2[,k3[,k4,k5,k6]] (default: those of the file)"""
    undistort_fov: Annotated[float, msgspec.Meta(ge=3, le=136)] | None = None
    """undistort the images to a pinhole with this horizontal field of view in degrees (default: a
    fisheye lens to a pinhole of the same focal length; other lenses keep their distortion)"""
    pair: Literal["name", "index", "time", "list"] | None = None
    """pair colour and depth by name, in their order, by the time in their names or in rgb.txt and
    depth.txt, or by associations.txt (default: by name, then by number, list or time stamps)"""
    skip_unpaired: bool = False
    """skip frames that lack colour or depth"""
    off_centre: bool = False
    """accept a principal point far from the image centre (cropped images)"""


@dataclass(frozen=True, kw_only=True)
class ImportOptions(ImageOptions):
    """Options for reading a recording in another format."""

    material: Material | None = None
    """material of imported objects whose format has none"""
    models: Path | None = None
    """folder of CAD models, for formats that store them separately"""
    known: KnownCameras = field(default_factory=KnownCameras)


@dataclass(frozen=True, kw_only=True)
class ImportRequest(ImportOptions):
    """A recording to import.

    Attributes:
        source: folder or file of the recording; for separate colour and depth folders, the
            folder of the colour images.
        name: name of the new scene.
        workspace: folder for images that are not files of their own, such as those of ROS.
    """

    source: Path
    name: str
    workspace: Path | None = None


def check_depth_numbers(options: ImageOptions) -> None:
    """Check unit and correction of the depth.

    Raises:
        ToolkitError: one of them is impossible.
    """
    if options.depth_scale is not None and not 0 < options.depth_scale <= 1:
        raise ToolkitError(
            "must be metres per unit of the depth images, above 0 and at most 1",
            field="--depth-scale",
            value=options.depth_scale,
            hint="millimetres: 0.001",
        )
    if not 0.8 < options.depth_correction < 1.25:
        raise ToolkitError(
            "must be between 0.8 and 1.25",
            field="--depth-correction",
            value=options.depth_correction,
            hint="give a calibrated factor such as 0.98; --depth-scale sets the unit",
        )
