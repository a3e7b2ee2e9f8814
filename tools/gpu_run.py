"""Trains compactdr in a few minutes of a GPU on another machine.

    python tools/gpu_run.py prepare FOLDER --data PACK ... [--most-mb 50]
    python tools/gpu_run.py train --parts FOLDER --weights FILE --out OUT [--minutes 8]
    python tools/gpu_run.py train --parts FOLDER --weights FILE --out OUT --minutes 0.5 --try
    python tools/gpu_run.py check --weights FILE

`prepare` writes the frames of packs as FOLDER/part-NN.npz, each small enough to be sent by itself.
`train` waits for the first part and takes in others as they arrive: a part is complete when
part-NN.npz.done lies beside it, which is sent after it. It needs PyTorch, OpenCV, kornia, msgspec,
Lightning and this repository's code. The arithmetic is bf16. Steps are replayed CUDA graphs, which
are compared with plain steps first. A thread of its own augments frames on the GPU. A running mean
of the weights is saved every two minutes. `--try` does the same on the CPU, in float32, with little
of everything.

The rate falls to 0 at the end of the time: how many steps there are is the machine's doing, and two
runs do not give the same weights. Weights are chosen afterwards by validation frames.

`check` measures frames per second of the network at several sizes.
"""

import argparse
import json
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmark.methods.depth.compactdr import PRESETS, CompactDRNetwork
from benchmark.methods.weights import load_weights, save_weights
from benchmark.training.config import TrainConfig, seed_of
from benchmark.training.depth.compactdr_training import compactdr_step
from benchmark.training.depth.depth_catalogue import COMPACTDR_TRAINING
from benchmark.training.module import RestorerTraining
from benchmark.training.step import Batch, ModelInput, StepInfo, model_input
from tools.gpu_parts import read_part, write_parts

# cuDNN compiles kernels for each size, which takes 20 to 40 s on an H200.
_SIZES = ("320x180", "320x180", "256x192")
_OPTIMIZATION = replace(
    COMPACTDR_TRAINING.optimization, learning_rate=1.5e-3, encoder_rate=0.2, weight_decay=0.01
)
_WARMUP = 200
_LONGEST_GRADIENT = 5.0
_MEAN = 0.999  # of the running mean of weights
_SAVED_S = 120.0
_LOGGED = 200  # steps
_AHEAD = 3  # augmented batches that wait


def main() -> None:
    parser = argparse.ArgumentParser(description="Train compactdr in a few minutes of a GPU.")
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("prepare")
    one.add_argument("folder", type=Path)
    one.add_argument("--data", type=Path, nargs="+", required=True)
    one.add_argument("--most-mb", type=float, default=50.0)
    one = commands.add_parser("train")
    one.add_argument("--parts", type=Path, required=True)
    one.add_argument("--weights", type=Path, required=True)
    one.add_argument("--out", type=Path, required=True)
    one.add_argument("--minutes", type=float, default=8.0)
    one.add_argument("--batch", type=int, default=64)
    one.add_argument("--try", action="store_true", dest="small")
    one = commands.add_parser("check")
    one.add_argument("--weights", type=Path, required=True)
    options = parser.parse_args()
    if options.command == "prepare":
        write_parts(options.folder, options.data, options.most_mb)
    else:
        {"train": train, "check": check}[options.command](options)


class Frames:
    """Frames on the device, more as further parts arrive."""

    def __init__(self, folder: Path, device: torch.device) -> None:
        self.folder, self.device = folder, device
        self.lock = threading.Lock()  # of the device: nothing else may run while a graph is made
        self._read: set[str] = set()
        self.tensors: dict[str, Tensor] = {}
        print(f"waiting for {folder}/part-*.npz.done", flush=True)
        while not self.take():
            time.sleep(0.2)
        threading.Thread(target=self._wait, daemon=True).start()

    def _wait(self) -> None:
        while True:
            time.sleep(1)
            self.take()

    def __len__(self) -> int:
        return len(self.tensors["color"]) if self.tensors else 0

    def take(self) -> bool:
        """Take in what is new; a part is read when `part-NN.npz.done` lies beside it."""
        for mark in sorted(self.folder.glob("part-*.npz.done")):
            if mark.name in self._read:
                continue
            self._read.add(mark.name)
            new = {n: torch.from_numpy(a) for n, a in read_part(mark.with_suffix("")).items()}
            with self.lock:
                on = {name: tensor.to(self.device) for name, tensor in new.items()}
                if self.tensors:
                    on = {name: torch.cat([self.tensors[name], on[name]]) for name in on}
                if self.device.type == "cuda":
                    torch.cuda.synchronize()  # batches are drawn on another stream
                self.tensors = on
            print(f"{mark.stem}: {len(self)} frames in all", flush=True)
        return len(self) > 0

    def batch(self, count: int, rng: np.random.Generator) -> Batch:
        tensors = self.tensors
        chosen = rng.choice(len(tensors["color"]), count, replace=len(tensors["color"]) < count)
        index = torch.from_numpy(chosen).to(self.device)
        return {**{name: t[index] for name, t in tensors.items()}, "index": index}


def configuration(small: bool) -> TrainConfig:
    """What the frames of a step are changed by."""
    return TrainConfig(
        method="compactdr", preset="compact", steps=1, validate_every=1, checkpoint_every=1,
        optimization=COMPACTDR_TRAINING.optimization, training="", validation="",
        geometry=True, object_dropout=0.3, copy_paste=0.1, clear_gone=0.4, clear_behind=0.35,
        holes=0.6, wrong_color=0.04, depth_noise=0.7, patterns=0.3, precision="bf16",
        sizes=("96x64", "64x96") if small else _SIZES,
    )  # fmt: skip


_KEPT = ("true", "mask", "materials", "K")


class Augmented(threading.Thread):
    """Makes augmented batches ahead, on a stream of its own."""

    def __init__(self, module: RestorerTraining, frames: Frames, batch: int) -> None:
        super().__init__(daemon=True)
        self.module, self.frames, self.count = module, frames, batch
        self.ready: queue.Queue[Any] = queue.Queue(_AHEAD)
        self.ended = threading.Event()
        self.cuda = frames.device.type == "cuda"

    def run(self) -> None:
        try:
            stream = torch.cuda.Stream() if self.cuda else None
            number = 0
            while not self.ended.is_set():
                if stream is None:
                    self.ready.put((self._one(number), None))
                else:
                    with torch.cuda.stream(stream):
                        made, done = self._one(number), torch.cuda.Event()
                        done.record(stream)
                    self.ready.put((made, done))
                number += 1
        except BaseException as error:  # for the thread that trains
            self.ready.put((error, None))
            raise

    def stop(self) -> None:
        self.ended.set()
        while self.is_alive():
            while not self.ready.empty():
                self.ready.get()
            self.join(0.1)

    @torch.no_grad()
    def _one(self, number: int) -> ModelInput:
        with self.frames.lock:
            return self._made(number)

    def _made(self, number: int) -> ModelInput:
        torch.manual_seed(seed_of(0, number))
        batch = self.frames.batch(self.count, np.random.default_rng([0, number]))
        with torch.autocast(self.frames.device.type, enabled=False):
            found = self.module.augmented(model_input(batch))
        return found._replace(batch={name: found.batch[name] for name in _KEPT})


class Step:
    """Gradients of all parts: of plain steps, or replayed for each size of frames."""

    def __init__(self, network: CompactDRNetwork, loss: Any, frames: Frames) -> None:
        self.network, self.loss = network, loss
        self.cuda, self.lock = frames.device.type == "cuda", frames.lock
        self.parameters = list(network.parameters())
        self.gradients = [torch.zeros_like(p) for p in self.parameters]
        self.graphs: dict[tuple[int, ...], tuple[Any, ModelInput, Tensor]] = {}
        self.pool: Any = None
        for p, g in zip(self.parameters, self.gradients, strict=True):
            p.grad = g

    def plain(self, inputs: ModelInput) -> Tensor:
        torch._foreach_zero_(self.gradients)
        kind = torch.bfloat16
        with torch.autocast("cuda" if self.cuda else "cpu", kind, self.cuda, cache_enabled=False):
            loss = compactdr_step(self.network, self.loss, inputs, StepInfo())
        loss.total.backward()
        return loss.total.detach()

    def __call__(self, inputs: ModelInput) -> Tensor:
        if not self.cuda:
            return self.plain(inputs)
        key = tuple(inputs.depth.shape)
        if key not in self.graphs:
            with self.lock:
                self.graphs[key] = self._captured(inputs)
        graph, static, total = self.graphs[key]
        if graph is None:
            return self.plain(inputs)
        _copy(inputs, static)
        graph.replay()
        return total

    def _captured(self, inputs: ModelInput) -> tuple[Any, Any, Any]:
        """A graph of the step at this size; None where it cannot be made or differs."""
        static = ModelInput(
            inputs.color.clone(), inputs.depth.clone(),
            {name: tensor.clone() for name, tensor in inputs.batch.items()},
        )  # fmt: skip
        side = torch.cuda.Stream()
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(3):
                plain = float(self.plain(static))
        torch.cuda.current_stream().wait_stream(side)
        try:
            graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(graph, pool=self.pool, capture_error_mode="thread_local"):
                total = self.plain(static)
            self.pool = self.pool or graph.pool()
            graph.replay()
            replayed = float(total)
        except RuntimeError as error:
            print(f"no graph: {error}", flush=True)
            torch.cuda.synchronize()
            return None, None, None
        apart = abs(replayed - plain) / max(abs(plain), 1e-6)
        size = f"{inputs.depth.shape[3]}x{inputs.depth.shape[2]}"
        print(f"graph {size}: loss {replayed:.5f}, of a plain step {plain:.5f}", flush=True)
        return (graph, static, total) if apart < 0.02 else (None, None, None)


def _copy(source: ModelInput, into: ModelInput) -> None:
    into.color.copy_(source.color)
    into.depth.copy_(source.depth)
    for name, tensor in into.batch.items():
        tensor.copy_(source.batch[name])


def train(options: argparse.Namespace) -> None:
    """Train for some minutes, and save the running mean of the weights every two."""
    cuda = torch.cuda.is_available() and not options.small
    device = torch.device("cuda" if cuda else "cpu")
    if cuda:
        torch.backends.cuda.matmul.allow_tf32 = True
        torch.backends.cudnn.allow_tf32 = True
        print(torch.cuda.get_device_name(), torch.__version__, flush=True)
    minutes, batch = options.minutes, 6 if options.small else options.batch
    options.out.mkdir(parents=True, exist_ok=True)
    begin = time.monotonic()
    torch.manual_seed(0)
    network = CompactDRNetwork(PRESETS["compact"])
    load_weights(network, options.weights)
    network.to(device).train()
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # missing in its stub
    own = network.state_dict()
    mean = {name: tensor.clone() for name, tensor in own.items()}
    frames = Frames(options.parts, device)
    loss = COMPACTDR_TRAINING.loss_with({})
    config = configuration(options.small)
    module = RestorerTraining(config, network, COMPACTDR_TRAINING.step, loss, str)
    augmented = Augmented(module, frames, batch)
    augmented.start()
    saved, number = time.monotonic(), 0
    log = (options.out / "log.txt").open("w")
    step = Step(network, loss, frames)
    optimizer = _OPTIMIZATION.make(network)
    rates = [group["lr"] for group in optimizer.param_groups]
    for inputs in _batches(augmented):
        share = (time.monotonic() - begin) / (60 * minutes)
        if share >= 1:
            break
        factor = min(1.0, (number + 1) / _WARMUP) * (1 - share)
        for group, rate in zip(optimizer.param_groups, rates, strict=True):
            group["lr"] = factor * rate
        total = step(inputs)
        torch.nn.utils.clip_grad_norm_(step.parameters, _LONGEST_GRADIENT, foreach=True)
        optimizer.step()
        number += 1
        kept = min(_MEAN, (1 + number) / (10 + number))
        with torch.no_grad():
            torch._foreach_lerp_([*mean.values()], [*own.values()], 1 - kept)
        if number % _LOGGED == 0 or options.small:
            if not np.isfinite(value := float(total)):
                raise SystemExit(f"step {number}: the loss is not a number")
            at = time.monotonic() - begin
            line = f"{at:6.1f} s, step {number}: loss {value:.4f}, {number * batch / at:.0f} "
            line += f"samples/s, {augmented.ready.qsize()} wait"
            print(line, file=log, flush=True)
            print(line, flush=True)
        if time.monotonic() - saved > _SAVED_S:
            saved = time.monotonic()
            _save(mean, options.out / f"mean-{number:06d}.safetensors")
    augmented.stop()
    _save(mean, options.out / "mean.safetensors")
    at = time.monotonic() - begin
    summary = {"steps": number, "batch": batch, "frames": len(frames), "seconds": round(at, 1)}
    (options.out / "run.json").write_text(json.dumps(summary))
    print(summary, flush=True)


def _batches(augmented: Augmented) -> Iterator[ModelInput]:
    while True:
        made, done = augmented.ready.get()
        if isinstance(made, BaseException):
            raise made
        if done is not None:
            torch.cuda.current_stream().wait_event(done)
            for tensor in (made.color, made.depth, *made.batch.values()):
                tensor.record_stream(torch.cuda.current_stream())
        yield made


def _save(mean: dict[str, Tensor], path: Path) -> None:
    network = CompactDRNetwork(PRESETS["compact"])
    network.load_state_dict({name: tensor.cpu() for name, tensor in mean.items()})
    save_weights(network.half(), path)


def check(options: argparse.Namespace) -> None:
    """Frames per second of the network, of one and of sixteen frames."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    network = CompactDRNetwork(PRESETS["compact"])
    load_weights(network, options.weights)
    network.to(device).eval()

    def timed(run: Callable[[], Any], rounds: int) -> float:
        for _ in range(3):
            run()
        if device.type == "cuda":
            torch.cuda.synchronize()
        begin = time.perf_counter()
        for _ in range(rounds):
            run()
        if device.type == "cuda":
            torch.cuda.synchronize()
        return rounds / (time.perf_counter() - begin)

    with torch.inference_mode():
        for (w, h), count in (((320, 180), 1), ((320, 240), 1), ((320, 180), 16)):
            color = torch.rand(count, 3, h, w, device=device)
            depth = 0.5 + torch.rand(count, 1, h, w, device=device)
            speed = count * timed(partial(network, color, depth), 20)
            print(f"{w}x{h}, {count} together: {speed:.1f} frames/s on {device.type}", flush=True)


if __name__ == "__main__":
    main()
