"""LM-O in BOP's layout, from the poses that are kept with the test data."""

from __future__ import annotations

import csv
import json
from pathlib import Path

RESULTS = "gt-pbrreal-rgb-mmodel_lmo-test_lmo.csv"


def write_lmo(source: Path, root: Path, *, unlisted_visible: float = 0.0) -> Path:
    """Lay the poses out: targets are the rows of the result file.

    Args:
        source: folder of the poses.
        root: folder to write.
        unlisted_visible: visible share of instances without a row.
    """
    folder = root / "test" / "000002"
    folder.mkdir(parents=True)
    (root / "models").symlink_to((source / "models").resolve())
    models = root / "models_eval"
    models.mkdir()
    for path in (source / "models").glob("*.ply"):
        (models / path.name).symlink_to(path.resolve())
    (models / "models_info.json").write_bytes((source / "models_info.json").read_bytes())
    camera = json.loads((source / "camera.json").read_text())
    (root / "camera.json").write_text(json.dumps(camera))
    K = [camera["fx"], 0, camera["cx"], 0, camera["fy"], camera["cy"], 0, 0, 1]
    gt = json.loads((source / "scene_gt.json").read_text())
    with (source / RESULTS).open() as file:
        rows = [(int(r["im_id"]), int(r["obj_id"])) for r in csv.DictReader(file)]
    listed = set(rows)
    documents = {
        folder / "scene_gt.json": gt,
        folder / "scene_camera.json": {k: {"cam_K": K, "depth_scale": 1.0} for k in gt},
        folder / "scene_gt_info.json": {
            k: [
                {"visib_fract": 1.0 if (int(k), e["obj_id"]) in listed else unlisted_visible}
                for e in entries
            ]
            for k, entries in gt.items()
        },
        root / "test_targets_bop19.json": [
            {"scene_id": 2, "im_id": i, "obj_id": o, "inst_count": 1} for i, o in rows
        ],
    }
    for path, content in documents.items():
        path.write_text(json.dumps(content))
    return root
