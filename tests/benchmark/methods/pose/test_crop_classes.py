"""Classes of objects whose masks come from another network, judged by crop NOCS."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

from benchmark.methods.pose.segmented import Segmented
from benchmark.methods.protocol import PoseView
from benchmark.methods.registry import MethodOptions, make_pose_method
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

CAMERA = Camera(128, 96, 120.0, 120.0, 63.5, 47.5)


def a_view() -> PoseView:
    rng = np.random.default_rng(0)
    depth = np.full((96, 128), 0.8, np.float32)
    depth[30:60, 40:70] = 0.7
    color = rng.integers(0, 255, (96, 128, 3)).astype(np.uint8)
    return PoseView(color, depth, depth, CAMERA)


class Segmenter:
    """Two objects, about whose classes it is not sure; the second is too small for a crop."""

    def segment(self, views):
        masks = np.zeros((2, 96, 128), bool)
        masks[0, 30:60, 40:70] = True
        masks[1, :3, :3] = True
        chances = np.array(
            [[0.2, 0.3, 0.25, 0.05, 0.05, 0.05, 0.05, 0.05], [0.5, 0.1, 0.4, 0, 0, 0, 0, 0]]
        )
        one = Segmented(np.array([1, 2]), np.array([0.3, 0.4]), masks, chances)
        return [one.of(np.array([1, 0])) for _ in views]


def segmented(**settings: str) -> Segmented:
    options = MethodOptions(preset="compact", settings={"masks": "true", **settings})
    method = make_pose_method("crop-nocs", options)
    method._segmenter = Segmenter()
    (found,) = method._segmented([a_view()])
    return found


def test_without_trust_classes_are_those_of_the_masks():
    found = segmented(trust="0")
    assert found.class_ids.tolist() == [2, 1]
    assert found.scores.tolist() == [0.4, 0.3]


def test_an_object_is_of_no_class_as_likely_as_before():
    found = segmented(trust="6")
    assert found.chances is not None
    small, large = (found.chances[found.masks.sum(axis=(1, 2)) == area] for area in (9, 900))
    assert small.tolist() == [[0.5, 0.1, 0.4, 0, 0, 0, 0, 0]]
    assert large[0, 0] == pytest.approx(0.2)
    assert large[0, 1:].sum() == pytest.approx(0.8)
    assert abs(large[0] - [0.2, 0.3, 0.25, *[0.05] * 5]).max() > 0.01
    assert found.scores.tolist() == sorted(found.scores, reverse=True)


def test_offsets_favour_categories():
    found = segmented(trust="1e-9", offsets="0,0,0,0,30,0,0")
    large = found.masks.sum(axis=(1, 2)) == 900
    assert found.class_ids[large].tolist() == [5]
    assert found.scores[large].tolist() == [pytest.approx(0.8)]


def test_offsets_of_another_number_are_refused():
    with pytest.raises(ToolkitError, match=r"offsets: must be as many as categories, 7"):
        segmented(offsets="1,2")
