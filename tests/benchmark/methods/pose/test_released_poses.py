"""SPD and SGPA with files of their authors' structure: known answers, keys, priors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.methods.pose.sgpa import SGPA
from benchmark.methods.pose.spd import SPD
from benchmark.methods.registry import MethodOptions
from std_toolkit.errors import ToolkitError
from tests.benchmark.methods.networks.released import oracle, released_state

NOCS = "bottle,bowl,camera,can,laptop,mug"
METHODS = {"spd": SPD, "sgpa": SGPA}
MEAN, STD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])


def method(name: str, weights: Path, priors: Path):
    np.save(priors, np.random.default_rng(0).uniform(-0.4, 0.4, (6, 1024, 3)))
    settings = {"categories": NOCS, "priors": str(priors), "masks": "true"}
    if name == "sgpa":
        settings["structure"] = "128"
    options = MethodOptions(preset="published", weights=weights, settings=settings)
    return METHODS[name](options)


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
@torch.inference_mode()
def test_known_answers(name: str, tmp_path: Path) -> None:
    torch.save(released_state(name), tmp_path / "model_50.pth")
    network = method(name, tmp_path / "model_50.pth", tmp_path / "mean_points_emb.npy").network
    r = np.random.RandomState(0)
    points = 0.2 * r.rand(1, 1024, 3) - 0.1
    image = r.rand(1, 3, 192, 192)
    pixels = r.randint(0, 192 * 192, (1, 1024))
    prior = 0.8 * r.rand(1, 1024, 3) - 0.4
    category = torch.tensor([2])
    network.prior[2] = torch.from_numpy(prior[0])
    # Theirs is given colour that was normalised before.
    color = image * STD[:, None, None] + MEAN[:, None, None]
    found = {}
    network.heads.assign.register_forward_hook(lambda *args: found.update(scores=args[2]))
    answer = network(
        torch.from_numpy(color).float(),
        torch.from_numpy(points).float(),
        torch.from_numpy(pixels),
        category,
    )
    wanted = oracle(name)
    scores = found["scores"][0].T[::16, ::16].numpy()
    assert wanted["assign"].std() > 1e-3 and wanted["deltas"].std() > 1e-3
    np.testing.assert_allclose(scores, wanted["assign"], rtol=0, atol=1e-4)
    np.testing.assert_allclose(answer.deformation[0], wanted["deltas"], rtol=0, atol=1e-4)
    if name == "sgpa":
        np.testing.assert_allclose(
            answer.structure[0], wanted["structure_points"], rtol=0, atol=1e-5
        )


@pytest.mark.slow
def test_other_weights_are_named(tmp_path: Path) -> None:
    few = {k: v for k, v in released_state("spd").items() if v.numel() < 100_000}
    torch.save(few, tmp_path / "model_50.pth")
    with pytest.raises(ToolkitError, match="another network") as caught:
        method("sgpa", tmp_path / "model_50.pth", tmp_path / "priors.npy")
    assert "SPD of its authors" in str(caught.value.hint)
    np.save(tmp_path / "five.npy", np.zeros((5, 1024, 3)))
    options = MethodOptions(
        preset="published", settings={"categories": NOCS, "priors": str(tmp_path / "five.npy")}
    )
    with pytest.raises(ToolkitError, match="of the categories"):
        SPD(options)
