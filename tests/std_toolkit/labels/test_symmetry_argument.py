"""Symmetries found in a mesh, and declared ones that it does not have."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.entry.symmetry_argument import (
    parse_symmetry,
    symmetry_doubt,
    symmetry_proposal,
)


@pytest.mark.slow
def test_auto_proposal_and_doubt() -> None:
    box = trimesh.creation.box((0.05, 0.08, 0.12))
    auto = parse_symmetry(["auto"], centre=(0, 0, 0), mesh=box)
    assert len(auto.discrete) == 3 and not auto.continuous
    proposal = symmetry_proposal(box)
    assert proposal is not None
    assert all(f"half a turn about {axis}" in proposal for axis in "xyz")
    assert symmetry_doubt(box, auto) is None
    quarter = parse_symmetry(["fold:z:4"], centre=(0, 0, 0))
    doubt = symmetry_doubt(box, quarter)
    assert doubt is not None and "turn of 90 deg" in doubt


def test_auto_stands_alone() -> None:
    with pytest.raises(ToolkitError, match="'auto' contradicts"):
        parse_symmetry(["auto", "axis:z"], centre=np.zeros(3).tolist())


def test_a_file_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "symmetry.json"
    path.write_text('\ufeff{"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]}')
    (axis,) = parse_symmetry([str(path)], centre=np.zeros(3).tolist()).continuous
    assert list(axis.axis) == [0, 0, 1]


def test_turns_that_are_no_group_are_refused_at_once(tmp_path: Path) -> None:
    angles = np.random.default_rng(0).uniform(0, 6, 300)
    turns = [SE3.exp([0, 0, 0, 0, 0, a]).flat() for a in angles]
    path = tmp_path / "symmetry.json"
    path.write_text(json.dumps({"symmetries_discrete": turns}))
    began = time.process_time()
    with pytest.raises(ToolkitError, match="do not form a finite group"):
        parse_symmetry([str(path)], centre=[0, 0, 0])
    assert time.process_time() - began < 2
    turns = [SE3.exp([0, 0, 0, 0, 0, 2 * np.pi * k / 60]).flat() for k in range(60)]
    path.write_text(json.dumps({"symmetries_discrete": turns}))
    assert len(parse_symmetry([str(path)], centre=[0, 0, 0]).discrete) == 59
