"""Which depth poses are fitted to: raw, true, restored, or restored earlier and saved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame
from benchmark.data.saved import saved_depth_path
from benchmark.data.source import FrameKey
from benchmark.methods.full_size import at_full_size
from benchmark.methods.protocol import Restorer
from benchmark.methods.registry import MethodOptions, make_restorer
from benchmark.running.batch import restore_views, told
from benchmark.running.views import view_of
from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import read_exr_channel

RAW, TRUE = "raw", "gt"
Depth = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class DepthChoice:
    """One of the depths that poses are fitted to.

    Attributes:
        name: `raw`, `gt`, a restorer's name, or what depth in a folder is called.
        options: of the restorer.
        folder: of depth that `std-bench --save-depth` kept; None for the others.
    """

    name: str
    options: MethodOptions = field(default_factory=MethodOptions)
    folder: Path | None = None

    @property
    def is_restored(self) -> bool:
        """Whether a restorer has to make it."""
        return self.folder is None and self.name not in (RAW, TRUE)

    @property
    def label(self) -> str:
        """As folders and tables have it."""
        return self.name.replace(":", ".")


class DepthGiver:
    """Gives the depth of frames; made once in every worker.

    Raises:
        ToolkitError: the restorer cannot be made, or there is no such folder.
    """

    def __init__(self, choice: DepthChoice, split: str) -> None:
        self.choice = choice
        self.split = split
        self.restorer: Restorer | None = None
        if choice.is_restored:
            self.restorer = make_restorer(choice.name, choice.options)
        elif choice.folder is not None and not choice.folder.is_dir():
            raise ToolkitError("no such folder of saved depth", path=choice.folder)

    def depths(self, frames: Mapping[int, DepthFrame]) -> dict[int, Depth | str]:
        """Depth of the frames of a batch, each of any size, or why there is none."""
        if self.restorer is None:
            return {index: self._known(frame) for index, frame in frames.items()}
        method = self.restorer
        views = {
            index: view_of(frame, method.input_size, with_mask=method.needs_mask)
            for index, frame in frames.items()
        }
        answers = restore_views(method, views)
        return {
            i: a if isinstance(a, str) else at_full_size(frames[i].depth_raw, a)
            for i, a in answers.items()
        }

    def _known(self, frame: DepthFrame) -> Depth | str:
        if self.choice.folder is None:
            return frame.depth_true if self.choice.name == TRUE else frame.depth_raw
        path = saved_depth_path(self.choice.folder, self.split, FrameKey(frame.scene, frame.name))
        try:
            return read_exr_channel(path).astype(np.float32)
        except ToolkitError as error:
            return told(error)
