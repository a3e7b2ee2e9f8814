"""The first image of a scene, while the rest of the window is being built."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QRectF, Qt
from PySide6.QtGui import QColor, QImage, QPainter, QPaintEvent
from PySide6.QtWidgets import QWidget

from annotator.window import theme


class OpeningPage(QWidget):
    """Loading what draws in three dimensions takes a second; the image is there at once."""

    def __init__(self, name: str, rgb: NDArray[np.uint8] | None) -> None:
        super().__init__()
        self._text = f"Opening {name} ..."
        self._rgb = rgb

    def paintEvent(self, _: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.fillRect(self.rect(), QColor(theme.BASE))
        if self._rgb is not None:
            height, width = self._rgb.shape[:2]
            stride = self._rgb.strides[0]
            image = QImage(self._rgb.data, width, height, stride, QImage.Format.Format_RGB888)
            scale = min(self.width() / width, self.height() / height)
            w, h = width * scale, height * scale
            place = QRectF((self.width() - w) / 2, (self.height() - h) / 2, w, h)
            painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
            painter.drawImage(place, image)
        painter.setPen(QColor(theme.MUTED))
        margin = self.rect().adjusted(12, 8, -12, -8)
        painter.drawText(margin, Qt.AlignmentFlag.AlignBottom, self._text)
