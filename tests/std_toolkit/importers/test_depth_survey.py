"""Depth of other programs: what means "nothing", its unit, and where it is in a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.importers import depth_survey
from std_toolkit.importers.depth_files import Missing, frame_marks, read_foreign_depth
from std_toolkit.importers.depth_survey import DepthFile, GuessedUnit, survey_depth, with_unit_asked
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_color, write_png
from std_toolkit.scene import Scene

W, H = 64, 48


def table(unit: float = 0.001, kind: type = np.uint16) -> NDArray[Any]:
    """A slanted table from 0.5 to 0.8 m."""
    metres = np.linspace(0.5, 0.8, W * H).reshape(H, W)
    return (metres / unit).astype(kind)


def recorded(folder: Path, depth: NDArray[Any], **changes: Any) -> Scene:
    for i in range(2):
        write_color(folder / f"color/{i}.png", np.full((H, W, 3), 90, np.uint8))
        if depth.dtype == np.uint16:
            write_png(folder / f"depth/{i}.png", depth)
        else:
            write_exr(folder / f"depth/{i}.exr", {"V": depth})
    request = ImportRequest(
        source=folder, name="d", color=str(folder / "color"), depth=str(folder / "depth"),
        intrinsics="60,60,31.5,23.5", **changes,
    )  # fmt: skip
    return import_recording(request, folder / "scene")


def depth_of(scene: Scene) -> NDArray[np.float32]:
    found = scene.read_depth(scene.frames[0])
    assert found is not None
    return found


MARKS: dict[str, tuple[NDArray[Any], float]] = {
    "blender's sky": (table(1.0, np.float32), 1e10),
    "half's largest": (table(1.0, np.float32), 65504.0),
    "far plane of a renderer": (table(1.0, np.float32), 10.0),
    "far plane beyond the sensor": (table(1.0, np.float32), 37.5),
    "65000": (table(), 65000),
    "65535": (table(), 65535),
    "10000": (table(), 10000),
    "8191": (table(), 8191),
    "4095": (table(), 4095),
    "another number beyond 10 m": (table(), 12345),
    "one": (table(), 1),
}  # fmt: skip


@pytest.mark.parametrize("kind", MARKS)
def test_marks_become_missing_with_a_line(
    kind: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    depth, mark = MARKS[kind]
    depth[:4] = mark
    with caplog.at_level("INFO", "std_toolkit"):
        found = depth_of(recorded(tmp_path, depth))
    assert (found[:4] == 0).all()
    assert found[4:].min() > 0.49 and found.max() < 0.81
    if mark != 65535:  # every reader of 16 bits knows it
        assert f"{mark:.6g} means no measurement (8.3% of the pixels)" in caplog.text


def test_two_marks_behind_one_another(tmp_path: Path) -> None:
    depth = table(1.0, np.float32)
    depth[:4], depth[4:8] = 1e10, 10.0
    found = depth_of(recorded(tmp_path, depth))
    assert (found[:8] == 0).all() and found[8:].min() > 0.5


KEPT: dict[str, NDArray[Any]] = {
    "a flat wall of a simulator": np.where(np.arange(H)[:, None] < 9, 1500, table()),
    "a flat table": np.full((H, W), 700, np.uint16),
    "a flat table, two heights": np.where(np.arange(H)[:, None] < 9, 500, np.full((H, W), 700)),
    "all distances to 6 m": np.linspace(500, 6000, W * H).reshape(H, W),
    "a few far pixels": np.where(np.arange(W * H).reshape(H, W) < 5, 9000, table()),
    "a wall with the floor before it": np.where(
        np.arange(H)[:, None] < 9, 4000, np.linspace(3990, 600, W * H).reshape(H, W)
    ),
}


@pytest.mark.parametrize("kind", KEPT)
def test_measurements_are_kept(kind: str, tmp_path: Path) -> None:
    depth = KEPT[kind].astype(np.uint16)
    scene = recorded(tmp_path, depth)
    assert (depth_of(scene) > 0).all()
    copied = (scene.root / "depth/0.png").read_bytes()
    assert copied == (tmp_path / "depth/0.png").read_bytes()


def test_a_lone_number_is_named_and_taken_as_missing_on_request(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    depth = KEPT["a flat wall of a simulator"].astype(np.uint16)
    depth[:9] = 2500
    with caplog.at_level("INFO", "std_toolkit"):
        assert (depth_of(recorded(tmp_path / "a", depth)) > 0).all()
    assert "2500 stands alone at the far end" in caplog.text and "--missing 2500" in caplog.text
    found = depth_of(recorded(tmp_path / "b", depth, missing="2500, 7"))
    assert (found[:9] == 0).all() and (found[9:] > 0).all()
    with pytest.raises(ToolkitError, match="--missing"):
        recorded(tmp_path / "c", depth, missing="none")


@pytest.mark.parametrize(
    ("unit", "named"), [(0.000125, "0.000125"), (0.0001, "0.0001"), (1 / 65535, "seems wrong")]
)
def test_a_guessed_unit_that_is_implausible_is_refused(
    unit: float, named: str, tmp_path: Path
) -> None:
    with pytest.raises(GuessedUnit, match=rf"\d m.*{named}") as error:
        recorded(tmp_path, table(unit) // 1)
    assert "--depth-scale 0.001" in str(error.value) and not (tmp_path / "scene").exists()


def test_a_stated_unit_is_taken(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "std_toolkit"):
        found = depth_of(recorded(tmp_path / "a", table(0.000125), depth_scale=0.000125))
    assert 0.499 < found.min() < found.max() < 0.801
    assert "median 0.65 m, 0.503 to 0.797 m" in caplog.text
    far = depth_of(recorded(tmp_path / "b", (table() * 10).astype(np.uint16), depth_scale=0.001))
    assert far.max() == pytest.approx(8, abs=0.01)


def test_the_unit_of_floating_point_images(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    millimetres = table(0.001, np.float32)
    with pytest.raises(GuessedUnit, match=r"not to be in metres; --depth-scale 0.001"):
        recorded(tmp_path / "a", millimetres)
    found = depth_of(recorded(tmp_path / "b", millimetres, depth_scale=0.001))
    assert found.max() == pytest.approx(0.8, abs=0.002)
    with caplog.at_level("INFO", "std_toolkit"):  # a flag for the 16-bit images of other scenes
        found = depth_of(recorded(tmp_path / "c", table(1.0, np.float32), depth_scale=0.001))
    assert found.max() == pytest.approx(0.8, abs=0.002)
    assert "--depth-scale 0.001 is not applied" in caplog.text


class Terminal:
    """Standard input and error of a user who answers."""

    def __init__(self, answer: str) -> None:
        self.answer, self.said = answer, ""

    def isatty(self) -> bool:
        return True

    def readline(self) -> str:
        return self.answer

    def write(self, text: str) -> None:
        self.said += text

    def flush(self) -> None:
        pass


@pytest.mark.parametrize(("answer", "used"), [("0.000125\n", 0.000125), ("\n", None)])
def test_a_terminal_is_asked(
    answer: str, used: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = Terminal(answer)
    monkeypatch.setattr(depth_survey.sys, "stdin", terminal)
    monkeypatch.setattr(depth_survey.sys, "stderr", terminal)

    def run(unit: float | None) -> float:
        if unit is None:
            raise GuessedUnit("5.6 m: --depth-scale 0.000125 would fit")
        return unit

    if used is None:
        with pytest.raises(GuessedUnit):
            with_unit_asked(run)
    else:
        assert with_unit_asked(run) == used
    assert "0.000125 would fit" in terminal.said


def save_parts(path: Path, parts: list[tuple[str, dict[str, NDArray[Any]]]]) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(
        [OpenEXR.Part({**header, "name": name}, dict(channels)) for name, channels in parts]
    ).write(str(path))


RGB = {c: np.full((H, W), v, np.float32) for c, v in zip("RGB", (0.1, 0.4, 0.9), strict=True)}


@pytest.mark.parametrize("name", ["Z", "depth.Z", "ViewLayer.Depth.Z", "depth", "Depth.V"])
def test_depth_beside_colour_in_one_exr(name: str, tmp_path: Path) -> None:
    depth = table(1.0, np.float32)
    write_exr(tmp_path / "a.exr", {**RGB, "A": RGB["R"], name: depth})
    found = read_foreign_depth(tmp_path / "a.exr", size=(W, H))
    assert (found.values == depth).all()


def test_depth_in_a_part_of_its_own(tmp_path: Path) -> None:
    depth = table(1.0, np.float32)
    save_parts(tmp_path / "a.exr", [("rgba", RGB), ("depth", {"Z": depth})])
    assert (read_foreign_depth(tmp_path / "a.exr", size=(W, H)).values == depth).all()
    with pytest.raises(ToolkitError, match="not aligned"):
        read_foreign_depth(tmp_path / "a.exr", size=(32, 24))


@pytest.mark.parametrize(
    "channels",
    [
        RGB,
        {"left.Z": RGB["R"], "right.Z": RGB["R"]},
        {"Y": RGB["R"], "RY": RGB["R"], "BY": RGB["R"]},
    ],
)
def test_colour_is_no_depth(channels: dict[str, NDArray[Any]], tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", channels)
    with pytest.raises(ToolkitError, match=r"colour image|several channels"):
        read_foreign_depth(tmp_path / "a.exr", size=(W, H))


def test_two_bytes_of_nocs(tmp_path: Path) -> None:
    depth = table()
    depth[0] = 32001
    coded = np.stack([np.zeros((H, W)), depth // 256, depth % 256], -1).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), coded)  # BGR
    found = read_foreign_depth(tmp_path / "a.png", size=(W, H), two_bytes=True).values
    assert (found[0] == 0).all() and (found[1:] == depth[1:]).all()
    with pytest.raises(ToolkitError, match="single-channel 16-bit"):
        read_foreign_depth(tmp_path / "a.png", size=(W, H))


def test_without_a_unit_nothing_is_called_a_mark() -> None:
    assert frame_marks(np.array([1, 65000, 65000], np.uint16), None) == []


def test_a_frame_with_a_mark_that_the_survey_did_not_see(tmp_path: Path) -> None:
    depth = table()
    depth[:4] = 65000
    write_png(tmp_path / "a.png", depth)
    found = read_foreign_depth(tmp_path / "a.png", size=(W, H), missing=Missing((), 0.00025))
    assert (found.values[:4] == 0).all() and found.marks == {65000.0: 4 * W}


def test_damaged_frames_do_not_stop_the_survey(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", table())
    (tmp_path / "b.png").write_bytes(b"no image")
    files = [DepthFile(tmp_path / n, (W, H), 0.001) for n in ("a.png", "b.png")]
    assert survey_depth(files, origin="guess").median_m == pytest.approx(0.65, abs=0.01)


def test_a_folder_of_nocs_camera(tmp_path: Path) -> None:
    depth = table()
    coded = np.stack([np.zeros((H, W)), depth // 256, depth % 256], -1).astype(np.uint8)
    for i in range(2):
        write_color(tmp_path / f"n/{i:04d}_color.png", np.full((H, W, 3), 90, np.uint8))
        cv2.imwrite(str(tmp_path / f"n/{i:04d}_depth.png"), coded)
        cv2.imwrite(str(tmp_path / f"n/{i:04d}_coord.png"), coded)
    request = ImportRequest(source=tmp_path / "n", name="n", intrinsics="60,60,31.5,23.5")
    found = depth_of(import_recording(request, tmp_path / "scene", format_name="nocs"))
    assert (found == depth * np.float32(0.001)).all()


@pytest.mark.parametrize(("unit", "number"), [(1e-4, 40_000), (1e-4, 30_000), (2e-4, 10_000)])
def test_a_wall_at_a_round_number_is_a_wall(unit: float, number: int, tmp_path: Path) -> None:
    depth = table(unit)
    depth[:10] = number
    found = recorded(tmp_path, depth, depth_scale=unit)
    values = found.read_depth(found.frames[0])
    assert values is not None
    assert values[:10] == pytest.approx(number * unit)


def test_65_metres_are_no_measurement_in_a_few_pixels_either(tmp_path: Path) -> None:
    depth = table()
    depth[0, :5] = 65_000
    found = recorded(tmp_path, depth)
    values = found.read_depth(found.frames[0])
    assert values is not None
    assert not values[0, :5].any()
    assert (values[0, 5:] > 0).all()
