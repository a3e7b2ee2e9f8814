"""Objects of a frame by material, category and whether they are distractors."""

from __future__ import annotations

import doctest
from pathlib import Path

import numpy as np
import pytest
from dreds_on_disk import Drawn, write_dreds_scene

from benchmark.data import frame as selection
from benchmark.data.frame import DepthFrame, Material, Selection, selection_of
from benchmark.data.splits import open_split
from std_toolkit.errors import ToolkitError


@pytest.fixture(scope="module")
def frame_and_truth(tmp_path_factory) -> tuple[DepthFrame, Drawn]:
    top: Path = tmp_path_factory.mktemp("dreds")
    drawn = write_dreds_scene(top / "DREDS-CatKnown/test/00000", frames=1)
    return open_split("dreds-catknown-test", top).load(0), drawn[0]


@pytest.mark.parametrize(
    ("chosen", "ids"),
    [
        (Selection(), [1, 2, 3, 4]),
        (Selection(distractors=False), [1, 2, 3]),
        (Selection(frozenset({Material.TRANSPARENT, Material.SPECULAR})), [1, 2]),
        (Selection(frozenset({Material.RAW})), [4]),
        (Selection(frozenset({Material.RAW}), distractors=False), []),
        (Selection(categories=frozenset({"mug", "camera"})), [2, 3]),
        (Selection(frozenset({Material.DIFFUSE}), frozenset({"mug"})), []),
        (selection_of(materials=["specular"], categories=["mug"], distractors=True), [2]),
    ],
)
def test_selected_pixels(frame_and_truth, chosen: Selection, ids: list[int]) -> None:
    frame, drawn = frame_and_truth
    np.testing.assert_array_equal(chosen.mask(frame), np.isin(drawn.mask, ids))


def test_names_that_mean_nothing() -> None:
    with pytest.raises(ToolkitError, match=r"no such material.*glass.*transparent"):
        selection_of(materials=["glass"], distractors=True)
    with pytest.raises(ToolkitError, match=r"no such category.*plate.*bottle"):
        selection_of(categories=["plate"], distractors=True)


@pytest.mark.slow
def test_the_examples_of_the_documentation() -> None:
    tried = doctest.testmod(selection)
    assert tried.attempted > 0
    assert tried.failed == 0
