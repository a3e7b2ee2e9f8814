"""Photograph an unsprayed glass tumbler in simulation and scan it: the outline tells its shape.

python examples/09_scan_an_object.py [FOLDER]

FOLDER/turntable then has photos/ and board.json as a camera would give them, FOLDER/model the mesh
and its report. Needs the extras `sim` and `scan`.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sensors.simulation.options import TurntableOptions
from sensors.simulation.turntable import make_turntable
from sensors.synthetic.shapes import tumbler
from std_toolkit import ScanOptions, ToolkitError, scan


def photograph(folder: Path) -> np.ndarray:
    """Photos of a tumbler on the printed board; returns its extents in metres, y up."""
    folder.mkdir(parents=True, exist_ok=True)
    mesh = tumbler(0.035, 0.1)
    mesh.export(folder / "tumbler.ply")
    make_turntable(
        TurntableOptions(
            mesh=folder / "tumbler.ply", out=folder / "turntable", material="glass", up="y",
            views=24, width=640, height=360,
        )
    )  # fmt: skip
    return np.asarray(mesh.extents)


def main(folder: Path) -> None:
    true = 1000 * photograph(folder)
    photos = folder / "turntable"
    options = ScanOptions(
        photos=photos / "photos",
        board=photos / "board.json",
        out=folder / "model",
        revolve=True,
        texture=512,
    )
    size = 1000 * np.ptp(scan(options).vertices, axis=0)
    print(f"scanned: {size[2]:.1f} mm high, {size[0]:.1f} mm wide")
    print(f"true:    {true[1]:.1f} mm high, {true[0]:.1f} mm wide")


if __name__ == "__main__":
    try:
        if len(sys.argv) > 1:
            main(Path(sys.argv[1]))
        else:
            with TemporaryDirectory() as temporary:
                main(Path(temporary))
    except ToolkitError as error:
        sys.exit(f"error: {error}")
