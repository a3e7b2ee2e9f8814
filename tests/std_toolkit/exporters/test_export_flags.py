"""Faults that the check found: flags in each layout, and frames left out."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest
from scene_factory import SERIAL, make_scene

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.exporters import ExportOptions, export_scene
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.options import ImportRequest
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.scene import Scene
from std_toolkit.scene.check_flags import SCENE_INPUT, read_check_flags, scene_fingerprint

DROP = ExportOptions(drop_bad_frames=True)


@pytest.fixture()
def scene(tmp_path: Path) -> Scene:
    return Scene.open(make_scene(tmp_path / "scene", frames=4).root)


def write_report(scene: Scene, frames: dict[int, str], objects: dict[tuple[int, int], str]) -> None:
    """A current report with these faults."""
    report = {
        "frames": [{"frame": f.id, "fault": frames.get(f.id, "")} for f in scene.frames],
        "objects": [
            {
                "object": o.id,
                "frames": [
                    {"frame": f.id, "fault": objects.get((f.id, o.id), "")} for f in scene.frames
                ],
            }
            for o in scene.objects.objects
        ],
    }
    (scene.root / "check").mkdir(exist_ok=True)
    (scene.root / "check" / "report.json").write_text(json.dumps(report))
    Artefact(scene.root, "check", {SCENE_INPUT: scene_fingerprint(scene)}).write([])


def ids(scene: Scene) -> list[int]:
    return [f.id for f in scene.frames]


@pytest.mark.parametrize("layout", ["std", "nocs", "bop"])
def test_flags_are_in_the_files_of_the_layout(scene: Scene, layout: str) -> None:
    first, second, *_ = rendered = [0, 2, 4, 6]
    write_report(scene, {first: "camera pose"}, {(second, 4): "shifted by 5.0 px"})
    out = scene.root.parent / layout
    sidecar = export_scene(scene, layout, out, jobs=SERIAL)
    assert [f.id for f in sidecar.frames] == rendered
    assert [f.fault for f in sidecar.frames] == ["camera pose", "", "", ""]
    found = {(f.id, o.object): o.fault for f in sidecar.frames for o in f.objects if o.fault}
    assert found == {(second, 4): "shifted by 5.0 px"}
    folder = out / sidecar.folder
    if layout == "bop":
        info = json.loads((folder / "scene_gt_info.json").read_text())
        flags = {key: [row["label_fault"] for row in rows] for key, rows in info.items()}
        index = next(o.mask_id for o in sidecar.frames[1].objects if o.object == 4)
        assert flags[str(second)][index] == "shifted by 5.0 px"
        assert sum(bool(x) for rows in flags.values() for x in rows) == 1
    else:
        faults = json.loads((folder / "label_faults.json").read_text())
        assert faults == {
            "0000": {"frame": "camera pose", "objects": {}},
            "0002": {"frame": "", "objects": {"2": "shifted by 5.0 px"}},
        }
        assert f"{sidecar.folder}/label_faults.json" in sidecar.files


def test_an_export_without_a_check_has_no_flags(scene: Scene) -> None:
    sidecar = export_scene(scene, "std", scene.root.parent / "std", jobs=SERIAL)
    assert all(f.fault is None for f in sidecar.frames)
    assert not list((scene.root.parent / "std").rglob("label_faults.json"))


def test_bad_frames_are_left_out(scene: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    write_report(scene, {2: "unreadable"}, {(4, 7): "moved"})
    out = scene.root.parent / "bop"
    arguments = ["export", str(scene.root), "--format", "bop", "--out", str(out)]
    assert main([*arguments, "--drop-bad-frames", "--engine", "serial"]) == 0
    assert "left out 2 bad frames" in capsys.readouterr().out
    sidecar = msgspec.json.decode((out / "std_toolkit.json").read_bytes())
    assert [f["id"] for f in sidecar["frames"]] == [0, 6]
    reasons = {f["id"]: f["reason"] for f in sidecar["left_out"] if "check" in f["reason"]}
    assert reasons == {2: "check: unreadable", 4: "check: object 7: moved"}
    assert sorted(p.stem for p in out.rglob("rgb/*.png")) == ["000000", "000006"]
    # An export with flags can be imported again.
    request = ImportRequest(source=out, name="again")
    again = import_recording(request, scene.root.parent / "again", options=SERIAL)
    assert len(again.frames) == 2


def test_dropping_needs_a_current_report(scene: Scene) -> None:
    out = scene.root.parent / "std"
    with pytest.raises(ToolkitError, match="no current report") as caught:
        export_scene(scene, "std", out, options=DROP, jobs=SERIAL)
    assert "std-curate check" in str(caught.value)
    write_report(scene, {}, {})
    label = scene.labels.labels[0]
    scene.save_labels(scene.labels.with_label(msgspec.structs.replace(label, annotator="other")))
    assert read_check_flags(scene) is None
    with pytest.raises(ToolkitError):
        export_scene(scene, "std", out, options=DROP, jobs=SERIAL)
    assert not out.exists()


def test_a_fault_everywhere_leaves_nothing_to_export(scene: Scene) -> None:
    write_report(scene, dict.fromkeys(ids(scene), "camera pose"), {})
    with pytest.raises(ToolkitError, match="every frame"):
        export_scene(scene, "std", scene.root.parent / "std", options=DROP, jobs=SERIAL)


def test_a_new_check_makes_a_new_export(scene: Scene) -> None:
    write_report(scene, {}, {})
    out = scene.root.parent / "std"
    export_scene(scene, "std", out, jobs=SERIAL)
    write_report(scene, {0: "camera pose"}, {})
    with pytest.raises(ToolkitError):
        export_scene(scene, "std", out, jobs=SERIAL)
    options = ExportOptions(overwrite=True)
    assert export_scene(scene, "std", out, options=options, jobs=SERIAL).frames[0].fault
