"""Small sets: all pairs are matched where the usual pairs leave images out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from std_toolkit.cli.main import main
from std_toolkit.options import PoseOptions
from std_toolkit.poses.pose_step import estimate_poses
from std_toolkit.poses.small_sets import _near, rank_model
from std_toolkit.scene import Scene
from tests.std_toolkit.poses.conftest import Recording, make_recording
from tests.std_toolkit.poses.test_estimate_poses import check_against_truth


class Model:
    """The part of a pycolmap.Reconstruction that is ranked."""

    def __init__(self, images: int, error: float) -> None:
        self.images, self.error = images, error

    def num_reg_images(self) -> int:
        return self.images

    def compute_mean_reprojection_error(self) -> float:
        return self.error


def test_more_images_rank_before_a_lower_error() -> None:
    models = [Model(5, 0.2), Model(7, 0.9), Model(7, 0.4)]
    assert max(models, key=rank_model) is models[2]


def test_the_last_image_of_a_ring_is_a_neighbour_of_the_first() -> None:
    assert [i for i in range(16) if _near(0, i, 16)] == [0, 1, 2, 14, 15]


@pytest.mark.slow
@pytest.mark.long
def test_images_in_an_arbitrary_order_are_all_registered(tmp_path: Path) -> None:
    """Pairs of neighbours in time are pairs of distant views here."""
    ordered = make_recording(7, arc_deg=240, seed=4)
    order = (0, 3, 6, 1, 4, 2, 5)
    shuffled = Recording(*([x[i] for i in order] for x in vars(ordered).values()))
    scene = shuffled.write(tmp_path / "scene", depth=False)
    few: dict[str, Any] = {
        "scale": "none",
        "threads": 1,
        "max_features": 1500,
        "overlap": 1,
        "loops": 0,
    }
    without = estimate_poses(scene, PoseOptions(small_set=0, **few))
    poses = estimate_poses(scene, PoseOptions(**few))
    registered = [sum(p.status == "registered" for p in x.frames) for x in (without, poses)]
    assert registered[0] < 7 == registered[1]
    assert poses.gates[-1].name == "matches_explained" and poses.gates[-1].passed
    check_against_truth(scene, shuffled.truth, metric=np.inf)


@pytest.mark.real
@pytest.mark.slow
@pytest.mark.long
def test_more_than_six_images_of_the_dino_ring(test_data: Path, tmp_path: Path) -> None:
    folder = test_data / "dino_ring"
    words = ["--quiet", "import", "--color", str(folder / "*.png"), "--off-centre"]
    words += ["--intrinsics", "3310.4,3325.5,316.73,200.55", "--out", str(tmp_path / "scene")]
    assert main(words) == 0
    scene = Scene.open(tmp_path / "scene")
    poses = estimate_poses(scene, PoseOptions(scale="none", threads=1))
    errors = [p.reprojection_px for p in poses.frames if p.reprojection_px is not None]
    assert sum(p.status == "registered" for p in poses.frames) > 6
    assert np.median(errors) < 1
