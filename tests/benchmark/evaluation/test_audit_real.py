"""Labels of real sets: first poses are told from refined ones; labels that leave their place."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from benchmark.data.field.label_sets import open_labels
from benchmark.evaluation.audit.judged import audited
from benchmark.evaluation.audit.record import AuditedLabel
from benchmark.evaluation.audit.rigid import groups_of
from std_toolkit.geometry import SE3
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.options import CheckOptions

pytestmark = [pytest.mark.real, pytest.mark.slow]

K = [618.0172729492188, 0, 312.376953125, 0, 618.0033569335938, 232.37530517578125, 0, 0, 1]


def write_ycb(data: Path, root: Path, kind: str, image: int) -> Path:
    """A frame with real depth in BOP's form; `kind` names the poses. No symmetry is declared."""
    folder, meshes = data / "realsense_ycb_frames", data / "ycb_meshes"
    names = sorted(p.name for p in meshes.iterdir() if p.is_dir() and p.name != "051_large_clamp")
    scene = root / "test" / "000001"
    for part in ("rgb", "depth"):
        (scene / part).mkdir(parents=True)
    (root / "models").mkdir()
    filed = scipy.io.loadmat(str(folder / "reference_poses" / f"{image:06d}-color.png.mat"))
    rows = []
    for number, pose in zip(filed["rois"][:, 1].astype(int), filed[kind], strict=True):
        T = SE3.from_quat(pose[:4], pose[4:7])
        rows.append({"obj_id": int(number), "cam_R_m2c": T.R.ravel().tolist(),
                     "cam_t_m2c": (1000 * T.t).tolist()})  # fmt: skip
        mesh = load_mesh(meshes / names[number - 1] / "textured.obj")
        mesh.vertices = 1000 * np.asarray(mesh.vertices)
        mesh.visual = mesh.visual.to_color()
        mesh.export(root / "models" / f"obj_{number:06d}.ply")
    (scene / "scene_gt.json").write_text(json.dumps({"0": rows}))
    (scene / "scene_camera.json").write_text(json.dumps({"0": {"cam_K": K}}))
    shutil.copy(folder / f"{image:06d}-color.png", scene / "rgb/000000.png")
    shutil.copy(folder / f"{image:06d}-depth.png", scene / "depth/000000.png")
    return root


def labels_of(root: Path) -> dict[str, AuditedLabel]:
    source = open_labels(root, "bop")
    (group,) = groups_of([source.labels(0)])
    return {x.object: x for x in audited("ycb", group, source, CheckOptions()).labels}


def test_first_poses_are_told_from_refined_ones(test_data: Path, tmp_path: Path) -> None:
    """Five boxes, bowls and bottles; first poses are 10 to 80 mm off their refined ones."""
    first = labels_of(write_ycb(test_data, tmp_path / "first", "poses", 0))
    refined = labels_of(write_ycb(test_data, tmp_path / "refined", "poses_refined", 0))
    for kind, labels in (("first", first), ("refined", refined)):
        for name in ("error_mm", "error_deg"):
            sizes = [getattr(x, name) for x in labels.values()]
            print(f"{kind} {name}: median {np.median([s.value for s in sizes]):.1f} of {sizes}")
    assert len(first) == 5
    assert {x.verdict for x in first.values()} == {"wrong"}
    for name, label in first.items():
        better = refined[name]
        assert label.error_mm is not None
        assert better.error_mm is not None
        assert label.error_mm.value > 1.5 * better.error_mm.value, (name, label, better)
        # Both are measured from the depth of one sensor, whose error they share.
        assert label.error_mm.value > 10 > better.error_mm.value, (name, label, better)
        assert (label.source, better.source) == ("one frame", "one frame")
        assert (label.along_std_mm or 0) > 4, "depth alone tells the distance to a percent"


def test_labels_of_lmo_without_images(test_data: Path, tmp_path: Path) -> None:
    """Labels against each other: rotations, penetration, and frames that leave their place."""
    folder = test_data / "lmo_poses"
    scene = tmp_path / "test" / "000002"
    scene.mkdir(parents=True)
    gt = json.loads((folder / "scene_gt.json").read_text())
    c = json.loads((folder / "camera.json").read_text())
    row = {"cam_K": [c["fx"], 0, c["cx"], 0, c["fy"], c["cy"], 0, 0, 1]}
    (scene / "scene_gt.json").write_text(json.dumps(gt))
    (scene / "scene_camera.json").write_text(json.dumps(dict.fromkeys(gt, row)))
    (tmp_path / "models").symlink_to(folder / "models")
    source = open_labels(tmp_path, "bop")
    frames = [source.labels(i) for i in range(len(source.keys()))]
    rough = [o.rotation_off for f in frames for o in f.objects]
    assert len(rough) == 1517
    assert max(rough) == pytest.approx(9.6e-3, abs=5e-5)
    groups = groups_of(frames)
    # Objects were rearranged during the recording: only runs stand still.
    runs = [g for g in groups if g.cameras == "from the labels"]
    assert sum(len(g.frames) for g in runs) > 100
    off = np.array([o for g in runs for o in g.off.values()])
    typical, most = np.median(off, axis=0), off.max(axis=0)
    print(f"LM-O, {len(runs)} runs: {(off[:, 0] > 4).sum()} of {len(off)} labels leave their place")
    assert typical[0] < 1.0
    assert typical[1] < 0.3
    assert most[0] > 20
    alone = groups_of([f for f in frames if f.key.name == "001212"])
    deep = [x.overlap_mm or 0 for x in audited("lmo", alone[0], source, CheckOptions()).labels]
    assert max(deep) == pytest.approx(6.2, abs=0.5)
