"""Intrinsics as they are written to documents."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

import msgspec

from std_toolkit.geometry.camera import Camera
from std_toolkit.scene.document import Document, Positive


class CameraModel(Document, frozen=True, kw_only=True):
    """Intrinsics of one image stream; see `geometry.Camera`."""

    width: Annotated[int, msgspec.Meta(gt=0)]
    height: Annotated[int, msgspec.Meta(gt=0)]
    fx: Positive
    fy: Positive
    cx: float
    cy: float
    distortion: list[float] = msgspec.field(default_factory=list)

    def check(self) -> None:
        self.camera()

    def camera(self) -> Camera:
        k = tuple(self.distortion)
        return _camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy, k)

    @staticmethod
    def of(camera: Camera) -> CameraModel:
        return CameraModel(
            width=camera.width,
            height=camera.height,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
            distortion=list(camera.distortion),
        )


# Asked for with every frame; its checks take longer than looking it up.
_camera = lru_cache(maxsize=32)(Camera)
