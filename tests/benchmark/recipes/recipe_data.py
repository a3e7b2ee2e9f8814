"""Small data for recipes: sets in the layouts of DREDS and STD, without any simulation."""

from __future__ import annotations

from pathlib import Path

from sensors.simulation.options import SimulationOptions
from sensors.simulation.simulated_set import SET_FILE, SetRecord
from std_toolkit.io.documents import write_document
from tests.dreds_on_disk import write_dreds_scene, write_std_scene

TINY_OPTIONS = SimulationOptions(views=2, width=64, height=36, quality="rough")


def write_set(root: Path, part: str, scenes: int, first: int = 0, frames: int = 2) -> Path:
    """Scenes in the DREDS layout, named after seeds, as `std-sim` leaves them."""
    for seed in range(first, first + scenes):
        folder = root / "DREDS-CatKnown" / part / f"{seed:05d}"
        write_dreds_scene(folder, frames=frames, seed=seed)
    return root


def mark_as_simulated(root: Path, options: SimulationOptions = TINY_OPTIONS) -> None:
    """Put the record of a simulated set beside."""
    record = SetRecord(version_of_tool="0", renderer="mitsuba", options=options)
    write_document(root / SET_FILE, record)


def write_std(root: Path, name: str = "STD-CatKnown") -> Path:
    """One scene of STD."""
    write_std_scene(root / name / "test_0")
    return root
