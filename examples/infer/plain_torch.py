"""Restore the frames of a list with a TorchScript model, in an environment without std-toolkit.

    std-bench infer-list --data /data --split std-catknown --out todo
    python plain_torch.py todo/frames.csv model.pt           # needs torch, numpy, opencv-python
    std-bench depth --method mine=todo/predictions --data /data --split std-catknown --out results

The model takes colour (1, 3, h, w) in [0, 1] and raw depth (1, 1, h, w) in metres, 0 where nothing
was measured, and gives depth (1, 1, h, w) in metres.
"""

import csv
import sys
from pathlib import Path

import cv2
import numpy as np
import torch

model = torch.jit.load(sys.argv[2]).eval()
with open(sys.argv[1], newline="") as file:  # noqa: PTH123
    rows = list(csv.DictReader(file))
for row in rows:
    color = cv2.imread(row["color"])[:, :, ::-1].astype(np.float32) / 255
    raw = cv2.imread(row["raw"], cv2.IMREAD_UNCHANGED) * np.float32(row["raw_unit_m"])
    raw = cv2.resize(raw, color.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    with torch.inference_mode():
        images = np.moveaxis(color, -1, 0)[None], raw[None, None]
        depth = model(*(torch.from_numpy(np.ascontiguousarray(i)) for i in images))
    Path(row["out"]).parent.mkdir(parents=True, exist_ok=True)
    np.save(row["out"], depth[0, 0].numpy())
