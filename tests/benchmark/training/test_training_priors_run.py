"""SPD and SGPA by the commands: packing, training, going on, poses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from training_set import SPLIT, packed, same, write_scenes

from benchmark.cli.bench import main as bench
from benchmark.cli.train import main
from benchmark.methods.registry import MethodOptions, make_pose_method
from benchmark.training.catalogue import get_trainable
from benchmark.training.fit import Beginning, make_network
from benchmark.training.options import TrainOptions
from benchmark.training.plan import plan_training
from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import read_color
from tests.benchmark.methods.pose.boxes_in_view import write_priors

SIZE = (64, 36)
TINY = {
    "prior_points": "64",
    "side": "32",
    "points": "48",
    "color_width": "8",
    "color_decoder": "8,8,8,8",
    "color": "16",
    "geometry": "16",
    "width": "32",
    "hidden": "32,32",
    "input_size": "64,36",
    "trained_on": "true",
}
SGPA = {
    "centres": "16,4",
    "radii": "0.3,0.6,0.8,1.6",
    "prior_radii": "0.1,0.2,0.3,0.6",
    "thickness": "8",
    "structure": "8",
    "structure_widths": "16,16",
}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("prior_data"), scenes=4, frames=2)


@pytest.fixture(scope="module")
def pack(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return packed(tmp_path_factory.mktemp("prior_pack") / "p", data, size=SIZE, nocs=True)


@pytest.fixture(scope="module")
def priors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_priors(tmp_path_factory.mktemp("priors") / "p.safetensors")


def settings(method: str, priors: Path) -> dict[str, str]:
    return {**TINY, **(SGPA if method == "sgpa" else {}), "priors": str(priors)}


def options(method: str, priors: Path) -> list[str]:
    pairs = [f"{name}={value}" for name, value in settings(method, priors).items()]
    return ["--method", method, "--preset", "compact", "--set", *pairs]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["spd", "sgpa"])
def test_from_training_to_the_table_of_poses(method, data, pack, priors, tmp_path, capsys):
    from safetensors.torch import load_file

    command = [*options(method, priors), "--data", str(pack), "--batch-size", "2"]
    command += ["--checkpoint-every", "2", "--validate-every", "2", "--hold-out", "0.3"]
    command += ["--readers", "0", "--accelerator", "cpu", "--seed", "3", "--debug"]
    run = tmp_path / "run"
    assert main([*command, "--steps", "4", "--out", str(run)]) == 0
    best = json.loads((run / "best.json").read_text())
    assert best["ranked_by"] == "coordinates" and 0 < best["scores"]["coordinates"] < 1
    known = {n for n in best["scores"] if n.startswith("coordinates_")}
    assert known == {"coordinates_bottle", "coordinates_mug", "coordinates_camera"}
    gallery = sorted((run / "gallery").glob("*.jpg"))
    assert len(gallery) == 2 and read_color(gallery[0]).shape[1] == 3 * SIZE[0]
    again = tmp_path / "again"
    assert main([*command, "--steps", "4", "--out", str(again)]) == 0
    first, second = (load_file(r / "last.safetensors") for r in (run, again))
    assert same(first, second)
    assert "prior" in first, "weights hold the priors that they were trained with"

    words = ["pose", *options(method, priors), "masks=true", "--weights"]
    words += [str(run / "best.safetensors"), "--data", str(data), "--split", SPLIT]
    words += ["--depth", "gt", "--limit", "2", "--engine", "serial", "--no-gallery"]
    capsys.readouterr()
    assert bench([*words, "--out", str(tmp_path / "out"), "--debug"]) == 0
    assert re.search(rf"{method} +gt +ransac +all +6 ", capsys.readouterr().out)


def test_frames_of_another_size_and_without_nocs_are_refused(data, pack, priors, tmp_path):
    def plan(folder, **changes):
        wanted = {**settings("spd", priors), **changes}
        return plan_training(
            TrainOptions(
                method="spd", settings=wanted, data=[folder], steps=2, batch_size=2, hold_out=0.3
            )
        )

    assert plan(pack)[0].steps == 2
    with pytest.raises(ToolkitError, match="packed at 64x36"):
        plan(pack, input_size="32,32")


def test_the_rate_of_sgpa_falls_after_five_and_ten_of_fifteen_epochs(pack, priors):
    config, _, _ = plan_training(
        TrainOptions(
            method="sgpa",
            settings=settings("sgpa", priors),
            data=[pack],
            steps=30,
            batch_size=2,
            hold_out=0.3,
        )
    )
    rates = [config.rate(step) / 1e-4 for step in (0, 9, 10, 19, 20, 29)]
    assert rates == pytest.approx([1, 1, 0.6, 0.6, 0.3, 0.3])


def test_a_training_can_begin_with_a_resnet_18(pack, priors, tmp_path):
    from safetensors.torch import save_file

    config, _, _ = plan_training(
        TrainOptions(
            method="spd",
            settings=settings("spd", priors),
            data=[pack],
            steps=2,
            batch_size=2,
            hold_out=0.3,
        )
    )
    trainable = get_trainable("spd")
    plain = make_network(trainable, config, Beginning())
    names = ("conv1", "bn1", "layer1", "layer2", "layer3", "layer4")
    state = {
        name: tensor + 0.25 if tensor.is_floating_point() else tensor
        for name, tensor in plain.color.state_dict().items()
        if name.startswith(names)
    }
    classifier = {**state, "fc.weight": state["bn1.weight"][:, None].clone()}
    save_file(classifier, tmp_path / "r.safetensors")
    begun = make_network(trainable, config, Beginning(imagenet=tmp_path / "r.safetensors"))
    for name, tensor in begun.color.state_dict().items():
        if name in state and tensor.is_floating_point():
            assert (tensor == state[name]).all(), name
    same_elsewhere = begun.heads.assign.last.weight == plain.heads.assign.last.weight
    assert same_elsewhere.all()
    state.pop("conv1.weight")
    save_file(state, tmp_path / "other.safetensors")
    with pytest.raises(ToolkitError, match=r"conv1\.weight"):
        make_network(trainable, config, Beginning(imagenet=tmp_path / "other.safetensors"))


def test_masks_need_a_method_that_segments_or_the_truth(priors, tmp_path):
    from benchmark.methods.weights import save_weights

    trainable = get_trainable("spd")
    network = trainable.network(trainable.config("compact", settings("spd", priors)))
    save_weights(network, tmp_path / "w.safetensors")

    def made(masks):
        return make_pose_method(
            "spd",
            MethodOptions(
                preset="compact",
                weights=tmp_path / "w.safetensors",
                settings={**settings("spd", priors), **masks},
            ),
        )

    assert made({"masks": "true"}).needs_truth
    with pytest.raises(ToolkitError, match="masks=true"):
        made({"masks": "nocs", "mask_weights": str(tmp_path / "missing.safetensors")})
    with pytest.raises(ToolkitError, match="does not segment"):
        made({"masks": "gt-nocs"})
