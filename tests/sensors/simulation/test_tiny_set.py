"""The small set that tests of other packages read, and its look to a reader of the layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sensors.output.dreds import SUFFIXES, read_record, scene_folder
from sensors.simulation.set_report import set_statistics
from std_toolkit.importers.foreign_files import read_mask_source
from std_toolkit.importers.std_objects import read_meta
from std_toolkit.io.exr import read_exr_depth

pytestmark = pytest.mark.slow


def test_the_tiny_set_is_whole(tiny_dreds: Path) -> None:
    folder = scene_folder(tiny_dreds, "train", "00000")
    names = {f"{index:04d}{suffix}" for index in range(2) for suffix in SUFFIXES}
    assert {p.name for p in folder.iterdir()} == names
    categories = [o.category for o in read_record(tiny_dreds, "train", "00000").objects]
    assert categories[:3] == ["bottle", "bowl", "mug"] and len(categories) == 4
    found = set_statistics(tiny_dreds)
    assert (found.scenes, found.frames) == (1, 2)


def test_masks_meta_and_depth_of_the_tiny_set_agree(tiny_dreds: Path) -> None:
    folder = scene_folder(tiny_dreds, "train", "00000")
    for index in range(2):
        mask = read_mask_source(folder / f"{index:04d}_mask.exr", size=None)
        ids = {row.mask_id for row in read_meta(folder / f"{index:04d}_meta.txt")}
        assert set(np.unique(mask).tolist()) - {255} <= ids
        exact = read_exr_depth(folder / f"{index:04d}_depth_120.exr")
        assert exact.shape == (90, 160) and (exact > 0).mean() > 0.99
