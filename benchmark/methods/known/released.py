"""Released networks under weights that a rule gives, and their answers to inputs of a seed.

The rule is that of the known answers that the authors' programs gave for seed 0: a number of a
standard normal by the CRC-32 of the key, scaled by the kind of entry.
"""

import csv
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from zlib import crc32

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from benchmark.methods.depth import dfnet, nlspn
from benchmark.methods.depth.swindrnet.swin import relative_index
from benchmark.methods.depth.swindrnet.swindrnet_network import SwinDRNetwork
from benchmark.methods.pose import sgpa, spd
from benchmark.methods.pose.released_keys import sgpa_state, spd_state
from std_toolkit.plugins import configured

Answers = Mapping[str, NDArray[np.floating]]

_FOLDER = Path(__file__).parent
_NOCS = "bottle,bowl,camera,can,laptop,mug"
_MEAN, _DEVIATION = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
_CATEGORY = 2


def known_weights(key: str, shape: tuple[int, ...], seed: int = 0) -> NDArray[np.float32]:
    """Return the weights of a key by the rule.

    Args:
        key: of the authors' state dict.
        shape: of the entry.
        seed: 0 gives the weights of the known answers of the authors' programs.
    """
    random = np.random.RandomState((crc32(key.encode()) + seed) % 2**32)
    x = random.standard_normal(shape).astype(np.float32)
    if key.endswith("running_var"):
        return 1 + np.float32(0.1) * np.abs(x)
    if key.endswith("running_mean"):
        return np.float32(0.1) * x
    if x.ndim <= 1:
        return 1 + np.float32(0.1) * x if key.endswith("weight") else np.float32(0.02) * x
    return np.asarray(x / np.sqrt(np.prod(shape[1:])), np.float32)


def waves(height: int, width: int) -> NDArray[np.float32]:
    """Return (height, width) depth of the known answers, metres, with a hole."""
    y, x = np.mgrid[:height, :width]
    depth = (0.5 + 0.3 * y / (height - 1) + 0.05 * np.sin(x / 9)).astype(np.float32)
    depth[60:110, 80:150] = 0
    return depth


def _state(network: nn.Module, seed: int) -> dict[str, Tensor]:
    """Weights of a network whose keys are the authors'."""
    return {
        key: torch.from_numpy(np.asarray(known_weights(key, tuple(t.shape), seed)))
        if t.is_floating_point()
        else torch.zeros(tuple(t.shape), dtype=t.dtype)
        for key, t in network.state_dict().items()
    }


def _filed_state(name: str, seed: int) -> dict[str, Tensor]:
    """Weights of a network whose authors' keys and shapes are in a file."""
    state = {}
    with (_FOLDER / f"{name}_released_state_dict.csv").open() as file:
        for row in csv.DictReader(file):
            shape = tuple(int(n) for n in row["shape"].split())
            if row["dtype"].startswith("int"):
                state[row["key"]] = torch.zeros(shape, dtype=torch.int64)
            else:
                state[row["key"]] = torch.from_numpy(known_weights(row["key"], shape, seed))
    return state


def _images(height: int, width: int, seed: int) -> tuple[Tensor, Tensor]:
    color = np.random.RandomState(seed).rand(1, 3, height, width).astype(np.float32)
    return torch.from_numpy(color), torch.from_numpy(waves(height, width))[None, None]


def _quarter(image: Tensor) -> NDArray[np.float32]:
    return np.asarray(image[0, 0, ::4, ::4].numpy())


def dfnet_answers(seed: int) -> Answers:
    """Return restored depth of DFNet's released form."""
    network = dfnet.dfnet_of(configured(dfnet.PRESETS["published"], {"form": "released"})).eval()
    network.load_state_dict(_state(network, seed), assign=True)
    return {"depth": _quarter(network(*_images(240, 320, seed)).depth)}


def nlspn_answers(confidence: str, seed: int) -> Answers:
    """Return initial and final depth and confidence of NLSPN."""
    config = configured(nlspn.PRESETS["published"], {"confidence": confidence})
    network = nlspn.NLSPNetwork(config).eval()
    own = network.state_dict()
    state = {
        key: 0.05 * tensor if "conv_offset_aff" in key else tensor
        for key, tensor in _state(network, seed).items()
    }
    # Neither is trained.
    kept = ("prop_layer.w", "prop_layer.b", "prop_layer.w_conf", "prop_layer.aff_scale_const")
    network.load_state_dict(state | {k: own[k] for k in kept if k in own}, assign=True)
    seen: dict[str, Tensor] = {}
    network.cf_dec0.register_forward_hook(lambda *args: seen.update(confidence=args[2]))
    found = network(*_images(224, 224, seed))
    assert found.initial is not None
    return {
        "initial": _quarter(found.initial),
        "confidence": _quarter(seen["confidence"]),
        "final": _quarter(found.depth),
    }


def swindrnet_answers(seed: int) -> Answers:
    """Return the four outputs of the released SwinDRNet."""
    with torch.device("meta"):
        network = SwinDRNetwork().eval()
    state = _state(network, seed)
    index = {key: relative_index(7) for key in state if key.endswith("relative_position_index")}
    network.load_state_dict(state | index, assign=True)
    found = network(*_images(224, 224, seed))
    assert found.initial is not None and found.confidence is not None
    outputs = (found.depth, found.initial, found.confidence, 1 - found.confidence)
    return {f"output_{i}": _quarter(output) for i, output in enumerate(outputs)}


def prior_answers(name: str, seed: int) -> Answers:
    """Return assignment before its softmax, deformations, and SGPA's structure points."""
    r = np.random.RandomState(seed)
    points = 0.2 * r.rand(1, 1024, 3) - 0.1
    image = r.rand(1, 3, 192, 192)
    pixels = r.randint(0, 192 * 192, (1, 1024))
    prior = 0.8 * r.rand(1, 1024, 3) - 0.4
    settings = {"categories": _NOCS}
    with tempfile.TemporaryDirectory() as folder:
        priors = Path(folder) / "priors.npy"
        np.save(priors, np.repeat(prior, len(_NOCS.split(",")), axis=0))
        settings["priors"] = str(priors)
        network: nn.Module
        if name == "spd":
            network = spd.SPDNetwork(configured(spd.PRESETS["published"], settings))
        else:
            settings["structure"] = "128"
            network = sgpa.SGPANetwork(configured(sgpa.PRESETS["published"], settings))
    renamed = {"spd": spd_state, "sgpa": sgpa_state}[name]
    own = network.state_dict()
    state = {k: t for k, t in renamed(_filed_state(name, seed), own).items() if k in own}
    network.eval().load_state_dict(state, assign=True)
    seen: dict[str, Tensor] = {}
    network.heads.assign.register_forward_hook(lambda *args: seen.update(scores=args[2]))
    # Theirs is given colour that was normalised before.
    color = image * _DEVIATION[:, None, None] + _MEAN[:, None, None]
    answer = network(
        torch.from_numpy(color).float(),
        torch.from_numpy(points).float(),
        torch.from_numpy(pixels),
        torch.tensor([_CATEGORY]),
    )
    found = {
        "assign": seen["scores"][0].T[::16, ::16].numpy(),
        "deltas": answer.deformation[0].numpy(),
    }
    return found if name == "spd" else {**found, "structure_points": answer.structure[0].numpy()}


# By name of the case; each is called with a seed.
RELEASED: dict[str, Callable[[int], Answers]] = {
    "dfnet released": dfnet_answers,
    "nlspn released": lambda seed: nlspn_answers("released", seed),
    "nlspn legacy": lambda seed: nlspn_answers("legacy", seed),
    "spd released": lambda seed: prior_answers("spd", seed),
    "sgpa released": lambda seed: prior_answers("sgpa", seed),
    "swindrnet released": swindrnet_answers,
}
