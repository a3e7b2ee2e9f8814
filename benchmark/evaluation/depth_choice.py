"""The depth that a task works on: raw, true, by a restorer, or saved in a folder."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame
from benchmark.data.predictions import DepthFolder
from benchmark.data.splits import FrameKey
from benchmark.evaluation.config import AS_FILED
from benchmark.evaluation.frames import error_line, restore_views
from benchmark.evaluation.values import plain_label
from benchmark.methods.depth.full_size import at_full_size, restorer_view
from benchmark.methods.protocol import Restorer
from benchmark.methods.registry import MethodOptions, make_restorer, restorers, weights_digest
from benchmark.methods.training_data import training_data, training_seed
from std_toolkit.errors import ToolkitError

RAW, TRUE = "raw", "gt"

Depth = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class DepthChoice:
    """One of the depths that poses are fitted to.

    Attributes:
        name: `raw`, `gt`, the name of a restorer, the name given to a folder of depth, or
            `as-filed`.
        options: options of the restorer.
        folder: folder of saved depth, or of poses that are `as-filed`; otherwise None.
    """

    name: str
    options: MethodOptions = field(default_factory=MethodOptions)
    folder: Path | None = None

    @property
    def is_restored(self) -> bool:
        """Whether the depth comes from a restorer."""
        return self.folder is None and self.name not in (RAW, TRUE)

    @property
    def label(self) -> str:
        """Name in folders and tables."""
        return plain_label(self.name)


def depth_choice(text: str) -> DepthChoice:
    """Parse `raw`, `gt`, the name of a restorer, or `NAME=FOLDER`.

    Raises:
        ToolkitError: a folder without a name, or with the name of another depth.
    """
    name, equals, folder = text.partition("=")
    if equals:
        if name in (RAW, TRUE, AS_FILED, *restorers.names()) or not name:
            raise ToolkitError(
                "depth in a folder needs a name of its own", field="depth", value=text
            )
        return DepthChoice(name=name, folder=Path(folder))
    return DepthChoice(name=text)


class DepthProvider:
    """Returns the depth of frames; created once in every worker.

    Raises:
        ToolkitError: the restorer cannot be created, or the folder does not exist.
    """

    def __init__(self, choice: DepthChoice, split: str) -> None:
        self.choice = choice
        self.split = split
        self.restorer: Restorer | None = None
        if choice.is_restored:
            self.restorer = make_restorer(choice.name, choice.options)
        self.answers = None if choice.folder is None else DepthFolder(choice.folder, split)

    def setup(self) -> dict[str, Any]:
        """Return the fields of a setup that the depth determines."""
        choice, options, folder = self.choice, self.choice.options, self.choice.folder
        return {
            "depth": choice.name,
            "depth_preset": options.preset if choice.is_restored else "",
            "depth_settings": dict(options.settings),
            "depth_weights_sha256": weights_digest(choice.name, self.restorer, options),
            "depth_folder": "" if folder is None else str(folder.resolve()),
        }

    @property
    def training_data(self) -> str:
        """What the restorer was trained on; see `benchmark.methods.training_data`."""
        return training_data(self.choice.name, self.restorer, self.choice.options)

    @property
    def training_seed(self) -> int | None:
        """Seed that the restorer was trained with; see `benchmark.methods.training_data`."""
        return training_seed(self.choice.name, self.restorer, self.choice.options)

    def depths(self, frames: Mapping[int, DepthFrame]) -> dict[int, Depth | str]:
        """Return the depth of the frames of a batch, each of any size, or error lines."""
        if self.restorer is None:
            return {index: self._known(frame) for index, frame in frames.items()}
        method = self.restorer
        views = {index: restorer_view(frame, method) for index, frame in frames.items()}
        answers = restore_views(method, views)
        return {
            i: a if isinstance(a, str) else at_full_size(frames[i].depth_raw, a)
            for i, a in answers.items()
        }

    def _known(self, frame: DepthFrame) -> Depth | str:
        if self.answers is None:
            return frame.depth_true if self.choice.name == TRUE else frame.depth_raw
        try:
            return self.answers.read(FrameKey(frame.scene, frame.name))
        except ToolkitError as error:
            return error_line(error)
