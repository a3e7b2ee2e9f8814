"""LingBot-Depth (github.com/robbyant/lingbot-depth). Not run with its weights: they are not here.

python lingbot_depth.py todo/frames.csv MODEL.pt
"""

import sys

import numpy as np
import torch
from frame_list import fill
from mdm.model.v2 import MDMModel

device = "cuda" if torch.cuda.is_available() else "cpu"
model = MDMModel.from_pretrained(sys.argv[2]).to(device).eval()


def answer(color: np.ndarray, raw: np.ndarray, k: np.ndarray) -> np.ndarray:
    height, width = raw.shape
    relative = k / np.array([[width], [height], [1]], np.float32)  # as parts of width and height
    image = np.moveaxis(color, -1, 0).astype(np.float32) / 255
    given = [torch.from_numpy(np.ascontiguousarray(a))[None].to(device)
             for a in (image, raw, relative)]  # fmt: skip
    with torch.inference_mode():
        found = model.infer(given[0], depth_in=given[1], intrinsics=given[2])
    return found["depth"].squeeze().float().cpu().numpy()


fill(sys.argv[1], answer)
