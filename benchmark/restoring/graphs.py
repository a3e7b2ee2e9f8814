"""Which ONNX graph runs a method: a user's own file, one of the toolkit's, or none."""

from importlib.util import find_spec
from pathlib import Path

from benchmark.methods import protocol
from benchmark.methods.registry import (
    MethodOptions,
    make_restorer,
    restorers,
    shipped_graphs,
    shipped_weights,
)
from benchmark.restoring.options import Backend
from std_toolkit.errors import ToolkitError


def users_graph(
    method: str, options: MethodOptions, size: tuple[int, int] | None, backend: Backend
) -> protocol.Restorer:
    """A network in a user's ONNX file.

    Raises:
        ToolkitError: another backend, no such method, or a file of another size.
    """
    if backend == "torch":
        raise ToolkitError(
            "torch does not run ONNX files", field="--backend", hint="give weights in .safetensors"
        )
    if method not in ("swindrnet", "onnx") and method not in restorers.names():
        raise ToolkitError("no such method", field="--method", value=method)
    made = make_restorer("onnx", options)
    if size is not None and made.input_size != size:
        raise ToolkitError(
            f"this file works at {made.input_size}",
            path=options.weights,
            field="--size",
            value=f"{size[0]}x{size[1]}",
            hint="`std-restore export --size` writes one of another size",
        )
    return made


def shipped_graph(
    method: str, options: MethodOptions, size: tuple[int, int] | None, backend: Backend
) -> Path | None:
    """The shipped graph to use; None to use the method as registered.

    Raises:
        ToolkitError: --backend onnx without a graph, or neither package is installed.
    """
    graphs = shipped_graphs(method, options.preset)
    known = graphs.get(size if size is not None else next(iter(graphs), None))
    usable = known is not None and options.weights is None and not options.settings
    if backend == "torch":
        return None
    if backend == "onnx" and not usable:
        sizes = " or ".join("any size" if s is None else f"{s[0]}x{s[1]}" for s in graphs)
        raise ToolkitError(
            "the toolkit has no ONNX graph for this",
            field="--backend",
            value=backend,
            hint=f"{method} has them at {sizes}, without --weights and --set; for others: "
            "`std-restore export`, then --weights FILE.onnx"
            if graphs
            else "`std-restore export` writes one, then --weights FILE.onnx",
        )
    if not usable:
        return None
    installed = find_spec("onnxruntime") is not None
    if not installed and (backend == "onnx" or find_spec("torch") is None):
        raise ToolkitError(
            "onnxruntime is not installed", hint="pip install 'std-toolkit[restore]'"
        )
    if not installed or (backend == "auto" and options.device != "cpu"):
        return None
    shipped_weights(method, options.preset)  # refuses damaged ones
    return known
