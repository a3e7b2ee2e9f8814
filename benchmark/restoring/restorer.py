"""A depth restorer for images of any size: `from benchmark import Restorer`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.evaluation.frames import check_restored
from benchmark.methods import protocol
from benchmark.methods.depth.full_size import sensor_view, to_full_size, working_size
from benchmark.methods.registry import (
    MethodOptions,
    make_restorer,
    preset_for,
)
from benchmark.restoring.graphs import shipped_graph, users_graph
from benchmark.restoring.options import Backend, MethodChoice, Where, default_where
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.depth_maps import LARGEST_MEDIAN_DEPTH_M
from std_toolkit.settings import Settings, limit

FINDER = "compactdr"  # looks for glass and metal where a method does not
GLASS = 0.5  # probability from which on a pixel is glass or metal


@dataclass(frozen=True, kw_only=True)
class WhereSettings(Settings):
    """Where a network answers for the finder of glass and metal."""

    doubted: float = limit(
        0.65,
        source="simulated validation frames: harm around glass of 1 % (0.75: 1.3, 0.85: 1.9)",
    )
    """trust in the sensor below which another network answers on glass and metal"""


@dataclass(frozen=True, eq=False)
class RestoredFrame:
    """Restored depth of a frame, at the camera's size.

    Attributes:
        depth: (H, W) float32 metres, z-depth; 0 where neither sensor nor method has an answer.
        confidence: (H, W) float32 in [0, 1], the method's trust in the sensor; None of methods
            without it.
        changed: (H, W) bool pixels whose depth is not the sensor's own.
        spread: (H, W) float32 metres, the expected error (standard deviation) of the method's
            answer; None of methods without it.
        clear: (H, W) float32 in [0, 1], probability of glass or metal; None of methods that do not
            look for it.
    """

    depth: NDArray[np.float32]
    confidence: NDArray[np.float32] | None
    changed: NDArray[np.bool_]
    spread: NDArray[np.float32] | None = None
    clear: NDArray[np.float32] | None = None


class Restorer:
    """A depth restorer that takes and gives depth at the camera's own size.

    Use `Restorer.load`.

    Args:
        method: restorer at its own image size.
        options: that it was made with.
        where: where the method answers. `everywhere`; on `glass` and metal alone, by its own mask
            or that of compactdr; `glass-and-holes`: where compactdr finds glass or metal and trusts
            the sensor less than `WhereSettings.doubted`, while all else is compactdr's.
        backend: what runs the network that looks for glass and metal; see `load`.
        max_error_m: depth with a larger expected error is left out; None for no limit.
    """

    def __init__(
        self,
        method: protocol.Restorer,
        options: MethodOptions,
        *,
        where: Where = "everywhere",
        backend: Backend = "auto",
        max_error_m: float | None = None,
    ) -> None:
        self.method = method
        self.options = options
        self.where = where
        self.backend: Backend = backend
        self._finder: protocol.Restorer | None = None
        self.max_error_m = max_error_m

    @classmethod
    def load(
        cls,
        method: str = "swindrnet",
        *,
        preset: str | None = None,
        weights: Path | str | None = None,
        size: tuple[int, int] | None = None,
        device: str = "cpu",
        backend: Backend = "auto",
        settings: Mapping[str, str] | None = None,
        where: Where | None = None,
    ) -> Restorer:
        """Load a method and its weights.

        Args:
            method: a name of `std-bench list methods`, `package.module:Class`, or
                `path/to/file.py:Class`.
            preset: `published` or `compact`; by default `compact` if its weights ship and no
                `weights` are given.
            weights: file of trained weights: .safetensors, or .onnx of `std-restore export`.
            size: (width, height) that the network works at; by default its own.
            device: cpu, cuda, or cuda:1.
            backend: `onnx` (onnxruntime), `torch`, or `auto`: onnxruntime where it is installed
                and the toolkit has the method's graph at this size, otherwise torch.
            settings: the method's own settings by name, as text.
            where: where the method answers, see `Restorer`; by default `glass-and-holes` for
                `swindrnet` without `weights`, else `everywhere`.

        Raises:
            ToolkitError: no such method, setting, device or file, weights of another network, a
                method that needs a mask, or a package that is not installed.
        """
        options = MethodOptions(
            preset=preset_for(method, preset, None if weights is None else Path(weights)),
            weights=None if weights is None else Path(weights),
            device=device,
            settings=dict(settings or {}),
        )
        where = where or default_where(method, weights)
        if options.weights is not None and options.weights.suffix == ".onnx":
            made = users_graph(method, options, size, backend)
            return cls(made, options, where=where, backend=backend)
        graph = shipped_graph(method, options, size, backend)
        if graph is not None:
            options = MethodOptions(preset=options.preset, weights=graph, device=device)
            made = make_restorer("onnx", options)
            return cls(made, options, where=where, backend=backend)
        if size is not None:
            added = {"input_size": f"{size[0]},{size[1]}"}
            options = MethodOptions(
                preset=options.preset,
                weights=options.weights,
                device=device,
                settings=added | dict(options.settings),
            )
        made = make_restorer(method, options)
        if getattr(made, "needs_infrared", False):
            raise ToolkitError(
                "the method needs the infrared pair, which std-restore does not read",
                field="--method", value=method, hint="std-bench scores it where the data have it",
            )  # fmt: skip
        if made.needs_mask:
            raise ToolkitError(
                "the method needs a mask of the pixels to doubt, which a camera does not give",
                field="--method",
                value=method,
                hint="choose another method or another setting of `mask`",
            )
        return cls(made, options, where=where, backend=backend)

    @classmethod
    def of(
        cls, choice: MethodChoice, *, device: str = "cpu", backend: Backend = "auto"
    ) -> Restorer:
        """Load what the options of a command choose; see `load`."""
        made = cls.load(
            choice.method,
            preset=choice.preset,
            weights=choice.weights,
            size=choice.size,
            device=device,
            backend=backend,
            settings=settings_of(choice.settings),
            where=choice.answers,
        )
        made.max_error_m = choice.max_error_m
        if made.where == "glass-and-holes":
            made.finder()  # a file that is damaged is told once, before any frame
        return made

    def restore(
        self, color: NDArray[np.uint8], depth: NDArray[np.floating], K: ArrayLike
    ) -> RestoredFrame:
        """Restore the depth of one frame.

        The method works at its own size. Its answer is brought to the camera's size, guided by
        colour. Pixels that the method trusts, and whose measurement is within 1.5 cm of the
        restored depth around them, keep the sensor's depth as measured; of a method without
        confidence, those within 3 cm.

        Args:
            color: (H, W, 3) uint8 RGB.
            depth: (H, W) floating-point metres, z-depth aligned to `color`. What is not finite or
                not positive is not measured.
            K: (3, 3) camera matrix of the images, or (fx, fy, cx, cy), pixels; the centre of the
                top-left pixel is (0, 0).

        Returns:
            Depth, confidence and changed pixels, all (H, W).

        Raises:
            ToolkitError: arrays of another type or shape, depth that is not aligned or not in
                metres, depth without any measurement, a matrix that does not fit the images, or an
                invalid answer of the method.
        """
        color, sensor = _checked(color, depth)
        return self.restore_view(color, sensor, _camera(K, sensor.shape))

    def restore_view(
        self, color: NDArray[np.uint8], sensor: NDArray[np.float32], camera: Camera
    ) -> RestoredFrame:
        """`restore` of arrays that are known to be good: 0 where nothing was measured.

        Raises:
            ToolkitError: no pixel is measured, or an invalid answer of the method.
        """
        if not (sensor > 0).any():
            raise ToolkitError(
                "the sensor measured nothing, so that nobody knows how far away anything is",
                field="depth",
            )
        size = working_size(self.method, camera.size)
        view = sensor_view(color, sensor, camera, size)
        found = to_full_size(sensor, _answer(self.method, view), color)
        depth, clear, spread = found.depth, found.clear, found.spread
        confidence = found.confidence
        if self.where == "glass-and-holes" or (self.where == "glass" and clear is None):
            finder = self.finder()
            seen = sensor_view(color, sensor, camera, working_size(finder, camera.size))
            by_finder = to_full_size(sensor, _answer(finder, seen), color)
            clear, trust = by_finder.clear, by_finder.confidence
            assert clear is not None and trust is not None
            if self.where == "glass-and-holes":
                answered = (clear >= GLASS) & (trust < WhereSettings.current().doubted)
                confidence = trust if confidence is None else np.where(answered, confidence, trust)
                if by_finder.spread is not None:
                    # Of a network that does not say how far off it is, the other's word is taken,
                    # and how far the two are apart.
                    apart = np.hypot(by_finder.spread, depth - by_finder.depth)
                    spread = np.where(
                        answered, apart if spread is None else spread, by_finder.spread
                    )
                depth = np.where(answered, depth, by_finder.depth)
        if self.max_error_m is not None and spread is None:
            raise ToolkitError(
                "the method does not say how far off its answers are",
                field="--max-error",
                hint=f"the default and --method {FINDER} do",
            )
        if self.max_error_m is not None and spread is not None:
            depth = np.where(spread <= self.max_error_m, depth, np.float32(0))
        if self.where == "glass":
            assert clear is not None
            depth = np.where(clear >= GLASS, depth, sensor)
        return RestoredFrame(depth, confidence, depth != sensor, spread, clear)

    def finder(self) -> protocol.Restorer:
        """The network that looks for glass and metal, on the device of the method.

        Raises:
            ToolkitError: its file is damaged, or a package is missing.
        """
        if self._finder is None:
            device = self.options.device
            self._finder = Restorer.load(FINDER, device=device, backend=self.backend).method
        return self._finder


def _answer(method: protocol.Restorer, view: protocol.View) -> protocol.Restored:
    """The method's answer to one view.

    Raises:
        ToolkitError: it gives none, or an invalid one.
    """
    answers = method.restore([view])
    if len(answers) != 1:
        raise ToolkitError(f"the method gave {len(answers)} answers to one view")
    check_restored(view, answers[0])
    return answers[0]


def settings_of(texts: Sequence[str]) -> dict[str, str]:
    """Settings by name from `NAME=VALUE`.

    Raises:
        ToolkitError: a text without name or value.
    """
    found = {}
    for text in texts:
        name, _, value = text.partition("=")
        if not (name and value):
            raise ToolkitError("expected NAME=VALUE", field="--set", value=text)
        found[name] = value
    return found


def _checked(
    color: NDArray[np.uint8], depth: NDArray[np.floating]
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    color, depth = np.asarray(color), np.asarray(depth)
    if color.dtype != np.uint8 or color.ndim != 3 or color.shape[2] != 3:
        raise ToolkitError(
            "must be (H, W, 3) uint8 RGB", field="color", value=f"{color.dtype} {color.shape}"
        )
    if depth.dtype.kind != "f":
        raise ToolkitError(
            "must be floating-point metres",
            field="depth",
            value=str(depth.dtype),
            hint="multiply 16-bit depth by its scale: depth * np.float32(0.001)",
        )
    if depth.shape != color.shape[:2]:
        raise ToolkitError(
            f"must have the size of the colour image, {color.shape[:2]}",
            field="depth",
            value=depth.shape,
            hint="align depth to colour (RealSense: rs.align(stream.color))",
        )
    measured = np.isfinite(depth) & (depth > 0)
    sensor = np.where(measured, depth, 0).astype(np.float32)
    middle = float(np.median(sensor[measured])) if measured.any() else 1.0
    if middle > LARGEST_MEDIAN_DEPTH_M:
        raise ToolkitError(
            "must be in metres", field="depth", value=f"median {middle:.4g}", hint="millimetres?"
        )
    return color, sensor


def _camera(K: ArrayLike, shape: tuple[int, ...]) -> Camera:
    try:
        numbers = np.asarray(K, np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape == (3, 3):
        numbers = numbers[[0, 1, 0, 1], [0, 1, 2, 2]]
    if numbers.shape != (4,):
        raise ToolkitError(
            "must be a (3, 3) camera matrix or (fx, fy, cx, cy)", field="K", value=numbers.shape
        )
    return Camera(shape[1], shape[0], *numbers)
