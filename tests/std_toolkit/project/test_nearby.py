"""Scenes that poses may be carried over from."""

from __future__ import annotations

from pathlib import Path

import msgspec

from std_toolkit.project.nearby import nearby_scenes
from std_toolkit.project.record import Project, Rules, create_project
from std_toolkit.project.shared import make_second
from std_toolkit.scene import ObjectTable, Scene
from tests.scene_on_disk import write_scene


def names(root: Path) -> list[str]:
    scene = Scene.open(root)
    return [found.folder.name for found in nearby_scenes(scene.root, scene.objects)]


def test_scenes_beside_it_with_labels_most_common_objects_first(tmp_path: Path) -> None:
    for name, labelled in (("here", True), ("twin", True), ("empty", False), ("another", True)):
        write_scene(tmp_path / name, labelled=labelled)
    other = Scene.open(tmp_path / "another")
    model = msgspec.structs.replace(other.objects.models[0], id="crate")
    item = msgspec.structs.replace(other.objects.objects[0], model="crate")
    other.save_objects(ObjectTable(models=[model], objects=[item]))
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken/scene.json").write_text("{")
    assert names(tmp_path / "here") == ["twin", "another"]
    found = nearby_scenes(tmp_path / "here", Scene.open(tmp_path / "here").objects)
    assert [(s.labelled, s.common) for s in found] == [(1, 1), (1, 0)]


def test_scenes_of_a_project_elsewhere_but_not_the_one_of_a_blind_copy(tmp_path: Path) -> None:
    for name in ("x/one", "y/two", "z/apart"):
        write_scene(tmp_path / name)
    folders = [tmp_path / "x/one", tmp_path / "y/two"]
    project, problems = create_project(tmp_path / "lab", scenes=folders, rules=Rules(twice_every=1))
    assert problems == []
    assert names(tmp_path / "x/one") == ["two"]
    assert names(tmp_path / "z/apart") == []
    project = Project.open(tmp_path / "lab")
    make_second(project, project.record.scenes[0])
    make_second(project, project.record.scenes[1])
    assert names(tmp_path / "lab/second/one") == ["two"]
