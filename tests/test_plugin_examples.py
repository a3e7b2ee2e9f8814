"""`examples/plugins`: installed by its entry points, every kind of plug-in is found and runs."""

from __future__ import annotations

import importlib
import re
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from std_toolkit import SE3, Camera, Scene, ToolkitError
from std_toolkit.cli.main import main as std_curate
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.plugins import Registry
from tests.benchmark.evaluation.bench_set import SPLIT, write_split
from tests.std_toolkit.exporters.scene_factory import make_scene

REPOSITORY = Path(__file__).resolve().parent.parent
FOLDER = REPOSITORY / "examples" / "plugins"
GROUPS: dict[str, dict[str, str]] = tomllib.loads((FOLDER / "pyproject.toml").read_text())[
    "project"
]["entry-points"]
PACKAGES = ("std_toolkit", "sensors", "benchmark")


@pytest.fixture(autouse=True)
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The package as pip would install it: on the path, and known by its entry points."""
    metadata = tmp_path / "site" / "my_plugins-0.1.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: my-plugins\nVersion: 0.1\n")
    lines = [
        line
        for group, names in GROUPS.items()
        for line in (f"[{group}]", *(f"{name} = {place}" for name, place in names.items()))
    ]
    (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n")
    monkeypatch.syspath_prepend(str(metadata.parent))
    monkeypatch.syspath_prepend(str(FOLDER))
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] == "my_plugins"]:
        del sys.modules[name]


@cache
def places() -> dict[str, str]:
    """The modules that have a registry, by its group."""
    found = {}
    for package in PACKAGES:
        for path in (REPOSITORY / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            for group in re.findall(r"\(\s*\"(std_toolkit\.\w+)\",\s*\{", text):
                found[group] = ".".join(path.relative_to(REPOSITORY).with_suffix("").parts)
    return found


def registry(group: str) -> Registry:
    values = vars(importlib.import_module(places()[group])).values()
    (found,) = (v for v in values if isinstance(v, Registry) and v.group == group)
    return found


@pytest.mark.slow
def test_each_kind_has_an_example_and_a_row() -> None:
    groups = set(places())
    assert groups == set(GROUPS)
    guide = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = {
        row[0]: row[1:]
        for row in re.findall(r"\| `([\w.]+)` \| `(\S+)` \| `(\S+)` \|$", guide, re.M)
    }
    assert set(rows) == groups
    for group, (example, protocol) in rows.items():
        (place,) = GROUPS[group].values()
        assert place == "my_plugins." + example.replace(".py:", ":")
        module, _, name = protocol.rpartition(".")
        assert hasattr(importlib.import_module(module), name), protocol


@pytest.mark.parametrize("group", GROUPS)
def test_it_is_found_by_name_and_by_file(group: str) -> None:
    ((name, place),) = GROUPS[group].items()
    if group.endswith("trainables"):
        pytest.importorskip("torch")
    plugins = registry(group)
    assert name in plugins.names()
    module, _, attribute = place.partition(":")
    found = plugins.get(name)
    assert found is getattr(importlib.import_module(module), attribute)
    file = FOLDER / f"{module.replace('.', '/')}.py"
    assert type(plugins.get(f"{file}:{attribute}")).__name__ == type(found).__name__


@pytest.mark.slow
def test_methods_splits_and_protocols_are_scored(tmp_path: Path) -> None:
    from benchmark import evaluate

    root = write_split(tmp_path, scenes=1, frames=2)
    table = evaluate(["raw", "median"], SPLIT, "close", data=root, settings={"median.least": 10})
    errors = table.groupby("method")["mae"].first()
    assert 0 < errors["median"] < errors["raw"]
    with pytest.raises(ToolkitError, match=r"most.*it has least"):
        evaluate("median", SPLIT, data=root, settings={"most": 1})
    poses = evaluate("nothing", SPLIT, "loose", data=root, task="pose")
    assert (poses["20deg10cm"] == 0).all() and (poses["true"] > 0).all()
    make_scene(tmp_path / "shelf" / "one")
    assert len(evaluate("raw", "shelf", data=tmp_path)) > 0


def test_a_grasp_on_the_highest_point() -> None:
    from benchmark.methods.protocol import GraspView
    from benchmark.methods.registry import make_planner

    camera = Camera(64, 48, 60, 60, 31.5, 23.5)
    depth = np.full((48, 64), 0.8, np.float32)
    depth[20:28, 28:36] = 0.7
    T_cam_table = np.diag([1.0, -1.0, -1.0, 1.0])
    T_cam_table[2, 3] = 0.8
    view = GraspView(np.zeros((48, 64, 3), np.uint8), depth, camera, None, T_cam_table)
    grasps = make_planner("highest").plan(view)
    assert grasps.translations[0, 2] == pytest.approx(0.7)


def test_a_recording_is_imported(tmp_path: Path) -> None:
    source = tmp_path / "source"
    for i in range(2):
        write_color(source / f"rgb/{i}.png", np.full((48, 64, 3), 90, np.uint8))
        write_depth_png16(
            source / f"depth/{i}.png", np.full((48, 64), 0.5, np.float32), scale=0.001
        )
    (source / "K.txt").write_text("70 71 31.5 23.5\n")
    assert std_curate(["import", str(source), "--out", str(tmp_path / "scene")]) == 0
    scene = Scene.open(tmp_path / "scene")
    assert scene.camera(scene.frames[1]).fy == 71
    depth = scene.read_depth(scene.frames[0])
    assert depth is not None and depth.max() == pytest.approx(0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    "place",
    [
        "pose-lines",
        f"{FOLDER}/my_plugins/curation.py:POSE_LINES",
        f"{FOLDER}/my_plugins/curation.py:PoseLines",
    ],
)
def test_an_exporter_has_an_option_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str
) -> None:
    scene = make_scene(tmp_path / "scene", frames=2)

    def export(out: str, *words: str) -> int:
        places = ["--format", place, "--out", str(tmp_path / out)]
        return std_curate(["export", str(scene.root), *places, *words])

    assert export("metres") == 0 and export("millimetres", "--set", "unit=mm") == 0
    tables = [np.loadtxt(tmp_path / out / "poses/view_0.txt") for out in ("metres", "millimetres")]
    np.testing.assert_allclose(1000 * tables[0][:, 1:], tables[1][:, 1:], atol=1e-3)
    true = scene.T_cam_obj(scene.frames[0].id, int(tables[0][0, 0]))
    assert true is not None
    np.testing.assert_allclose(tables[0][0, 1:], true.t, atol=1e-6)
    assert export("millimetres", "--set", "unit=mm") == 0, "the same export is kept"
    capsys.readouterr()
    for words, reported in (
        (["--set", "unit=inch"], "expected one of m, mm"),
        (["--set", "units=mm"], "the exporter has no such setting.*it has unit"),
        (["--set", "mm"], "expected NAME=VALUE"),
        ([], "not a complete export of this scene"),
    ):
        assert export("millimetres", *words) == 1
        assert re.search(reported, capsys.readouterr().err), words
    nocs = ["--format", "nocs", "--out", str(tmp_path / "nocs"), "--set", "a=b"]
    assert std_curate(["export", str(scene.root), *nocs]) == 1
    assert "the exporter has no settings" in capsys.readouterr().err


def test_ground_truth_ends_at_two_metres(tmp_path: Path) -> None:
    from std_toolkit.options import RenderOptions
    from std_toolkit.rendering.ground_truth import read_ground_truth
    from std_toolkit.rendering.render_step import render_ground_truth

    far = {1: SE3(np.eye(3), np.array([0, 0, 0.6])), 4: SE3(np.eye(3), np.array([0.3, 0, 2.5]))}
    far |= {7: SE3(np.eye(3), np.array([-0.3, 0, 2.5]))}
    scene = make_scene(tmp_path / "scene", frames=1, world_poses=far, render=False)
    render_ground_truth(scene, RenderOptions(renderer="near")).raise_if_failed()
    depth = read_ground_truth(scene, scene.frames[0].id).depth
    assert 0 < depth.max() < 2


def test_metres_from_a_tape(tmp_path: Path) -> None:
    (tmp_path / "tape.txt").write_text("0.8\n")
    poses = {i: SE3(np.eye(3), np.array([-0.2 * i, 0, 0])) for i in range(3)}
    context = SimpleNamespace(scene=SimpleNamespace(root=tmp_path), poses=poses)
    source = registry("std_toolkit.scale_sources").get("tape")()
    assert source.available(context)
    assert source.estimate(context).factor == pytest.approx(2)


def test_depth_maps_take_two_more_photos(monkeypatch: pytest.MonkeyPatch) -> None:
    careful = registry("std_toolkit.scan_depth").get("careful")
    module = sys.modules[careful.__module__]
    monkeypatch.setattr(module, "depth_maps", lambda *_, **given: given)
    assert careful([], None, deepest=1.0, neighbours=6, threads=1)["neighbours"] == 8


def test_a_live_camera_gives_images_until_it_is_stopped() -> None:
    from std_toolkit.cameras import CAMERAS, CameraRequest

    seen: list[float] = []
    request = CameraRequest(size=(64, 48), stop=lambda: len(seen) == 3)
    camera = CAMERAS.get("wall")(request)
    for frame in camera.frames():
        assert frame.color.shape == (48, 64, 3) and (frame.depth == 1).all()
        seen.append(frame.timestamp)
    camera.close()
    assert seen == [0, pytest.approx(1 / 30), pytest.approx(2 / 30)]


def test_a_matcher_finds_the_disparity() -> None:
    from sensors.stereo import make_matcher

    left = np.random.default_rng(0).integers(0, 255, (96, 160), np.uint8)
    disparity = make_matcher("blocks", min_disparity=0, max_disparity=32).match(
        left, np.roll(left, -8, axis=1)
    )
    assert np.median(disparity[20:-20, 60:-20]) == 8


def test_crates_are_assets() -> None:
    from sensors.assets.asset_source import open_source

    crate = open_source("crates").sample(np.random.default_rng(1), "crate")
    assert crate.category == "crate"
    assert np.linalg.norm(crate.mesh.extents) == pytest.approx(1)
    assert open_source("crates").load(crate.id).mesh.extents == pytest.approx(crate.mesh.extents)


def test_a_short_range_camera_sees_one_metre() -> None:
    """A wall at 0.8 m in the lower half of the image, one at 1.5 m in the upper half."""
    from sensors.depth_models.depth_model import DEPTH_MODELS, DepthModelOptions
    from sensors.specs import load_sensor

    sensor = load_sensor("d415")
    options = DepthModelOptions(width=640, height=360, matcher="blocks", noise=False)
    model = DEPTH_MODELS.get("short-range")(sensor, options)
    left = np.random.default_rng(0).random((model.camera.height, model.camera.width), np.float32)
    pixels = [round(model.camera.fx * sensor.baseline_m / metres) for metres in (1.5, 0.8)]
    halves = zip(np.split(left, 2), pixels, strict=True)
    right = np.concatenate([np.roll(half, -shift, axis=1) for half, shift in halves])
    depth = model.read((left, right), seed=0).depth
    middle = depth[:, depth.shape[1] // 2 :]
    assert np.median(middle[len(depth) * 3 // 4 :]) == pytest.approx(0.8, abs=0.02)
    assert np.median(middle[: len(depth) // 4]) == 0


@pytest.mark.slow
def test_a_renderer_of_light_has_another_name() -> None:
    pytest.importorskip("mitsuba")
    from sensors.render.sim_renderer import SIM_RENDERERS

    assert SIM_RENDERERS.get("dim")(threads=1).name.startswith("dim/")
