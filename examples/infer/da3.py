"""Depth Anything 3 (github.com/ByteDance-Seed/depth-anything-3), colour alone. Not run with its
weights: they are not here.

    python da3.py todo/frames.csv FOLDER
    std-bench depth --method da3=todo/predictions --protocol aligned-frame ...

Only its metric models give metres, some of them for a focal length of their own: read their card
before you score by another protocol.
"""

import sys

import numpy as np
import torch
from depth_anything_3.api import DepthAnything3
from frame_list import fill

device = "cuda" if torch.cuda.is_available() else "cpu"
model = DepthAnything3.from_pretrained(sys.argv[2]).to(device).eval()


def answer(color: np.ndarray, _: np.ndarray, __: np.ndarray) -> np.ndarray:
    return np.asarray(model.inference([color]).depth[0])


fill(sys.argv[1], answer)
