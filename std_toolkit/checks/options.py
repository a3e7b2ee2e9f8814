"""Limits of the gates and the amount of work of `std-curate check`."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from std_toolkit.errors import ToolkitError


@dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """What a scene must reach, and how closely it is looked at.

    Attributes:
        min_registered: smallest share of frames with a camera pose.
        max_reprojection_px: largest mean reprojection error over the registered frames.
        max_scale_disagreement: largest relative difference between two sources of metres.
        max_edge_px: largest median distance from a label's contour to the nearest image edge.
        max_shift_px: largest median shift between a label's contour and the image.
        max_depth_mm: largest |median| of rendered minus sensor depth on a diffuse object, to
            which the part that the scale leaves open is added.
        max_drift_px: largest movement of the image edges against the contour from frame to
            frame that no single pose of the object explains.
        max_label_std_mm: largest standard deviation of a label along its weakest direction.
        min_edge_support: smallest share of the contour that meets an image edge; below it the
            image does not confirm the label.
        max_frames: frames looked at, spread evenly over the registered ones; 0 means all.
        overlay_frames: frames shown with all labels.
        search_px: how far from the contour an image edge is looked for.
        shift_px: largest shift of the whole contour that is tried.
        image_width: width of the embedded pictures in pixels, at most.
        jpeg_quality: of the embedded pictures.
    """

    min_registered: float = 0.9
    max_reprojection_px: float = 1.5
    max_scale_disagreement: float = 0.005
    max_edge_px: float = 3.0
    max_shift_px: float = 3.0
    max_depth_mm: float = 5.0
    max_drift_px: float = 3.0
    max_label_std_mm: float = 5.0
    min_edge_support: float = 0.3
    max_frames: int = 120
    overlay_frames: int = 6
    search_px: float = 16.0
    shift_px: float = 12.0
    image_width: int = 1280
    jpeg_quality: int = 82

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not np.isfinite(value) or value < 0:
                raise ToolkitError(
                    "must be a number that is not negative", field=field.name, value=value
                )
        for name in ("min_registered", "min_edge_support"):
            if getattr(self, name) > 1:
                raise ToolkitError("is a share, at most 1", field=name, value=getattr(self, name))
        if not 4 <= self.search_px <= 100:
            raise ToolkitError("must be 4 to 100 pixels", field="search_px", value=self.search_px)
        if not 0 < self.shift_px <= self.search_px:
            raise ToolkitError(
                "must be positive and at most search_px", field="shift_px", value=self.shift_px
            )
        if not 1 <= self.jpeg_quality <= 100:
            raise ToolkitError("must be 1 to 100", field="jpeg_quality", value=self.jpeg_quality)
        if self.image_width < 160:
            raise ToolkitError("must be at least 160", field="image_width", value=self.image_width)
