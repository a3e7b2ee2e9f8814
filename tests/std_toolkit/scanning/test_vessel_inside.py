"""The inside of a vessel: stated by the user, or guessed and called so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.options import ScanOptions
from std_toolkit.scanning.vessel.inside import StatedInside, with_inside
from std_toolkit.scanning.vessel.revolved_surface import RevolvedSurface
from tests.std_toolkit.scanning.vessels import WHISKY, WHISKY_INSIDE, WINE, surface_of, turned


def floor_mm(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Height above the table at which a fall beside the axis from above ends."""
    down = np.array([[1.3e-3, 2.1e-3, 1.0, 0, 0, -1.0]], np.float32)
    return 1000 * (1 - float(RayCaster(vertices, faces).cast(down).distance[0]))


def stated(found: RevolvedSurface, **values: float) -> RevolvedSurface:
    return with_inside(found, [], StatedInside(**values))


@pytest.mark.parametrize(
    "values", [{"base_mm": 22.0}, {"depth_mm": 70.0}, {"base_mm": 22.0, "depth_mm": 71.5}]
)
def test_stated_base_is_that_of_the_mesh(values: dict[str, float]) -> None:
    true = turned(WHISKY, WHISKY_INSIDE)
    assert floor_mm(true.vertices, true.faces) == pytest.approx(22, abs=0.05)
    found = stated(surface_of(WHISKY), wall_mm=2.8, **values)
    vertices, faces = found.mesh()
    assert floor_mm(vertices, faces) == pytest.approx(22, abs=0.05)
    mesh = trimesh.Trimesh(vertices, faces)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(true.volume, rel=0.08)
    assert found.facts["base"] == "22.0 mm, stated by the user"
    assert found.facts["inside depth"] == "70.0 mm, stated by the user"
    assert found.facts["wall"] == "2.8 mm, stated by the user"
    assert found.warnings == ()


def test_a_guess_is_called_one_and_names_the_options() -> None:
    found = stated(surface_of(WHISKY), wall_mm=4)
    assert found.facts["base"] == "8.0 mm, guessed"
    assert floor_mm(*found.mesh()) == pytest.approx(8, abs=0.05)
    assert len(found.warnings) == 1
    assert "base is a guess, 8 mm" in found.warnings[0]
    assert "--base-mm or --inside-depth-mm" in found.warnings[0]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"base_mm": 91.0}, "--base-mm: is not in the vessel, which is 92.0 mm"),
        ({"depth_mm": 92.0}, "--inside-depth-mm: is not in the vessel, which is 92.0 mm"),
        ({"depth_mm": 1.0}, "--inside-depth-mm: is not in the vessel, which is 92.0 mm"),
        ({"base_mm": 22.0, "depth_mm": 60.0},
         "--inside-depth-mm: with --base-mm 22 makes 82.0 mm, but the vessel is 92.0 mm high"),
    ],
)  # fmt: skip
def test_values_that_the_vessel_contradicts(values: dict[str, float], words: str) -> None:
    with pytest.raises(ToolkitError) as caught:
        stated(surface_of(WHISKY), wall_mm=2.8, **values)
    assert str(caught.value).startswith(words)
    assert f"(got {list(values.values())[-1]})" in str(caught.value)
    assert caught.value.hint
    assert "\n" not in str(caught.value)


def test_the_inside_of_a_stemmed_glass_ends_in_its_bowl() -> None:
    found = stated(surface_of(WINE), wall_mm=1.2)
    assert 0.070 < found.stem_end_m < 0.082
    assert 78 < floor_mm(*found.mesh()) < 86
    assert trimesh.Trimesh(*found.mesh()).is_watertight
    exact = stated(surface_of(WINE), wall_mm=1.2, depth_mm=108.0)
    assert floor_mm(*exact.mesh()) == pytest.approx(82, abs=0.05)
    with pytest.raises(
        ToolkitError, match=r"--base-mm: the vessel is narrower than two walls of 5"
    ):
        stated(surface_of(WINE), wall_mm=5, base_mm=10.0)


def test_a_waist_is_no_stem() -> None:
    assert surface_of(WHISKY).stem_end_m == 0
    waist = surface_of([(26, 0), (18, 30), (30, 90)])
    assert waist.stem_end_m == 0


@pytest.mark.parametrize("option", ["--base-mm", "--inside-depth-mm"])
def test_only_with_revolve(option: str) -> None:
    values = {option[2:].replace("-", "_"): 22.0}
    options = {"photos": Path("photos"), "out": Path("cup"), "board": Path("board.json")}
    with pytest.raises(ToolkitError, match=rf"{option}: is of a vessel scanned with --revolve"):
        ScanOptions(**options, **values)
    assert ScanOptions(**options, revolve=True, **values).revolve
