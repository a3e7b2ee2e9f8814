"""A frame's image, drawn behind the meshes and as a translucent veil in front of them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonDataModel import vtkImageData, vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkTexture

from annotator.views.layers import Layers, fill
from annotator.views.projection import ImageWindow

Array = NDArray[np.float64]

# Magnification from which pixels are drawn as squares, screen pixels per image pixel.
CRISP_SCALE = 3.0


class Picture:
    """The image of a view."""

    def __init__(self, layers: Layers) -> None:
        self._image: NDArray[np.uint8] | None = None
        self._level = -1
        self._texture = vtkTexture()
        self._texture.SetColorModeToDirectScalars()
        self._texture.MipmapOff()
        self._texture.EdgeClampOn()
        self._actors = [self._quad() for _ in range(2)]
        self._back, self._veil = self._actors
        self._veil.ForceTranslucentOn()
        self._veil.VisibilityOff()
        layers.backdrop.AddActor(self._back)
        layers.veil.AddActor(self._veil)

    def show(self, image: NDArray[np.uint8] | None) -> None:
        """Show (H, W, 3) RGB, or nothing."""
        if image is not self._image:
            self._image = image
            self._level = -1
        if image is None:
            for actor in self._actors:
                actor.VisibilityOff()

    def place(self, window: ImageWindow, *, veil: float, part: Array | None = None) -> None:
        """Place the image according to `window`.

        Args:
            veil: opacity of the image in front of the meshes.
            part: (2, 2) screen positions of the corners of the meshes' bounding box, to which the
                veil is limited.
        """
        if self._image is None:
            return
        self._choose_level(window.scale)
        self._texture.SetInterpolate(window.scale < CRISP_SCALE)
        height, width = self._image.shape[:2]
        size = np.array([width, height]) * window.scale
        _stretch(self._back, window, size, np.array([[0.0, 0.0], [1.0, 1.0]]))
        self._back.VisibilityOn()
        shares = np.array([[0.0, 0.0], [1.0, 1.0]])
        if part is not None:
            shares = np.clip((part - [window.x, window.y]) / size, 0, 1)
        shown = veil > 0 and bool((shares[1] > shares[0]).all())
        self._veil.SetVisibility(shown)
        if shown:
            _stretch(self._veil, window, size, shares)
            self._veil.GetProperty().SetOpacity(veil)

    def _choose_level(self, scale: float) -> None:
        """Upload the image at the resolution shown, because minified textures alias."""
        assert self._image is not None
        level = int(np.clip(np.floor(np.log2(1 / scale) + 0.25), 0, 4))
        if level == self._level:
            return
        self._level = level
        image = self._image
        height, width = image.shape[:2]
        if level:
            size = (max(width >> level, 1), max(height >> level, 1))
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        height, width = image.shape[:2]
        data = vtkImageData()
        data.SetDimensions(width, height, 1)
        data.GetPointData().SetScalars(
            numpy_to_vtk(np.ascontiguousarray(image).reshape(-1, image.shape[2]), deep=True)
        )
        self._texture.SetInputData(data)

    def _quad(self) -> vtkActor:
        mapper = vtkPolyDataMapper()
        mapper.SetInputData(vtkPolyData())
        actor = vtkActor()
        actor.SetMapper(mapper)
        actor.SetTexture(self._texture)
        actor.GetProperty().LightingOff()
        actor.VisibilityOff()
        return actor


def _stretch(actor: vtkActor, window: ImageWindow, size: Array, shares: Array) -> None:
    """Set a quad to the part of the image between two corners, given as fractions of its size."""
    (x0, y0), (x1, y1) = shares
    # Image rows go downwards like those of the screen.
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    mapper: Any = actor.GetMapper()
    polydata = mapper.GetInput()
    points = np.concatenate([corners * size + [window.x, window.y], np.zeros((4, 1))], axis=1)
    fill(polydata, points, np.array([[0, 1, 2], [0, 2, 3]]))
    polydata.GetPointData().SetTCoords(numpy_to_vtk(corners.astype(np.float32), deep=True))
