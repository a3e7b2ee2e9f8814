"""ONNX: shipped graphs refer to the shipped weights and compute what torch computes; export."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest

from benchmark.cli.restore import main
from benchmark.methods.depth.onnx_network import OnnxNetwork
from benchmark.methods.registry import (
    MethodOptions,
    make_restorer,
    sha256_of,
    shipped_file,
    shipped_graphs,
)
from benchmark.restoring import onnx_export
from benchmark.restoring.onnx_export import (
    LARGEST_DIFFERENCE,
    differences,
    export_onnx,
    made_up_views,
)
from std_toolkit.errors import ToolkitError

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

GRAPHS = shipped_graphs("swindrnet", "compact")

TINY = """
from torch import nn
from benchmark.methods.network import NetworkRestorer, Prediction
from benchmark.methods.weights import load_weights

class Network(nn.Module):
    def __init__(self):
        super().__init__()
        self.conv = nn.Conv2d(4, 2, 3, padding=1)
    def forward(self, color, depth):
        import torch
        found = self.conv(torch.cat([color, depth], 1))
        return Prediction(depth + found[:, :1], depth, found[:, 1:].sigmoid())

class Tiny(NetworkRestorer):
    def __init__(self, options):
        network = Network()
        load_weights(network, options.weights)
        super().__init__(network, options, (64, 36))
"""


def test_a_network_of_any_size_becomes_a_graph_of_any_size(tmp_path):
    """Its answers, spreads and masks are those of torch at sizes of no multiple, turned, too."""
    from safetensors.torch import save_file

    from benchmark.methods.depth.compactdr import CompactDRNetwork

    torch.manual_seed(0)
    network = CompactDRNetwork()
    for head in (network.head, network.last):
        torch.nn.init.normal_(head.weight, std=0.05)
    weights = tmp_path / "own.safetensors"
    save_file(network.state_dict(), weights)
    options = MethodOptions(preset="compact", weights=weights)
    found = export_onnx("compactdr", options, tmp_path / "own.onnx")
    assert set(found) == {"depth", "confidence", "spread", "clear"}
    assert max(found.values()) < LARGEST_DIFFERENCE
    graph = OnnxNetwork(MethodOptions(weights=tmp_path / "own.onnx"))
    own = make_restorer("compactdr", options)
    assert graph.input_size is None and graph.longest == own.longest
    for size in ((97, 61), (64, 150), (160, 128)):
        (view, *_) = made_up_views(size)
        told, wanted = graph.restore([view]), own.restore([view])
        assert told[0].clear.shape == view.depth.shape
        assert max(differences(told, wanted).values()) < LARGEST_DIFFERENCE
        assert wanted[0].spread.std() > 0  # not the same everywhere


@pytest.mark.parametrize("size", GRAPHS)
def test_a_shipped_graph_refers_to_the_numbers_of_the_shipped_weights(size):
    weights = shipped_file("swindrnet", "compact")
    data = weights.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    entries = json.loads(data[8 : 8 + length])
    model = onnx.load(GRAPHS[size], load_external_data=False)
    notes = {p.key: p.value for p in model.metadata_props}
    assert notes["weights_sha256"] == sha256_of(weights)
    outside = [t for t in model.graph.initializer if t.data_location == onnx.TensorProto.EXTERNAL]
    assert len(outside) > 500
    for tensor in outside:
        entry = entries[tensor.name.removesuffix(".half").removeprefix("network.")]
        place = {e.key: e.value for e in tensor.external_data}
        assert place["location"] == weights.name and list(tensor.dims) == entry["shape"]
        first, last = entry["data_offsets"]
        assert int(place["offset"]) == 8 + length + first and int(place["length"]) == last - first
    # The graphs are small: no weight is shipped twice.
    assert sum(path.stat().st_size for path in GRAPHS.values()) < 2.5e6


@pytest.mark.slow
@pytest.mark.parametrize("size", GRAPHS)
def test_a_shipped_graph_computes_what_torch_computes(size):
    views = made_up_views(size)
    wanted = make_restorer("swindrnet", MethodOptions(preset="compact"))
    own = OnnxNetwork(MethodOptions(weights=GRAPHS[size]))
    assert own.input_size == size
    found = differences(own.restore(views), wanted.restore(views))
    assert max(found.values()) < LARGEST_DIFFERENCE


@pytest.fixture(scope="module")
def tiny(tmp_path_factory) -> tuple[str, Path]:
    """A small network in a file of its own, and its weights."""
    from benchmark.methods.weights import save_weights
    from std_toolkit.plugins import Registry

    folder = tmp_path_factory.mktemp("tiny")
    (folder / "tiny.py").write_text(TINY)
    torch.manual_seed(0)
    save_weights(Registry("t", {}).get(f"{folder}/tiny.py:Network")(), folder / "w.safetensors")
    return f"{folder}/tiny.py:Tiny", folder / "w.safetensors"


@pytest.mark.slow
def test_a_network_is_exported_compared_and_run(tiny, tmp_path, monkeypatch, capsys):
    method, weights = tiny
    out = tmp_path / "net.onnx"
    words = ["export", "--onnx", str(out), "--method", method, "--weights", str(weights)]
    assert main(words) == 0
    assert "differs from torch's by at most" in capsys.readouterr().out
    view = made_up_views((64, 36))[0]
    by_torch = make_restorer(method, MethodOptions(weights=weights)).restore([view])
    by_onnx = make_restorer("onnx", MethodOptions(weights=out)).restore([view])
    assert differences(by_onnx, by_torch)["depth"] < 1e-5
    # A network that computes something else is no result.
    monkeypatch.setattr(onnx_export, "LARGEST_DIFFERENCE", -1.0)
    with pytest.raises(ToolkitError, match="does not compute what torch does"):
        export_onnx(method, MethodOptions(weights=weights), tmp_path / "wrong.onnx")
    assert [p.name for p in tmp_path.iterdir()] == ["net.onnx"]


@pytest.mark.long
def test_swindrnet_is_exported(tmp_path):
    out = tmp_path / "net.onnx"
    found = export_onnx("swindrnet", MethodOptions(preset="compact"), out)
    assert found["depth"] < 1e-5
    alone = OnnxNetwork(MethodOptions(weights=out))
    shipped = OnnxNetwork(MethodOptions(weights=GRAPHS[224, 126]))
    views = made_up_views((224, 126))
    assert max(differences(alone.restore(views), shipped.restore(views)).values()) < 1e-5


def test_what_is_no_network_is_refused(tmp_path):
    with pytest.raises(ToolkitError, match="no network of colour and depth"):
        export_onnx("nearest", MethodOptions(), tmp_path / "net.onnx")


def test_files_that_are_no_restorer_are_refused(tmp_path):
    path = tmp_path / "net.onnx"
    path.write_bytes(b"no graph")
    with pytest.raises(ToolkitError, match="onnxruntime cannot load it"):
        OnnxNetwork(MethodOptions(weights=path))
    kind = onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [1])
    twin = onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [1])
    node = onnx.helper.make_node("Relu", ["x"], ["y"])
    graph = onnx.helper.make_graph([node], "other", [kind], [twin])
    opset = [onnx.helper.make_opsetid("", 18)]
    onnx.save(onnx.helper.make_model(graph, opset_imports=opset, ir_version=10), path)
    with pytest.raises(ToolkitError, match="not a network that restores depth"):
        OnnxNetwork(MethodOptions(weights=path))
    with pytest.raises(ToolkitError, match="does not have this device"):
        OnnxNetwork(MethodOptions(weights=path, device="tpu"))
    with pytest.raises(ToolkitError, match="its own precision"):
        OnnxNetwork(MethodOptions(weights=path, precision="bf16"))
