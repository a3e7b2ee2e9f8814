"""In which unit a mesh file is, as far as its size tells."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh

from annotator.app.mesh_import import measure_mesh
from std_toolkit.errors import ToolkitError


def box(folder: Path, *extents: float) -> Path:
    path = folder / "box.ply"
    trimesh.creation.box(extents).export(path)
    return path


def test_metres_are_taken_where_they_can_be_meant(tmp_path: Path) -> None:
    size = measure_mesh(box(tmp_path, 0.06, 0.04, 0.1))
    assert size.units == ("m",)
    assert size.in_mm("m") == pytest.approx((60, 40, 100))


def test_the_likeliest_of_other_units_comes_first(tmp_path: Path) -> None:
    size = measure_mesh(box(tmp_path, 66.0, 66.0, 122.0))
    assert size.units[0] == "mm"
    assert "m" not in size.units
    assert size.extents == pytest.approx((66, 66, 122), rel=1e-5)
    assert size.in_mm("mm") == pytest.approx((66, 66, 122), rel=1e-5)
    assert measure_mesh(box(tmp_path, 12.0, 8.0, 20.0)).units[0] == "cm"


@pytest.mark.parametrize("edge", [1e-7, 1e6])
def test_what_lies_on_no_table_in_any_unit_is_refused(tmp_path: Path, edge: float) -> None:
    with pytest.raises(ToolkitError, match=r"box\.ply.*no object on a table"):
        measure_mesh(box(tmp_path, edge, edge, edge))


def test_a_file_that_is_no_mesh_is_named(tmp_path: Path) -> None:
    path = tmp_path / "bad.obj"
    path.write_text("nothing")
    with pytest.raises(ToolkitError, match=r"bad\.obj"):
        measure_mesh(path)
