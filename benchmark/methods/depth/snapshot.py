"""Depth networks of `transformers`, from a user's own snapshot of a model (`--weights FOLDER`).

The folder is what Hugging Face stores of a model: config.json and safetensors. Nothing is ever
downloaded and no code of the folder runs. Images are prepared as each model's own processor does,
which needs torchvision: the numbers of preprocessor_config.json are read, the resizing is torch's.

Networks that see colour alone know the sensor only through `fit=sensor`: one scale and one shift a
frame, by least squares in what the network predicts (inverse depth, or depth), over measurements
that their neighbours confirm, without those that then lie far off, such as wrong ones on glass.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import interpolate

from benchmark.methods.depth.filling.filler import fill_nearest
from benchmark.methods.depth.sensor_fit import fit_line, trusted_pixels
from benchmark.methods.network import narrow_type, parameter_count, torch_device
from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions
from std_toolkit.arrays import Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import InvalidDocument, read_document
from std_toolkit.plugins import configured

Array = NDArray[np.float64]

_IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
_HALF = ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
_INVERSE_RANGE = (1e-4, 1e4)  # of inverse depth, 1 / m, as Depth Pro's processor clamps it


class _Config(msgspec.Struct, frozen=True):
    """What is read of config.json."""

    model_type: str = ""
    depth_estimation_type: str = "relative"


class _Preparation(msgspec.Struct, frozen=True):
    """What is read of preprocessor_config.json; None where that of the published model holds."""

    size: dict[str, int] | int | None = None
    ensure_multiple_of: float | None = None
    keep_aspect_ratio: bool | None = None
    image_mean: tuple[float, float, float] | None = None
    image_std: tuple[float, float, float] | None = None
    do_pad: bool | None = None
    do_resize: bool = True
    do_rescale: bool = True
    do_normalize: bool = True

    def __post_init__(self) -> None:
        size = (
            {"height": self.size, "width": self.size} if isinstance(self.size, int) else self.size
        )
        hint = "the answer of a network depends on it; use the model's own preprocessor_config.json"
        if size is not None and (set(size) != {"height", "width"} or min(size.values()) < 1):
            raise InvalidDocument("not a height and a width", field="size", value=size, hint=hint)
        for name in ("do_resize", "do_rescale", "do_normalize"):
            if not getattr(self, name):
                raise InvalidDocument("it must be on", field=name, value=False, hint=hint)
        if self.ensure_multiple_of is not None and self.ensure_multiple_of < 1:
            field, value = "ensure_multiple_of", self.ensure_multiple_of
            raise InvalidDocument("not a number above 0", field=field, value=value, hint=hint)


@dataclass(frozen=True, kw_only=True)
class ColorSettings:
    """Settings of networks that see colour alone.

    Attributes:
        fit: `sensor` maps the answer to metres by trusted measurements of the frame; `none` gives
            the network's own, for the protocols `aligned-frame` and `aligned-clip`, and for
            networks that predict metres.
    """

    fit: Literal["sensor", "none"] = "sensor"


@dataclass(frozen=True, kw_only=True)
class PromptSettings:
    """Settings of networks that get the sensor's depth as a prompt.

    Attributes:
        holes: how holes in the prompt are filled, which the network cannot take: by the `nearest`
            measurement, or the `median` of all.
    """

    holes: Literal["nearest", "median"] = "nearest"


class Snapshot(ABC):
    """A network in a folder.

    Args:
        options: `weights` is the folder; settings are those of `settings_type`.

    Raises:
        ToolkitError: no folder, one of another model, or files that cannot be read.
    """

    model_type: ClassVar[str]
    settings_type: ClassVar[type[Any]] = ColorSettings
    # (height, width), multiple, whether proportions stay, mean and deviation of colour.
    size: ClassVar[tuple[int, int]]
    multiple: ClassVar[int] = 1
    keeps_aspect: ClassVar[bool] = True
    colors: ClassVar[tuple[tuple[float, ...], tuple[float, ...]]] = _IMAGENET
    resampling: ClassVar[str] = "bicubic"
    # Whether colour is smoothed before it is made smaller, and whether the centres of the corner
    # pixels stay in place.
    smooths: ClassVar[bool] = True
    corners: ClassVar[bool] = False

    input_size: tuple[int, int] | None = None
    needs_mask = False

    def __init__(self, options: MethodOptions) -> None:
        self.settings = configured(self.settings_type(), options.settings)
        folder = options.weights
        if folder is None:
            raise ToolkitError(
                "the method needs your own snapshot of the model, a folder",
                field="--weights",
                hint="the folder of config.json and model.safetensors; nothing is downloaded",
            )
        self.weights = folder
        self.config = self._read(folder / "config.json", _Config)
        if self.config.model_type != self.model_type:
            raise ToolkitError(
                f"is no model of the type {self.model_type}",
                path=folder / "config.json",
                field="model_type",
                value=self.config.model_type or "none",
            )
        path = folder / "preprocessor_config.json"
        self.preparation = self._read(path, _Preparation) if path.is_file() else _Preparation()
        self.device = torch_device(options.device)
        self._narrow = narrow_type(options.precision)
        self.network = self._load(folder).to(self.device)
        self.parameter_count = parameter_count(self.network)
        if options.compile:
            self.network = torch.compile(self.network)

    @classmethod
    def label_end(cls, settings: Mapping[str, str]) -> str:
        """Return what the name in tables says of the settings that decide what the row is."""
        chosen = configured(cls.settings_type(), settings)
        if isinstance(chosen, PromptSettings):
            return f"+{chosen.holes}"
        return "" if chosen.fit == "none" else "+sensor"

    @staticmethod
    def _read(path: Path, kind: type[Any]) -> Any:
        if not path.is_file():
            raise ToolkitError("is no snapshot of a model: the file is missing", path=path)
        return read_document(path, kind)

    def _load(self, folder: Path) -> Any:
        try:
            from transformers import AutoModelForDepthEstimation
            from transformers.utils.logging import disable_progress_bar
        except ImportError as error:
            raise ToolkitError(
                "transformers is not installed", hint="pip install 'transformers>=5,<6'"
            ) from error
        disable_progress_bar()
        try:
            model = AutoModelForDepthEstimation.from_pretrained(
                folder, local_files_only=True, use_safetensors=True, trust_remote_code=False
            )
        except Exception as error:  # transformers raises what each file's reader raises
            text = " ".join(str(error).split())[:200]
            raise ToolkitError(f"the model cannot be read: {text}", path=folder) from error
        return model.eval()

    def restore(self, views: Sequence[View]) -> list[Restored]:
        """Restore views one by one.

        Raises:
            ToolkitError: `fit=sensor`, and a frame has too few measurements to fit to.
        """
        return [Restored(self.answer(view)) for view in views]

    @abstractmethod
    def answer(self, view: View) -> Floats:
        """Depth (h, w) of one view, metres, or up to scale and shift with `fit=none`."""

    def predict(self, view: View, **more: NDArray[Any]) -> Array:
        """What the network predicts, (h, w) at the size of the view."""
        pixels = self._prepared(view.color)
        given = {name: torch.from_numpy(values).to(self.device) for name, values in more.items()}
        kind = self.device.type
        narrowed = torch.autocast(kind, self._narrow or torch.float32, enabled=bool(self._narrow))
        with torch.inference_mode(), narrowed:
            found = self.network(pixel_values=pixels.to(self.device), **given).predicted_depth
            whole = self._unprepared(found[None].float(), view.depth.shape)
        return whole[0, 0].cpu().numpy().astype(np.float64)

    def _prepared(self, color: NDArray[np.uint8]) -> torch.Tensor:
        """Colour as the network wants it, (1, 3, h, w)."""
        read = self.preparation
        image = torch.from_numpy(np.ascontiguousarray(color.transpose(2, 0, 1))).float() / 255
        mean, deviation = (
            torch.tensor(a)[:, None, None]
            for a in (read.image_mean or self.colors[0], read.image_std or self.colors[1])
        )
        whole = self._padded(image[None])
        small = interpolate(
            whole, self._size(*whole.shape[2:]), mode=self.resampling,
            antialias=self.smooths, align_corners=self.corners,
        )  # fmt: skip
        return (small - mean) / deviation

    def _padded(self, image: torch.Tensor) -> torch.Tensor:
        return image

    def _unprepared(self, found: torch.Tensor, shape: tuple[int, ...]) -> torch.Tensor:
        """The answer (1, 1, h, w) at the size of the view."""
        return interpolate(found, shape, mode="bilinear", align_corners=False)

    def _size(self, height: int, width: int) -> tuple[int, int]:
        """(height, width) that an image is resized to, as the model's own processor does."""
        read = self.preparation
        size = read.size if read.size is not None else self.size
        if isinstance(size, dict):
            wanted = [size["height"], size["width"]]
        else:
            wanted = [size, size] if isinstance(size, int) else list(size)
        multiple = int(read.ensure_multiple_of or self.multiple)
        scales = [wanted[0] / height, wanted[1] / width]
        keeps = self.keeps_aspect if read.keep_aspect_ratio is None else read.keep_aspect_ratio
        if keeps:  # the side that changes less decides
            scales = [min(scales, key=lambda scale: abs(1 - scale))] * 2
        rounded = [round(s * n / multiple) for s, n in zip(scales, (height, width), strict=True)]
        return multiple * max(1, rounded[0]), multiple * max(1, rounded[1])

    def fitted(self, predicted: Array, view: View) -> Array:
        """The prediction after scale and shift, if they are wanted; of inverse depth or depth.

        Raises:
            ToolkitError: too few measurements.
        """
        if self.settings.fit == "none":
            return predicted
        known = 1 / np.where(view.depth > 0, view.depth, 1) if self.is_inverse else view.depth
        scale, shift = fit_line(predicted, known, trusted_pixels(view.depth))
        return scale * predicted + shift

    @property
    def is_inverse(self) -> bool:
        """Whether the network predicts inverse depth."""
        return False

    def to_depth(self, predicted: Array) -> Floats:
        """Depth of a prediction; 0 where it is none."""
        if self.is_inverse:
            low, high = _INVERSE_RANGE
            there = predicted > low
            return np.where(there, 1 / predicted.clip(low, high), 0).astype(np.float32)
        return np.where(predicted > 0, predicted, 0).astype(np.float32)


class DepthAnything(Snapshot):
    """Depth Anything 2: colour alone, relative or metric (--weights SNAPSHOT)."""

    model_type = "depth_anything"
    size, multiple = (518, 518), 14

    @property
    def is_inverse(self) -> bool:
        return bool(self.config.depth_estimation_type == "relative")

    def answer(self, view: View) -> Floats:
        return self.to_depth(self.fitted(self.predict(view), view))


class DepthPro(Snapshot):
    """Depth Pro: colour and the camera's focal length (--weights SNAPSHOT)."""

    model_type = "depth_pro"
    size, keeps_aspect = (1536, 1536), False
    colors, resampling, smooths = _HALF, "bilinear", False
    is_inverse = True

    def answer(self, view: View) -> Floats:
        """See `Snapshot.answer`; the focal length is the camera's, not the network's guess."""
        predicted = self.predict(view) * (view.camera.width / view.camera.fx)
        return self.to_depth(self.fitted(predicted, view))


class ZoeDepth(Snapshot):
    """ZoeDepth: colour alone, metric (--weights SNAPSHOT)."""

    model_type = "zoedepth"
    size, multiple = (384, 512), 32
    colors, resampling, smooths, corners = _HALF, "bilinear", False, True

    def answer(self, view: View) -> Floats:
        return self.to_depth(self.fitted(self.predict(view), view))

    def _border(self, height: int, width: int) -> tuple[int, int]:
        """Pixels that are mirrored on each side; the processor's own rule."""
        if self.preparation.do_pad is False:
            return 0, 0
        above, left = int(3 * np.sqrt(height / 2)), int(3 * np.sqrt(width / 2))
        return min(above, height - 1), min(left, width - 1)

    def _padded(self, image: torch.Tensor) -> torch.Tensor:
        above, left = self._border(*image.shape[2:])
        sides = (left, left, above, above)
        return torch.nn.functional.pad(image, sides, mode="reflect")

    def _unprepared(self, found: torch.Tensor, shape: tuple[int, ...]) -> torch.Tensor:
        above, left = self._border(*shape)
        padded = (shape[0] + 2 * above, shape[1] + 2 * left)
        whole = interpolate(found, padded, mode="bicubic", align_corners=False)
        return whole[..., above : above + shape[0], left : left + shape[1]]


class PromptDepthAnything(Snapshot):
    """Prompt Depth Anything: metric, prompted by the sensor's depth (--weights SNAPSHOT)."""

    model_type = "prompt_depth_anything"
    settings_type = PromptSettings
    size, multiple = (756, 756), 14

    def answer(self, view: View) -> Floats:
        """See `Snapshot.answer`; 0 everywhere without a single measurement."""
        if not (view.depth > 0).any():
            return np.zeros_like(view.depth)
        prompt = filled_prompt(view.depth, self.settings.holes)
        return self.to_depth(self.predict(view, prompt_depth=prompt[None, None]))


def filled_prompt(depth: Floats, holes: Literal["nearest", "median"]) -> Floats:
    """The sensor's depth without holes.

    Args:
        depth: (h, w) metres, 0 where nothing was measured, but not everywhere.
        holes: what they are filled with: the nearest measurement, or the median of all.

    Returns:
        (h, w) float32 metres, of two values at least: the network divides by their range.
    """
    there = depth > 0
    filled = fill_nearest(depth, ~there) if holes == "nearest" else depth.copy()
    filled[filled == 0] = np.median(depth[there])
    if np.ptp(filled) == 0:
        filled[0, 0] *= np.float32(1 + 1e-6)
    return filled.astype(np.float32)
