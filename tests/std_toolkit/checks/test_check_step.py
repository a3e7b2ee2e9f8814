"""The whole check on toy scenes: good ones, wrong ones, incomplete ones, damaged ones."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest
from toy_balls import CAMERA, DISTANCE_M, Toy, arc_pose

from std_toolkit.checks.check_step import run_check
from std_toolkit.checks.result import CheckReport
from std_toolkit.checks.summary import summarise
from std_toolkit.cli import main as cli
from std_toolkit.io.documents import read_document
from std_toolkit.io.images import read_color, read_mask, write_color, write_png
from std_toolkit.jobs import JobOptions
from std_toolkit.options import CheckOptions, RenderOptions
from std_toolkit.rendering.render_step import render_ground_truth
from std_toolkit.scene import CameraPoses, FramePose, Frames, Labels, ObjectTable, Scene
from std_toolkit.scene.check_flags import report_is_current
from std_toolkit.scene.model import ScaleEstimate, ScaleReport

MakeScene = Callable[[Toy], Scene]
SERIAL = JobOptions(engine="serial", progress=False)
FILES = ("report.html", "report.json", "report.csv", "frames.csv")


def check(scene: Scene, **options: float) -> CheckReport:
    return run_check(scene, CheckOptions(**options), SERIAL)  # type: ignore[arg-type]


def failed(report: CheckReport) -> set[str]:
    return {g.key for g in report.failed_gates()}


def page(scene: Scene) -> str:
    return (scene.root / "check" / "report.html").read_text()


class Loads(HTMLParser):
    """Collects what a page would load, and the text of its scripts and styles."""

    def __init__(self) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.tags: list[str] = []
        self.styles = ""
        self._in = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._in = tag
        for name, value in attrs:
            if name in ("src", "srcset", "data", "action", "poster", "background") or (
                name == "href" and tag == "link"
            ):
                self.sources.append(value or "")

    def handle_data(self, data: str) -> None:
        if self._in == "style":
            self.styles += data


@pytest.mark.slow
def test_true_labels_pass_and_the_report_is_self_contained(make_scene: MakeScene) -> None:
    scene = make_scene(Toy())
    report = check(scene)
    assert report.passed and report.verdict == "PASS: labels usable"
    for item in report.objects:
        assert item.verdict == "fits"
        edge, offset, drift = (item.value(key) for key in ("edge_px", "offset_mm", "drift_px"))
        assert edge is not None and edge < 0.2
        assert item.value("depth_mm") == pytest.approx(0, abs=0.15)
        assert offset is not None and offset < 0.3
        assert drift is not None and drift < 0.15
        assert item.value("visible_fraction") == 1.0
        assert item.value("parallax_deg") == pytest.approx(60, abs=8)
    html = page(scene)
    loads = Loads()
    loads.feed(html)
    assert all(s.startswith("data:") for s in loads.sources)
    assert "iframe" not in loads.tags and "@import" not in loads.styles
    assert "url(" not in loads.styles
    assert html.count("plotly.js v") == 1
    assert str(scene.root) not in html
    assert html.count('<path class="line"') >= 12
    assert len(html) < 8_000_000


@pytest.mark.slow
def test_numbers_on_disk_are_those_returned(make_scene: MakeScene) -> None:
    scene = make_scene(Toy())
    report = check(scene)
    assert read_document(scene.root / "check" / "report.json", CheckReport) == report
    objects = pd.read_csv(scene.root / "check" / "report.csv")
    assert list(objects["name"]) == ["ball_1", "ball_2"]
    assert objects["edge_px"].tolist() == [o.value("edge_px") for o in report.objects]
    frames = pd.read_csv(scene.root / "check" / "frames.csv", dtype={"name": str})
    assert list(frames["frame"]) == list(range(6))
    assert frames["name"][1] == "000001"
    assert frames["points"].tolist() == [100 + i for i in range(6)]


@pytest.mark.slow
def test_depth_that_is_4_mm_off_gives_a_residual_of_4_mm(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(depth_error_m=-0.004, frames=3, materials=("diffuse", "transparent")))
    report = check(scene)
    assert report.objects[0].value("depth_mm") == pytest.approx(4.0, abs=0.15)
    assert report.objects[0].value("raw_median_mm") == pytest.approx(-4.0, abs=0.3)
    # Glass is not judged by depth.
    assert report.objects[1].value("depth_mm") is None
    assert {m.material for m in report.materials} == {"diffuse", "transparent"}
    for row in report.materials:
        assert row.completeness == 1.0
        assert row.mae_mm == pytest.approx(4.0, abs=0.5)
        assert sum(row.histogram_share) == pytest.approx(1, abs=1e-4)
    assert not failed(report)
    # One diffuse object does not tell an error of its label from a bias of the sensor.
    assert not failed(check(scene, max_depth_mm=3.0))
    far = make_scene(Toy(depth_error_m=-0.03, frames=3, materials=("diffuse", "transparent")))
    assert "depth" in failed(check(far))


@pytest.mark.slow
def test_a_label_5_px_aside_fails_and_is_told_by_how_much(make_scene: MakeScene) -> None:
    metres = 5 * DISTANCE_M / CAMERA.fy
    scene = make_scene(Toy(moved={2: np.array([0, metres, 0])}))
    report = check(scene)
    assert failed(report) >= {"motion"}
    assert report.verdict.startswith("FAIL: ")
    good, bad = report.objects
    assert good.verdict == "fits" and bad.verdict == "wrong"
    assert bad.value("shift_px") == pytest.approx(5, abs=0.3)
    offset = bad.entry("offset_mm")
    assert offset is not None
    assert offset.motion == pytest.approx([0, -1000 * metres, 0, 0, 0, 0], abs=0.6)
    # One displacement explains all frames: the label is off, the cameras are not.
    drift = bad.value("drift_px")
    assert drift is not None and drift < 0.3


@pytest.mark.slow
def test_a_wrong_scale_shows_as_drift(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=9, arc_deg=80))
    assert scene.poses is not None
    start = arc_pose(-40)
    frames = []
    for pose in scene.poses.frames:
        T = scene.T_world_cam(pose.frame)
        assert T is not None
        T = type(T)(T.R, start.t + 1.03 * (T.t - start.t))
        frames.append(msgspec.structs.replace(pose, T_world_cam=T.flat()))
    scene.save_poses(CameraPoses(frames=frames))
    report = check(scene)
    assert (report.objects[0].value("shift_spread_px") or 0) > 1.5
    true = check(make_scene(Toy(frames=9, arc_deg=80)))
    spread = true.objects[0].value("shift_spread_px")
    assert spread is not None and spread < 0.1


@pytest.mark.slow
def test_second_run_does_nothing_and_changes_are_noticed(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=3))
    first = check(scene)
    files = [scene.root / "check" / name for name in FILES]
    stamps = [p.stat().st_mtime_ns for p in files]
    assert check(Scene.open(scene.root)) == first
    assert [p.stat().st_mtime_ns for p in files] == stamps
    # A deleted output, another limit, another label: each is done again.
    files[2].unlink()
    check(scene)
    assert files[2].exists()
    assert check(scene, max_edge_px=2.5).limits["max_edge_px"] == 2.5
    scene.save_labels(Labels())
    assert check(scene).gate("labelled").value == 2
    assert "labelled" in failed(check(scene, strict=True))


@pytest.mark.slow
def test_outputs_are_the_same_bytes_for_any_number_of_workers(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=4))
    check(scene)
    folder = scene.root / "check"
    once = [(folder / name).read_bytes() for name in FILES]
    shutil.rmtree(folder)
    run_check(scene, CheckOptions(), JobOptions(workers=2, progress=False))
    assert [(folder / name).read_bytes() for name in FILES] == once


@pytest.mark.slow
def test_leftovers_of_a_killed_run_are_swept(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=2))
    left = scene.root / "check" / ".report.0123456789ab.tmp.html"
    left.parent.mkdir()
    left.write_text("half a page")
    check(scene)
    assert not left.exists()


@pytest.mark.slow
def test_scene_without_depth(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(depth_error_m=None, frames=3))
    report = check(scene)
    assert report.passed and report.materials == []
    assert any("Sensor depth" in m for m in report.missing)
    assert "Sensor depth: no depth residuals" in page(scene)


@pytest.mark.slow
def test_scene_without_labels_says_so_and_fails_if_strict(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=3))
    scene.save_labels(Labels())
    report = check(scene)
    assert report.passed and "no labels" in report.verdict and not failed(report)
    strict = check(scene, strict=True)
    assert failed(strict) == {"labelled"} and strict.verdict == "FAIL: unknown: ball_1, ball_2"
    assert any("Labels" in m for m in report.missing)
    assert {o.verdict for o in report.objects} == {"unknown"}


@pytest.mark.slow
def test_scene_without_objects_is_judged_by_its_poses(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=3))
    scene.save_labels(Labels())
    scene.save_objects(ObjectTable())
    report = check(scene)
    assert report.passed and "no labels" in report.verdict
    assert report.objects == []


@pytest.mark.slow
def test_scene_without_poses(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=3))
    (scene.root / "poses.json").unlink()
    report = check(Scene.open(scene.root))
    assert "registered" in failed(report)
    assert any("Camera poses" in m for m in report.missing)


@pytest.mark.slow
def test_scene_with_no_frame_registered(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=3))
    scene.save_poses(
        CameraPoses(frames=[FramePose(frame=i, status="unregistered") for i in range(3)])
    )
    report = check(scene)
    assert "registered" in failed(report)
    assert any("0-2" in w.problem for w in report.warnings)


def test_scene_without_frames(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=2))
    shutil.rmtree(scene.root / "poses", ignore_errors=True)
    empty = Scene.create(scene.root / "empty", scene.info, Frames(frames=[]))
    assert check(empty).summary.frames == 0


@pytest.mark.slow
def test_damaged_frame_is_listed_and_the_rest_is_checked(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=4))
    path = scene.root / "color/000002.png"
    path.write_bytes(path.read_bytes()[:500])
    report = check(scene)
    assert failed(report) == {"frames"}
    assert report.frames[2].problem and not report.frames[2].looked_at
    assert report.summary.looked_at == 3
    assert report.objects[0].verdict == "fits"


@pytest.mark.slow
def test_unreadable_mesh_fails_its_gate(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=2))
    (scene.root / "models/ball/ball.ply").write_bytes(b"not a mesh")
    report = check(Scene.open(scene.root))
    assert "meshes" in failed(report)


@pytest.mark.slow
def test_ground_truth_is_used_while_it_fits_the_labels(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=3, depth_error_m=0.004))
    options = RenderOptions(renderer="raycast", policy="models")
    render_ground_truth(scene, options, jobs=SERIAL)
    report = check(scene)
    assert report.passed
    assert report.summary.truth_source == "rendered maps" and report.summary.truth_frames == 3
    assert report.materials[0].median_mm == pytest.approx(4.0, abs=0.3)
    label = scene.labels.labels[0]
    assert label.T_world_obj is not None
    moved = [*label.T_world_obj]
    moved[3] += 0.0001
    scene.save_labels(scene.labels.with_label(msgspec.structs.replace(label, T_world_obj=moved)))
    stale = check(scene)
    assert {f.truth for f in stale.frames} == {"stale"}
    assert any("rendered from other labels" in w.problem for w in stale.warnings)
    assert stale.summary.truth_source == "labels cast here"
    # What a label that is gone hid is still hidden in it.
    scene.save_labels(Labels(labels=[x for x in scene.labels.labels if x.object != label.object]))
    assert {f.truth for f in check(scene).frames} == {"stale"}


@pytest.mark.slow
def test_things_no_label_covers_are_left_out(make_scene: MakeScene) -> None:
    # Half of ball 1 is hidden by something that only the ground truth knows of.
    scene = make_scene(Toy(frames=3))
    render_ground_truth(scene, RenderOptions(renderer="raycast", policy="models"), jobs=SERIAL)
    before = check(scene).objects[0]
    for frame in scene.frames:
        path = scene.root / f"gt/mask/{frame.id:06d}.png"
        mask = read_mask(path)
        mask[: CAMERA.height // 2][mask[: CAMERA.height // 2] == 1] = 0
        rows = np.flatnonzero((mask == 1).any(axis=1))
        mask[: rows[0] + 30] = np.where(mask[: rows[0] + 30] == 1, 0, mask[: rows[0] + 30])
        write_png(path, mask)
        image = read_color(scene.color_path(frame))
        image[: rows[0] + 30] = 150
        write_color(scene.color_path(frame), image)
    after = check(Scene.open(scene.root)).objects[0]
    edge = after.value("edge_px")
    assert before.value("edge_px") is not None and edge is not None and edge < 0.2


@pytest.mark.slow
def test_label_out_of_view_is_told(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=3, moved={1: np.array([0, 5.0, 0])}))
    report = check(scene)
    assert any("is not visible in any" in w.problem for w in report.warnings)


@pytest.mark.slow
def test_command_line(make_scene: MakeScene, capsys: pytest.CaptureFixture[str]) -> None:
    good = make_scene(Toy(frames=3))
    assert cli.main(["check", str(good.root), "--engine", "serial"]) == 0
    assert "PASS: labels usable" in capsys.readouterr().out
    bad = make_scene(Toy(frames=3, moved={1: np.array([0, 0.01, 0])}))
    assert cli.main(["check", str(bad.root), "--engine", "serial"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert any(x.startswith("FAIL shift: ") and "ball_1" in x for x in lines)
    assert all(";" in x for x in lines if x.startswith("FAIL shift"))
    assert cli.main(["check", str(good.root / "nowhere")]) == 1


CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium to open the page with")
def test_page_opens_and_draws_its_figures(make_scene: MakeScene, tmp_path: Path) -> None:
    scene = make_scene(Toy())
    check(scene)
    assert CHROMIUM is not None
    done = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
         "--disable-background-networking", "--disable-component-update", "--disable-sync",
         f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=8000", "--dump-dom",
         (scene.root / "check" / "report.html").resolve().as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    plots = re.findall(r'id="plot-[\w-]+"', done.stdout)
    drawn = re.findall(r'class="plot[^"]*js-plotly-plot"', done.stdout)
    assert len(plots) == len(drawn) >= 6


@pytest.mark.slow
def test_a_report_of_other_labels_is_told(make_scene: MakeScene) -> None:
    scene = make_scene(Toy())
    check(scene, max_frames=1)
    assert report_is_current(scene)
    assert summarise(scene).next_command != f"std-curate check {scene.root}"
    assert scene.labels.labels
    scene.save_labels(Labels(labels=scene.labels.labels[:-1]))
    assert not report_is_current(scene)
    assert "OUTDATED" in "\n".join(summarise(scene).lines())


@pytest.mark.slow
def test_warnings_of_weight_are_printed(
    make_scene: MakeScene, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = make_scene(Toy())
    depth = ScaleEstimate(source="depth", factor=1.0, spread=0.01, standard_error=0.001, count=9)
    report = ScaleReport(unit="metre", chosen="depth", estimates=[depth])
    scene.save_poses(msgspec.structs.replace(scene.poses, scale=report))
    assert cli.main(["check", str(scene.root), "--engine", "serial", "--max-frames", "1"]) == 0
    assert (
        "warning: scale: the metric scale comes from sensor depth alone" in capsys.readouterr().out
    )
