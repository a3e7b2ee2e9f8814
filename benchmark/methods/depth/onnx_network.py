"""A restoration network in the ONNX format, run by onnxruntime without torch.

`std-restore export` writes such files. The graph `network(color, depth)` has the interface of
`benchmark.methods.network.NetworkRestorer`, for one image of a fixed size, or of any size whose
sides are multiples of 32: images are then enlarged at the right and below by their last pixels.
"""

import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import resize_nearest
from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.options import usable_cores
from std_toolkit.plugins import configured

INPUTS = ("color", "depth")
# The last ones are missing in networks without them.
OUTPUTS = ("restored", "confidence", "spread", "clear")
MULTIPLE = 32  # of the sides of images of any size
LONGEST = "longest"  # pixels of images of any size at most: a note in the file


@dataclass(frozen=True)
class OnnxConfig:
    """Settings of `OnnxNetwork`.

    Attributes:
        threads: of an operation; None for OMP_NUM_THREADS, or else all usable cores.
        timeout_s: seconds after which a frame is given up: a graph can hold a loop without end.
            The shipped networks take up to 4 s.
    """

    threads: int | None = None
    timeout_s: float = 20.0


class OnnxNetwork:
    """A network that `std-restore export` wrote, run by onnxruntime (--weights FILE.onnx).

    Raises:
        ToolkitError: no file, another kind of file, an unknown setting, onnxruntime or the device
            is missing, or a precision other than that of the file is asked for.
    """

    settings_type = OnnxConfig

    needs_mask = False

    def __init__(self, options: MethodOptions) -> None:
        if options.weights is None:
            raise ToolkitError(
                "the method needs a file", field="--weights", hint="`std-restore export` writes it"
            )
        if options.precision != "fp32":
            raise ToolkitError(
                "an ONNX file is run in its own precision",
                field="--precision",
                value=options.precision,
            )
        config = configured(OnnxConfig(), options.settings)
        self.weights, self._timeout_s = options.weights, config.timeout_s
        self._session, self._options = _session(options.weights, options.device, config.threads)
        self.input_size = _input_size(self._session, options.weights)
        notes = self._session.get_modelmeta().custom_metadata_map
        longest = notes.get(LONGEST, "")
        self.longest = int(longest) if longest.isdecimal() else None

    def restore(self, views: Sequence[View]) -> list[Restored]:
        """Restore views one by one; those of another size are resized by the nearest pixel."""
        return [self._restore(view) for view in views]

    def _restore(self, view: View) -> Restored:
        color, depth = view.color, view.depth
        size = (depth.shape[1], depth.shape[0])
        if self.input_size is None:
            right, below = -size[0] % MULTIPLE, -size[1] % MULTIPLE
            color = np.pad(color, ((0, below), (0, right), (0, 0)), mode="edge")
            depth = np.pad(depth, ((0, below), (0, right)), mode="edge")
        elif size != self.input_size:
            color = resize_nearest(color, self.input_size)
            depth = resize_nearest(depth, self.input_size)
        depth = np.where(np.isfinite(depth) & (depth > 0), depth, 0)
        images = (color.transpose(2, 0, 1).astype(np.float32) / np.float32(255), depth[None])
        named = {
            name: np.ascontiguousarray(image[None], np.float32)
            for name, image in zip(INPUTS, images, strict=True)
        }
        expected = (1, 1, *depth.shape)
        outputs = self._run(named)
        for output in outputs:
            if np.shape(output) != expected:
                raise ToolkitError(
                    f"an answer of the network must have the shape {expected}",
                    path=self.weights,
                    value=np.shape(output),
                )
        found = [np.asarray(output[0, 0], np.float32) for output in outputs]
        if self.input_size is None:
            found = [image[: size[1], : size[0]] for image in found]
        elif size != self.input_size:
            found = [resize_nearest(image, size) for image in found]
        if len(found) > 1:
            found[1] = found[1].clip(0, 1)
        return Restored(*found)

    def _run(self, images: dict[str, NDArray[np.float32]]) -> list[NDArray[Any]]:
        """What the network answers.

        Raises:
            ToolkitError: it fails, or takes longer than `timeout_s`.
        """
        options = self._options()
        options.log_severity_level = 4  # a failure is reported below
        late = threading.Event()

        def end() -> None:
            late.set()
            options.terminate = True

        timer = threading.Timer(self._timeout_s, end)
        timer.daemon = True
        timer.start()
        try:
            return list(self._session.run(None, images, options))
        except Exception as error:  # the binding has an exception for every status
            if late.is_set():
                raise ToolkitError(
                    f"the network took longer than {self._timeout_s:g} s for a frame",
                    path=self.weights,
                    hint="--set timeout_s=SECONDS allows more",
                ) from error
            line = " ".join(str(error).split())[:300]
            raise ToolkitError(f"the network fails: {line}", path=self.weights) from error
        finally:
            timer.cancel()


def _session(path: Path, device: str, threads: int | None) -> tuple[Any, Any]:
    """The session of a graph, and the class of the options of its runs."""
    try:
        import onnxruntime
    except ImportError as error:
        raise ToolkitError(
            "onnxruntime is not installed", hint="pip install 'std-toolkit[restore]'"
        ) from error
    if not path.is_file():
        problem = "is not a regular file" if path.exists() else "no such file of weights"
        raise ToolkitError(problem, path=path)
    if path.suffix != ".onnx":
        raise ToolkitError("not an ONNX file", path=path, hint="`std-restore export` writes one")
    kind, _, index = device.partition(":")
    provider = {"cpu": "CPUExecutionProvider", "cuda": "CUDAExecutionProvider"}.get(kind)
    if provider not in onnxruntime.get_available_providers():
        raise ToolkitError(
            "onnxruntime does not have this device here",
            field="--device",
            value=device,
            hint="for CUDA: pip install onnxruntime-gpu, or --backend torch",
        )
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = threads or _threads()
    # Threads that wait for work in a loop would take the cores from reading and writing.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    settings = {"device_id": index} if index else {}
    try:
        made = onnxruntime.InferenceSession(str(path), options, providers=[(provider, settings)])
    except Exception as error:  # the binding has an exception for every status
        raise ToolkitError(f"onnxruntime cannot load it: {error}", path=path) from error
    return made, onnxruntime.RunOptions


def _threads() -> int:
    given = os.environ.get("OMP_NUM_THREADS", "")
    return int(given) if given.isdecimal() and int(given) else usable_cores()


def _input_size(session: Any, path: Path) -> tuple[int, int] | None:
    """(width, height) of the graph's images; None for any.

    Raises:
        ToolkitError: the graph is not a restorer of images.
    """
    names = tuple(each.name for each in session.get_inputs())
    outputs = tuple(each.name for each in session.get_outputs())
    shapes = [each.shape for each in session.get_inputs()]
    fits = names == INPUTS and outputs in [OUTPUTS[:n] for n in range(1, len(OUTPUTS) + 1)]
    if not (fits and shapes[0][:2] == [1, 3] and shapes[1] == [1, 1, *shapes[0][2:]]):
        raise ToolkitError(
            "not a network that restores depth: it must have the inputs color (1, 3, h, w) and "
            "depth (1, 1, h, w) and the output restored",
            path=path,
            value=dict(zip(names, shapes, strict=True)),
            hint="`std-restore export` writes one",
        )
    height, width = shapes[0][2:]
    if isinstance(height, str) and isinstance(width, str):
        return None
    return int(width), int(height)
