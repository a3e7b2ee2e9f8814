"""A scene that std-sim writes is a scene like any other: it renders to its own truth and checks."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from sensors.output.toolkit_scene import read_simulation
from sensors.simulation.cli import main
from std_toolkit.cli.main import main as curate
from std_toolkit.io.exr import read_exr_depth
from std_toolkit.rendering.ground_truth import read_ground_truth
from std_toolkit.scene import Scene

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three views of boxes and tori along an arc."""
    folder = tmp_path_factory.mktemp("simulated")
    for name, mesh in {
        "box/small.obj": trimesh.creation.box((0.1, 0.06, 0.08)),
        "drum/flat.obj": trimesh.creation.cylinder(0.05, 0.06, sections=48),
    }.items():
        (folder / "shapes" / name).parent.mkdir(parents=True)
        mesh.export(folder / "shapes" / name)
    command = [
        *("--out", str(folder / "set"), "--scenes", "1", "--engine", "serial"),
        *("--layout", "scene", "--order", "arc", "--sweep-deg", "30", "--views", "3"),
        *("--assets", "folder", "--assets-root", str(folder / "shapes")),
        *("--preset", "tiny", "--width", "320", "--height", "180"),
    ]
    assert main(command) == 0
    return folder / "set" / "scenes" / "00000"


def test_pyrender_draws_what_the_simulator_knows(simulated: Path, tmp_path: Path) -> None:
    exact = Scene.open(simulated)
    again = Scene.open(shutil.copytree(simulated, tmp_path / "again"))
    shutil.rmtree(again.root / "gt")
    arguments = ["--renderer", "pyrender", "--policy", "models", "--engine", "serial"]
    assert curate(["render", str(again.root), *arguments]) == 0
    seen = 0
    for frame in exact.frames:
        truth, drawn = read_ground_truth(exact, frame.id), read_ground_truth(again, frame.id)
        assert drawn.info.renderer == "pyrender"
        for key in np.unique(truth.mask[truth.mask > 0]):
            ours, theirs = truth.mask == key, drawn.mask == key
            if ours.sum() < 200:  # of a sliver one pixel is more than a percent
                continue
            assert (ours & theirs).sum() / (ours | theirs).sum() > 0.99
            seen += 1
        both = (truth.mask > 0) & (truth.mask == drawn.mask)
        whole = read_exr_depth(exact.root / f"reference/depth/{frame.name}.exr")
        assert np.abs(drawn.depth - whole)[both].max() < 1e-3
        assert np.abs(drawn.nocs - truth.nocs)[both].max() < 2e-3
    assert seen >= 6


def test_the_infrared_pair_is_stored_with_its_cameras(simulated: Path) -> None:
    scene, record = Scene.open(simulated), read_simulation(simulated)
    camera = record.infrared_camera.camera()
    for frame in scene.frames:
        left, right = (
            cv2.imread(f"{simulated}/infrared/{eye}/{frame.name}.png", cv2.IMREAD_UNCHANGED)
            for eye in ("left", "right")
        )
        assert left.shape == right.shape == (camera.height, camera.width)
        assert left.dtype == np.uint8 and left.std() > 5
        assert (left != right).any()


def test_the_check_runs_and_measures_the_sensor(simulated: Path, tmp_path: Path) -> None:
    scene = shutil.copytree(simulated, tmp_path / "checked")
    # Its gates ask for more frames than three; what counts is that it comes to a verdict.
    assert curate(["check", str(scene), "--engine", "serial"]) in (0, 1)
    assert (scene / "check" / "report.html").is_file()
    assert Scene.open(scene).labels.labels
