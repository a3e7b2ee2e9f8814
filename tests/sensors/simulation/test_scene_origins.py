"""Scenes that do not come from the built-in library: GraspNet-1Billion, a pattern of one's own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
import trimesh

from sensors.output.dreds import read_record
from sensors.simulation.cli import main
from sensors.simulation.equipment import Arrangements, Equipment
from sensors.simulation.options import SimulationOptions
from sensors.simulation.set_report import set_statistics
from sensors.specs import load_sensor
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, so3_exp

pytest.importorskip("mujoco", reason="needs the extra [sim]")

MODELS = {3: trimesh.creation.box((0.08, 0.06, 0.04)), 9: trimesh.creation.icosphere(3, 0.03)}
# On the table, away from the table's origin.
PLACES = {3: (0.4, 0.2, 0.02), 9: (0.5, 0.2, 0.03)}
T_WORLD_CAM0 = SE3(so3_exp([np.pi - 0.5, 0, 0]), np.array([0.0, -0.3, 0.6]))


def write_scene(root: Path, number: int) -> None:
    """A scene as the data set has it; see sensors.physics.graspnet."""
    folder = root / "scenes" / f"scene_{number:04d}" / "realsense"
    (folder / "annotations").mkdir(parents=True)
    np.save(folder / "cam0_wrt_table.npy", T_WORLD_CAM0.matrix())
    np.save(folder / "camera_poses.npy", np.eye(4)[None])
    rows = ""
    for model, place in PLACES.items():
        T = T_WORLD_CAM0.inverse() @ SE3(np.eye(3), np.array(place))
        t, q = (" ".join(f"{x:.6f}" for x in v) for v in (T.t, T.quat()))
        rows += f"<obj><obj_id>{model}</obj_id><obj_name>{model}.ply</obj_name>"
        rows += f"<obj_path>models/{model}.ply</obj_path><pos_in_world>{t}</pos_in_world>"
        rows += f"<ori_in_world>{q}</ori_in_world></obj>"
    (folder / "annotations" / "0000.xml").write_text(f"<scene>{rows}</scene>")


@pytest.fixture(scope="module")
def graspnet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("graspnet")
    for number in (7, 42, 130):
        write_scene(root, number)
    for number, mesh in MODELS.items():
        folder = root / "models" / f"{number:03d}"
        folder.mkdir(parents=True)
        mesh.export(folder / "nontextured.ply")
    return root


def options(**given: object) -> SimulationOptions:
    return msgspec.structs.replace(SimulationOptions(views=1), **given)


def arranged(root: Path, split: str) -> Arrangements:
    return Arrangements(options(scenes_from="graspnet", graspnet_root=str(root), split=split))


def test_seeds_go_through_the_scenes_of_the_split(graspnet: Path) -> None:
    training = arranged(graspnet, "train")
    assert [training.of_seed(s).scene for s in (0, 1, 2)] == [7, 42, 7]
    assert arranged(graspnet, "test").of_seed(0).scene == 130


def test_the_arrangement_is_moved_to_where_the_cameras_look(graspnet: Path) -> None:
    found = arranged(graspnet, "train").of_seed(0)
    assert [a.id for a in found.assets] == ["graspnet-003", "graspnet-009"]
    at = np.array([T.t for T in found.poses])
    np.testing.assert_allclose(at[:, :2].mean(axis=0), 0, atol=1e-9)
    # Where they lie beside each other, and on the floor, is as it was.
    np.testing.assert_allclose(at[1] - at[0], np.subtract(PLACES[9], PLACES[3]), atol=2e-3)
    np.testing.assert_allclose(at[:, 2], [0.02, 0.03], atol=5e-4)


def test_a_folder_without_scenes_of_the_split_is_refused(graspnet: Path, tmp_path: Path) -> None:
    write_scene(tmp_path, 7)
    with pytest.raises(ToolkitError, match="no annotated scene of the split 'test'"):
        arranged(tmp_path, "test")


SMALL = ("--preset", "tiny", "--width", "160", "--height", "90", "--views", "1", "--scenes", "1")


@pytest.mark.slow
def test_a_set_of_graspnet_scenes_and_an_own_pattern(graspnet: Path, tmp_path: Path) -> None:
    pytest.importorskip("mitsuba", reason="needs the extra [sim]")
    dots = np.zeros((300, 400), np.uint8)
    dots[::6, ::6] = 255
    cv2.imwrite(str(tmp_path / "dots.png"), cv2.GaussianBlur(dots, (3, 3), 0))
    out = tmp_path / "set"
    words = ["--out", str(out), *SMALL, "--scenes-from", "graspnet"]
    words += ["--graspnet-root", str(graspnet), "--pattern", str(tmp_path / "dots.png")]
    assert main([*words, "--engine", "serial"]) == 0
    record = read_record(out, "train", "00000")
    assert record.parameters["graspnet_scene"] == 7
    assert [o.asset_id for o in record.objects] == ["graspnet-003", "graspnet-009"]
    assert record.parameters["options"]["pattern"] == str(tmp_path / "dots.png")
    found = set_statistics(out)
    assert (found.scenes, found.frames) == (1, 1)


def test_the_pattern_is_that_of_the_file(tmp_path: Path) -> None:
    image = np.zeros((30, 40), np.uint8)
    image[10, 20] = 255
    path = tmp_path / "dot.png"
    cv2.imwrite(str(path), image)
    pattern = Equipment.of(options(pattern=str(path))).depth_model.pattern(0)
    assert pattern is not None
    projector = load_sensor("d415").projector
    assert projector is not None and pattern.fov_x_deg == projector.fov_deg[0]
    np.testing.assert_array_equal(pattern.image * 255, image)
    wider = Equipment.of(options(pattern=str(path), pattern_fov_deg=90.0)).depth_model.pattern(0)
    assert wider is not None and wider.fov_x_deg == 90


def _millimetres(folder: Path) -> list[str]:
    (folder / "box").mkdir()
    trimesh.creation.box((120.0, 60.0, 80.0)).export(folder / "box" / "big.obj")
    (folder / "assets.json").write_text(
        '{"assets": [{"mesh": "box/big.obj", "category": "box", "unit": "m"}]}'
    )
    return ["--assets", "folder", "--assets-root", str(folder)]


def _empty_mesh(folder: Path) -> list[str]:
    (folder / "box").mkdir()
    (folder / "box" / "huge.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    return ["--assets", "folder", "--assets-root", str(folder)]


def _black(folder: Path) -> list[str]:
    cv2.imwrite(str(folder / "black.png"), np.zeros((8, 8), np.uint8))
    return ["--pattern", str(folder / "black.png")]


BAD: dict[str, tuple[Callable[[Path], list[str]], str]] = {
    "no GraspNet": (
        lambda d: ["--scenes-from", "graspnet", "--graspnet-root", str(d)],
        "holds no folder `scenes`",
    ),
    "no root": (lambda _: ["--scenes-from", "graspnet"], "--graspnet-root"),
    "no pattern": (lambda d: ["--pattern", str(d / "none.png")], "none.png"),
    "black pattern": (_black, "the pattern is black"),
    "angle alone": (lambda _: ["--pattern-fov", "60"], "--pattern-fov"),
    "no environments": (lambda d: ["--environments", str(d / "maps")], "maps"),
    "empty environments": (lambda d: ["--environments", str(d)], "{folder}"),
    "no floors": (lambda d: ["--floors", str(d / "tiles")], "tiles"),
    "no assets": (lambda _: ["--assets", "folder"], "root"),
    "no shapes": (lambda d: ["--assets", "folder", "--assets-root", str(d)], "{folder}"),
    "millimetres": (_millimetres, "big.obj"),
    "empty mesh": (_empty_mesh, "huge.obj"),
    "unknown sensor": (lambda _: ["--sensor", "d999"], "d999"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_makes_nothing(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "given"
    folder.mkdir()
    more, said = BAD[case]
    out = tmp_path / "set"
    words = ["--out", str(out), *SMALL, "--engine", "serial", *more(folder)]
    # What contradicts itself is wrong usage.
    assert main(words) == (2 if case in ("no root", "angle alone") else 1)
    told = capsys.readouterr().err
    lines = [x for x in told.splitlines() if said.format(folder=folder) in x]
    assert len(lines) == 1 and "Traceback" not in told
    assert not (out / "DREDS-CatKnown").exists()


def test_an_open_surface_is_used_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Scans have holes: not watertight is no reason to stop, and is told."""
    mesh = trimesh.creation.box((0.1, 0.06, 0.08))
    mesh.update_faces(np.arange(len(mesh.faces)) != 0)
    (tmp_path / "box").mkdir()
    mesh.export(tmp_path / "box" / "open.obj")
    with caplog.at_level("WARNING", logger="std_toolkit"):
        source = Equipment.of(options(assets="folder", assets_root=str(tmp_path), split="all"))
        asset = source.assets.sample(np.random.default_rng(0), "box")
    assert not asset.mesh.is_watertight
    assert "open.obj: the surface is not closed" in caplog.text
