"""Labels that are turned wrongly, of shapes of which most looks the same after the turn."""

from __future__ import annotations

import numpy as np
import pytest
from fault_table import FaultCase, Study

from sensors.synthetic.kinds import JUDGING, kind_named
from sensors.synthetic.world_scene import draw_world
from std_toolkit.checks.inject.faults import Fault, apply_fault
from std_toolkit.checks.measure.textures import compare_textures
from std_toolkit.geometry import SE3, Symmetry, rotation_error, so3_exp
from std_toolkit.labels.texture.alternatives import NearSymmetry
from std_toolkit.labels.texture.comparison import TextureComparison
from std_toolkit.scene import Scene

UP = (0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def bracket(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """One bracket of two arms, untextured; a half turn exchanges the long arm and the short one."""
    world = draw_world(565, JUDGING, frames=6, sensor="colour")
    (thing,) = [t for t in world.things() if t.labelled]
    assert (thing.kind.name, thing.look) == ("bracket", "bare")
    return world.scene(tmp_path_factory.mktemp("bracket"))


def _compared(scene: Scene) -> TextureComparison:
    (found,) = compare_textures(scene, scene.registered_frames()).values()
    return found.comparison


@pytest.mark.slow
def test_a_half_turn_that_fits_for_the_most_part_is_wrong(bracket: Scene) -> None:
    (thing,) = bracket.objects.objects
    right = bracket.T_world_obj(thing.id)
    assert right is not None
    study = Study(bracket)
    (item,) = study.report(FaultCase("right", "pass", bracket, frames=())).objects
    assert item.verdict == "fits"
    turned = apply_fault(bracket, Fault("turn", 180.0, thing.id, up=UP))
    case = FaultCase("half turn", "fail", turned, objects=(thing.id,))
    (item,) = study.report(case).objects
    assert item.verdict == "wrong"
    assert [f.gate for f in item.gates if f.verdict == "wrong"] == ["texture"]
    found = _compared(turned)
    assert (found.verdict, found.by_contour, found.rival_leads) == ("turned", True, True)
    assert found.sentence().endswith("fits the contour better")
    # The turn leads back to the object.
    label = turned.T_world_obj(thing.id)
    assert label is not None and found.turn is not None
    back = label @ found.turn
    centre = np.asarray(bracket.mesh(thing.model).bounds).mean(axis=0)
    assert np.linalg.norm(back @ centre - right @ centre) < 0.002
    assert np.rad2deg(rotation_error(back, right)) < 1.5


@pytest.mark.slow
def test_small_errors_of_a_right_turn_are_no_turns(bracket: Scene) -> None:
    (thing,) = bracket.objects.objects
    off = apply_fault(bracket, Fault("along", 4.0, thing.id, along=(1.0, 0.0, 0.0)))
    assert _compared(off).verdict == "undecided"
    assert not _compared(off).rival_leads


def test_turns_after_which_most_of_a_silhouette_is_the_same() -> None:
    mesh = kind_named("bracket").mesh(np.random.default_rng(3))
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    away = [SE3(so3_exp([0.7, 0.5, 0.0]), np.array([0.0, 0.0, 4 * size]))]
    near = NearSymmetry(vertices, faces)
    found = near.similar(away)
    assert found
    # A symmetry that the model declares is no alternative.
    half = [a for a in found if a.text.startswith("turned by 180 deg")]
    declared = Symmetry(discrete=tuple(tuple(a.turn.flat()) for a in half[:1]))
    left = NearSymmetry(vertices, faces, declared).similar(away)
    assert half[0].text not in [a.text for a in left]


def test_words_of_a_turn_by_contour() -> None:
    nan = float("nan")
    found = TextureComparison(
        "undecided", SE3.identity(), "turned by 90 deg about z", nan, nan, 6, contour_gain=1.0
    )
    assert found.rival_leads
    assert "fits the contour about as well: photograph the other side" in found.sentence()
