"""Joins the three published weight files of ClearGrasp into one.

    python -m benchmark.methods.depth.cleargrasp.join \\
        masks.pth normals.pth boundaries.pth all.safetensors

The benchmark records the hash of the one file. An input may also contain all three networks, as
`std-train` writes them; only the network it is given for is read.
"""

import argparse
from pathlib import Path

from torch import nn

from benchmark.methods.depth.cleargrasp import cleargrasp_network
from benchmark.methods.weights import check_keys, load_weights, read_weights, save_weights
from std_toolkit.errors import ToolkitError


def join_weights(
    masks: Path,
    normals: Path,
    boundaries: Path,
    path: Path,
    config: cleargrasp_network.ClearGraspConfig | None = None,
) -> None:
    """Write one file of the weights of three.

    Raises:
        ToolkitError: one cannot be read, or is of another network.
    """
    network = cleargrasp_network.ClearGraspNetwork(config)
    files = {"masks": masks, "normals": normals, "boundaries": boundaries}
    for name, file in files.items():
        _load(network.get_submodule(name), name, file)
    save_weights(network, path)


def _load(part: nn.Module, name: str, path: Path) -> None:
    found = read_weights(path)
    own = {
        key.removeprefix(f"{name}."): t for key, t in found.items() if key.startswith(f"{name}.")
    }
    if not own:
        load_weights(part, path)
        return
    check_keys(part.state_dict(), own, path)
    part.load_state_dict(own)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for name in ("masks", "normals", "boundaries"):
        parser.add_argument(name, type=Path, help=f"weights of the network for {name}")
    parser.add_argument("path", type=Path, help="file to write, .safetensors")
    parser.add_argument("--preset", choices=list(cleargrasp_network.PRESETS), default="published")
    arguments = parser.parse_args()
    try:
        join_weights(
            arguments.masks,
            arguments.normals,
            arguments.boundaries,
            arguments.path,
            cleargrasp_network.PRESETS[arguments.preset],
        )
    except ToolkitError as error:
        parser.exit(1, f"{error}\n")


if __name__ == "__main__":
    main()
