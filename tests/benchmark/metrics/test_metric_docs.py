"""Public functions of metrics and protocols are documented in full."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from types import ModuleType

import pytest

import benchmark.metrics

NAMES = [
    module.name
    for module in pkgutil.walk_packages(benchmark.metrics.__path__, "benchmark.metrics.")
]
NEVER_RAISE = {
    "as_real",
    "band_width",
    "boxes_meet_triangles",
    "category_of",
    "cut_holes",
    "detection_intervals",
    "edge_band",
    "even_points",
    "filled_share",
    "flip_test",
    "found_of",
    "friction_scores",
    "hits_mesh",
    "hits_plane",
    "holm",
    "largest_distance",
    "lowest_points",
    "model_paths",
    "most_estimates",
    "namespace",
    "needed_friction",
    "pinhole",
    "pair_sums",
    "precision_at",
    "right_pixels",
    "right_without_truth",
    "ring_stretch",
    "score_sensor",
    "seal_at",
    "seconds_per_image",
    "selective_errors",
    "shown_columns",
    "spread_coverage",
    "suppress_similar",
    "tolerance",
    "usable",
    "voxel_means",
}


def imported(name: str) -> ModuleType:
    if name.endswith("_torch"):
        pytest.importorskip("torch")
    return importlib.import_module(name)


@pytest.mark.parametrize("name", NAMES)
def test_public_functions_say_what_they_take_and_give(name: str) -> None:
    module = imported(name)
    functions = [
        f
        for key, f in inspect.getmembers(module, inspect.isfunction)
        if f.__module__ == name and not key.startswith("_")
    ]
    for function in functions:
        text, signature = function.__doc__ or "", inspect.signature(function)
        if not signature.parameters:
            continue
        assert ">>>" in text, function
        assert "Args:" in text, function
        assert "Raises:" in text or function.__name__ in NEVER_RAISE, function
        assert "Returns:" in text or signature.return_annotation in (None, "None"), function
