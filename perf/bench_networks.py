"""Time and memory of the networks per frame, and the gain of the optimised implementations.

    python perf/bench_networks.py [--method swindrnet nlspn lidf ...] [--threads 2] [--rounds 7]

For each network at its published size: elapsed time and processor time of a frame (the least of
several rounds, because the machine may be busy), products, parameters, and the peak memory of a
process that only restores frames. SwinDRNet is measured as in `std-bench` and, alternating with it,
in its published implementation, which computes the same result; their ratio is comparable between
machines. Weights are random, which does not change the amount of work.

On a GPU: `--device cuda --precision bf16 --compile`.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

REPOSITORY = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(REPOSITORY))

ANY_SIZE = (1280, 720)  # for methods that take images as they come
LIMIT_S, LIMIT_GIB = 0.9, 3.0  # of SwinDRNet on two cores
PUBLISHED_FPS = 30  # of SwinDRNet on a GeForce RTX 3090
NETWORKS = {
    "swindrnet": "benchmark.methods.depth.swindrnet.swindrnet_network:SwinDRNetwork",
    "nlspn": "benchmark.methods.depth.nlspn:NLSPNetwork",
    "lidf": "benchmark.methods.depth.lidf.lidf:LIDFNetwork",
    "cleargrasp": "benchmark.methods.depth.cleargrasp.cleargrasp_network:ClearGraspNetwork",
    "dfnet": "benchmark.methods.depth.dfnet:DFNetwork",
}


def random_weights(method: str, path: Path) -> None:
    """A file of untrained weights."""
    import torch

    from benchmark.methods.weights import save_weights

    torch.manual_seed(0)
    module, _, name = NETWORKS[method].partition(":")
    network = getattr(__import__(module, fromlist=[name]), name)()
    save_weights(network, path)


def synthetic_view(size: tuple[int, int]):
    """A colour image of noise and a slope with a hole, where there is an object."""
    from benchmark.methods.protocol import View
    from std_toolkit.geometry.camera import Camera

    w, h = size
    color = np.random.default_rng(0).integers(0, 256, (h, w, 3), dtype=np.uint8)
    depth = np.linspace(0.5, 0.8, h * w, dtype=np.float32).reshape(h, w)
    depth[h // 4 : h // 2, w // 3 : w // 2] = 0
    return View(color, depth, Camera(w, h, w, w, w / 2 - 0.5, h / 2 - 0.5), depth == 0)


def least(works: list[Callable[[], object]], rounds: int) -> list[tuple[float, float]]:
    """Elapsed and processor seconds of each, measured alternately."""
    for work in works:
        work()
    found = [(float("inf"), float("inf"))] * len(works)
    for _ in range(rounds):
        for index, work in enumerate(works):
            wall, processor = time.perf_counter(), time.process_time()
            work()
            spent = time.perf_counter() - wall, time.process_time() - processor
            found[index] = min(found[index][0], spent[0]), min(found[index][1], spent[1])
    return found


def measure(arguments: argparse.Namespace, method: str, weights: Path) -> dict[str, float]:
    """The figures of one network, in this process."""
    import torch

    from benchmark.methods.registry import MethodOptions, make_restorer

    torch.set_num_threads(arguments.threads)
    restorer = make_restorer(
        method,
        MethodOptions(
            weights=weights,
            device=arguments.device,
            precision=arguments.precision,
            compile=arguments.compile,
        ),
    )
    view = synthetic_view(restorer.input_size or ANY_SIZE)

    def restore() -> None:
        restorer.restore([view])  # its answer comes as an array: the device has finished

    restore()
    found: dict[str, float] = {}
    found["peak_gib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    if torch.cuda.is_available():
        found["peak_gib"] = torch.cuda.max_memory_allocated() / 2**30
    works: list[Callable[[], object]] = [restore]
    if method == "swindrnet" and arguments.device == "cpu":
        from benchmark.methods.depth.swindrnet.swindrnet_network import SwinDRNetwork

        published = SwinDRNetwork().eval()
        inputs = restorer.inputs([view])  # type: ignore[attr-defined]

        def as_published() -> None:
            with torch.inference_mode():
                published(*inputs)

        works.append(as_published)
    (found["wall_s"], found["processor_s"]), *others = least(works, arguments.rounds)
    if others:
        found["published_wall_s"], found["published_processor_s"] = others[0]
    found["gmacs"] = restorer.macs(view) / 1e9  # type: ignore[attr-defined]
    found["parameters"] = restorer.parameter_count  # type: ignore[attr-defined]
    return found


def show(method: str, found: dict[str, float]) -> None:
    print(
        f"{method:<12}{1000 * found['wall_s']:>9.1f}{1000 * found['processor_s']:>12.1f}"
        f"{1 / found['wall_s']:>9.1f}{found['gmacs']:>8.1f}{found['parameters'] / 1e6:>9.2f}"
        f"{found['peak_gib']:>9.2f}"
    )
    if "published_wall_s" in found:
        wall, processor = found["published_wall_s"], found["published_processor_s"]
        print(f"{'  as published':<12}{1000 * wall:>7.1f}{1000 * processor:>12.1f}{1 / wall:>9.1f}")
        print(
            f"  ratio {found['wall_s'] / wall:.2f} elapsed, "
            f"{found['processor_s'] / processor:.2f} processor; "
            f"limits {LIMIT_S} s on two cores, {LIMIT_GIB} GiB"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--method", nargs="+", choices=list(NETWORKS), default=list(NETWORKS))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--precision", default="fp32", choices=["fp32", "bf16", "fp16"])
    parser.add_argument("--compile", action="store_true")
    parser.add_argument("--inside", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.inside:
        print(json.dumps(measure(arguments, arguments.method[0], arguments.inside)))
        return
    print(f"{'':<12}{'ms':>9}{'processor':>12}{'frames/s':>9}{'GMAC':>8}{'M par.':>9}{'GiB':>9}")
    with tempfile.TemporaryDirectory() as folder:
        for method in arguments.method:
            weights = Path(folder) / f"{method}.safetensors"
            random_weights(method, weights)
            # A process of its own: peak memory is that of a process.
            command = [sys.executable, __file__, *sys.argv[1:], "--inside", str(weights)]
            command += ["--method", method]
            answer = subprocess.run(command, check=True, capture_output=True, text=True)
            show(method, json.loads(answer.stdout.splitlines()[-1]))
            weights.unlink()


if __name__ == "__main__":
    main()
