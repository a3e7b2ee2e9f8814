"""Depth from colour alone with `transformers`, in an environment without std-toolkit.

    std-bench infer-list --data /data --split std-catknown --out todo
    python depth_anything.py todo/frames.csv SNAPSHOT  # needs torch, transformers, opencv-python
    std-bench depth --method da2=todo/predictions --data /data --split std-catknown \
        --protocol aligned-frame --out results

SNAPSHOT is your folder of a Depth Anything 2 model. Metric ones give metres; relative ones give
disparity, of which depth is taken as the inverse. Images are prepared without torchvision.
"""

import csv
import sys
from pathlib import Path

import cv2
import numpy as np
import torch
from transformers import AutoModelForDepthEstimation

SIDE, MEAN, DEVIATION = 518, (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
model = AutoModelForDepthEstimation.from_pretrained(sys.argv[2]).eval()
patch = model.config.backbone_config.patch_size
with open(sys.argv[1], newline="") as file:  # noqa: PTH123
    rows = list(csv.DictReader(file))
for row in rows:
    color = cv2.imread(row["color"])[:, :, ::-1].astype(np.float32) / 255
    scale = SIDE / min(color.shape[:2])
    size = [max(patch, patch * round(n * scale / patch)) for n in color.shape[1::-1]]
    small = (cv2.resize(color, size, interpolation=cv2.INTER_CUBIC) - MEAN) / DEVIATION
    with torch.inference_mode():
        pixels = torch.from_numpy(np.moveaxis(small, -1, 0)[None].astype(np.float32))
        found = model(pixel_values=pixels).predicted_depth[0].numpy()
    if model.config.depth_estimation_type == "relative":
        found = 1 / np.maximum(found, 1e-6)
    Path(row["out"]).parent.mkdir(parents=True, exist_ok=True)
    np.save(row["out"], cv2.resize(found, color.shape[1::-1], interpolation=cv2.INTER_LINEAR))
