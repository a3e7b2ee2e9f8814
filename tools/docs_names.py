"""The names that the text of a guide introduces, made small, so that its Python blocks run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


def names_of(page: str, folder: Path) -> dict[str, Any]:
    """Names for the blocks of a page; files are written to the working folder."""
    return _MAKERS.get(page, _nothing)(folder)


def _nothing(folder: Path) -> dict[str, Any]:  # noqa: ARG001
    return {}


def _scene(root: Path) -> Any:
    from tests.scene_on_disk import write_scene

    return write_scene(root)


def _readme(folder: Path) -> dict[str, Any]:
    _scene(folder / "scenes/mugs")
    return {}


def _annotating(folder: Path) -> dict[str, Any]:
    scene = _scene(folder / "scenes/table")
    path = scene.root / "objects.json"
    path.write_text(path.read_text().replace("box_1", "mug"))
    return {}


def _ground_truth(folder: Path) -> dict[str, Any]:
    from std_toolkit import RenderOptions, render_ground_truth

    options = RenderOptions(renderer="raycast")
    render_ground_truth(_scene(folder / "my_scene"), options).raise_if_failed()
    return {}


def _benchmark(folder: Path) -> dict[str, Any]:
    from benchmark.cli.bench import main

    _ground_truth(folder / "data")
    words = ["--method", "nearest", "--split", "scenes", "--no-speed", "--no-gallery"]
    main([*words, "--data", str(folder / "data"), "--out", str(folder / "results")])
    return {}


def _labelling(folder: Path) -> dict[str, Any]:
    from sensors.synthetic import RecordingOptions, make_recording, scene_from_truth
    from std_toolkit import JobOptions

    options = RecordingOptions(frames=3, width=320, height=240, samples=1)
    make_recording(folder / "recording", options, jobs=JobOptions(workers=1))
    scene = scene_from_truth(folder / "recording", folder / "scene")
    first, second = scene.objects.objects[:2]
    names = {}
    for name, obj in (("mug", first), ("glass", second)):
        names[name] = scene.mesh(obj.model)
        names[f"T_world_{name}"] = scene.T_world_obj(obj.id)
    return {
        "scene": scene,
        "mesh": names["mug"],
        "T_world_obj": names["T_world_mug"],
        **names,
    }


def _pose_metrics(folder: Path) -> dict[str, Any]:  # noqa: ARG001
    RT = np.eye(4)[None]
    RT[0, :3, 3] = 0.1, 0.0, 0.8
    return {
        "class_ids": np.array([6]),
        "RT": RT,
        "sizes": np.array([[0.12, 0.1, 0.08]]),
        "scores": np.array([0.9]),
        "handle_visible": np.array([True]),
    }


def _protocols(folder: Path) -> dict[str, Any]:
    from benchmark.data.splits import iterate, open_split

    _ground_truth(folder / "data")
    frame = next(iter(iterate(open_split("scenes", folder / "data"))))
    names = {"frame": frame, "depth": frame.depth_raw}
    try:
        import torch
    except ModuleNotFoundError:
        return names
    from benchmark.metrics.depth.accumulate import DepthMetrics

    batch = {name: torch.ones(1, 8, 8) for name in ("depth_true", "valid")}
    batch["valid"] = batch["valid"] > 0
    more = {"DepthMetrics": DepthMetrics, "loader": [batch]}
    return {**names, **more, "network": lambda given: given["depth_true"] * 1.01}


def _restoring(folder: Path) -> dict[str, Any]:  # noqa: ARG001
    from benchmark.restoring.onnx_export import made_up_views

    view = made_up_views((96, 72))[0]
    return {"color": view.color, "depth": view.depth, "K": [96, 96, 47.5, 35.5]}


def _sensors(folder: Path) -> dict[str, Any]:  # noqa: ARG001
    return {"depth": np.full((360, 640), 0.8, np.float32)}


_MAKERS: dict[str, Callable[[Path], dict[str, Any]]] = {
    "README.md": _readme,
    "annotating.md": _annotating,
    "benchmark.md": _benchmark,
    "checks.md": _ground_truth,
    "ground-truth.md": _ground_truth,
    "labelling.md": _labelling,
    "pose_metrics.md": _pose_metrics,
    "protocols.md": _protocols,
    "restoring.md": _restoring,
    "sensors.md": _sensors,
}
