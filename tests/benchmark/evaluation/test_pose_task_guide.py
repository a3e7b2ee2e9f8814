"""The guide's pose method, as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from benchmark.data.splits import open_split
from benchmark.data.true_poses import known_boxes, true_poses
from benchmark.evaluation.tasks.pose import pose_view
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.pose import rotation_errors_deg
from tests.benchmark.evaluation.pose_set import SPLIT, write_pose_split

GUIDE = Path(__file__).parents[3] / "docs" / "pose.md"


def test_a_method_of_ones_own(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(import numpy.*?)```", GUIDE.read_text(), re.S)
    names: dict = {}
    exec(compile(code, str(GUIDE), "exec"), names)
    mine = names["Mine"](MethodOptions(settings={"fit": "ransac", "threshold_m": "0.01"}))
    mine.input_size = None
    source = open_split(SPLIT, write_pose_split(tmp_path, scenes=1, frames=1))
    frame = source.load(0, nocs=True)
    boxes = known_boxes(source, 0)
    truths = true_poses(frame, boxes)
    ids = [t.instance.mask_id for t in truths]
    masks = np.array([frame.mask == i for i in ids])
    classes = [t.instance.class_id for t in truths]
    mine.network = lambda *_: (classes, masks, frame.nocs, [1.0] * len(ids))
    (found,) = mine.estimate([pose_view(frame, frame.depth_true, mine, boxes=boxes)])
    errors = rotation_errors_deg(found.prediction.RT, np.array([t.RT for t in truths]))
    assert errors.max() < 1
    assert found.masks is not None and len(found.masks) == 3
