"""Trained weights: shipped ones, and files given by the user."""

import argparse
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from benchmark.methods.registry import MethodOptions, shipped_weights
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic

# Under these keys training programs keep the weights, beside the state of their optimizer.
_WRAPPERS = ("state_dict", "model_state_dict", "model", "net", "network")
# Before every key: what was wrapped for several GPUs, and compiled.
_PREFIXES = ("module.", "_orig_mod.")
_NAMED = 3  # keys named in an error

SWINDRNET = "SwinDRNet"

# Weights of a file and state of the network to weights with the network's keys.
Renamed = Callable[[dict[str, Tensor], dict[str, Tensor]], dict[str, Tensor]]

# Keys by which the weights of an architecture are known; the first whose prefixes all occur.
ARCHITECTURES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("SwinDRNet's pose network", ("backbone_rgb_branch.", "decode_head_nocs.")),
    ("heads of SwinDRNet's pose network", ("trunk_sha256", "to_quarter.", "middles.")),
    # Of the authors: it has decoders of depth too, and more blocks of fusion than SwinDRNet.
    ("SwinDRNet's pose network", ("cross_attention_0.cross_attn_layer.blocks.1.",)),
    (SWINDRNET, ("backbone_rgb_branch.", "decode_head_depth_restoration.")),
    ("SwinDRNet of one stream", ("backbone.patch_embed.", "decode_head_depth_restoration.")),
    ("SwinDRNet's pose network", ("backbone_rgb_branch.",)),
    ("CompactDR", ("encoder.stem.", "of_depth.", "narrow.")),
    ("EfficientNet-Lite (ImageNet)", ("_conv_stem.", "_blocks.")),
    ("NLSPN", ("conv1_dep.", "prop_layer.")),
    ("DFNet", ("stem.", "skips.", "downs.", "ups.")),
    ("DFNet of its authors", ("first.", "dense1s.layers.", "updense4_duc.")),
    ("LIDF", ("color_net.", "termination.", "refinement.")),
    ("ClearGrasp", ("masks.backbone.", "normals.backbone.", "boundaries.backbone.")),
    ("GraspNet", ("levels.", "back.", "approach.", "operation.")),
    ("a Swin classifier (ImageNet)", ("patch_embed.", "layers.", "head.")),
    ("a Swin backbone", ("patch_embed.", "layers.")),
    ("a Swin of transformers", ("swin.embeddings.patch_embeddings.",)),
    ("a Swin of transformers", ("embeddings.patch_embeddings.", "encoder.layers.")),
    ("Crop NOCS", ("joined.", "down.", "bins.")),
    ("NOCS", ("pyramid.backbone.", "detector.", "coordinate_heads.")),
    ("SGPA", ("structure.weigh.", "heads.assign.")),
    ("SGPA of its authors", ("prior_enricher.", "psp.feats.", "assignment.")),
    ("SPD of its authors", ("psp.feats.", "assignment.", "deformation.")),
    ("SPD", ("prior_geometry.", "heads.assign.")),
    ("a ResNet classifier (ImageNet)", ("conv1.weight", "layer4.", "fc.")),
    ("a ResNet", ("layer1.", "layer4.")),
    ("DeepLabv3+, such as one of ClearGrasp's three", ("backbone.", "aspp", "decoder.")),
)


_UNTRAINED: ContextVar[bool] = ContextVar("untrained", default=False)


@contextmanager
def untrained() -> Iterator[None]:
    """Networks that are made within the block keep the weights that they begin training with.

    Their cost is that of trained ones, and their answers mean nothing.
    """
    before = _UNTRAINED.set(True)
    try:
        yield
    finally:
        _UNTRAINED.reset(before)


def is_untrained() -> bool:
    """Whether networks are made without trained weights now."""
    return _UNTRAINED.get()


def weights_for(method: str, options: MethodOptions) -> Path:
    """The file of weights that a user gave, or else the one that comes with the toolkit.

    Raises:
        ToolkitError: neither.
    """
    if is_untrained():
        return Path()  # that nothing reads
    return options.weights or shipped_weights(method, options.preset)


def read_weights(path: Path) -> dict[str, Tensor]:
    """The tensors of a safetensors file, or of a checkpoint of torch (.pth, .pt, .tar), by key.

    A checkpoint is read without running code of its own. What training programs wrap around the
    weights, and put before their keys, is taken off.

    Raises:
        ToolkitError: no such file, not weights, or a checkpoint that holds code.
    """
    if not path.is_file():
        raise ToolkitError("no such file of weights", path=path)
    if path.suffix == ".safetensors":
        return _without_prefix(_read_safetensors(path))
    try:
        with torch.serialization.safe_globals(_plain_types()):
            found = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise ToolkitError(
            "not a checkpoint of torch, or one that holds more than tensors, which could run any "
            "code and is not loaded",
            path=path,
            hint="save its state_dict alone, best as safetensors",
        ) from error
    except (RuntimeError, EOFError, ValueError, KeyError) as error:
        raise ToolkitError(f"not a checkpoint of torch: {error}", path=path) from error
    return _without_prefix(_unwrapped(found, path))


def _plain_types() -> list[Any]:
    """Types of plain data that training programs keep beside weights: options and numbers."""
    scalar = np.dtype(np.float64).type(0).__reduce__()[0]
    kinds = {type(np.dtype(t)) for t in (np.float32, np.float64, np.int32, np.int64, np.bool_)}
    # Files name the function by the module of NumPy 1 or of NumPy 2.
    names = [(scalar, f"numpy.{core}.multiarray.scalar") for core in ("core", "_core")]
    return [argparse.Namespace, np.dtype, *kinds, *names]


def load_weights(
    network: nn.Module,
    path: Path,
    ignored: Sequence[str] = (),
    renamed: Renamed | None = None,
) -> None:
    """Read a network's weights from a file; within `untrained`, leave them as they are.

    Args:
        network: gets the tensors of the file themselves: no second copy in memory.
        path: a safetensors file or a checkpoint of torch.
        ignored: keys that the file may have and the network does not need.
        renamed: turns the weights of the authors' program, if they are such, into the network's.

    Raises:
        ToolkitError: the file cannot be read, or is of another architecture: which keys are
            missing, which unknown and which have another shape.
    """
    if is_untrained():
        return
    state = read_weights(path)
    if renamed is not None:
        state = renamed(state, network.state_dict())
    state = {name: tensor for name, tensor in state.items() if name not in ignored}
    check_keys(network.state_dict(), state, path)
    wanted = {name: tensor.dtype for name, tensor in network.state_dict().items()}
    state = {name: tensor.to(wanted[name]) for name, tensor in state.items()}
    trains = {name: p.requires_grad for name, p in network.named_parameters()}
    network.load_state_dict(state, assign=True)
    for name, parameter in network.named_parameters():
        parameter.requires_grad_(trains[name])


def save_weights(network: nn.Module, path: Path) -> None:
    """Write a network's weights as safetensors, atomically.

    Raises:
        ToolkitError: the file cannot be written.
    """
    state = {name: t.detach().cpu().contiguous() for name, t in network.state_dict().items()}
    # As bytes: files that the library writes itself are readable only by their owner.
    write_bytes_atomic(path, save(state))


def check_keys(wanted: Mapping[str, Tensor], found: Mapping[str, Tensor], path: Path) -> None:
    """Refuse weights whose keys or shapes are not the wanted ones.

    Raises:
        ToolkitError: which they are (the first few), how many, and what the weights look like.
    """
    missing = [name for name in wanted if name not in found]
    unknown = [name for name in found if name not in wanted]
    shapes = [
        f"{name} {_shape(found[name])} instead of {_shape(tensor)}"
        for name, tensor in wanted.items()
        if name in found and found[name].shape != tensor.shape
    ]
    parts = [
        f"{len(names)} {what} ({_first(names)})"
        for names, what in (
            (missing, "keys missing"),
            (unknown, "keys unknown"),
            (shapes, "of another shape"),
        )
        if names
    ]
    if not parts:
        return
    looks, own = architecture_of(found), architecture_of(wanted)
    hint = None
    if looks is not None and looks != own:
        hint = f"they look like those of {looks}"
    elif looks is not None:
        hint = f"they are of {looks}, but of another size or with other settings"
    raise ToolkitError(f"weights of another network: {'; '.join(parts)}", path=path, hint=hint)


def architecture_of(state: Mapping[str, Any]) -> str | None:
    """Which architecture weights look like, by their keys; None if like none that is known."""
    for title, prefixes in ARCHITECTURES:
        if all(any(key.startswith(prefix) for key in state) for prefix in prefixes):
            return title
    return None


def _read_safetensors(path: Path) -> dict[str, Tensor]:
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            return {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise ToolkitError(f"not a file of safetensors: {error}", path=path) from error


_DEEPEST_WRAPPER = 8


def _unwrapped(found: object, path: Path) -> dict[str, Tensor]:
    for _ in range(_DEEPEST_WRAPPER):  # a checkpoint may contain itself
        if not isinstance(found, Mapping):
            break
        inner = next((found[key] for key in _WRAPPERS if isinstance(found.get(key), Mapping)), None)
        if inner is None:
            break
        found = inner
    tensors = isinstance(found, Mapping) and {
        key: value for key, value in found.items() if isinstance(value, Tensor)
    }
    if not tensors:
        raise ToolkitError("the checkpoint holds no tensors by name", path=path)
    return tensors


def _without_prefix(state: dict[str, Tensor]) -> dict[str, Tensor]:
    for prefix in (*_PREFIXES, *_PREFIXES):  # either may stand before the other
        if state and all(key.startswith(prefix) for key in state):
            state = {key.removeprefix(prefix): value for key, value in state.items()}
    return state


def _first(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")


def _shape(tensor: Tensor) -> str:
    return "x".join(map(str, tensor.shape)) or "scalar"
