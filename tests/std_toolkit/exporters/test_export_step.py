"""Exports appear whole or not at all, go on where they stopped, and are the same every time."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from scene_factory import SERIAL, make_scene

from std_toolkit.checks.summary import summarise
from std_toolkit.errors import ToolkitError
from std_toolkit.exporters import EXPORTERS, ExportOptions, export_scene
from std_toolkit.exporters.staging import state_of
from std_toolkit.exporters.std_exporter import StdExporter
from std_toolkit.geometry import SE3
from std_toolkit.io.documents import read_document
from std_toolkit.io.images import read_png, write_png
from std_toolkit.jobs import JobOptions
from std_toolkit.scene import Labels, Scene
from std_toolkit.scene.sidecar import SIDECAR_NAME, Sidecar

FORMATS = ["std", "bop", "nocs"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Scene:
    return make_scene(tmp_path_factory.mktemp("step") / "scene", frames=4)


def content(folder: Path) -> dict[str, str]:
    return {
        p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_same_bytes_wherever_and_however_wide(scene, name, tmp_path):
    export_scene(scene, name, tmp_path / "a", jobs=SERIAL)
    jobs = JobOptions(workers=2, progress=False) if name == "bop" else SERIAL
    export_scene(scene, name, tmp_path / "deeper/b", jobs=jobs)
    assert content(tmp_path / "a") == content(tmp_path / "deeper/b")
    text = "".join(p.read_text() for p in (tmp_path / "a").rglob("*.json"))
    assert str(tmp_path) not in text
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "deeper"]


def test_a_finished_export_is_left_alone(scene, tmp_path, monkeypatch):
    export_scene(scene, "std", tmp_path / "std", jobs=SERIAL)
    times = {p: p.stat().st_mtime_ns for p in (tmp_path / "std").rglob("*")}
    monkeypatch.setattr(StdExporter, "write_frame", None)  # would fail if called
    export_scene(scene, "std", tmp_path / "std", jobs=SERIAL)
    assert times == {p: p.stat().st_mtime_ns for p in (tmp_path / "std").rglob("*")}


def test_an_interrupted_export_goes_on_where_it_stopped(scene, tmp_path, monkeypatch):
    whole = tmp_path / "whole"
    export_scene(scene, "std", whole, jobs=SERIAL)
    write = StdExporter.write_frame
    calls: list[int] = []

    def dies_at_the_third(self, target, frame):
        calls.append(frame.id)
        if len(calls) == 3:
            raise OSError("disk full")
        return write(self, target, frame)

    monkeypatch.setattr(StdExporter, "write_frame", dies_at_the_third)
    with pytest.raises(ToolkitError, match="disk full"):
        export_scene(scene, "std", tmp_path / "std", jobs=SERIAL)
    assert not (tmp_path / "std").exists()
    export_scene(scene, "std", tmp_path / "std", jobs=SERIAL)
    assert calls == [0, 2, 4, 6, 4]  # only the failed frame again
    assert content(tmp_path / "std") == content(whole)


def _export(root: str, out: str) -> None:
    export_scene(Scene.open(root), "bop", out, jobs=SERIAL)


@pytest.mark.slow
def test_a_killed_export_leaves_no_trace_after_the_next_run(scene, tmp_path):
    whole = tmp_path / "whole"
    export_scene(scene, "bop", whole, jobs=SERIAL)
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=_export, args=(str(scene.root), str(tmp_path / "bop")))
    process.start()
    started = time.monotonic()
    progress = tmp_path / ".bop.partial/.progress"
    while time.monotonic() - started < 60 and process.is_alive():
        if progress.is_dir() and any(progress.glob("*.json")):
            break
        time.sleep(0.002)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    (tmp_path / ".bop.partial").mkdir(exist_ok=True)
    (tmp_path / ".bop.partial/stranger.txt").write_text("of another run")
    export_scene(scene, "bop", tmp_path / "bop", jobs=SERIAL, options=ExportOptions(overwrite=True))
    assert content(tmp_path / "bop") == content(whole)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bop", "whole"]


def test_a_damaged_export_is_replaced_on_request_only(scene, tmp_path):
    out = tmp_path / "nocs"
    export_scene(scene, "nocs", out, jobs=SERIAL)
    before = content(out)
    damaged = next(out.rglob("*_mask.png"))
    damaged.write_bytes(b"")
    with pytest.raises(ToolkitError, match="--overwrite"):
        export_scene(scene, "nocs", out, jobs=SERIAL)
    export_scene(scene, "nocs", out, jobs=SERIAL, options=ExportOptions(overwrite=True))
    assert content(out) == before
    assert [p.name for p in tmp_path.iterdir()] == ["nocs"]


def test_overwrite_never_touches_a_folder_that_is_no_export(scene, tmp_path):
    (tmp_path / "thesis.txt").write_text("precious")
    with pytest.raises(ToolkitError, match="not an export"):
        export_scene(scene, "std", tmp_path, options=ExportOptions(overwrite=True))
    assert content(tmp_path).keys() == {"thesis.txt"}


@pytest.mark.parametrize("layout", ["std", "bop", "nocs"])
def test_maps_that_were_changed_are_refused(tmp_path, layout):
    scene = make_scene(tmp_path / "scene", frames=2)
    path = max((scene.root / "gt/mask").iterdir())
    write_png(path, np.full_like(read_png(path), 255))
    told = rf"not what was rendered.*gt/mask/{path.stem}\.png changed"
    with pytest.raises(ToolkitError, match=told):
        export_scene(scene, layout, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_stale_ground_truth_is_refused(tmp_path):
    scene = make_scene(tmp_path / "scene", frames=2)
    labels = scene.labels.labels
    T = SE3.from_matrix(labels[0].T_world_obj)
    moved = SE3(T.R, T.t + np.array([0, 0, 0.001])).flat()
    from msgspec.structs import replace

    scene.save_labels(Labels(labels=[replace(labels[0], T_world_obj=moved), *labels[1:]]))
    with pytest.raises(ToolkitError, match="older than the labels"):
        export_scene(Scene.open(scene.root), "std", tmp_path / "std")
    assert not (tmp_path / "std").exists()
    told = summarise(Scene.open(scene.root))
    assert (told.ground_truth, told.stale_ground_truth) == (0, 2)
    assert told.next_command == f"std-curate render {scene.root}"


def test_a_scene_without_ground_truth_is_refused(tmp_path):
    scene = make_scene(tmp_path / "scene", frames=1, render=False)
    with pytest.raises(ToolkitError, match="std-curate render"):
        export_scene(scene, "bop", tmp_path / "bop")
    assert [p.name for p in tmp_path.iterdir()] == ["scene"]


def test_an_export_cannot_lie_inside_its_scene(scene):
    with pytest.raises(ToolkitError, match="inside its scene"):
        export_scene(scene, "std", scene.root / "export")


def test_the_sidecar_tells_what_the_layouts_cannot(scene, tmp_path):
    sidecar = export_scene(scene, "std", tmp_path / "std", jobs=SERIAL)
    assert sidecar.scene.cameras["color"].fx == scene.info.cameras["color"].fx
    for frame in sidecar.frames:
        T = scene.T_world_cam(frame.id)
        np.testing.assert_allclose(frame.T_world_cam, T.flat(), atol=1e-12)
        for row in frame.objects:
            expected = scene.T_cam_obj(frame.id, row.object).flat()
            np.testing.assert_allclose(row.T_cam_obj, expected, atol=1e-9)
    assert sidecar.poses.scale.chosen == "board"
    assert sidecar.visibility[0].policy == "models"
    files = set(content(tmp_path / "std")) - {"std_toolkit.json"}
    assert files == set(sidecar.files)


def test_a_third_party_exporter_is_found_by_its_path(scene, tmp_path):
    assert EXPORTERS.get("std_toolkit.exporters.std_exporter:STD") is not None
    sidecar = export_scene(
        scene, "std_toolkit.exporters.std_exporter:STD", tmp_path / "x", jobs=SERIAL
    )
    assert sidecar.layout == "std_toolkit.exporters.std_exporter:STD"
    with pytest.raises(ToolkitError, match="known: std, bop, nocs"):
        export_scene(scene, "coco", tmp_path / "y")


def test_an_export_of_other_inputs_is_another(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", frames=1, size=(160, 120))
    export_scene(scene, "nocs", tmp_path / "nocs", jobs=SERIAL)
    out = next((tmp_path / "nocs").rglob(SIDECAR_NAME)).parent
    digest = read_document(out / SIDECAR_NAME, Sidecar).digest
    assert state_of(out, digest) == "same"
    assert state_of(out, "0" * len(digest)) == state_of(out, "f" * len(digest)) == "other"
    assert state_of(tmp_path / "nothing", digest) == "vacant"
