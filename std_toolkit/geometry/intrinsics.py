"""Intrinsics as other programs file them: without an image size, with their name of the lens."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.camera_models import MODELS, Pinhole

# Largest distance of the principal point of an uncropped image from its centre, as a fraction of
# the image. Half-size intrinsics put it at a quarter, those of a 4:3 image on 16:9 at two thirds.
_OFF_CENTRE = 0.15
# Keys of foreign files that name the lens model. `model` may also be the name of the device.
_MODEL_KEYS = ("camera_model", "distortion_model", "lens_model", "model")
_FURTHER_KEYS = ("k3", "k4", "k5", "k6")
_FISHEYE_KEYS = ("is_fisheye", "fisheye_model", "fisheye")
# Names that mention one of these are lens models other than OpenCV's, not names of devices.
_FOREIGN = re.compile("inverse|fisheye|equi|kannala|theta|omni|eucm|^ds|spher|division|fov")


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics as read; pixels, centre of the top-left pixel at (0, 0).

    Attributes:
        distortion: coefficients of the lens model `model`.
        size: (width, height) if the source has it.
        model: as in `Camera`.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    size: tuple[int, int] | None = None
    model: str = "opencv"

    @staticmethod
    def of(camera: Camera) -> Intrinsics:
        """The intrinsics of a camera, with its image size."""
        c = camera
        return Intrinsics(c.fx, c.fy, c.cx, c.cy, c.distortion, c.size, c.model)

    def camera(self, size: tuple[int, int], *, path: str, off_centre: bool = False) -> Camera:
        """The camera for images of `size`.

        Raises:
            ToolkitError: the intrinsics belong to another size.
        """
        shown = f"{size[0]}x{size[1]}"
        if self.size is not None and self.size != size:
            raise ToolkitError(
                f"intrinsics are for {self.size[0]}x{self.size[1]} images, these are {shown}",
                path=path,
                hint="give the intrinsics for this image size",
            )
        with located(path):
            camera = Camera(*size, self.fx, self.fy, self.cx, self.cy, self.distortion, self.model)
        for name, value, extent in (("cx", self.cx, size[0]), ("cy", self.cy, size[1])):
            if not off_centre and abs((value + 0.5) / extent - 0.5) > _OFF_CENTRE:
                raise ToolkitError(
                    f"does not fit {shown} images: the centre is at {(extent - 1) / 2:g}",
                    path=path,
                    field=name,
                    value=value,
                    hint="intrinsics of another image size? for cropped images give --off-centre",
                )
        return camera

    def scene_camera(self, size: tuple[int, int], *, path: str) -> Camera:
        """The camera for images of `size` that are used as they are.

        Raises:
            ToolkitError: as `camera`, or images of this lens must be undistorted first.
        """
        camera = self.camera(size, path=path)
        if not camera.lens.in_scenes:
            raise ToolkitError(
                "images of this lens must be undistorted first",
                path=path,
                field="model",
                value=self.model,
                hint="a recording that `std-curate import` reads is undistorted",
            )
        return camera


def named_lens(
    data: Mapping[str, Any], number: Callable[[Any], float]
) -> tuple[str, tuple[float, ...]]:
    """Lens model and coefficients of a document that names them k1, k2, p1, ...

    Args:
        data: its keys.
        number: converts a value, or raises.

    Raises:
        ToolkitError: the model is not supported, its coefficients are missing, or k4 is not clear.
    """
    found = {key: number(data.get(key, 0.0)) for key in ("k1", "k2", "p1", "p2", *_FURTHER_KEYS)}
    model = model_of_file(data, has_coefficients=any(found.values()))
    k = tuple(found[key] for key in re.findall(r"\w+", MODELS[model].order))
    if model != "opencv":
        if "k1" not in data:  # a pinhole is OpenCV's model without coefficients; these are not
            raise ToolkitError(
                f"the coefficients of the {model} lens are missing",
                field="k1",
                hint=f"needed: {MODELS[model].order}, or `distortion` with all of them",
            )
        return model, k
    if not any(k[5:]):
        return model, k[:5] if any(k) else ()
    if not ("k5" in data or "k6" in data or re.search("(?i)full|rational", str(data))):
        raise ToolkitError(
            "of the rational model, or of a longer polynomial, as nerfstudio has it?",
            field="k4",
            value=data["k4"],
            hint="state the model: FULL_OPENCV or OPENCV_FISHEYE; others are not supported",
        )
    return model, k


def listed_coefficients(values: Sequence[float], model: str) -> tuple[float, ...]:
    """Coefficients of a list in the model's order, without zeros that are too many.

    Raises:
        ToolkitError: too many coefficients.
    """
    k = list(values)
    count = max((n for n in MODELS[model].counts if n <= len(k)), default=len(k))
    if any(k[count:]):
        raise ToolkitError("too many distortion coefficients", value=len(k))
    return tuple(k[:count])


def model_of_file(data: Mapping[str, Any], *, has_coefficients: bool) -> str:
    """The model in `MODELS` that a foreign document states; "opencv" if it states none.

    Args:
        data: its keys, such as `camera_model`, `distortion_model`, `is_fisheye`.
        has_coefficients: whether a distortion coefficient differs from 0.

    Raises:
        ToolkitError: the stated model is none of `MODELS`.
    """
    flags = [str(data.get(key, "")).lower() for key in _FISHEYE_KEYS]
    found = {"fisheye"} if any(flag in ("true", "1", "1.0") for flag in flags) else set()
    for key in _MODEL_KEYS:
        text = str(data.get(key) or "").lower().removeprefix("distortion.")
        plain = re.sub("[^a-z0-9]", "", text)
        known = next((name for name, kind in MODELS.items() if plain in kind.named), None)
        if known is not None:
            found.add(known)
        elif plain and not _is_harmless(key, plain, has_coefficients):
            raise ToolkitError(
                "this distortion model is not supported",
                field=key,
                value=text,
                hint="supported are OpenCV's radial-tangential, rational and fisheye models; "
                "undistort the images first",
            )
    # Kalibr states "pinhole" and "equidistant" of one lens.
    return next((name for name in found if name != "opencv"), "opencv")


def _is_harmless(key: str, name: str, has_coefficients: bool) -> bool:
    """Whether a name that is no known model is that of a pinhole, or may be that of a device."""
    if name in Pinhole.named:
        return True
    if not has_coefficients and "brown" in name:  # those of librealsense, without distortion
        return True
    may_be_device = key == "model" or (key == "camera_model" and not has_coefficients)
    return may_be_device and not _FOREIGN.search(name)
