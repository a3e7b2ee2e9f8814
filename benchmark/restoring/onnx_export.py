"""Export of restoration networks to ONNX, and the comparison with torch.

The weights that come with the toolkit are not stored twice: the shipped graphs refer to numbers
within the safetensors file beside them (`write_graph`). A user's file holds its weights.

Source: "External Data" and "Intermediate Representation", onnx.ai.
"""

import json
import logging
import struct
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.methods.depth.onnx_network import INPUTS, LONGEST, OUTPUTS, OnnxNetwork
from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions, make_restorer, preset_for, sha256_of
from benchmark.restoring.options import ExportOptions
from benchmark.restoring.restorer import settings_of
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.io.atomic import atomic_path

# Metres, and share of 1: by what onnxruntime and torch may differ in single precision.
LARGEST_DIFFERENCE = 1e-4

_OPSET = 18  # of onnxruntime 1.14 and later
_MAPS = ("depth", "confidence", "spread", "clear")  # of `Restored`
_ANY = (224, 160)  # size at which a network of any size is traced
_TRIED = ((224, 126), (120, 176))  # sizes at which it must answer as torch does
_NAMED = "network."  # before the names of weights in the exported module


def export_choice(options: ExportOptions) -> str:
    """Write what the options of a command choose; returns a line on it for the terminal.

    Raises:
        ToolkitError: as `export_onnx`.
    """
    choice = options.choice
    settings = settings_of(choice.settings)
    if choice.size is not None:
        settings["input_size"] = f"{choice.size[0]},{choice.size[1]}"
    preset = preset_for(choice.method, choice.preset, choice.weights)
    made = MethodOptions(preset=preset, weights=choice.weights, settings=settings)
    found = export_onnx(choice.method, made, options.out)
    told = [f"depth differs from torch's by at most {found['depth']:.1e} m"]
    told += [f"{name} by {apart:.1e}" for name, apart in list(found.items())[1:]]
    return f"{options.out}: {', '.join(told)}"


def export_onnx(method: str, options: MethodOptions, out: Path) -> dict[str, float]:
    """Write a restorer's network as one ONNX file, weights included.

    Args:
        method: name of a restorer around a network.
        options: preset, weights and settings; `input_size` is one of SwinDRNet's. A network of
            images of any size gives a graph of any size.
        out: the file, with the suffix .onnx.

    Returns:
        The largest differences from torch on made-up views, by the names of `Restored`.

    Raises:
        ToolkitError: a method without a network of colour and depth, one that cannot be exported,
            or a result that differs from that of torch; no file is left then.
    """
    restorer, model, state = _exported(method, options)
    weights = [_tensor(name, array) for name, array in state.items()]
    return _write(out, restorer, _with_weights(model, [], weights), method, options)


def write_graph(method: str, options: MethodOptions, out: Path) -> dict[str, float]:
    """Write a graph without weights, which refers to the safetensors file in its folder.

    It is how graphs of shipped weights are made; see `export_onnx`.

    Args:
        out: the graph; the file of weights lies beside it.
    """
    import onnx

    assert options.weights is not None
    restorer, model, state = _exported(method, options)
    entries, begin = _safetensors_header(options.weights)
    casts, weights = [], []
    for name, array in state.items():
        entry = entries[name.removeprefix(_NAMED)]
        wanted = onnx.helper.np_dtype_to_tensor_dtype(array.dtype)
        tensor = onnx.TensorProto(
            name=name,
            dims=entry["shape"],
            data_type=onnx.helper.np_dtype_to_tensor_dtype(np.dtype(_TYPES[entry["dtype"]])),
            data_location=onnx.TensorProto.EXTERNAL,
        )
        first, last = entry["data_offsets"]
        for key, value in (
            ("location", options.weights.name),
            ("offset", begin + first),
            ("length", last - first),
        ):
            tensor.external_data.add(key=key, value=str(value))
        if tensor.data_type != wanted:  # half precision in the file
            tensor.name = f"{name}.half"
            casts.append(onnx.helper.make_node("Cast", [tensor.name], [name], to=wanted))
        weights.append(tensor)
    return _write(out, restorer, _with_weights(model, casts, weights), method, options)


_TYPES = {"F16": np.float16, "F32": np.float32, "I64": np.int64}


def _exported(method: str, options: MethodOptions) -> tuple[Any, Any, dict[str, np.ndarray]]:
    """The restorer, its graph without weights, and the weights that the graph uses by name."""
    import onnxruntime  # noqa: F401 - needed at the end; missed before minutes of work
    import torch

    from benchmark.methods.network import NetworkRestorer

    restorer = make_restorer(method, options)
    if (
        not isinstance(restorer, NetworkRestorer)
        or not restorer.takes_color_and_depth
        or not (restorer.input_size or hasattr(restorer, "longest"))
    ):
        raise ToolkitError(
            "has no network of colour and depth of a fixed size or of any, which alone can be "
            "exported",
            field="--method",
            value=method,
        )
    network = _with_tuple(restorer.plain_network())
    width, height = restorer.input_size or _ANY
    # It warns of every package that it could use and does not need.
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    example = (torch.rand(1, 3, height, width), torch.rand(1, 1, height, width) + 0.5)
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            outputs = OUTPUTS[: len(network(*example))]
            if restorer.input_size is None:
                model, state = _of_any_size(network, example, outputs)
            else:
                model, state = _of_one_size(network, example, outputs)
    except (ToolkitError, KeyboardInterrupt, MemoryError):
        raise
    except Exception as error:  # the exporter raises whatever it meets
        reason = next((line for line in str(error).splitlines() if line.strip()), "")
        raise ToolkitError(
            f"torch cannot export this network: {type(error).__name__}: {reason}",
            field="--method",
            value=method,
        ) from error
    for _ in range(len(model.graph.input) - len(INPUTS)):
        model.graph.input.pop()
    used = {name for node in model.graph.node for name in node.input}
    return restorer, model, {name: array for name, array in state.items() if name in used}


def _of_one_size(network: Any, example: Any, outputs: Sequence[str]) -> tuple[Any, dict[str, Any]]:
    import onnx
    import torch
    from onnxscript import optimizer
    from torch.nn.attention import SDPBackend, sdpa_kernel

    # Attention in its plain form: that of a processor has another layout in memory.
    with sdpa_kernel(SDPBackend.MATH):
        program = torch.onnx.export(
            network,
            example,
            dynamo=True,
            optimize=False,
            verbose=False,
            opset_version=_OPSET,
            input_names=INPUTS,
            output_names=outputs,
        )
    assert program is not None
    model = program.model_proto
    # Simplified without the values of weights, whose names would else be lost.
    state = {each.name: onnx.numpy_helper.to_array(each) for each in model.graph.initializer}
    for each in model.graph.initializer:
        model.graph.input.append(
            onnx.helper.make_tensor_value_info(each.name, each.data_type, each.dims)
        )
    del model.graph.initializer[:]
    return optimizer.optimize(model), state


def _of_any_size(network: Any, example: Any, outputs: Sequence[str]) -> tuple[Any, dict[str, Any]]:
    import onnx
    import torch

    # By tracing: the exporter of graphs takes sizes halved down to one pixel for constants. Norms
    # stay apart, so that weights keep their names.
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "network.onnx")
        torch.onnx.export(
            network,
            example,
            path,
            dynamo=False,
            opset_version=_OPSET,
            training=torch.onnx.TrainingMode.PRESERVE,
            do_constant_folding=False,
            input_names=INPUTS,
            output_names=outputs,
            dynamic_axes={name: {2: "h", 3: "w"} for name in (*INPUTS, *outputs)},
        )
        model = onnx.load(path)
    state = {each.name: onnx.numpy_helper.to_array(each) for each in model.graph.initializer}
    del model.graph.initializer[:]
    return model, state


def _with_weights(model: Any, nodes: Sequence[Any], weights: Sequence[Any]) -> Any:
    """The model with its weights, and without the notes of the exporter."""
    graph = model.graph
    everything = [*nodes, *graph.node]
    del graph.node[:]
    graph.node.extend(everything)
    graph.initializer.extend(weights)
    graph.name = "restorer"
    graph.doc_string = ""
    del graph.value_info[:]
    for part in (model, graph, *graph.node, *graph.initializer, *graph.input, *graph.output):
        del part.metadata_props[:]
    for node in graph.node:
        node.name = node.doc_string = ""
    return model


def _write(
    out: Path, restorer: Any, model: Any, method: str, options: MethodOptions
) -> dict[str, float]:
    """Write the model if it computes what torch computes; returns the differences."""
    from benchmark.methods.weights import weights_for

    notes = {
        "method": method,
        "preset": options.preset,
        "weights_sha256": sha256_of(weights_for(method, options)),
        **{f"setting.{name}": value for name, value in options.settings.items()},
    }
    for key, value in notes.items():
        model.metadata_props.add(key=key, value=value)
    model.producer_name, model.producer_version = "std-toolkit", __version__
    if restorer.input_size is None:
        model.metadata_props.add(key=LONGEST, value=str(restorer.longest))
    # Sides of any length are those of no multiple, too.
    views = [
        view
        for size in ([restorer.input_size] if restorer.input_size else _TRIED)
        for view in made_up_views(size)
    ]
    with atomic_path(out) as temporary:
        temporary.write_bytes(model.SerializeToString(deterministic=True))
        own = OnnxNetwork(MethodOptions(weights=temporary))
        wanted = [answer for view in views for answer in restorer.restore([view])]
        found = differences(own.restore(views), wanted)
        if max(found.values()) > LARGEST_DIFFERENCE:
            raise ToolkitError(
                "the exported network does not compute what torch does", path=out, value=found
            )
    return found


def differences(found: Sequence[Restored], wanted: Sequence[Restored]) -> dict[str, float]:
    """The largest absolute differences between answers, of each of their maps."""
    names = [name for name in _MAPS if getattr(wanted[0], name) is not None]
    return {
        name: max(
            float(np.abs(getattr(a, name) - getattr(b, name)).max())
            for a, b in zip(found, wanted, strict=True)
        )
        for name in names
    }


def made_up_views(size: tuple[int, int], count: int = 3) -> list[View]:
    """Views of a slope with a box on it, with holes and noise; the last has no depth at all."""
    rng = np.random.default_rng(0)
    width, height = size
    v, u = np.mgrid[:height, :width] / max(size)
    views = []
    for index in range(count):
        depth = 0.5 + 0.2 * u + 0.3 * v + rng.normal(0, 1e-3, u.shape)
        depth[height // 3 : height // 2, width // 3 : width // 2] -= 0.08
        depth[rng.random(u.shape) < 0.05] = 0
        depth[: height // 4, width // 2 : width // 2 + width // 4] = 0
        color = rng.integers(0, 60, (height, width, 3)) + (150 * np.stack([u, v, u], 2)).astype(int)
        views.append(
            View(
                color.astype(np.uint8),
                (depth * (index + 1 < count)).astype(np.float32),
                Camera(width, height, width, width, (width - 1) / 2, (height - 1) / 2),
            )
        )
    return views


def _tensor(name: str, array: np.ndarray) -> Any:
    import onnx

    return onnx.numpy_helper.from_array(array, name)


def _safetensors_header(path: Path) -> tuple[dict[str, Any], int]:
    """The tensors of a file by name, and where its numbers begin."""
    with path.open("rb") as file:
        (length,) = struct.unpack("<Q", file.read(8))
        return json.loads(file.read(length)), 8 + length


def _with_tuple(network: Any) -> Any:
    """A module around a network, whose output is a tuple."""
    from torch import nn

    class WithTuple(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.network = network

        def forward(self, color: Any, depth: Any) -> tuple[Any, ...]:
            found = self.network(color, depth)
            maps = (found.depth, found.confidence, found.spread, found.clear)
            return tuple(image for image in maps if image is not None)

    return WithTuple().eval()
