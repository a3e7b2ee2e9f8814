"""What a finished scan says of itself: advice, and meshes that must not be used."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

pytest.importorskip("manifold3d")

from std_toolkit.cli import scanning
from std_toolkit.scanning import scan_step
from std_toolkit.scanning.model.bake import Texture
from std_toolkit.scanning.model.report import write_report
from std_toolkit.scanning.model.write_model import Scan, write_model
from std_toolkit.scanning.options import ScanOptions
from tests.std_toolkit.scanning.ball import CENTRE, RADIUS, ball_views


def written(folder: Path, mesh: trimesh.Trimesh, *, seen: float = 0.8) -> Scan:
    """A finished scan of the photos of the ball with any mesh, and its files."""
    faces = np.asarray(mesh.faces, np.int64)
    count = len(faces)
    uv = np.tile(np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]]), (count, 1, 1))
    shown = (np.arange(count) < seen * count).astype(np.int64)
    texture = Texture(uv, np.full((8, 8, 3), 90, np.uint8), np.zeros((8, 8), bool), shown,
                      np.ones((8, 3)))  # fmt: skip
    scan = Scan(
        name="ball", vertices=np.asarray(mesh.vertices, np.float64), faces=faces, texture=texture,
        supported=np.ones(count, bool), views=ball_views(8), facts={}, warnings=["one warning"],
    )  # fmt: skip
    write_model(folder, "ball", scan.vertices, faces, texture)
    return write_report(folder, scan)


def ball(radius: float = RADIUS) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=radius).apply_translation(CENTRE)


def test_a_good_mesh_has_no_fault(tmp_path: Path) -> None:
    done = written(tmp_path, ball())
    assert list(done.faults) == []
    facts = json.loads((tmp_path / "scan.json").read_text())
    assert facts["usable"] and facts["warnings"][0] == "one warning"
    assert "the mesh is watertight" in (tmp_path / "report.html").read_text()


def test_a_mesh_with_a_hole_is_said_to_be_open(tmp_path: Path) -> None:
    mesh = ball()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    done = written(tmp_path, mesh)
    assert any("not watertight" in fault for fault in done.faults)
    assert "the mesh is not watertight" in (tmp_path / "report.html").read_text()
    assert not json.loads((tmp_path / "scan.json").read_text())["usable"]


def test_a_mesh_of_something_else_must_not_be_used(tmp_path: Path) -> None:
    half = ball(0.6 * RADIUS)
    assert any("not the object" in fault for fault in written(tmp_path, half).faults)
    (tmp_path / "b").mkdir()
    assert any("rest is a guess" in f for f in written(tmp_path / "b", ball(), seen=0.1).faults)


def test_the_command_prints_the_advice_and_ends_with_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = written(tmp_path, ball(0.6 * RADIUS))
    monkeypatch.setattr(scan_step, "scan", lambda _: done)
    options = ScanOptions(photos=tmp_path, out=tmp_path)
    assert scanning.run_scan(options) == 1
    told = capsys.readouterr().err
    # The advice of the page, which looks at single photos.
    assert "warning: the outline of the mesh differs from the mask in 8 photos" in told
    assert "error: the mesh must not be used: its outline overlaps" in told
    monkeypatch.setattr(scan_step, "scan", lambda _: replace(done, faults=()))
    assert scanning.run_scan(options) == 0
