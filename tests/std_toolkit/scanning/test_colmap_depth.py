"""Depth maps by a user's COLMAP, with a stand-in for the program that answers in its files."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import trimesh

from std_toolkit.errors import ToolkitError
from std_toolkit.scanning.surface.colmap_depth import colmap_depth, read_array, write_workspace
from std_toolkit.scanning.surface.depth_maps import depth_engine
from tests.std_toolkit.scanning.ball import CENTRE, RADIUS, ball_views

# It reads the workspace on its own and answers with the depth of the ball.
PROGRAM = """#!{python}
import sys
from pathlib import Path
import numpy as np
import pycolmap

words = dict(zip(sys.argv[2::2], sys.argv[3::2]))
folder = Path(words["--workspace_path"])
assert sys.argv[1] == "patch_match_stereo"
low, high = (float(words["--PatchMatchStereo.depth_" + m]) for m in ("min", "max"))
lines = (folder / "stereo/patch-match.cfg").read_text().splitlines()
wanted = dict(zip(lines[::2], lines[1::2]))
model = pycolmap.Reconstruction(folder / "sparse")
centre, radius = np.array({centre}), {radius}
for image in model.images.values():
    if image.name not in wanted:
        continue
    assert (folder / "images" / image.name).is_file()
    assert all((folder / "images" / n).is_file() for n in wanted[image.name].split(", "))
    camera = model.cameras[image.camera_id]
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    xy = camera.cam_from_img(np.stack([x.ravel(), y.ravel()], 1))
    ray = np.concatenate([xy, np.ones((len(xy), 1))], 1)
    pose = image.cam_from_world()
    c = pose * centre
    a, b = (ray**2).sum(1), ray @ c
    root = b * b - a * (c @ c - radius**2)
    z = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0)
    assert ((z == 0) | ((z > low) & (z < high))).all()
    normal = np.where(z[:, None] > 0, (ray * z[:, None] - c) / radius, 0)
    for kind, values in (("depth", z[:, None]), ("normal", normal)):
        path = folder / "stereo" / (kind + "_maps") / (image.name + ".geometric.bin")
        head = f"{{camera.width}}&{{camera.height}}&{{values.shape[1]}}&".encode()
        planes = values.T.reshape(values.shape[1], camera.height, camera.width)
        path.write_bytes(head + planes.astype("<f4").tobytes())
"""


def install(folder: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    program = folder / "colmap"
    program.write_text(text)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")


def hull() -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(4, 1.03 * RADIUS)
    return np.asarray(mesh.vertices) + CENTRE, np.asarray(mesh.faces)


def test_depth_of_colmap_is_that_of_the_surface(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = PROGRAM.format(python=sys.executable, centre=CENTRE.tolist(), radius=RADIUS)
    install(tmp_path, text, monkeypatch)
    views = ball_views()
    engine = depth_engine("colmap")
    maps = engine(views, hull(), deepest=0.02, neighbours=4, threads=2)
    assert len(maps) == len(views) and all(m is not None for m in maps)
    for view, m in zip(views, maps, strict=True):
        assert m is not None
        v, u = np.nonzero(m.depth > 0)
        assert len(v) > 0.95 * view.shown.sum()
        at = np.stack([u + m.x, v + m.y], axis=1).astype(float)
        local = view.camera.unproject(at) * m.depth[v, u][:, None]
        world = view.T_world_cam @ local
        np.testing.assert_allclose(np.linalg.norm(world - CENTRE, axis=1), RADIUS, atol=1e-6)
        out = m.normal[v, u] @ view.T_world_cam.R.T
        np.testing.assert_allclose(out, (world - CENTRE) / RADIUS, atol=1e-4)
        assert (m.contrast[v, u] > 0).mean() > 0.9


def test_the_workspace_has_the_poses_and_pixels_of_the_photos(tmp_path: Path) -> None:
    views = ball_views(6)
    write_workspace(tmp_path, views, [[(k + 1) % 6, (k + 5) % 6] for k in range(6)])
    model = pycolmap.Reconstruction(tmp_path / "sparse")
    point = CENTRE + np.array([0.01, 0.02, 0.005])
    for image in model.images.values():
        view = views[int(Path(image.name).stem)]
        uv, _ = view.project(point[None])
        np.testing.assert_allclose(image.project_point(point), uv[0] + 0.5, atol=1e-6)
    lines = (tmp_path / "stereo/patch-match.cfg").read_text().splitlines()
    assert lines[:2] == ["00000.png", "00001.png, 00005.png"]


def test_without_colmap_it_is_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(pycolmap, "has_cuda", False)
    with pytest.raises(ToolkitError, match=r"--depth.*COLMAP with CUDA"):
        depth_engine("colmap")


def test_what_colmap_says_last_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "#!/bin/sh\necho starting\necho 'No CUDA device' >&2\nexit 3\n", monkeypatch)
    with pytest.raises(ToolkitError, match=r"status 3: .*starting|status 3: .*No CUDA device"):
        colmap_depth(ball_views(8), hull(), deepest=0.02, neighbours=4, threads=1)


def test_a_photo_without_a_map_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "#!/bin/sh\nexit 0\n", monkeypatch)
    maps = colmap_depth(ball_views(8), hull(), deepest=0.02, neighbours=4, threads=1)
    assert maps == [None] * 8


@pytest.mark.parametrize("data", [b"", b"4&3&1&", b"4&3&1&" + bytes(44), b"a&b&c&d", b"4&-3&1&xx"])
def test_a_damaged_map_is_named(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.bin").write_bytes(data)
    with pytest.raises(ToolkitError, match=r"a\.bin: no map of COLMAP"):
        read_array(tmp_path / "a.bin")
