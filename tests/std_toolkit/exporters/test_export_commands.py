"""import, info, export and schema as a user types them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scene_factory import make_scene

from std_toolkit.cli.main import main
from std_toolkit.io.images import write_color


def test_from_images_to_scene_and_what_comes_next(tmp_path, capsys):
    for i in range(3):
        write_color(tmp_path / f"c/{i}.png", np.full((48, 64, 3), 90, np.uint8))
    out = tmp_path / "scene"
    arguments = ["import", "--color", str(tmp_path / "c"), "--intrinsics", "70,71,31.5,23.5"]
    assert main([*arguments, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert f"std-curate poses {out}" in text
    assert "64x48" in text
    assert main(["info", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 3
    assert main([*arguments, "--out", str(out)]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ["import", "--out", "x"],
        ["import", "a", "--color", "b", "--out", "x"],
        ["import", "nothing-here", "--out", "x"],
        ["import", ".", "--out", "x"],
        ["import", ".", "--format", "exotic", "--out", "x"],
        ["import", "--color", ".", "--intrinsics", "1,1,1,1", "--out", "x"],
        ["import", "--color", ".", "--out", "x", "--depth-correction", "5"],
        ["import", "--color", ".", "--out", "x", "--name", "../y"],
        ["info", "."],
        ["export", ".", "--format", "std", "--out", "x"],
        ["schema", "exotic"],
    ],
)
def test_wrong_commands_are_one_line(arguments, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_info_of_a_finished_scene(tmp_path, capsys):
    scene = make_scene(tmp_path / "scene", frames=2, unregistered=[1])
    assert main(["info", str(scene.root)]) == 0
    text = capsys.readouterr().out
    for part in ("1 of 2 frames registered", "metres from board", "3 of 3 objects labelled"):
        assert part in text
    assert f"std-curate check {scene.root}" in text
    (scene.root / "color/view_1.png").unlink()
    main(["info", str(scene.root)])
    assert "MISSING" in capsys.readouterr().out


def test_export_and_import_again(tmp_path, capsys):
    scene = make_scene(tmp_path / "scene", frames=2, unregistered=[1])
    out = str(tmp_path / "bop")
    assert main(["export", str(scene.root), "--format", "bop", "--out", out]) == 0
    text = capsys.readouterr().out
    assert "1 frames, 3 models" in text
    assert "skipped 1 frames without ground truth" in text
    assert main(["import", out, "--out", str(tmp_path / "again")]) == 0
    options = ["--label-size", "80by60"]
    assert main(["export", str(scene.root), "--format", "std", "--out", out, *options]) == 2
    assert "a size such as 1280x720" in capsys.readouterr().err


def test_schema_prints_and_writes(tmp_path, capsys):
    assert main(["schema", "scene"]) == 0
    assert json.loads(capsys.readouterr().out)["$schema"].endswith("2020-12/schema")
    assert main(["schema", "--out", str(tmp_path / "s")]) == 0
    assert (tmp_path / "s/poses.schema.json").is_file()
    assert main(["schema"]) == 0
