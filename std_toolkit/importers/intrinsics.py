"""Intrinsics from flags and from the files of cameras and data sets."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.filed_cameras import FiledCamera, chosen_camera, filed_cameras
from std_toolkit.geometry.filed_lens import plain_key
from std_toolkit.geometry.filed_numbers import y_down
from std_toolkit.geometry.intrinsics import Intrinsics
from std_toolkit.io.camera_documents import read_camera_document
from std_toolkit.log import logger

_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"


def read_intrinsics(
    text: str, *, size: tuple[int, int] | None = None, camera: str | None = None
) -> Intrinsics:
    """Intrinsics from "fx,fy,cx,cy" or from a file; what was read of the lens is logged.

    Files: JSON, YAML, XML, INI, plain text and NumPy arrays with a matrix (`K`, `cam_K`,
    `camera_matrix`, Open3D's and Record3D's column-major ones) or with `fx fy cx cy` under the
    names of RealSense, nerfstudio, ROS, Kalibr, OpenCV, ORB-SLAM, VINS, ScanNet and others;
    cameras.txt of COLMAP; the output of `rs-enumerate-devices -c` (the colour stream of the images'
    size is taken).

    Args:
        text: value of the flag.
        size: image size, to select among several sets.
        camera: name of a camera, for files of several.

    Raises:
        ToolkitError: unreadable, incomplete, several cameras, or a lens that is not supported.
    """
    numbers = [p.strip() for p in text.split(",")]
    if len(numbers) == 4 and all(re.fullmatch(_NUMBER, p) for p in numbers):
        if camera is not None:
            raise ToolkitError(
                "four numbers are one camera", field="--camera", value=camera, hint="leave it out"
            )
        fx, fy, cx, cy = (float(p) for p in numbers)
        given, note = y_down(Intrinsics(fx, fy, cx, cy))
        if min(given.fx, given.fy) <= 0:
            raise ToolkitError(
                "focal lengths must be positive", field="--intrinsics", value=text,
                hint="the order is fx,fy,cx,cy",
            )  # fmt: skip
        if note:
            logger.warning("%s: %s", text, note)
        return given
    path = Path(text)
    if not path.is_file():
        raise ToolkitError(
            "no such intrinsics file",
            path=text,
            hint="give a file, or four numbers: --intrinsics fx,fy,cx,cy",
        )
    document = read_camera_document(path, size)
    found = filed_cameras(document, path, size=size, wanted=camera)
    if any(row != listed[0] for listed in [coefficients_of_frames(document)[1]] for row in listed):
        logger.warning(
            "%s: the intrinsics change from image to image; those of the whole recording are taken",
            path,
        )
    return told(chosen_camera(found, path, camera), path)


def coefficients_of_frames(document: Any) -> tuple[str, list[Any]]:
    """Key and rows of Record3D's intrinsics of each image; no rows in other documents."""
    pairs = document.items() if isinstance(document, Mapping) else ()
    for key, value in pairs:
        if plain_key(key) == "perframeintrinsiccoeffs" and isinstance(value, list):
            return str(key), value
    return "", []


def told(found: FiledCamera, source: Path | str) -> Intrinsics:
    """The intrinsics of a camera with sentences on its lens, which are logged."""
    name = f", camera {found.name}" if found.name else ""
    notes = [f"{source}{name}: {found.lens}"]
    scale = None
    if found.depth_unit is not None:
        scale, key = found.depth_unit
        notes.append(f"{source}{name}: depth unit {scale:.6g} m ({key})")
    for note in notes:
        logger.info("%s", note)
    return replace(found.intrinsics, depth_scale=scale, notes=tuple(notes))


def parse_distortion(text: str) -> tuple[float, ...]:
    """Coefficients from "k1,k2,p1,p2[,k3[,k4,k5,k6]]".

    Raises:
        ToolkitError: not numbers.
    """
    try:
        return tuple(float(p) for p in text.split(","))
    except ValueError as error:
        raise ToolkitError(
            "distortion is k1,k2,p1,p2[,k3[,k4,k5,k6]]", field="--distortion", value=text
        ) from error


def with_distortion(intrinsics: Intrinsics, text: str | None) -> Intrinsics:
    """The intrinsics with the coefficients of --distortion, if they are given.

    Raises:
        ToolkitError: not numbers.
    """
    if text is None:
        return intrinsics
    return replace(intrinsics, distortion=parse_distortion(text), model="opencv")
