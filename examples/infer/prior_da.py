"""Prior Depth Anything (github.com/SpatialVision/Prior-Depth-Anything). Not run with its weights:
they are not here. The package looks for them itself, and downloads them.

    python prior_da.py todo/frames.csv
"""

import sys

import numpy as np
import torch
from frame_list import fill
from prior_depth_anything import PriorDepthAnything

device = "cuda:0" if torch.cuda.is_available() else "cpu"
model = PriorDepthAnything(device=device)


def answer(color: np.ndarray, raw: np.ndarray, _: np.ndarray) -> np.ndarray:
    if not (raw > 0).any():
        return np.zeros_like(raw)
    found = model.infer_one_sample(image=color, prior=raw, visualize=False)
    return torch.as_tensor(found).squeeze().float().cpu().numpy()


fill(sys.argv[1], answer)
