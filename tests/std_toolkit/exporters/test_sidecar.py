"""Sidecars from elsewhere are input like any other: they cannot name files outside the export."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from scene_factory import SERIAL, make_scene

from std_toolkit.errors import ToolkitError
from std_toolkit.exporters import export_scene
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.options import ImportRequest


@pytest.fixture(scope="module")
def exports(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("sidecar")
    scene = make_scene(folder / "scene", frames=1, size=(64, 48))
    for name in ("std", "bop", "nocs"):
        export_scene(scene, name, folder / name, jobs=SERIAL)
    return folder


def at(*keys, value):
    def change(document):
        for key in keys[:-1]:
            document = document[key]
        document[keys[-1]] = value

    return change


HOSTILE = {
    "folder outside": (at("folder", value="../../etc"), "folder"),
    "absolute folder": (at("folder", value="/etc"), "folder"),
    "stem outside": (at("frames", 0, "stem", value="../../../etc/passwd"), "stem|unavailable"),
    "frame name": (at("frames", 0, "name", value="../../x"), "name"),
    "model path": (at("models", 0, "path", value="../../../etc/passwd"), "path"),
    "mesh path": (at("objects", "models", 0, "mesh", value="/etc/passwd"), "mesh"),
    "model id": (at("objects", "models", 0, "id", value="../x"), "id"),
    "unknown model": (at("models", 0, "model", value="ghost"), "ghost"),
    "no model": (at("models", value=[]), "model"),
    "scale zero": (at("models", 0, "metres_per_unit", value=0), "metres_per_unit"),
    "scale of kilometres": (at("models", 0, "metres_per_unit", value=1e4), "implausibly|model"),
    "no camera": (at("scene", "cameras", value={}), "camera"),
    "camera of another size": (at("scene", "cameras", "color", "cx", value=400.0), "cx"),
    "unknown camera": (at("frames", 0, "camera", value="left"), "camera|left"),
    "pose that is none": (at("labels", "labels", 0, "T_world_obj", value=[2.0] * 16), "pose|row"),
    "label of a stranger": (at("labels", "labels", 0, "object", value=99), "object"),
    "surprise": (at("surprise", value=1), "surprise"),
    "another version": (at("format_version", value=2), "format_version"),
    "frames twice": (
        lambda d: d["frames"].append(d["frames"][0]), "appears twice|unique|exists|rising",
    ),
    "garbage": (None, "JSON"),
}  # fmt: skip
# BOP's own documents tell these, not the sidecar.
NOT_FOR_BOP = {
    "stem outside", "no camera", "camera of another size", "unknown camera", "frames twice",
    "scale zero", "scale of kilometres", "model path",
}  # fmt: skip


CASES = [
    (name, case)
    for name in ("std", "bop", "nocs")
    for case in HOSTILE
    if name != "bop" or case not in NOT_FOR_BOP
]


@pytest.mark.parametrize(("name", "case"), CASES)
def test_hostile_sidecars_are_one_line(exports, tmp_path, name, case):
    change, problem = HOSTILE[case]
    shutil.copytree(exports / name, tmp_path / "export")
    path = tmp_path / "export/std_toolkit.json"
    if change is None:
        path.write_text('{"format":')
    else:
        document = json.loads(path.read_text())
        change(document)
        path.write_text(json.dumps(document))
    before = sorted(tmp_path.rglob("*"))
    request = ImportRequest(source=tmp_path / "export", name="x")
    with pytest.raises(ToolkitError, match=problem) as error:
        import_recording(request, tmp_path / "scene", format_name=name)
    assert "\n" not in str(error.value)
    assert ".tmp" not in str(error.value)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("name", ["std", "bop", "nocs"])
def test_missing_and_damaged_files_of_an_export_are_named(exports, tmp_path, name):
    shutil.copytree(exports / name, tmp_path / "export")
    request = ImportRequest(source=tmp_path / "export", name="x")
    patterns = ("*_mask.png", "models/*.ply", "*.obj", "*.exr")
    found = [sorted((tmp_path / "export").rglob(p)) for p in patterns]
    victims = [paths[0] for paths in found if paths]
    assert victims
    for victim in victims:
        content = victim.read_bytes()
        victim.write_bytes(content[: len(content) // 3])
        with pytest.raises(ToolkitError) as error:
            import_recording(request, tmp_path / "scene", format_name=name)
        assert "\n" not in str(error.value)
        assert not (tmp_path / "scene").exists()
        victim.write_bytes(content)
    assert import_recording(request, tmp_path / "scene", format_name=name).frames


def test_the_sidecar_of_an_export_does_not_tell_of_what_was_put_below_it(exports, tmp_path):
    shutil.copytree(exports / "std", tmp_path / "std")
    stranger = tmp_path / "std/other_scene"
    shutil.copytree(tmp_path / "std/bench_7", stranger)
    request = ImportRequest(source=stranger, name="x", intrinsics="70.4,53.76,34.3,22.4")
    scene = import_recording(request, tmp_path / "scene")
    assert scene.poses is None  # as of any download
