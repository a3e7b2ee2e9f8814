"""The two cameras above the table: seeded, and alike in what they cannot measure."""

import numpy as np
import pytest

from benchmark.data.frame import BACKGROUND, Material
from benchmark.tabletop.arrange import Arrangement
from benchmark.tabletop.sense import HEIGHT, WIDTH, make_camera
from std_toolkit.errors import ToolkitError
from tests.benchmark.tabletop.clearing_cases import box, standing, table_object

GLASS, STEEL = box((0.05, 0.05, 0.12), "glass"), box((0.06, 0.06, 0.05), "steel")
ARRANGEMENT = Arrangement(
    7,
    (table_object(GLASS, 0, "transparent"), table_object(STEEL, 1, "specular")),
    (standing(GLASS, x=-0.1), standing(STEEL, x=0.1)),
)


def _look(kind: str, attempt: int = 0, *, color: bool = False):
    camera = make_camera(kind, ARRANGEMENT)
    return camera.observe(ARRANGEMENT.objects, ARRANGEMENT.poses, attempt, color=color)


@pytest.mark.slow
def test_the_quick_camera_is_seeded_by_round_and_attempt():
    first, again, later = _look("quick"), _look("quick"), _look("quick", 1)
    assert first.frame.depth_raw.tobytes() == again.frame.depth_raw.tobytes()
    assert not np.array_equal(first.frame.depth_raw, later.frame.depth_raw)
    frame = first.frame
    assert frame.depth_raw.shape == (HEIGHT, WIDTH)
    assert [i.material for i in frame.instances] == [Material.TRANSPARENT, Material.SPECULAR]
    # How much of an object is lost stays with it for the round.
    lost = [
        (observe.frame.depth_raw[observe.frame.mask == 0] == 0).mean() for observe in (first, later)
    ]
    assert lost[0] == pytest.approx(lost[1], abs=0.01)
    # All but a thin line of each edge is the table itself.
    table = frame.mask == BACKGROUND
    measured = table & (frame.depth_raw > 0)
    assert (np.abs(frame.depth_raw - frame.depth_true)[measured] < 0.01).mean() > 0.9


def test_another_camera_is_refused():
    with pytest.raises(ToolkitError, match="no such camera"):
        make_camera("blurred", ARRANGEMENT)


@pytest.mark.slow
def test_the_simulator_stands_where_the_quick_camera_does():
    pytest.importorskip("mitsuba")
    quick, simulated = _look("quick", color=True), _look("simulated", color=True)
    assert quick.frame.color.shape == simulated.frame.color.shape == (HEIGHT, WIDTH, 3)
    # One scene, light and exposure: they differ by noise alone.
    apart = quick.frame.color.astype(int) - simulated.frame.color.astype(int)
    assert np.abs(apart).mean() < 6
    depth, true = simulated.frame.depth_raw, simulated.frame.depth_true
    right = (depth > 0) & (np.abs(depth - true) < 0.01)
    table = simulated.frame.mask == BACKGROUND
    assert right[table].mean() > 0.75
    # Hazy plastic returns part of the projector's light from its surface.
    assert right[simulated.frame.mask == 0].mean() < right[table].mean() - 0.2


def test_glass_in_pictures_shows_what_is_behind_it() -> None:
    from benchmark.evaluation.tasks.grasp_pictures import through_glass

    stripes = np.where(np.arange(60) // 10 % 2, 220.0, 60.0)[None, :, None] + np.zeros((40, 1, 3))
    facing = np.broadcast_to(np.float32([0, 0, -1]), (40, 60, 3))
    seen = through_glass(stripes, facing)
    assert np.allclose(seen, stripes * [0.93, 0.97, 0.98], atol=1)
    # Slanted, it shows another place; at its edge it mirrors what is bright.
    aslant = np.broadcast_to(np.float32([0.6, 0, -0.8]), (40, 60, 3))
    assert (np.abs(through_glass(stripes, aslant) - seen)[..., 0] > 60).mean() > 0.2
    edge = np.broadcast_to(np.float32([1, 0, 0]), (40, 60, 3))
    assert through_glass(stripes, edge).min() > 200
