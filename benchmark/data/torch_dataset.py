"""Frames as tensors of one size, for training."""

from typing import Any, Literal

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import interpolate
from torch.utils.data import Dataset, get_worker_info

from benchmark.data.frame import BACKGROUND, DepthFrame
from benchmark.data.splits import DepthSource
from std_toolkit.errors import ToolkitError


class DepthDataset(Dataset[dict[str, Any]]):
    """The frames of a source, resized; a map-style data set for `torch.utils.data.DataLoader`.

    An item has
        color: (3, h, w) float32 in [0, 1], RGB.
        depth_raw, depth_true: (1, h, w) float32 metres, 0 = missing.
        mask: (h, w) uint8 instance ids, 255 elsewhere.
        material: (h, w) uint8 `Material`, 255 elsewhere.
        class_id: (h, w) uint8 category, 0 = other, 255 elsewhere.
        K: (3, 3) float32 intrinsics at this size; fx and fy differ if the aspect ratio changes.
        nocs: (3, h, w) float32, only if requested.
        index, key: index and name of the frame.

    Args:
        source: source of the frames; it is pickled to the worker processes.
        size: (width, height) of all maps; the aspect ratio may change.
        color: interpolation of colour. All other maps use nearest-neighbour sampling with the
            indices of `torch.nn.functional.interpolate`.
        nocs: whether items have the NOCS map.

    Raises:
        ToolkitError: invalid size. Items raise the errors of `DepthSource.load`, and an error if
            `nocs` is requested and the frame has none.
    """

    def __init__(
        self,
        source: DepthSource,
        size: tuple[int, int],
        *,
        color: Literal["nearest", "cubic"] = "nearest",
        nocs: bool = False,
    ) -> None:
        if min(size) < 1:
            raise ToolkitError("must be positive", field="size", value=size)
        self.source = source
        self.size = size
        self.color = color
        self.nocs = nocs

    def __len__(self) -> int:
        return len(self.source)

    def __getitem__(self, index: int) -> dict[str, Any]:
        if get_worker_info() is not None:
            # Otherwise every worker starts one thread per core.
            cv2.setNumThreads(0)
        return self.item(self.source.load(index, nocs=self.nocs), index)

    def item(self, frame: DepthFrame, index: int) -> dict[str, Any]:
        """Return the tensors of a frame."""
        mask = self._nearest(frame.mask)[0, 0]
        materials, classes = (np.full(256, BACKGROUND, np.uint8) for _ in range(2))
        for instance in frame.instances:
            materials[instance.mask_id] = instance.material
            classes[instance.mask_id] = instance.class_id
        ids = mask.long()
        item: dict[str, Any] = {
            "color": self._color(frame.color),
            "depth_raw": self._nearest(frame.depth_raw)[0],
            "depth_true": self._nearest(frame.depth_true)[0],
            "mask": mask,
            "material": torch.from_numpy(materials)[ids],
            "class_id": torch.from_numpy(classes)[ids],
            "K": torch.from_numpy(frame.camera.resized(*self.size).K.astype(np.float32)),
            "index": index,
            "key": frame.key,
        }
        if self.nocs:
            if frame.nocs is None:
                raise ToolkitError(
                    "the frame has no NOCS map",
                    path=frame.key,
                    hint="category-novel sets have none",
                )
            item["nocs"] = self._nearest(frame.nocs)[0]
        return item

    def _color(self, image: NDArray[np.uint8]) -> torch.Tensor:
        if self.color == "cubic":
            resized = cv2.resize(image, self.size, interpolation=cv2.INTER_CUBIC)
            tensor = torch.from_numpy(resized).permute(2, 0, 1)
        else:
            tensor = self._nearest(image)[0]
        return tensor.float() / 255

    def _nearest(self, image: NDArray[Any]) -> torch.Tensor:
        """(1, C, h, w) of (H, W) or (H, W, C)."""
        tensor = torch.from_numpy(np.ascontiguousarray(image))
        tensor = tensor[None, None] if image.ndim == 2 else tensor.permute(2, 0, 1)[None]
        width, height = self.size
        return interpolate(tensor, size=(height, width), mode="nearest")
