"""The NOCS export through a loader written in the style of the public one."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import cv2
import msgspec
import numpy as np
import pytest
from scene_factory import SERIAL, make_scene

from std_toolkit.errors import ToolkitError
from std_toolkit.exporters import ExportOptions, export_scene
from std_toolkit.exporters.nocs_exporter import NocsExporter
from std_toolkit.exporters.std_exporter import write_depth_exr
from std_toolkit.geometry import umeyama
from std_toolkit.geometry.mesh import mesh_extents, nocs_frame
from std_toolkit.io.documents import write_document
from std_toolkit.scene import Scene
from std_toolkit.scene.model import Frames

CLASSES = {"other": 0, "can": 4, "mug": 6}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("nocs")
    scene = make_scene(folder / "scene", size=(320, 240), frames=2)
    options = ExportOptions(scene_number=3)
    export_scene(scene, "nocs", folder / "nocs", options=options, jobs=SERIAL)
    return scene, folder / "nocs"


def load(top: Path, stem: str) -> dict:
    path = str(top / "real/test/scene_3" / stem)
    lines = Path(path + "_meta.txt").read_text().splitlines(keepends=True)
    meta = [line[:-1].split(" ") for line in lines]
    coord = cv2.imread(path + "_coord.png")[:, :, (2, 1, 0)].astype(np.float32) / 255
    coord[:, :, 2] = 1 - coord[:, :, 2]
    return {
        "meta": meta,
        "mask": cv2.imread(path + "_mask.png")[:, :, 2].astype(np.int32),
        "depth": cv2.imread(path + "_depth.png", -1),
        "coord": coord,
        "color": cv2.imread(path + "_color.png"),
        "scales": [np.loadtxt(top / f"obj_models/real_test/{m[2]}.txt") for m in meta],
    }


def test_ids_are_line_numbers_and_the_background_is_255(exported):
    scene, top = exported
    for stem in ("0000", "0002"):
        sample = load(top, stem)
        assert [m[0] for m in sample["meta"]] == ["1", "2", "3"]
        assert all(len(m) == 3 for m in sample["meta"])  # of the real recordings
        ids = np.unique(sample["mask"])
        assert ids[-1] == 255
        assert set(ids[:-1]) <= {1, 2, 3}
        for line, object_id in zip(sample["meta"], (1, 4, 7), strict=True):
            assert int(line[1]) == CLASSES[scene.objects.model_of(object_id).category]


def test_depth_is_16_bit_millimetres(exported):
    scene, top = exported
    depth = load(top, "0000")["depth"]
    assert depth.dtype == np.uint16
    np.testing.assert_allclose(depth / 1000, scene.read_depth(scene.frames[0]), atol=0.51e-3)


def test_models_and_scales_fit_the_maps(exported):
    """NOCS * norm(scale) fits ground-truth depth rigidly, without any scale left to find."""
    scene, top = exported
    sample = load(top, "0000")
    camera = scene.camera(scene.frames[0])
    from std_toolkit.rendering.ground_truth import read_ground_truth

    truth_depth = read_ground_truth(scene, 0).depth
    for i, object_id in enumerate((1, 4, 7)):
        model = scene.objects.model_of(object_id)
        centre, diagonal = nocs_frame(scene.mesh(model.id))
        np.testing.assert_allclose(
            sample["scales"][i], mesh_extents(scene.mesh(model.id)), atol=1e-6
        )
        assert np.linalg.norm(sample["scales"][i]) == pytest.approx(diagonal, abs=1e-6)
        v, u = np.nonzero(sample["mask"] == i + 1)
        points = camera.unproject(np.stack([u, v], 1), truth_depth[v, u])
        fit = umeyama((sample["coord"][v, u].astype(float) - 0.5) * diagonal, points)
        assert fit.scale == pytest.approx(1, abs=0.01)
        assert np.linalg.norm(fit.t - scene.T_cam_obj(0, object_id) @ centre) < 1e-3
        assert (top / f"obj_models/real_test/{model.id}.obj").is_file()


def test_depth_beyond_16_bits_is_dropped_and_not_clipped(tmp_path):
    """65,535 mm are the last that fit; what is farther is no reading, not a wall at 65.5 m."""
    scene = make_scene(tmp_path / "scene", frames=1)
    frame = scene.frames[0]
    depth = scene.read_depth(frame)
    depth[3, 4:10] = 65.534, 65.535, 65.536, 70.0, 131.071, 1000.0
    write_depth_exr(scene.root / "depth/far.exr", depth)
    frames = Frames(frames=[msgspec.structs.replace(frame, depth="depth/far.exr")])
    write_document(scene.root / "frames.json", frames)
    options = ExportOptions(scene_number=3)
    export_scene(Scene.open(scene.root), "nocs", tmp_path / "nocs", options=options, jobs=SERIAL)
    exported = load(tmp_path / "nocs", "0000")["depth"]
    assert exported[3, 4:10].tolist() == [65534, 65535, 0, 0, 0, 0]
    assert np.count_nonzero(exported > 60_000) == 2


def test_more_objects_than_the_loader_supports_are_refused(tmp_path):
    target = SimpleNamespace(object_ids=list(range(19)), scene=SimpleNamespace(root=tmp_path))
    with pytest.raises(ToolkitError, match="at most 18 objects"):
        NocsExporter().check(target)
    target.object_ids.pop()
    NocsExporter().check(target)
