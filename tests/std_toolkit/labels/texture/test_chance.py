"""A texture is confirmed clearly above random ones, and missed where a strong one is not there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from realsense_ycb import load_frame, texture_of
from textured_views import POSE, box_mesh, box_object, cameras, photos, textured_picture

from std_toolkit.geometry import SE3, Symmetry, so3_exp
from std_toolkit.geometry.turned_surface import turn_about
from std_toolkit.labels.texture.comparison import TextureComparison, compare_texture
from std_toolkit.labels.texture.scores import chance_scores, cut_window, score_view
from std_toolkit.rendering.texture import TexturedSurface

# Names of objects in the frames, and what is wrong with them.
DRILL, CRACKERS, SUGAR = "035_power_drill", "003_cracker_box", "004_sugar_box"


def test_random_textures_score_less_than_the_right_one_and_like_a_wrong_one() -> None:
    mesh = box_mesh(textured_picture(3))
    (view,) = photos(mesh, POSE, where=cameras(3)[1:2])
    right, wrong = (TexturedSurface.from_mesh(box_mesh(textured_picture(s))) for s in (3, 4))
    assert right is not None and wrong is not None
    window = cut_window(view, right, POSE, [])
    assert window is not None
    chance = chance_scores(window, right, POSE, count=6)
    scores = [score_view(window, surface, POSE) for surface in (right, wrong)]
    assert scores[0] is not None and scores[1] is not None
    assert len(chance) == 6
    assert scores[0].value > max(chance) + 0.3
    assert scores[1].value < max(chance) + 0.05
    assert chance == chance_scores(window, right, POSE, count=6)


@pytest.mark.slow
def test_the_texture_of_another_product_is_missed() -> None:
    views = photos(box_mesh(textured_picture(3)), POSE)
    found = compare_texture(views, box_object(box_mesh(textured_picture(4)), POSE))
    assert found.verdict == "other"
    assert found.score < found.chance
    assert "another product, or the label is elsewhere" in found.sentence()


@pytest.mark.slow
def test_a_texture_beside_its_object_is_missed() -> None:
    mesh = box_mesh(textured_picture(3))
    beside = SE3(POSE.R, POSE.t + np.array([0.06, 0.0, 0.0]))
    found = compare_texture(photos(mesh, POSE), box_object(mesh, beside))
    assert found.verdict == "other"


@pytest.mark.slow
def test_one_frame_alone_misses_nothing() -> None:
    """It may be blurred, or something unknown hides the object."""
    views = photos(box_mesh(textured_picture(3)), POSE, where=cameras(3)[1:2])
    found = compare_texture(views, box_object(box_mesh(textured_picture(4)), POSE))
    assert found.verdict == "undecided"
    assert found.chance > found.score


def test_an_undecided_comparison_names_a_rival_that_leads_and_what_decides() -> None:
    found = TextureComparison(
        "undecided", SE3.identity(), "turned by 180 deg about z", 0.15, 0.27, 8, 0.2, (30, 34, 38)
    )
    assert found.rival_leads
    assert found.sentence() == (
        "turned by 180 deg about z scores 0.27 against 0.15: look at the label in frames 30 to 38"
    )
    unseen = replace(found, telling=())
    assert unseen.sentence().endswith("0.15: photograph the other side")
    alone = TextureComparison("undecided", None, "", 0.25, float("nan"), 1, 0.4)
    assert not alone.rival_leads
    assert "scores 0.25, and a random one up to 0.40" in alone.sentence()


def _in_frame(data: Path, index: int, name: str, *, half: bool = False) -> TextureComparison:
    if not (data / "realsense_ycb_frames").is_dir():
        pytest.skip("realsense_ycb_frames not found")
    frame = load_frame(data, index)
    k = [o.name for o in frame.objects].index(name)
    obj = frame.objects[k]
    pose = obj.T_world_obj
    if half:
        pose = pose @ turn_about(obj.centre, so3_exp([0, 0, np.pi]))
    obj = replace(obj, texture=texture_of(data, name), symmetry=Symmetry(), T_world_obj=pose)
    return compare_texture([frame.view], obj, frame.objects[:k] + frame.objects[k + 1 :])


@pytest.mark.slow
@pytest.mark.real
def test_a_drill_half_a_turn_wrong_does_not_fit(test_data: Path) -> None:
    """It scores 0.25 and has no rival, but so do random patches of its colours."""
    found = _in_frame(test_data, 3, DRILL, half=True)
    assert found.verdict == "undecided"
    assert 0.2 < found.score < found.chance


@pytest.mark.slow
@pytest.mark.real
def test_sugar_does_not_fit_where_crackers_are(test_data: Path) -> None:
    if not (test_data / "realsense_ycb_frames").is_dir():
        pytest.skip("realsense_ycb_frames not found")
    frame = load_frame(test_data, 0)
    names = [o.name for o in frame.objects]
    crackers, sugar = (frame.objects[names.index(n)] for n in (CRACKERS, SUGAR))
    texture = texture_of(test_data, SUGAR)
    assert texture is not None
    scale = np.ptp(crackers.vertices, axis=0) / np.ptp(sugar.vertices, axis=0)
    vertices = (sugar.vertices - sugar.centre) * scale + crackers.centre
    wrong = TexturedSurface(vertices, sugar.faces, texture.colors)
    others = [o for o in frame.objects if o is not crackers]
    placed = replace(crackers, texture=wrong, symmetry=Symmetry())
    # The same view twice: one frame alone misses nothing.
    again = replace(frame.view, frame=9)
    found = compare_texture([frame.view, again], placed, others)
    assert found.verdict in ("other", "undecided")
    assert found.score < found.chance
