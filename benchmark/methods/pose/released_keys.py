"""Weights of the authors' programs of SPD and SGPA, under this package's keys.

Their files are the state dicts alone (`model_50.pth`). The priors are not in them: those of the
network are kept.
"""

import re

import torch
from torch import Tensor

_COLOR = (
    (r"psp\.feats\.(.*)", r"color.\1"),
    (r"psp\.psp\.stages\.(\d)\.1\.(.*)", r"color.levels.\1.1.\2"),
    (r"psp\.final\.(.*)", r"color.final.\1"),
    (r"instance_color\.0\.(.*)", r"color.each.0.\1"),
)
_HEADS = (
    (r"instance_global\.(.*)", r"heads.whole.\1"),
    (r"category_global\.(.*)", r"heads.prior_whole.\1"),
    (r"assignment\.([02])\.(.*)", r"heads.assign.trunk.\1.\2"),
    (r"assignment\.4\.(.*)", r"heads.assign.last.\1"),
    (r"deformation\.([02])\.(.*)", r"heads.deform.trunk.\1.\2"),
    (r"deformation\.4\.(.*)", r"heads.deform.last.\1"),
)
_SPD = (
    (r"instance_geometry\.(.*)", r"geometry.\1"),
    (r"category_local\.(.*)", r"prior_geometry.\1"),
)
_SGPA = (
    (r"conv1d_stpts_prob\.(.*)", r"structure.weigh.\1"),
    (r"prior_enricher\.enricher\.linears\.3\.(.*)", r"adapt.attention.out_proj.\1"),
)
_POINTS = {"instance_geometry": "geometry", "category_local": "prior_geometry"}
_LEVELS = 4


def spd_state(state: dict[str, Tensor], own: dict[str, Tensor]) -> dict[str, Tensor]:
    """The weights of SPD's authors under our keys; other weights as they are.

    Args:
        state: of the file.
        own: of the network: shapes of the last layers, and the priors.
    """
    if "psp.feats.conv1.weight" not in state:
        return state
    return _mapped(state, own, (*_COLOR, *_SPD, *_HEADS))


def sgpa_state(state: dict[str, Tensor], own: dict[str, Tensor]) -> dict[str, Tensor]:
    """The weights of SGPA's authors under our keys; other weights as they are.

    Args:
        state: of the file.
        own: of the network: shapes of the last layers, and the priors.
    """
    if "prior_enricher.enricher.linears.0.weight" not in state:
        return state
    found = _mapped(state, own, (*_COLOR, *_SGPA, *_HEADS))
    for kind in ("weight", "bias"):
        keys = [f"prior_enricher.enricher.linears.{i}.{kind}" for i in range(3)]
        # Queries, keys and values are one layer here.
        found[f"adapt.attention.in_proj_{kind}"] = torch.cat([found.pop(key) for key in keys])
    for theirs, ours in _POINTS.items():
        for key in [k for k in found if k.startswith(f"{theirs}.")]:
            tensor = found.pop(key)
            name = _pointnet_key(key.removeprefix(f"{theirs}."))
            if name is None:
                continue
            if name.startswith("up.") and tensor.ndim == 4:
                tensor = tensor[..., 0]
            found[f"{ours}.{name}"] = tensor
    return found


def _pointnet_key(key: str) -> str | None:
    """Ours of a key of their PointNet++; None for the classifier, which they do not use."""
    match = re.fullmatch(
        r"(SA|FP)_modules\.(\d)\.mlps?\.?(\d)?\.layer(\d)\.(conv|bn\.bn)\.(.*)", key
    )
    if match is None:
        return None
    kind, level, scale, layer, part, rest = match.groups()
    place = 3 * int(layer) + (part != "conv")
    if kind == "SA":
        return f"down.{level}.mlps.{scale}.{place}.{rest}"
    # Theirs begin with the finest level.
    return f"up.{_LEVELS - 1 - int(level)}.mlp.{place}.{rest}"


def _mapped(
    state: dict[str, Tensor], own: dict[str, Tensor], rules: tuple[tuple[str, str], ...]
) -> dict[str, Tensor]:
    found = {}
    for key, tensor in state.items():
        name = re.sub(r"^psp\.up_(\d)\.conv\.", lambda m: f"color.up.{int(m[1]) - 1}.", key)
        for pattern, ours in rules:
            if re.fullmatch(pattern, key):
                name = re.sub(pattern, ours, key)
                break
        if ".last." in name and name in own and tensor.numel() == own[name].numel():
            tensor = tensor.reshape(own[name].shape)  # category by category
        found[name] = tensor
    first = "heads.deform.trunk.0.weight"
    if first in found and first in own and found[first].shape == own[first].shape:
        # Theirs takes the whole prior before the whole object.
        width = own["heads.whole.2.weight"].shape[0]
        begin = found[first].shape[1] - 2 * width
        parts = found[first].split([begin, width, width], dim=1)
        found[first] = torch.cat([parts[0], parts[2], parts[1]], dim=1)
    return found | {"prior": own["prior"]} if "prior" in own else found
