"""Networks of `transformers` in a user's folder: tiny ones of random weights.

What they answer is worth nothing; how images reach them, and what becomes of the answer, is.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.evaluation.results import TABLE
from benchmark.methods.depth.snapshot import filled_prompt
from benchmark.methods.protocol import View
from benchmark.methods.registry import MethodOptions, make_restorer, weights_digest
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from tests.benchmark.evaluation.bench_set import SPLIT, write_split

transformers = pytest.importorskip("transformers")
STAGES = ["stage1", "stage2", "stage3", "stage4"]


def _dino(**more: Any) -> Any:
    return transformers.Dinov2Config(
        hidden_size=16, num_hidden_layers=4, num_attention_heads=2, image_size=56, patch_size=14,
        out_features=STAGES, reshape_hidden_states=False, apply_layernorm=True, **more,
    )  # fmt: skip


def depth_anything(kind: str = "relative") -> Any:
    config = transformers.DepthAnythingConfig(
        backbone_config=_dino(), reassemble_hidden_size=16, neck_hidden_sizes=[8, 8, 8, 8],
        fusion_hidden_size=8, head_hidden_size=4, patch_size=14, depth_estimation_type=kind,
        max_depth=1 if kind == "relative" else 2,
    )  # fmt: skip
    model = transformers.DepthAnythingForDepthEstimation(config)
    model.head.conv3.weight.data.abs_()  # else answers are cut off at 0
    model.head.conv3.bias.data.fill_(0.1)
    return model


def prompt_depth_anything() -> Any:
    config = transformers.PromptDepthAnythingConfig(
        backbone_config=_dino(), reassemble_hidden_size=16, neck_hidden_sizes=[8, 8, 8, 8],
        fusion_hidden_size=8, head_hidden_size=4, patch_size=14, depth_estimation_type="metric",
        max_depth=1,
    )  # fmt: skip
    model = transformers.PromptDepthAnythingForDepthEstimation(config)
    for name, values in model.named_parameters():
        if "prompt_depth_layer" in name:  # begin at 0: the prompt would have no effect
            values.data.normal_(std=0.5)
    return model


def depth_pro() -> Any:
    part = {
        "model_type": "dinov2", "hidden_size": 16, "num_hidden_layers": 2, "image_size": 8,
        "num_attention_heads": 2, "intermediate_size": 16, "patch_size": 4,
    }  # fmt: skip
    config = transformers.DepthProConfig(
        patch_size=8, fusion_hidden_size=8, intermediate_hook_ids=[1, 0],
        intermediate_feature_dims=[8, 8], scaled_images_feature_dims=[8, 8, 8],
        merge_padding_value=0, image_model_config=dict(part), patch_model_config=dict(part),
        fov_model_config=dict(part), use_fov_model=False,
    )  # fmt: skip
    return transformers.DepthProForDepthEstimation(config)


def zoedepth() -> Any:
    beit = transformers.BeitConfig(
        image_size=32, patch_size=8, hidden_size=16, num_hidden_layers=4, num_attention_heads=2,
        intermediate_size=16, out_features=STAGES, reshape_hidden_states=False,
    )  # fmt: skip
    config = transformers.ZoeDepthConfig(
        backbone_config=beit, backbone_hidden_size=16, neck_hidden_sizes=[8, 8, 8, 8],
        fusion_hidden_size=8, bottleneck_features=8, num_relative_features=8,
        num_attractors=[2, 2, 1, 1], bin_embedding_dim=8,
        bin_configurations=[{"n_bins": 8, "min_depth": 0.001, "max_depth": 10.0}],
    )  # fmt: skip
    return transformers.ZoeDepthForDepthEstimation(config)


# Name, the model, and what its processor's document says of images as small as these.
MODELS: dict[str, tuple[Callable[[], Any], dict[str, Any]]] = {
    "depth-anything": (depth_anything, {"size": {"height": 56, "width": 56}}),
    "prompt-depth-anything": (
        prompt_depth_anything,
        {"size": {"height": 56, "width": 56}, "ensure_multiple_of": 14},
    ),
    "depth-pro": (depth_pro, {"size": {"height": 32, "width": 32}}),
    "zoedepth": (zoedepth, {"size": {"height": 32, "width": 32}, "ensure_multiple_of": 32}),
}


@pytest.fixture(scope="module")
def snapshots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    import torch

    found = {}
    for name, (make, preparation) in MODELS.items():
        torch.manual_seed(3)
        folder = found[name] = tmp_path_factory.mktemp(name) / "model"
        make().save_pretrained(folder)
        (folder / "preprocessor_config.json").write_text(json.dumps(preparation))
    return found


def a_view(height: int = 45, width: int = 80) -> View:
    rng = np.random.default_rng(5)
    color = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    depth = np.tile(np.linspace(0.5, 0.9, width, dtype=np.float32), (height, 1))
    depth[10:20, 10:20] = 0
    return View(color, depth, Camera(width, height, 90.0, 90.0, width / 2, height / 2))


def made(name: str, folder: Path, **settings: str) -> Any:
    return make_restorer(name, MethodOptions(weights=folder, settings=settings))


@pytest.mark.parametrize("name", MODELS)
def test_a_network_answers_at_the_size_of_the_view(name: str, snapshots: dict[str, Path]) -> None:
    view = a_view()
    # The answer of random weights may fall where the measurements grow, which none fits to.
    method = made(name, snapshots[name], **({"fit": "none"} if name == "depth-anything" else {}))
    (found,) = method.restore([view])
    assert found.depth.shape == view.depth.shape and found.depth.dtype == np.float32
    assert np.isfinite(found.depth).all() and (found.depth > 0).mean() > 0.5
    (again,) = method.restore([view])
    np.testing.assert_array_equal(found.depth, again.depth)
    assert method.parameter_count > 1000


@pytest.mark.parametrize("name", MODELS)
def test_images_are_prepared_as_the_models_own_processor_says(
    name: str, snapshots: dict[str, Path]
) -> None:
    method = made(name, snapshots[name])
    white = np.full((45, 80, 3), 255, np.uint8)
    pixels = method._prepared(white)
    # The side that changes less decides: 56/45 = 1.24 of the height, not 56/80 = 0.7 of the width;
    # the width is then 99.6, and rounded to a multiple of 14.
    # The sides of ZoeDepth's image are mirrored by int(3 * sqrt(n / 2)) first: 73 x 116, of
    # which 32/73 = 0.44 changes less than 32/116 = 0.28.
    wanted = {
        "depth-anything": (56, 98),
        "prompt-depth-anything": (56, 98),
        "depth-pro": (32, 32),
        "zoedepth": (32, 64),
    }[name]
    assert tuple(pixels.shape) == (1, 3, *wanted)
    mean, deviation = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
    if name in ("depth-pro", "zoedepth"):
        mean, deviation = (0.5,) * 3, (0.5,) * 3
    for channel in range(3):
        value = (1 - mean[channel]) / deviation[channel]
        np.testing.assert_allclose(pixels[0, channel].numpy(), value, atol=1e-5)


IMAGENET = {"image_mean": [0.485, 0.456, 0.406], "image_std": [0.229, 0.224, 0.225]}
# Processors of transformers that need no torchvision, and how far off Pillow's rounding is.
PROCESSORS = {
    "depth-anything": (
        "DPTImageProcessorPil",
        {"keep_aspect_ratio": True, "ensure_multiple_of": 14, "resample": 3, **IMAGENET},
        0.03,
    ),
    "prompt-depth-anything": (
        "PromptDepthAnythingImageProcessorPil",
        {"keep_aspect_ratio": True, **IMAGENET},
        0.03,
    ),
    "zoedepth": ("ZoeDepthImageProcessorPil", {}, 1e-6),
}


@pytest.mark.parametrize("name", PROCESSORS)
@pytest.mark.parametrize(("height", "width"), [(45, 80), (90, 60)])
def test_images_equal_those_of_the_models_own_processor(
    name: str, height: int, width: int, snapshots: dict[str, Path]
) -> None:
    rows, columns = np.mgrid[:height, :width]
    levels = (2 * rows + columns)[..., None] + np.array([0, 20, 40])
    color = (255 * levels / levels.max()).astype(np.uint8)
    processor, said, apart = PROCESSORS[name]
    made_of = getattr(transformers, processor)(**MODELS[name][1], **said)
    wanted = made_of(images=color, return_tensors="np")["pixel_values"]
    found = made(name, snapshots[name])._prepared(color).numpy()
    np.testing.assert_allclose(found, np.asarray(wanted), atol=apart)


def test_an_answer_is_fitted_to_measurements_and_not_to_wrong_ones(
    snapshots: dict[str, Path],
) -> None:
    """Inverse depth of unknown scale and shift becomes metres; what glass shows moves nothing."""
    view = a_view()
    true = np.tile(np.linspace(0.5, 0.9, 80), (45, 1))
    predicted = 3 / true - 0.7
    wrong = view.depth.copy()
    wrong[25:40, 30:50] = 1.3  # the wall behind a glass
    method = made("depth-anything", snapshots["depth-anything"])
    for depth in (view.depth, wrong):
        seen = View(view.color, depth, view.camera)
        found = method.to_depth(method.fitted(predicted, seen))
        np.testing.assert_allclose(found, true, atol=1e-3)
    alone = made("depth-anything", snapshots["depth-anything"], fit="none")
    found = alone.to_depth(alone.fitted(predicted, view))
    np.testing.assert_allclose(found, 1 / predicted, rtol=1e-5)
    metric = made("zoedepth", snapshots["zoedepth"])
    found = metric.to_depth(metric.fitted(2 * true + 0.1, view))
    np.testing.assert_allclose(found, true, atol=1e-3)
    empty = View(view.color, np.zeros_like(view.depth), view.camera)
    with pytest.raises(ToolkitError, match="too few measurements"):
        method.restore([empty])


def test_depth_pro_uses_the_cameras_focal_length(snapshots: dict[str, Path]) -> None:
    view = a_view()
    method = made("depth-pro", snapshots["depth-pro"], fit="none")
    longer = Camera(80, 45, 180.0, 180.0, 40.0, 22.5)
    (near,), (far,) = (
        method.restore([View(view.color, view.depth, camera)]) for camera in (view.camera, longer)
    )
    np.testing.assert_allclose(far.depth, 2 * near.depth, rtol=1e-4)


def test_holes_of_a_prompt_are_filled_as_the_setting_says(snapshots: dict[str, Path]) -> None:
    view = a_view()
    folder = snapshots["prompt-depth-anything"]
    measured = view.depth > 0
    prompts = {holes: filled_prompt(view.depth, holes) for holes in ("nearest", "median")}
    for prompt in prompts.values():
        np.testing.assert_array_equal(prompt[measured], view.depth[measured])
    hole = prompts["nearest"][10:20, 10:20]
    assert np.abs(hole - np.linspace(0.5, 0.9, 80)[10:20]).max() < 0.03
    assert (prompts["median"][10:20, 10:20] == np.median(view.depth[measured])).all()
    assert np.ptp(filled_prompt(np.full((4, 4), 0.5, np.float32), "nearest")) > 0
    near, middle = (
        made("prompt-depth-anything", folder, holes=holes).restore([view])[0].depth
        for holes in ("nearest", "median")
    )
    assert not np.array_equal(near, middle)
    empty = View(view.color, np.zeros_like(view.depth), view.camera)
    assert not made("prompt-depth-anything", folder).restore([empty])[0].depth.any()


def test_the_prompt_moves_the_answer(snapshots: dict[str, Path]) -> None:
    view = a_view()
    method = made("prompt-depth-anything", snapshots["prompt-depth-anything"])
    twice = View(view.color, 2 * view.depth, view.camera)
    (once,), (double,) = method.restore([view]), method.restore([twice])
    np.testing.assert_allclose(double.depth, 2 * once.depth, rtol=1e-4)


def test_from_the_command_line_to_tables(snapshots: dict[str, Path], tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=1, frames=2)
    names = ["depth-pro", "prompt-depth-anything"]
    words = ["depth", "--data", str(root), "--split", SPLIT, "--out", str(tmp_path / "out")]
    words += ["--engine", "serial", "--no-gallery", "--no-speed"]
    for name, options in zip(names, (["--set", "fit=none"], []), strict=True):
        own = ["--method", name, "--weights", str(snapshots[name]), *options]
        assert main([*words, *own]) == 0
    label = "prompt-depth-anything+nearest"
    for name in ("depth-pro", label):
        table = pd.read_parquet(tmp_path / "out" / SPLIT / name / "strict" / TABLE)
        assert (table["error"] == "").all() and np.isfinite(table["rmse"]).any()
    aligned = [*words, "--protocol", "aligned-frame", "--method", "depth-anything"]
    weights = ["--weights", str(snapshots["depth-anything"])]
    assert main([*aligned, *weights, "--set", "fit=none"]) == 0
    assert (tmp_path / "out" / SPLIT / "depth-anything" / "aligned-frame" / TABLE).is_file()
    setup = json.loads((tmp_path / "out" / SPLIT / label / "strict" / "run.json").read_text())
    digests = [weights_digest(name, made(name, snapshots[name]), MethodOptions()) for name in names]
    assert setup["setup"]["weights_sha256"] == digests[1]
    assert len(set(digests)) == 2 and "" not in digests


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("size", {"shortest_edge": 56}),
        ("size", {"height": 56, "width": 0}),
        ("do_resize", False),
        ("do_normalize", False),
        ("ensure_multiple_of", 0),
    ],
)
def test_a_preparation_that_is_not_done_is_refused(
    field: str, value: object, snapshots: dict[str, Path], tmp_path: Path
) -> None:
    folder = tmp_path / "model"
    shutil.copytree(snapshots["depth-anything"], folder)
    (folder / "preprocessor_config.json").write_text(json.dumps({field: value}))
    with pytest.raises(ToolkitError, match=rf"preprocessor_config\.json: {field}"):
        made("depth-anything", folder)


def test_an_answer_that_fits_upside_down_is_no_answer(snapshots: dict[str, Path]) -> None:
    view = a_view()
    falling = np.tile(np.linspace(0.9, 0.5, 80), (45, 1))
    metric = made("zoedepth", snapshots["zoedepth"])
    with pytest.raises(ToolkitError, match="grows where the measurements fall"):
        metric.fitted(falling, view)


def test_wrong_folders(snapshots: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="your own snapshot"):
        make_restorer("depth-pro", MethodOptions())
    with pytest.raises(ToolkitError, match=r"config\.json"):
        made("depth-pro", tmp_path)
    with pytest.raises(ToolkitError, match="no model of the type depth_pro"):
        made("depth-pro", snapshots["zoedepth"])
    (tmp_path / "config.json").write_text((snapshots["zoedepth"] / "config.json").read_text())
    with pytest.raises(ToolkitError, match="cannot be read"):
        made("zoedepth", tmp_path)
    (tmp_path / "pytorch_model.bin").write_bytes(b"\x80\x04cposix\nsystem\n")
    with pytest.raises(ToolkitError, match="cannot be read"):
        made("zoedepth", tmp_path)  # no pickle is ever read
    with pytest.raises(ToolkitError, match="fit"):
        made("zoedepth", snapshots["zoedepth"], fit="truth")
