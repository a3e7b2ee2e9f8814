"""Images, maps and meshes of a scene, damaged: named, and nothing else is touched."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from scene_on_disk import contents

from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_png


def png_bomb() -> bytes:
    """1 MB of zeros that claims to be 100,000 x 100,000 pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", 100_000, 100_000, 8, 2, 0, 0, 0)
    body = chunk(b"IDAT", zlib.compress(b"\0" * 1_000_000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + body + chunk(b"IEND", b"")


def encoded(suffix: str, image: np.ndarray) -> bytes:
    return cv2.imencode(suffix, image)[1].tobytes()


NOISE = np.random.default_rng(0).integers(0, 256, (72, 96, 3), dtype=np.uint8)


def bytes_of(content: bytes) -> Callable[[Path], None]:
    return lambda path: (path.unlink(missing_ok=True), path.write_bytes(content))[0]


def cut(share: float) -> Callable[[Path], None]:
    def damage(path: Path) -> None:
        data = path.read_bytes()
        path.write_bytes(data[: int(len(data) * share)])

    return damage


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def link_to(target: str) -> Callable[[Path], None]:
    return lambda path: (path.unlink(), path.symlink_to(target))[0]


ANY_FILE: dict[str, Callable[[Path], Any]] = {
    "missing": lambda path: path.unlink(),
    "empty": bytes_of(b""),
    "text": bytes_of(b"not an image\n" * 50),
    "html": bytes_of(b"<html>404 not found</html>"),
    "zeros": bytes_of(b"\0" * 5000),
    "half": cut(0.5),
    "nearly_whole": cut(0.99),
    "header": cut(0.02),
    "flipped_bit": flip,
    "pipe": pipe,
    "folder": folder,
    "link_to_device": link_to("/dev/zero"),
    "link_to_nothing": link_to("/nowhere/at/all"),
    "link_to_text": link_to("/etc/passwd"),
}
COLOUR = {
    **ANY_FILE,
    "bomb": bytes_of(png_bomb()),
    "other_size": bytes_of(encoded(".png", NOISE[:36, :48])),
    "turned": bytes_of(encoded(".png", NOISE.transpose(1, 0, 2))),
    "jpeg_named_png": bytes_of(encoded(".jpg", NOISE)),
    "bmp_named_png": bytes_of(encoded(".bmp", NOISE)),
    "16_bit": bytes_of(encoded(".png", NOISE.astype(np.uint16) * 257)),
}
DEPTH = {
    **ANY_FILE,
    "bomb": bytes_of(png_bomb()),
    "other_size": bytes_of(encoded(".png", np.full((36, 48), 800, np.uint16))),
    "8_bit": bytes_of(encoded(".png", np.full((72, 96), 80, np.uint8))),
    "picture": bytes_of(encoded(".png", NOISE)),
    "unit_100_um_too_coarse": bytes_of(encoded(".png", np.full((72, 96), 60_000, np.uint16))),
    "in_metres": bytes_of(encoded(".png", np.full((72, 96), 1, np.uint16))),
}


@pytest.fixture
def report(root: Path, run: Any, tmp_path: Path) -> Callable[..., str]:
    """Assert that a command names the damaged file and changes nothing that was there.

    Ground truth of a frame that cannot be rendered any more may go: it would be stale.
    """

    def files(path: Path) -> dict[str, bytes]:
        stale = f"/{path.stem}."
        everything = contents(root).items()
        return {
            name: data
            for name, data in everything
            if root / name != path and not (name.startswith("gt/") and stale in name)
        }

    def assert_reported(path: Path, *arguments: object) -> str:
        before = files(path)
        outcome = run(*arguments)
        shown = outcome.err + outcome.out
        assert outcome.status == 1, shown
        assert path.name in outcome.err, shown
        assert "Traceback" not in shown
        assert "a defect of" not in shown, shown
        assert len(outcome.error_lines) <= 1
        after = files(path)
        assert {k: after.get(k) for k in before} == before
        return outcome.err

    return assert_reported


def export(root: Path, out: Path) -> tuple[object, ...]:
    return ("export", root, "--format", "bop", "--out", out, "--engine", "serial")


@pytest.mark.parametrize("damage", COLOUR)
def test_a_damaged_colour_image_is_named(
    root: Path, tmp_path: Path, report: Any, damage: str
) -> None:
    path = root / "color/000001.png"
    COLOUR[damage](path)
    report(path, *export(root, tmp_path / "out"))
    assert not (tmp_path / "out").exists() or not any(
        p.name == "scene_gt.json" for p in (tmp_path / "out").rglob("*")
    )


@pytest.mark.parametrize("damage", DEPTH)
def test_a_damaged_depth_image_is_named(
    root: Path, tmp_path: Path, report: Any, damage: str
) -> None:
    path = root / "depth/000001.png"
    DEPTH[damage](path)
    report(path, *export(root, tmp_path / "out"))
    report(
        path, "render", root, "--renderer", "raycast", "--policy", "sensor", "--engine", "serial"
    )


def all_nan(path: Path) -> None:
    write_exr(path, {"Y": np.full((72, 96), np.nan, np.float32)})


MAPS = [
    *(
        (f"gt/{kind}", damage)
        for kind in ("depth/000001.exr", "mask/000001.png")
        for damage in ("missing", "empty", "half", "flipped_bit", "text")
    ),
    ("gt/nocs/000001.png", "half"),
]


@pytest.mark.parametrize(("name", "damage"), MAPS)
def test_a_damaged_map_is_made_again_by_rendering(
    root: Path, pristine: Path, run: Any, name: str, damage: str
) -> None:
    """What the toolkit made itself is no error: it is stale, and rendering mends it."""
    path = root / name
    ANY_FILE[damage](path)
    outcome = run("render", root, "--renderer", "raycast", "--engine", "serial")
    assert outcome.status == 0, outcome.err
    assert path.read_bytes() == (pristine / name).read_bytes()


def millimetres(path: Path) -> None:
    trimesh.creation.box((60, 40, 100)).export(path)


MESHES: dict[str, Callable[[Path], Any]] = {
    "missing": lambda path: path.unlink(),
    "empty": bytes_of(b""),
    "half": cut(0.5),
    "text": bytes_of(b"not a mesh"),
    "in_millimetres": millimetres,
    "bomb": bytes_of(
        b"ply\nformat binary_little_endian 1.0\nelement vertex 900000000000\nproperty float x\n"
        b"property float y\nproperty float z\nelement face 1\n"
        b"property list uchar int vertex_indices\nend_header\n"
    ),
    "points_only": bytes_of(
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        b"property float z\nend_header\n0 0 0\n"
    ),
    "pipe": pipe,
    "link_to_device": link_to("/dev/zero"),
}


@pytest.mark.parametrize("damage", MESHES)
def test_a_damaged_mesh_is_named(root: Path, report: Any, damage: str) -> None:
    path = root / "models/box/box.ply"
    MESHES[damage](path)
    report(path, "propagate", root)
    report(path, "render", root, "--renderer", "raycast", "--engine", "serial")


def test_depth_without_its_scale_is_named(root: Path, tmp_path: Path, report: Any) -> None:
    scene = root / "scene.json"
    scene.write_text(scene.read_text().replace('"depth_scale": 0.001', '"depth_scale": null'))
    report(root / "depth/000000.png", *export(root, tmp_path / "out"))


def test_depth_of_negative_numbers_is_named(root: Path, tmp_path: Path, report: Any) -> None:
    for i in range(3):
        (root / f"depth/{i:06d}.png").unlink()
        write_exr(root / f"depth/{i:06d}.exr", {"Z": np.full((72, 96), -0.8, np.float32)})
    frames = root / "frames.json"
    text = frames.read_text()
    for i in range(3):
        text = text.replace(f"depth/{i:06d}.png", f"depth/{i:06d}.exr")
    frames.write_text(text)
    report(root / "depth/000000.exr", *export(root, tmp_path / "out"))


def test_a_link_in_place_of_an_output_is_replaced_and_not_written_through(
    root: Path, tmp_path: Path, run: Any
) -> None:
    precious = tmp_path / "precious"
    precious.write_bytes(b"keep")
    for name in ("labels.json", "gt/mask/000001.png", ".std/records/propagate.json"):
        path = root / name
        data = path.read_bytes()
        path.unlink()
        path.symlink_to(precious)
        if name == "labels.json":  # it must be readable to get anywhere
            precious.write_bytes(data)
        outcome = (
            run("propagate", root)
            if "gt" not in name
            else run("render", root, "--renderer", "raycast", "--engine", "serial")
        )
        assert "a defect of" not in outcome.err, outcome.err
        if name == "labels.json":
            assert precious.read_bytes() == data
            precious.write_bytes(b"keep")
            path.unlink(missing_ok=True)
            path.write_bytes(data)
        assert precious.read_bytes() == b"keep"


def test_an_unwritable_disk_is_one_line(
    root: Path, run: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    before = contents(root)
    (root / ".std/records/propagate.json").unlink()
    monkeypatch.setattr(os, "fsync", fail)
    outcome = run("propagate", root)
    assert outcome.status == 1
    assert "No space left on device" in outcome.error_lines[0]
    monkeypatch.undo()
    before.pop(".std/records/propagate.json")
    assert contents(root) == before


def test_an_interrupted_command_says_how_to_go_on(
    root: Path, run: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from std_toolkit.scene import Scene

    def interrupt(*args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Scene, "open", interrupt)
    outcome = run("info", root)
    assert outcome.status == 130
    assert outcome.err.strip() == "interrupted; run the same command again to resume"


def test_a_defect_of_ours_is_one_line_too(
    root: Path, run: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from std_toolkit.cli.main import main
    from std_toolkit.scene import Scene

    def fail(*args: object) -> None:
        raise ZeroDivisionError("two\nlines")

    monkeypatch.setattr(Scene, "open", fail)
    outcome = run("info", root)
    assert outcome.status == 1
    assert outcome.err.startswith("error: unexpected ZeroDivisionError: two lines; a defect of")
    assert outcome.err.count("\n") == 1
    with pytest.raises(ZeroDivisionError):
        main(["--debug", "info", str(root)])


def test_a_wrong_folder_is_one_line(tmp_path: Path, run: Any) -> None:
    write_png(tmp_path / "image.png", np.zeros((2, 2), np.uint8))
    for path in (tmp_path, tmp_path / "missing", tmp_path / "image.png", Path("/dev/null")):
        outcome = run("info", path)
        assert outcome.status == 1
        assert len(outcome.error_lines) == 1
        assert str(path) in outcome.err
