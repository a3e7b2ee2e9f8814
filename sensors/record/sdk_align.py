"""Depth aligned to colour by librealsense itself."""

from __future__ import annotations

from typing import Any

from sensors.record.frames import Units
from sensors.record.images import depth_image
from sensors.record.realsense import librealsense


class SdkAligner:
    """`rs.align` on images that were paired here.

    It takes nothing but a set of frames, which only a processing block can put together.
    """

    def __init__(self) -> None:
        rs = librealsense()
        self._pair: list[Any] = []
        self._sets = rs.frame_queue(1, True)

        def join(_: Any, source: Any) -> None:
            source.frame_ready(source.allocate_composite_frame(self._pair))

        self._block = rs.processing_block(join)
        self._block.start(self._sets)
        self._align = rs.align(rs.stream.color)

    def __call__(self, depth: Any, color: Any) -> Units:
        """(H, W) units; librealsense keeps the depth camera's own z."""
        self._pair = [depth, color]
        self._block.invoke(depth)
        joined = self._sets.wait_for_frame(5000).as_frameset()
        self._pair = []
        return depth_image(self._align.process(joined).get_depth_frame())
