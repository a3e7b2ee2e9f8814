"""The sensor's depth as it is: the row that every method must beat."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmark.methods.filling.filler import measured_pixels
from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions
from std_toolkit.errors import ToolkitError


class Raw:
    """Gives back what the sensor measured; 0 ("no answer") where it measured nothing.

    Raises:
        ToolkitError: any setting at all.
    """

    input_size: tuple[int, int] | None = None
    needs_mask = False

    def __init__(self, options: MethodOptions | None = None) -> None:
        for name in (options or MethodOptions()).settings:
            raise ToolkitError("method `raw` has no settings", field=name)

    def restore(self, views: Sequence[View]) -> list[Restored]:
        return [
            Restored(np.where(measured_pixels(v.depth), v.depth, 0).astype(np.float32))
            for v in views
        ]
