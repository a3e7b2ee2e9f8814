"""`benchmark.Restorer`: arrays in, arrays out; what is refused; packages that are missing."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from restore_cases import SIZE, sensor_depth

import benchmark
from benchmark import Restorer
from benchmark.cli.bench import main as bench
from benchmark.cli.restore import main as restore
from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions, make_restorer, preset_for, weights_digest
from benchmark.methods.training_data import training_data
from benchmark.restoring.onnx_export import made_up_views
from benchmark.restoring.options import MethodChoice, RestoreOptions
from std_toolkit.cli.command_options import UsageError, parse_options, words_of
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

K = np.array([[96.0, 0, 47.5], [0, 96, 35.5], [0, 0, 1]])
COLOR = made_up_views(SIZE)[0].color


def test_three_lines():
    found = Restorer.load("swindrnet").restore(COLOR, sensor_depth(), K)
    assert found.depth.shape == SIZE[::-1] and found.depth.dtype == np.float32
    assert (found.depth > 0).all() and found.confidence is not None
    kept = ~found.changed
    assert np.array_equal(found.depth[kept], sensor_depth()[kept]) and kept.mean() > 0.5


def test_scores_say_what_runs_the_networks(monkeypatch):
    """Results of onnxruntime and of torch are not mixed in one folder."""
    pytest.importorskip("onnxruntime")
    options = MethodOptions(preset="compact")
    assert make_restorer("std-restore", options).backend == "onnx"
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    method = make_restorer("std-restore", options)
    assert method.backend == "torch" and hasattr(method, "network")


def test_what_is_not_measured_may_be_written_in_any_way():
    restorer = Restorer.load("nearest")
    depth = sensor_depth()
    odd = depth.astype(np.float64)
    odd[depth == 0] = np.resize([np.nan, -1, np.inf, 0], int((depth == 0).sum()))
    a, b = (restorer.restore(COLOR, d, K) for d in (depth, odd))
    assert np.array_equal(a.depth, b.depth) and a.confidence is None
    assert np.array_equal(a.changed, depth == 0)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"color": COLOR[..., 0]}, "color: must be (H, W, 3) uint8"),
        ({"color": COLOR / 255}, "color: must be (H, W, 3) uint8"),
        ({"depth": np.uint16(1000 * sensor_depth())}, "depth: must be floating-point metres"),
        ({"depth": sensor_depth()[:36]}, "align depth to colour"),
        ({"depth": 1000 * sensor_depth()}, "millimetres?"),
        ({"depth": 0 * sensor_depth()}, "the sensor measured nothing"),
        ({"K": np.eye(4)}, "K: must be a (3, 3)"),
        ({"K": (96, 96, 640, 360)}, "cx"),
        ({"K": "K"}, "K: must be a (3, 3)"),
    ],
)
def test_wrong_arrays_are_refused(change, told):
    given = {"color": COLOR, "depth": sensor_depth(), "K": K} | change
    with pytest.raises(ToolkitError) as caught:
        Restorer.load("nearest").restore(**given)
    assert told in str(caught.value)


def test_the_door_costs_nothing_until_it_is_used():
    code = (
        "import sys, benchmark; assert 'Restorer' in dir(benchmark); print('numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "False", done.stderr
    with pytest.raises(AttributeError, match="Restore"):
        _ = benchmark.Restore  # type: ignore[attr-defined]


@pytest.mark.slow
def test_torch_and_onnxruntime_give_the_same_answer():
    pytest.importorskip("torch")
    by_torch, by_onnx = (
        Restorer.load(backend=backend).restore(COLOR, sensor_depth(), K)
        for backend in ("torch", "onnx")
    )
    assert np.abs(by_torch.confidence - by_onnx.confidence).max() < 1e-4
    # Pixels at the limit of what is trusted may differ.
    assert (by_torch.changed == by_onnx.changed).mean() > 0.999
    same = by_torch.changed == by_onnx.changed
    assert np.abs(by_torch.depth - by_onnx.depth)[same].max() < 1e-4


def test_without_torch_the_shipped_weights_run(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    assert (Restorer.load().restore(COLOR, sensor_depth(), K).depth > 0).all()


class WithoutTorch:
    """A finder of modules that finds no torch.

    None in `sys.modules` would look as if torch were imported.
    """

    def __init__(self, finder):
        self._finder = finder

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "torch":
            return None
        return self._finder.find_spec(name, path, target)

    def __getattr__(self, name):
        return getattr(self._finder, name)


def test_missing_packages_are_named_with_the_command_to_install_them(monkeypatch, tmp_path, capsys):
    monkeypatch.delitem(sys.modules, "torch", raising=False)
    monkeypatch.setattr(sys, "meta_path", [WithoutTorch(f) for f in sys.meta_path])
    for name in [n for n in sys.modules if n.startswith("benchmark.methods.depth.swindrnet")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "benchmark.methods.network", raising=False)
    with pytest.raises(ToolkitError, match=r"torch is not installed.*'std-toolkit\[train\]'"):
        Restorer.load(size=(320, 180))
    with pytest.raises(ToolkitError, match=r"torch is not installed.*'std-toolkit\[train\]'"):
        Restorer.load("dfnet")
    data = tmp_path / "data/DREDS-CatKnown/test/shapenet_generate_1216_val_novel/00000"
    from tests.dreds_on_disk import write_dreds_scene

    write_dreds_scene(data)
    words = ["--method", "swindrnet", "--split", "dreds-catknown-test"]
    assert bench([*words, "--data", str(tmp_path / "data"), "--out", str(tmp_path / "out")]) == 1
    assert "pip install 'std-toolkit[train]'" in capsys.readouterr().err
    assert restore(["export", "--onnx", str(tmp_path / "net.onnx")]) == 1
    assert "pip install 'std-toolkit[train]'" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ToolkitError, match=r"'std-toolkit\[restore\]'"):
        Restorer.load()


SURE = """
import numpy as np
from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions, make_restorer, preset_for, weights_digest
from benchmark.methods.training_data import training_data


class Sure:
    input_size, needs_mask = None, False

    def __init__(self, options):
        pass

    def restore(self, views):
        \"\"\"Everything is 0.5 m away; glass is at the left, and the right half is uncertain.\"\"\"
        answers = []
        for view in views:
            depth = np.full(view.depth.shape, 0.5, np.float32)
            left = np.arange(depth.shape[1]) < depth.shape[1] // 2
            spread = np.where(left, np.float32(0.004), np.float32(0.03)) + 0 * depth
            answers.append(Restored(depth, None, spread, left + 0 * depth))
        return answers
"""


def test_what_the_method_cannot_vouch_for_is_left_out(tmp_path):
    (tmp_path / "sure.py").write_text(SURE)
    restorer = Restorer.of(MethodChoice(method=f"{tmp_path}/sure.py:Sure", max_error_m=0.01))
    found = restorer.restore(COLOR, sensor_depth(), K)
    half = SIZE[0] // 2
    assert (found.depth[:, :half] > 0).all() and (found.depth[:, half:] == 0).all()
    assert found.spread is not None and found.spread[0, 0] == np.float32(0.004)
    nearest = Restorer.of(MethodChoice(method="nearest", max_error_m=0.01))
    with pytest.raises(ToolkitError, match="--max-error"):
        nearest.restore(COLOR, sensor_depth(), K)


def test_by_default_the_two_networks_tell_how_far_they_are_apart():
    found = Restorer.of(MethodChoice()).restore(COLOR, sensor_depth(), K)
    finder = Restorer.of(MethodChoice(method="compactdr")).restore(COLOR, sensor_depth(), K)
    swindrnet = found.depth != finder.depth
    apart = np.hypot(finder.spread, found.depth - finder.depth)
    assert swindrnet.any() and np.array_equal(found.spread[~swindrnet], finder.spread[~swindrnet])
    assert found.spread[swindrnet] == pytest.approx(apart[swindrnet], abs=1e-6)
    limited = Restorer.of(MethodChoice(max_error_m=0.02)).restore(COLOR, sensor_depth(), K)
    assert np.array_equal(limited.depth == 0, (found.spread > 0.02) | (found.depth == 0))


def test_where_there_is_no_glass_the_sensor_stays(tmp_path):
    (tmp_path / "sure.py").write_text(SURE)
    choice = MethodChoice(method=f"{tmp_path}/sure.py:Sure", where="glass")
    found = Restorer.of(choice).restore(COLOR, sensor_depth(), K)
    half = SIZE[0] // 2
    assert np.array_equal(found.depth[:, half:], sensor_depth()[:, half:])  # holes, too
    assert (found.depth[:, :half] > 0).all() and found.changed[:, :half].any()
    assert not found.changed[:, half:].any()


def test_a_network_answers_where_glass_is_found_and_the_sensor_doubted(tmp_path):
    """The finder, by itself, sees glass in the upper half, and trusts the sensor at its left."""
    (tmp_path / "flat.py").write_text(SURE.replace("left + 0 * depth)", ")"))
    shape = SIZE[::-1]
    rows, columns = np.indices(shape)
    glass, trusted = rows < shape[0] // 2, columns < shape[1] // 2

    class Finder:
        input_size, needs_mask = None, False

        def restore(self, views):
            filled = np.where(views[0].depth > 0, views[0].depth, 0.9).astype(np.float32)
            trust = np.where(trusted, 0.9, 0.5).astype(np.float32)
            return [Restored(filled, trust, None, glass.astype(np.float32))]

    network = Restorer.load(f"{tmp_path}/flat.py:Sure", where="glass-and-holes")
    network._finder = Finder()
    found = network.restore(COLOR, sensor_depth(), K)
    answered = glass & ~trusted
    assert np.allclose(found.depth[answered & (sensor_depth() == 0)], 0.5, atol=1e-3)
    holes = ~answered & (sensor_depth() == 0)
    assert holes.any() and (found.depth[holes] > 0.6).mean() > 0.9
    kept = ~answered & (sensor_depth() > 0)
    assert np.array_equal(found.depth[kept], sensor_depth()[kept])


def test_it_is_the_default_of_swindrnet_alone():
    assert MethodChoice().answers == "glass-and-holes"
    assert Restorer.load("swindrnet").where == "glass-and-holes"
    assert Restorer.load("nearest").where == "everywhere"
    assert MethodChoice(method="compactdr").answers == "everywhere"
    assert MethodChoice(where="everywhere").answers == "everywhere"


def test_the_benchmark_scores_what_is_written_by_default():
    view = View(COLOR, sensor_depth(), Camera(*SIZE, 96, 96, 47.5, 35.5))
    method = make_restorer("std-restore", MethodOptions(preset="compact"))
    found, empty = method.restore([view, replace(view, depth=0 * view.depth)])
    written = Restorer.of(MethodChoice()).restore(COLOR, sensor_depth(), K)
    assert np.array_equal(found.depth, written.depth) and not empty.depth.any()
    assert np.array_equal(found.confidence, written.confidence)
    assert preset_for("std-restore", None, None) == "compact"
    alone = MethodOptions(preset="compact", settings={"where": "everywhere"})
    names = [
        {path.name for path in made.weights}
        for made in (method, make_restorer("std-restore", alone))
    ]
    assert names[0] == {"swindrnet-compact.safetensors", "compactdr-compact.safetensors"}
    assert names[1] == {"swindrnet-compact.safetensors"}
    digests = [weights_digest("std-restore", make_restorer("std-restore", o), o) for o in (
        MethodOptions(preset="compact"), alone,
        MethodOptions(preset="compact", settings={"where": "glass"}),
    )]  # fmt: skip
    assert digests[0] == digests[2] != digests[1]
    assert "; " in training_data("std-restore", method, MethodOptions())


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (MethodOptions(weights=Path("x.safetensors")), "--weights: std-restore runs as it ships"),
        (
            MethodOptions(preset="compact", precision="bf16"),
            "--precision: std-restore runs as fp32",
        ),
        (MethodOptions(preset="published"), "--preset: std-restore runs as compact"),
        (MethodOptions(preset="compact", settings={"where": "no"}), "where: "),
    ],
)
def test_the_benchmark_runs_it_as_it_ships(options, told):
    with pytest.raises(ToolkitError) as caught:
        make_restorer("std-restore", options)
    assert told in str(caught.value)


@pytest.mark.parametrize("given", ["10", "10mm", "1cm", "0.01m"])
def test_the_largest_error_is_given_in_millimetres(given):
    words = ["rec", "--out", "o", "--max-error", given]
    options, _ = parse_options(RestoreOptions, words, "std-restore")
    assert options.choice.max_error_m == pytest.approx(0.01)
    again = words_of(options)
    assert parse_options(RestoreOptions, again, "std-restore")[0] == options


@pytest.mark.parametrize("given", ["ten", "10 m", "-1", "0mm"])
def test_another_largest_error_is_refused(given):
    with pytest.raises((UsageError, SystemExit), match=r"max-error|^2$"):
        parse_options(RestoreOptions, ["rec", "--out", "o", "--max-error", given], "std-restore")
