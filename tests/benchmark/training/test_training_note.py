"""The note of a training holds the options of a simulated set, whatever they are."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec

from benchmark.training.run_note import PartNote, _simulation
from sensors.simulation.options import SimulationOptions
from tests.benchmark.recipes.recipe_data import mark_as_simulated


def test_options_of_every_kind_are_noted(tmp_path: Path) -> None:
    """Lists among them: `fix` is one."""
    options = SimulationOptions(fix=("lighting", "objects"), assets_root=str(tmp_path))
    mark_as_simulated(tmp_path, options)
    found = _simulation(tmp_path)
    assert found["fix"] == ["lighting", "objects"]
    kind = {f.name: f.type for f in msgspec.structs.fields(PartNote)}["simulation"]
    assert msgspec.convert(json.loads(json.dumps(found)), kind) == found
