"""Networks whose weights come with the toolkit, and their answers to inputs of a seed."""

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmark.methods.known.released import Answers
from benchmark.methods.protocol import View
from benchmark.methods.registry import (
    MethodOptions,
    make_planner,
    make_pose_method,
    make_restorer,
)
from std_toolkit.geometry.camera import Camera

_SIZE = (224, 126)  # (width, height), which the smallest networks work at


def _view(seed: int) -> View:
    """A slope with two boxes: one that the sensor does not see, one that it looks through."""
    random = np.random.RandomState(seed)
    width, height = _SIZE
    y, x = np.mgrid[:height, :width]
    depth = 0.7 + 0.2 * random.rand() * y / height + 0.1 * random.rand() * x / width
    color = 60 + 60 * random.rand(3) + 40 * (np.sin(x / 7) + np.cos(y / 5))[..., None]
    for lost in (True, False):
        top, left = random.randint(10, 70), random.randint(10, 150)
        box = np.s_[top : top + 40, left : left + 50]
        color[box] = 255 * random.rand(3)
        depth[box] = 0 if lost else depth[box] + 0.15
    camera = Camera(width, height, 200.0, 200.0, width / 2, height / 2)
    return View(color.clip(0, 255).astype(np.uint8), depth.astype(np.float32), camera)


def restorer_answers(name: str, seed: int) -> Answers:
    """Return restored depth and what the network says beside it."""
    method = make_restorer(name, MethodOptions(preset="compact"))
    (found,) = method.restore([_view(seed)])
    maps = {"depth": found.depth, "confidence": found.confidence, "spread": found.spread}
    maps["clear"] = found.clear
    return {key: value[::4, ::4] for key, value in maps.items() if value is not None}


def crop_nocs_answers(seed: int) -> Answers:
    """Return the logits of coordinates, and half sides, of a random crop."""
    options = MethodOptions(preset="compact", settings={"masks": "true"})
    network = make_pose_method("crop-nocs", options).network  # type: ignore[attr-defined]
    random, side, count = np.random.RandomState(seed), network.config.side, 64
    color = torch.from_numpy(random.rand(1, 4, side, side).astype(np.float32))
    points = torch.from_numpy((0.1 * random.rand(1, count, 3) + 0.5).astype(np.float32))
    pixels = torch.from_numpy(random.randint(0, side * side, (1, count)))
    logits, half = network.answer(color, points, pixels, torch.tensor([seed % 3]))
    return {"logits": _flat(logits)[::8], "half_sides": _flat(half)}


def swindrnet_nocs_answers(seed: int) -> Answers:
    """Return classes and coordinates of an image."""
    method = make_pose_method("swindrnet-nocs", MethodOptions(preset="small"))
    seen: dict[str, Tensor] = {}

    def keep(_module: object, _inputs: object, outputs: object) -> None:
        seen.update({"classes": outputs.classes, "nocs": outputs.nocs})  # type: ignore[attr-defined]

    from benchmark.methods.protocol import PoseView

    method.network.register_forward_hook(keep)  # type: ignore[attr-defined]
    view = _view(seed)
    method.estimate([PoseView(view.color, view.depth, view.depth, view.camera)])
    return {name: _flat(values)[::64] for name, values in seen.items()}


def graspnet_answers(seed: int) -> Answers:
    """Return what is said of the seeds of a cloud: a table with a ball on it."""
    planner = make_planner("graspnet", MethodOptions(preset="compact"))
    random = np.random.RandomState(seed)
    table = np.column_stack([random.rand(3000, 2) * 0.4 - 0.2, np.full(3000, 0.6)])
    ball = random.standard_normal((1000, 3))
    ball = 0.04 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [0.02, 0.01, 0.56]
    cloud = np.concatenate([table, ball])[random.permutation(4000)].astype(np.float32)
    seeds = planner.network.seeds(torch.from_numpy(cloud)[None])  # type: ignore[attr-defined]
    found = {f"approaches_{i}": _flat(t)[::64] for i, t in enumerate(seeds.approaches)}
    return {"points": _flat(seeds.points), **found}


def _flat(values: Tensor) -> NDArray[np.float32]:
    return values.float().flatten().cpu().numpy()


# By name of the case; each is called with a seed.
SHIPPED: dict[str, Callable[[int], Answers]] = {
    "compactdr compact": lambda seed: restorer_answers("compactdr", seed),
    "dfnet compact": lambda seed: restorer_answers("dfnet", seed),
    "nlspn compact": lambda seed: restorer_answers("nlspn", seed),
    "swindrnet compact": lambda seed: restorer_answers("swindrnet", seed),
    "crop-nocs compact": crop_nocs_answers,
    "swindrnet-nocs small": swindrnet_nocs_answers,
    "graspnet compact": graspnet_answers,
}
